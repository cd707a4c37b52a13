"""The rows of `duel.py` as Markdown."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
from missions import MISSIONS

WHO = {
    "downwash": "downwash, after 60 s of own flight",
    "raptor": "RAPTOR, zero-shot",
    "lqr": "the paper's LQR, model-free",
    "se3": "RotorPy's SE3",
}


def rows(path: str) -> list[dict[str, Any]]:
    found = {}
    for line in Path(path).read_text().splitlines():
        row = json.loads(line)
        # A later row of a vehicle replaces the earlier.
        found[row["seed"], row["index"]] = row
    return [found[key] for key in sorted(found)]


def errors(flown: list[dict[str, Any]], mission: str, who: str) -> np.ndarray:
    """Errors in m; infinite for a crash."""
    each = (row["missions"][mission][who] for row in flown)
    return np.array([math.inf if e["crashed"] else e["error_m"] for e in each])


def quantile(values: np.ndarray, share: float) -> float:
    # There is no interpolation towards infinity.
    if np.isinf(high := np.quantile(values, share, method="higher")):
        return float(high)
    return float(np.quantile(np.where(np.isinf(values), high, values), share))


def length(value: float) -> str:
    return "crash" if math.isinf(value) else f"{value:.4f}"


def ratio(of: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Ratio of the errors `of` to `to`, vehicle by vehicle; 1 if both crash."""
    both = np.isinf(of) & np.isinf(to)
    return np.where(both, 1.0, of / np.where(both, 1.0, to))


def main() -> None:
    everything = rows(sys.argv[1])
    flown = [row for row in everything if "failure" not in row]
    print(f"{len(flown)} vehicles, {len(everything) - len(flown)} that the bench failed on\n")
    head = ["Mission", "Competitor", "median m", "quartiles m", "worst m", "crashes"]
    head += ["their error over downwash's, median", "vehicles where downwash is worse"]
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for mission in MISSIONS:
        own = errors(flown, mission, "downwash")
        for who, title in WHO.items():
            theirs = errors(flown, mission, who)
            cells = [mission, title, length(quantile(theirs, 0.5))]
            cells.append(f"{length(quantile(theirs, 0.25))} to {length(quantile(theirs, 0.75))}")
            cells += [length(float(theirs.max())), str(int(np.isinf(theirs).sum()))]
            if who == "downwash":
                cells += ["", ""]
            else:
                worse = int((own > theirs).sum())
                cells.append(f"{np.median(ratio(theirs, own)):.1f}")
                cells.append(f"{worse} of {len(own)}")
            print("| " + " | ".join(cells) + " |")
    print("\nBy effect that the file does not say, median m over the missions (vehicles with two count twice):\n")
    print("| Effect | vehicles | " + " | ".join(WHO.values()) + " |")
    print("|" + "---|" * (2 + len(WHO)))
    for kind in sorted({kind for row in flown for kind in row["kinds"]}):
        some = [row for row in flown if kind in row["kinds"]]
        medians = [
            length(quantile(np.concatenate([errors(some, m, who) for m in MISSIONS]), 0.5))
            for who in WHO
        ]
        print("| " + " | ".join([kind, str(len(some)), *medians]) + " |")
    lost = [
        (row["index"], mission, who, row["missions"][mission][who].get("end", "lost"))
        for row in flown
        for mission in MISSIONS
        for who in WHO
        if row["missions"][mission][who]["crashed"]
    ]
    if lost:
        print("\nCrashes and flights that ended early: ", end="")
        print("; ".join(f"vehicle {i}, {mission}, {who}: {end}" for i, mission, who, end in lost))


if __name__ == "__main__":
    main()
