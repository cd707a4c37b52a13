"""Desired trajectories."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path as _FilePath
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from . import _downwash as _native
from ._arguments import Array, Path, flat, numbers, to_json

POINT: Final = (
    "north_m",
    "east_m",
    "down_m",
    "north_m_s",
    "east_m_s",
    "down_m_s",
    "north_m_s2",
    "east_m_s2",
    "down_m_s2",
    "yaw_rad",
    "yaw_rad_s",
)
"""Names of a desired point's components, in world axes."""


class Trajectory:
    """A desired trajectory: a trajectory file, a shipped one by name, or a file's keys as a table, such as
    ``Trajectory({"family": "hover", "altitude_m": 1.0, "duration_s": 10.0})``."""

    __slots__ = ("_native",)

    def __init__(self, source: Path | Mapping[str, Any]) -> None:
        if isinstance(source, Mapping):
            self._native = _native.Trajectory.parse(to_json("trajectory", source), "trajectory")
        elif isinstance(source, (str, os.PathLike)):
            self._native = _native.Trajectory.load(source)
        else:
            raise TypeError(
                f"trajectory: expected a path, a name or a table, found {type(source).__name__}"
            )

    @property
    def name(self) -> str:
        """Name of the trajectory."""
        return self._native.name

    @property
    def duration_s(self) -> float:
        """Duration, s."""
        return self._native.duration_s

    def sample(self, time_s: ArrayLike) -> Array:
        """The desired points at these times, shape (n, 11), with the columns `POINT`. Times are clamped to
        the start and the end."""
        times = numbers("time_s", time_s, "n")
        points = np.empty((len(times), len(POINT)))
        self._native.sample(times, flat(points))
        return points

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Trajectory):
            return NotImplemented
        return self._native.equals(other._native)

    def __hash__(self) -> int:
        return hash((self.name, self.duration_s))

    def __repr__(self) -> str:
        return f"<downwash.Trajectory {self.name!r}, {self.duration_s:g} s>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, self._native.source


def _restored(text: str, origin: _FilePath) -> Trajectory:
    trajectory = object.__new__(Trajectory)
    trajectory._native = _native.Trajectory.restored(text, origin)
    return trajectory


def trajectory_of(given: Trajectory | Mapping[str, Any] | Path) -> Trajectory:
    """Converts to a `Trajectory`, if it is not one already."""
    return given if isinstance(given, Trajectory) else Trajectory(given)
