"""The simulated vehicle without its autopilot, which turns motor outputs into motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from . import _downwash as _native
from ._arguments import (
    Array,
    Effects,
    Path,
    array_of,
    count,
    effects_json,
    flat,
    listed,
    numbers,
    seed_of,
)
from ._vehicle import Vehicle, vehicle_of

STATE: Final = (
    "north_m",
    "east_m",
    "down_m",
    "north_m_s",
    "east_m_s",
    "down_m_s",
    "qw",
    "qx",
    "qy",
    "qz",
    "roll_rad_s",
    "pitch_rad_s",
    "yaw_rad_s",
)
"""Names of a state's components: position and velocity in world axes (north, east, down), the rotation from
body to world as a quaternion, the body rate in body axes (front, right, down)."""

REST: Final[tuple[float, ...]] = (0.0,) * 6 + (1.0,) + (0.0,) * 6
"""A state at rest at the origin, level, heading north."""

_MOST_STEPS = 1_000_000
# About half a second of work; Ctrl-C is checked between two calls.
_STEPS_A_CALL = 1_000_000
_LONGEST = 10_000_000


class Plant:
    """A vehicle driven by motor outputs in 0..1, each rotor's thrust over its full thrust. Outputs and rotor
    states outside are limited to 0..1.

    ``effects`` are what the vehicle has beyond its file. A step takes `Plant.step_s`. The floor is at down
    0. One thread at a time may use a plant.
    """

    step_s: Final = _native.Plant.STEP_S
    """Length of a step, s."""

    def __init__(
        self,
        vehicle: Vehicle | Path = "crazyflie",
        effects: Effects | None = None,
        *,
        seed: int = 0,
        state: ArrayLike | None = None,
    ) -> None:
        native = vehicle_of(vehicle)._native
        self._native = _native.Plant(native, effects_json(effects), seed_of(seed))
        if state is not None:
            self.state = state

    @property
    def state(self) -> Array:
        """A copy of the state, 13 numbers in the order of `STATE`. Assign a whole state to change it."""
        state = np.empty(len(STATE))
        self._native.state(state)
        return state

    @state.setter
    def state(self, state: ArrayLike) -> None:
        self._native.set_state(numbers("state", state, len(STATE)))

    @property
    def rotor_states(self) -> Array:
        """The rotors' states after their lag, as fractions of full thrust: four numbers in 0..1."""
        return np.array(self._native.rotor_states)

    @rotor_states.setter
    def rotor_states(self, states: ArrayLike) -> None:
        self._native.set_rotor_states(numbers("rotor_states", states, 4))

    def step(self, outputs: ArrayLike, steps: int = 1) -> Array:
        """Holds four outputs for ``steps`` steps. Returns the state after them."""
        return flat(self.rollout(numbers("outputs", outputs, 4)[np.newaxis], steps))

    def rollout(self, outputs: ArrayLike, steps: int = 1) -> Array:
        """Applies rows of outputs, shape (n, 4), each held for ``steps`` steps. Returns the state after
        each row, shape (n, 13)."""
        rows = numbers("outputs", outputs, "n", 4)
        steps = count("steps", steps, 1, _MOST_STEPS)
        states = np.empty((len(rows), len(STATE)))
        block = max(1, _STEPS_A_CALL // steps)
        for at in range(0, len(rows), block):
            part = slice(at, at + block)
            self._native.step(flat(rows[part]), steps, flat(states[part]))
        return states

    @property
    def specific_force_m_s2(self) -> Array:
        """Reading of an ideal accelerometer in body axes, m/s^2."""
        return np.array(self._native.specific_force_m_s2)

    @property
    def acceleration_m_s2(self) -> Array:
        """Acceleration of the centre of mass in world axes, m/s^2."""
        return np.array(self._native.acceleration_m_s2)

    @property
    def angular_acceleration_rad_s2(self) -> Array:
        """Angular acceleration in body axes, rad/s^2."""
        return np.array(self._native.angular_acceleration_rad_s2)

    @property
    def air_velocity_m_s(self) -> Array:
        """Velocity of the air in world axes, m/s."""
        return np.array(self._native.air_velocity_m_s)

    @property
    def voltage_v(self) -> float:
        """Terminal voltage of the pack, V."""
        return self._native.voltage_v

    @property
    def time_s(self) -> float:
        """Time since the start, s."""
        return self._native.time_s

    def copy(self) -> Plant:
        """An independent copy of the vehicle in its present state."""
        copy = object.__new__(Plant)
        copy._native = self._native.copy()
        return copy

    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> Plant:
        return self.copy()

    def __repr__(self) -> str:
        return f"<downwash.Plant at {self.time_s:g} s>"


def rollouts(
    outputs: ArrayLike,
    start: ArrayLike = REST,
    *,
    vehicle: Vehicle | Path = "crazyflie",
    effects: Effects | Sequence[Effects] | None = None,
    steps: int = 1,
    seed: int = 0,
    airborne: bool = True,
) -> Array:
    """Simulates many vehicles at once, on every core.

    ``outputs`` has shape (vehicles, n, 4), in 0..1, and is limited to that. ``start`` is one state, or one for each vehicle, shape
    (vehicles, 13). ``effects`` is one set, or one for each vehicle. The rotors start at the first outputs.
    ``seed + i`` seeds the gusts of vehicle i. Without ``airborne`` there is a floor at down 0.

    Returns the states after each row of outputs, shape (vehicles, n, 13).
    """
    rows = numbers("outputs", outputs, "vehicles", "n", 4)
    vehicles, length, _ = rows.shape
    starts = array_of("start", start)
    if starts.ndim == 1:
        one = numbers("start", starts, len(STATE))
        starts = np.broadcast_to(one, (vehicles, len(STATE)))
    starts = numbers("start", starts, vehicles, len(STATE))
    sets = [effects] if effects is None or isinstance(effects, Mapping) else listed("effects", effects)
    if len(sets) not in (1, vehicles):
        raise ValueError(f"effects: expected one set, or {vehicles}, found {len(sets)}")
    texts = [effects_json(each) for each in sets]
    steps = count("steps", steps, 1, _MOST_STEPS)
    if length * steps > _LONGEST:
        raise ValueError(
            f"outputs: expected at most {_LONGEST} steps a vehicle, found {length * steps}"
        )
    seed = seed_of(seed)
    native = vehicle_of(vehicle)._native
    states = np.empty((vehicles, length, len(STATE)))
    if length == 0:
        return states
    block = max(1, 4 * _STEPS_A_CALL // (length * steps))
    for at in range(0, vehicles, block):
        part = slice(at, at + block)
        _native.rollouts(
            native,
            texts if len(texts) == 1 else texts[part],
            (seed + at) % 2**64,
            flat(starts[part]),
            flat(rows[part]),
            steps,
            flat(states[part]),
            bool(airborne),
        )
    return states
