"""Controllers that run on board: true state in, motor outputs out, on downwash's plant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import downwash as dw
import numpy as np
from missions import RATE_HZ, Array, error_m, lost
from vehicles import Drawn

# downwash hovers for this long before its mission.
HOVER_S = 5.0
STEPS = round(1 / RATE_HZ / dw.Plant.step_s)


class Controller(Protocol):
    """Flies several vehicles at once, one row each."""

    def outputs(self, states: Array, points: Array) -> Array:
        """Motor outputs in 0..1, shape (n, 4), from states and desired points."""


def turned(quaternion: Array, roll: float, pitch: float) -> Array:
    """A reported attitude: the true one, then the trim (yaw, pitch, roll)."""
    cr, sr, cp, sp = np.cos(roll / 2), np.sin(roll / 2), np.cos(pitch / 2), np.sin(pitch / 2)
    w, x, y, z = np.array([cr * cp, sr * cp, cr * sp, -sr * sp])
    a, b, c, d = quaternion
    return np.array(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )


def fly(
    drawn: Drawn,
    missions: list[Array],
    begins_s: list[float],
    seed: int,
    make: Callable[[int], Controller],
) -> list[dict[str, Any]]:
    """Flies each mission, after a hover of `HOVER_S` on the plant's clock."""
    vehicle = drawn.vehicle()
    trim = drawn.effects.get("attitude_trim", {})
    roll, pitch = trim.get("roll_rad", 0.0), trim.get("pitch_rad", 0.0)
    plants = []
    for points, begin in zip(missions, begins_s, strict=True):
        plant = dw.Plant(vehicle, drawn.effects, seed=seed)
        waited = round((begin - HOVER_S) / dw.Plant.step_s)
        plant.step(np.zeros(4), max(1, waited))
        yaw = points[0, 9]
        start = [*points[0, :3], 0, 0, 0, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2), 0, 0, 0]
        plant.state = start
        plant.rotor_states = np.full(4, drawn.file["hover_thrust"])
        plants.append(plant)
    count = len(plants)
    controller = make(count)
    hover = round(HOVER_S * RATE_HZ)
    flown = [np.empty((len(points), 3)) for points in missions]
    crashed = [False] * count
    states = np.array([plant.state for plant in plants])
    for tick in range(-hover, max(map(len, missions))):
        now = np.array([points[min(max(tick, 0), len(points) - 1)] for points in missions])
        if tick < 0:
            now[:, 3:9], now[:, 10] = 0.0, 0.0
        for i, state in enumerate(states):
            if 0 <= tick < len(flown[i]):
                flown[i][tick] = state[:3]
                crashed[i] |= lost(state, now[i])
            elif tick < 0:
                crashed[i] |= lost(state, now[i])
        seen = states.copy()
        if roll or pitch:
            for row in seen:
                row[6:10] = turned(row[6:10], roll, pitch)
        outputs = np.clip(controller.outputs(seen, now), 0.0, 1.0)
        for i, plant in enumerate(plants):
            if not crashed[i]:
                states[i] = plant.step(outputs[i], STEPS)
    return [
        {"crashed": crashed[i], "error_m": None if crashed[i] else error_m(flown[i], missions[i])}
        for i in range(count)
    ]
