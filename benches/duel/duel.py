"""Flies random vehicles with every competitor, one JSON row per vehicle; existing rows are kept.

    python duel.py ROWS [VEHICLES] [SEED] [JOBS]
"""

from __future__ import annotations

import json
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import downwash as dw
import ground
import onboard
from missions import MISSIONS, desired
from raptor import Policy
from se3 import Geometric
from vehicles import draw

# When a flight from the ground never reaches its mission, the on-board controllers start at the usual time.
USUAL_BEGIN_S = 9.0
SEEDS_APART = 100_000


def fly(seed: int, index: int) -> dict[str, Any]:
    """One vehicle, on every mission, with every competitor."""
    began = time.monotonic()
    drawn = draw(seed, index)
    # The file must not contain the hidden effects.
    assert dw.Vehicle.parse(json.dumps(drawn.file)).to_dict()["modelled_effects"] == {}
    flight_seed = seed * SEEDS_APART + index
    own_seed = flight_seed + SEEDS_APART // 2
    errors: dict[str, dict[str, Any]] = {mission: {} for mission in MISSIONS}
    with TemporaryDirectory() as name:
        folder = Path(name)
        for mission, row in errors.items():
            row["lqr"] = ground.model_free(drawn, mission, flight_seed, folder)
        courses = [desired(mission) for mission in MISSIONS]
        begins = [row["lqr"]["begin_s"] or USUAL_BEGIN_S for row in errors.values()]
        for who, make in (("raptor", Policy), ("se3", lambda _: Geometric(drawn))):
            flown = onboard.fly(drawn, courses, begins, flight_seed, make)
            for row, each in zip(errors.values(), flown, strict=True):
                row[who] = each
        learning = time.monotonic()
        model, own = ground.learned_from_own_flight(drawn, own_seed, folder)
        learning = time.monotonic() - learning
        for mission, row in errors.items():
            row["downwash"] = ground.planned(drawn, model, mission, flight_seed, folder)
    return {
        "seed": seed,
        "index": index,
        "version": dw.__version__,
        "mass_kg": drawn.file["mass"],
        "kinds": drawn.kinds,
        "effects": drawn.effects,
        "own": own,
        "learn_s": round(learning, 2),
        "wall_s": round(time.monotonic() - began, 2),
        "missions": errors,
    }


def attempt(seed: int, index: int) -> dict[str, Any]:
    """As `fly`; an error of the bench becomes a row with its reason, never a missing vehicle."""
    try:
        return fly(seed, index)
    except Exception as error:  # noqa: BLE001
        return {"seed": seed, "index": index, "failure": f"{type(error).__name__}: {error}"}


def main() -> None:
    path = Path(sys.argv[1])
    given = [int(argument) for argument in sys.argv[2:]]
    count, seed, jobs = given + [100, 1, 2][len(given) :]
    path.parent.mkdir(parents=True, exist_ok=True)
    there = set()
    if path.exists():
        for line in path.read_text().splitlines():
            row = json.loads(line)
            if row["seed"] == seed and "failure" not in row:
                there.add(row["index"])
    missing = [index for index in range(count) if index not in there]
    with ProcessPoolExecutor(jobs) as pool, path.open("a") as file:
        for done in as_completed([pool.submit(attempt, seed, index) for index in missing]):
            row = done.result()
            file.write(json.dumps(row) + "\n")
            file.flush()
            outcome = row.get("failure") or {
                mission: {who: each["error_m"] and round(each["error_m"], 4) for who, each in row.items()}
                for mission, row in row["missions"].items()
            }
            print(row["index"], row.get("kinds"), outcome, f"{row.get('wall_s')} s", file=sys.stderr)


if __name__ == "__main__":
    # Two processes share the cores; each process is single-threaded.
    os.environ.setdefault("RAYON_NUM_THREADS", "1")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
