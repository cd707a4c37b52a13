"""Flights of the simulated vehicle in lockstep."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from . import _downwash as _native
from ._arguments import Effects, Path, count, effects_json, listed, seed_of, to_json
from ._plan import Plan
from ._progress import Progress, teller
from ._rows import Rows
from ._trajectory import Trajectory, trajectory_of
from ._vehicle import Vehicle, vehicle_of


def settings_of(
    settings: Mapping[str, Any] | None, controller: str | Mapping[str, Any] | None
) -> str:
    """Encodes settings by dotted path as JSON, including the controller's."""
    found = dict(settings or {})
    if isinstance(controller, str):
        found["control.law"] = controller
    elif isinstance(controller, Mapping):
        found |= {f"control.{key}": value for key, value in controller.items()}
    elif controller is not None:
        raise TypeError("controller: expected the name of a law, or a table of its settings")
    return to_json("settings", found)


def _onsets_json(onsets: Iterable[tuple[float, Effects]]) -> str:
    try:
        pairs = [(float(at_s), effects) for at_s, effects in listed("onsets", onsets)]
    except (TypeError, ValueError):
        raise TypeError("onsets: expected pairs of a time in s and effects") from None
    return to_json("onsets", pairs)


def _reference_of(
    given: Trajectory | Plan | Mapping[str, Any] | Path,
) -> _native.Trajectory | _native.Plan:
    # As on the command line, a file with this ending is a plan.
    if isinstance(given, (str, os.PathLike)) and os.fspath(given).endswith(".json"):
        return Plan.load(given)._native
    return given._native if isinstance(given, Plan) else trajectory_of(given)._native


def fly(
    vehicle: Vehicle | Path = "crazyflie",
    trajectory: Trajectory | Plan | Mapping[str, Any] | Path = "sinusoid-yaw",
    effects: Effects | None = None,
    controller: str | Mapping[str, Any] | None = None,
    seeds: int | Iterable[int] = 1,
    *,
    onsets: Iterable[tuple[float, Effects]] = (),
    settings: Mapping[str, Any] | None = None,
    config: Path | None = None,
    simulation: Mapping[str, Any] | None = None,
    logs: Path | None = None,
    jobs: int | None = None,
    progress: Progress = None,
) -> Rows:
    """Flies the simulated vehicle in lockstep, once for each seed, and returns a row for each flight.

    ``trajectory`` may be a plan, or the path of a plan file (.json). The controller knows the vehicle file.
    The vehicle also has ``effects``, and those of ``onsets``, pairs of a time in s on its clock and effects. ``controller`` is the name of a law, or settings of
    ``control``; ``settings`` are other settings by dotted path, which override the configuration file
    ``config``. ``simulation`` has keys of the simulated vehicle's configuration. With ``logs``, each
    flight's log goes into the subfolder ``seed-N``. ``jobs`` flights run at once, by default one for each
    core. The rows are those of ``downwash simulate --json``, in the order of the seeds, whatever ``jobs``
    is.
    """
    of = [seeds] if isinstance(seeds, (int, np.integer)) else listed("seeds", seeds)
    if jobs is not None:
        jobs = count("jobs", jobs, 1, 1024)
    rows = _native.fly(
        vehicle_of(vehicle)._native,
        _reference_of(trajectory),
        effects_json(effects),
        _onsets_json(onsets),
        settings_of(settings, controller),
        config,
        None if simulation is None else to_json("simulation", dict(simulation)),
        [seed_of(seed) for seed in of],
        logs,
        jobs,
        teller(progress),
    )
    return Rows(json.loads(row) for row in rows)
