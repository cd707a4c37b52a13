"""Many identical vehicles, stepped together."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from . import _downwash as _native
from ._arguments import Effects, Path, array_of, count, effects_json, numbers, seed_of
from ._plant import _MOST_STEPS, REST, STATE
from ._vehicle import Vehicle, vehicle_of

Floats: TypeAlias = "NDArray[np.floating[Any]]"

_MOST_VEHICLES = 1_000_000
# Steps over all vehicles, a fraction of a second of work; Ctrl-C is checked between two calls.
_STEPS_A_CALL = 500_000


class Fleet:
    """``vehicles`` vehicles, stepped together with the processor's widest vector instructions.

    Each matches a `Plant`: to rounding error in float64, and to about 1e-5 m per second in float32, which
    is faster. ``seed + i`` seeds the gusts of vehicle i. Without ``airborne`` there is a floor at down 0.
    The cores share the work of many steps. One thread at a time may use a fleet.
    """

    def __init__(
        self,
        vehicles: int,
        vehicle: Vehicle | Path = "crazyflie",
        effects: Effects | None = None,
        *,
        state: ArrayLike = REST,
        seed: int = 0,
        airborne: bool = True,
        dtype: DTypeLike = np.float64,
    ) -> None:
        self._count = count("vehicles", vehicles, 0, _MOST_VEHICLES)
        self._dtype = np.dtype(dtype)
        if self._dtype not in (np.float32, np.float64):
            raise TypeError(f"dtype: expected float32 or float64, found {self._dtype}")
        single = self._dtype == np.float32
        native = vehicle_of(vehicle)._native
        self._native = _native.Fleet(
            native, self._count, effects_json(effects), seed_of(seed), bool(airborne), single
        )
        self.set_state(state)

    def __len__(self) -> int:
        return self._count

    @property
    def dtype(self) -> np.dtype[Any]:
        """float32 or float64."""
        return self._dtype

    @property
    def instructions(self) -> str:
        """Name of the vector instruction set in use."""
        return self._native.instructions

    @property
    def state(self) -> Floats:
        """The states, shape (vehicles, 13), with the columns `STATE`."""
        states = np.empty((self._count, len(STATE)), self._dtype)
        self._native.state(states.reshape(-1))
        return states

    def set_state(self, state: ArrayLike, rotor_states: ArrayLike = (0.0,) * 4) -> None:
        """Sets one state for all vehicles, or one for each, shape (vehicles, 13); likewise the rotor
        states, four numbers in 0..1."""
        self._native.set_state(
            self._rows("state", state, len(STATE)), self._rows("rotor_states", rotor_states, 4)
        )

    @property
    def rotor_states(self) -> Floats:
        """The rotor states as fractions of full thrust, shape (vehicles, 4)."""
        return np.array(self._native.rotor_states, self._dtype).reshape(self._count, 4)

    def step(self, outputs: ArrayLike, steps: int = 1) -> Floats:
        """Holds outputs, four numbers for all or shape (vehicles, 4), for ``steps`` steps. Outputs are
        limited to 0..1. Returns the states after them. Ctrl-C leaves every vehicle at the same time."""
        left = count("steps", steps, 1, _MOST_STEPS)
        rows = self._rows("outputs", outputs, 4)
        states = np.empty((self._count, len(STATE)), self._dtype)
        block = -(-_STEPS_A_CALL // max(1, self._count))
        while left > 0:
            self._native.step(rows, min(left, block), states.reshape(-1))
            left -= block
        return states

    def copy(self) -> Fleet:
        """An independent copy of the vehicles in their present states."""
        copy = object.__new__(Fleet)
        copy._count, copy._dtype, copy._native = self._count, self._dtype, self._native.copy()
        return copy

    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> Fleet:
        return self.copy()

    def __repr__(self) -> str:
        return f"<downwash.Fleet of {self._count} vehicles in {self._dtype}>"

    def _rows(self, what: str, value: ArrayLike, length: int) -> Floats:
        """One row for each vehicle, flattened, in the fleet's dtype."""
        array = array_of(what, value)
        if array.ndim == 1:
            array = np.broadcast_to(numbers(what, array, length), (self._count, length))
        if array.dtype == self._dtype and array.shape == (self._count, length):
            return np.require(array, self._dtype, ["C", "A"]).reshape(-1)
        return numbers(what, array, self._count, length).reshape(-1).astype(self._dtype)
