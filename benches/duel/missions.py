"""The missions, and the error of a flight along them."""

from __future__ import annotations

import math

import downwash as dw
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE_HZ = 100.0
# Farther than this from the desired position, or upside down, a flight counts as a crash.
LOST_M = 3.0

# The authors' figure: 2 m by 1 m.
MISSIONS = {
    "steps": {
        "family": "steps",
        "altitude_m": 1.2,
        "dwell_s": 3.0,
        "offsets": [
            [0.4, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0],
            [0.0, 0.4, 0.0, 0.0],
            [0.0, 0.0, 0.3, 0.0],
            [0.0, 0.0, 0.0, 0.0],
        ],
    },
    "sinusoid-yaw": {
        "family": "sinusoid-yaw",
        "altitude_m": 1.2,
        "duration_s": 15.0,
        "amplitude_m": 1.0,
        "period_s": 5.0,
        "yaw_period_s": 10.0,
    },
    "figure-8": {
        "family": "figure-8",
        "altitude_m": 1.2,
        "duration_s": 15.0,
        "length_m": 2.0,
        "width_m": 1.0,
        "period_s": 5.0,
    },
}


def trajectory(mission: str) -> dw.Trajectory:
    return dw.Trajectory(MISSIONS[mission])


def desired(mission: str) -> Array:
    """The mission's points at `RATE_HZ`, with columns `dw.POINT`."""
    along = trajectory(mission)
    return along.sample(np.arange(0.0, along.duration_s + 1e-9, 1 / RATE_HZ))


def error_m(positions: Array, points: Array) -> float:
    """Root mean square distance between actual and desired positions, row by row."""
    return float(np.sqrt(np.mean(np.sum((positions - points[:, :3]) ** 2, axis=1))))


def lost(state: Array, point: Array) -> bool:
    """Whether a vehicle that should be at ``point`` has crashed."""
    # The body's down axis against the world's.
    level = 1 - 2 * (state[7] ** 2 + state[8] ** 2)
    far = math.dist(state[:3], point[:3]) > LOST_M
    return bool(far or level < 0 or state[2] > -0.02 or not np.isfinite(state).all())
