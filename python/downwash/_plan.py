"""Plans: feasible references near a desired trajectory."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path as _FilePath
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from . import _downwash as _native
from ._arguments import Array, Path, to_json
from ._progress import Progress, teller
from ._trajectory import Trajectory
from ._vehicle import Vehicle, vehicle_of

if TYPE_CHECKING:
    from ._model import Model

PLAN_STATE: Final = (
    "north_m",
    "east_m",
    "down_m",
    "north_m_s",
    "east_m_s",
    "down_m_s",
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
    "roll_rad_s",
    "pitch_rad_s",
    "yaw_rad_s",
)
"""Names of a planned state's components: position and velocity in world axes, Euler angles, body rates."""

PLAN_INPUT: Final = (
    "thrust_n",
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
    "roll_rad_s",
    "pitch_rad_s",
    "yaw_rad_s",
)
"""Names of a planned input's components: collective thrust, desired attitude and body rate."""


class Plan:
    """States with the inputs that lead through them. `fly` accepts a plan in place of a trajectory."""

    __slots__ = ("_native",)

    def __init__(self, native: _native.Plan) -> None:
        if not isinstance(native, _native.Plan):
            raise TypeError("a Plan is made by plan() or Plan.load()")
        self._native = native

    @classmethod
    def load(cls, path: Path) -> Plan:
        """Reads a plan file."""
        return cls(_native.Plan.load(path))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Plan):
            return NotImplemented
        return self._native.equals(other._native)

    def __hash__(self) -> int:
        return hash((self._native.trajectory, self.status, self.cost_m))

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self._native.to_json(), self.passed_s)

    def save(self, path: Path) -> None:
        """Writes the plan file, which ``downwash fly`` accepts."""
        _FilePath(path).write_text(self._native.to_json(), encoding="utf-8")

    @property
    def status(self) -> str:
        """How the search ended."""
        return self._native.status

    @property
    def not_flyable(self) -> str | None:
        """Why the plan must not be flown; None if it may."""
        return self._native.not_flyable

    @property
    def duration_s(self) -> float:
        """Time from the first state to the last, s."""
        return self.period_s * len(self.inputs)

    @property
    def passed_s(self) -> list[float] | None:
        """Time of each passage of a course, s; None for other plans and for a plan from a file."""
        return self._native.passed_s

    @property
    def cost_m(self) -> float:
        """Sum of the distances from the desired states, m; for a time-optimal plan its duration, s."""
        return self._native.cost

    @property
    def period_s(self) -> float:
        """Time between states, s."""
        return self._native.period_s

    @property
    def time_s(self) -> Array:
        """Times of the states, shape (n + 1,)."""
        return self.period_s * np.arange(len(self.states), dtype=np.float64)

    @property
    def states(self) -> Array:
        """Planned states, shape (n + 1, 12), with the columns `PLAN_STATE`."""
        return self._native.states().reshape(-1, len(PLAN_STATE))

    @property
    def desired(self) -> Array:
        """Desired states, in the shape of `states`."""
        return self._native.desired().reshape(-1, len(PLAN_STATE))

    @property
    def inputs(self) -> Array:
        """Planned inputs, shape (n, 7), with the columns `PLAN_INPUT`."""
        return self._native.inputs().reshape(-1, len(PLAN_INPUT))

    def __repr__(self) -> str:
        return f"<downwash.Plan along {self._native.trajectory!r}: {self.status}>"


def _restored(text: str, passed_s: list[float] | None) -> Plan:
    return Plan(_native.Plan.parse(text, passed_s))


def _wish(given: Trajectory | Mapping[str, Any] | Path) -> _native.Trajectory | _native.Wish:
    if isinstance(given, Trajectory):
        return given._native
    if isinstance(given, Mapping):
        return _native.Wish.parse(to_json("trajectory", given), "trajectory")
    if isinstance(given, (str, os.PathLike)):
        return _native.Wish.load(given)
    found = type(given).__name__
    raise TypeError(f"trajectory: expected a Trajectory, a path, a name or a table, found {found}")


def plan(
    trajectory: Trajectory | Mapping[str, Any] | Path,
    vehicle: Vehicle | Path = "crazyflie",
    model: Model | None = None,
    *,
    kind: str | None = None,
    settings: Mapping[str, Any] | None = None,
    config: Path | None = None,
    progress: Progress = None,
) -> Plan:
    """Plans a feasible reference near a trajectory, with the vehicle's physics or the ``kind`` of a model
    (net, physics, hybrid; by default the preferred one).

    For the family ``time-optimal``, which states where to fly and not when, such as the shipped ``race``,
    it plans the fastest flight."""
    from ._model import Model

    if not (model is None or isinstance(model, Model)):
        raise TypeError(f"model: expected a Model, found {type(model).__name__}")
    return Plan(
        _native.plan(
            _wish(trajectory),
            vehicle_of(vehicle)._native,
            None if model is None else model._native,
            kind,
            config,
            to_json("settings", dict(settings or {})),
            teller(progress),
        )
    )
