"""downwash and the paper's LQR: from the ground, over the wire, through noisy telemetry."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import downwash as dw
import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from missions import RATE_HZ, Array, desired, error_m, trajectory
from vehicles import Drawn

OWN_FLIGHT_S = 60
# A subproblem limit ends searches, not the clock: a busy machine finds the same plans.
PLANNING = {"plan.time_limit_s": 600.0, "plan.subproblems_max": 12}
REGULARIZATION = 1e-5
FLYING: dict[str, Any] = {"control.adaptive": True}
# A payload beside the middle leaves the paper's feedback too far from where it should be.
COLLECTING = '[offboard.offset_free]\nobserver = "on"\n'
UNPLANNED: dict[str, Any] = {"offboard.offset_free.feed_forward": "on"}


def flown(log: str, points: Array) -> tuple[float | None, float | None]:
    """The true error along the desired points, m, and their start on the vehicle's clock, s;
    None if they were never followed, no error if the log ends before they do."""
    decoders = [DecoderFactory()]
    with Path(log).open("rb") as file:
        reader = make_reader(file, decoder_factories=decoders)
        for _, _, message, tick in reader.iter_decoded_messages(topics=["/control"]):
            if np.isfinite(tick.trajectory_time_s):
                begin_ns = message.log_time - round(1e9 * tick.trajectory_time_s)
                break
        else:
            return None, None
        margin_ns = 20_000_000
        end_ns = begin_ns + round(1e9 * (len(points) - 1) / RATE_HZ)
        rows = [
            (message.log_time - begin_ns, true.vehicle_time_us, true.p_n_m, true.p_e_m, true.p_d_m)
            for _, _, message, true in reader.iter_decoded_messages(
                topics=["/sim/truth"],
                start_time=begin_ns - margin_ns,
                end_time=end_ns + margin_ns,
            )
        ]
    truth = np.array(rows, dtype=float)
    at = truth[:, 0] * 1e-9
    begin = float(np.interp(0.0, at, truth[:, 1])) * 1e-6
    times = np.arange(len(points)) / RATE_HZ
    if at[-1] < times[-1]:
        return None, begin
    positions = np.array([np.interp(times, at, truth[:, i]) for i in (2, 3, 4)]).T
    return error_m(positions, points), begin


def _fly(
    drawn: Drawn, course: Any, mission: str, seed: int, folder: Path, settings: dict[str, Any]
) -> dict[str, Any]:
    row = dw.fly(
        drawn.vehicle(), course, drawn.effects, settings=settings, seeds=seed, logs=folder, jobs=1
    )[0]
    error, begin = flown(row["log"], desired(mission))
    os.remove(row["log"])
    # The flight ended before the mission: lost, or landed early by its supervisor.
    crashed = row["end"] != "done" or error is None
    return {
        "crashed": crashed,
        "error_m": None if crashed else error,
        "end": row["end"],
        "begin_s": begin,
    }


def model_free(drawn: Drawn, mission: str, seed: int, folder: Path) -> dict[str, Any]:
    """The paper's LQR along the trajectory, without learning or estimation."""
    return _fly(drawn, trajectory(mission), mission, seed, folder / "lqr", {})


def _own_flight(drawn: Drawn, seed: int, folder: Path) -> list[Path]:
    """Logs of one minute of the programme that `downwash collect` flies."""
    vehicle, effects = folder / "vehicle.json", folder / "effects.toml"
    config = folder / "collect.toml"
    config.write_text(COLLECTING)
    drawn.vehicle().save(vehicle)
    lines = []
    for name, values in drawn.effects.items():
        lines += [f"[{name}]", *(f"{key} = {value}" for key, value in values.items())]
    effects.write_text("\n".join(lines) + "\n")
    command = [sys.executable, "-m", "downwash", "collect", "--out", str(folder / "own")]
    command += ["--vehicle", str(vehicle), "--effects", str(effects), "--config", str(config)]
    command += ["--seconds", str(OWN_FLIGHT_S), "--seed", str(seed), "--jobs", "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    logs = sorted((folder / "own").glob("*.mcap"))
    if not logs:
        raise RuntimeError(f"no own flight: {done.stderr[-500:]}")
    return logs


def learned_from_own_flight(
    drawn: Drawn, seed: int, folder: Path
) -> tuple[dw.Model, dict[str, Any]]:
    """The model, and its training data. It sees only a file and a minute of logs."""
    logs = _own_flight(drawn, seed, folder)
    model = dw.Learner(drawn.vehicle(), regularization=(REGULARIZATION,)).fit(logs).model_
    return model, {"logs": len(logs), "kind": model.preferred}


def planned(
    drawn: Drawn, model: dw.Model, mission: str, seed: int, folder: Path
) -> dict[str, Any]:
    """Plans through the learned model, and flies the plan."""
    began = time.monotonic()
    # Within the thrust that the configuration's envelope allows a trajectory, 1.6 g.
    bound = {"offboard.limits.thrust_max": min(0.9, 1.5 * drawn.file["hover_thrust"])}
    plan = dw.plan(trajectory(mission), drawn.vehicle(), model, settings=PLANNING | bound)
    planned_s = round(time.monotonic() - began, 2)
    outcome = {"plan": plan.status, "not_flyable": plan.not_flyable, "plan_s": planned_s}
    if plan.not_flyable is None:
        try:
            return _fly(drawn, plan, mission, seed, folder / "plan", FLYING) | outcome
        except dw.DownwashError as refusal:
            outcome["not_flyable"] = str(refusal)
    # Without a flyable plan, it flies the trajectory itself.
    course = trajectory(mission)
    return _fly(drawn, course, mission, seed, folder / "plan", FLYING | UNPLANNED) | outcome
