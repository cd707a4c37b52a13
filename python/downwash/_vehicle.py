"""Vehicles and the catalogue of effects."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path as _FilePath
from typing import Any

from . import _downwash as _native
from ._arguments import Effects, Path, effects_json, listed, to_json
from ._rows import Rows


class Vehicle:
    """A simulator's nominal model of a quadrotor: a vehicle file.

    ``Vehicle("crazyflie")`` accepts the path of a file, or the name of a shipped vehicle. Vehicles are equal if
    their keys and values are.
    """

    __slots__ = ("_native",)

    def __init__(self, path: Path = "crazyflie") -> None:
        self._native = _native.Vehicle.load(path)

    @classmethod
    def load(cls, path: Path) -> Vehicle:
        """Reads a vehicle file, TOML or JSON, or a shipped vehicle by its name."""
        return cls(path)

    @classmethod
    def parse(cls, text: str, name: str = "vehicle") -> Vehicle:
        """Parses the text of a vehicle file; ``name`` identifies it in messages."""
        return cls._of(_native.Vehicle.parse(text, name))

    @classmethod
    def init(
        cls,
        parameters: Path | None = None,
        *,
        name: str | None = None,
        mass_kg: float | None = None,
        inertia_kg_m2: Sequence[float] = (),
        arm_m: float | None = None,
        layout: str | None = None,
        thrust_n: float | None = None,
        hover_throttle: float | None = None,
        propeller_inch: float | None = None,
        torque_ratio_m: float | None = None,
        motor_lag_s: float | None = None,
        cells: int | None = None,
    ) -> Vehicle:
        """Creates a vehicle from an autopilot's parameters and measured numbers.

        ``parameters`` is a parameter file or a log of PX4 or ArduPilot. A number that no source gives
        raises `DownwashError`, which explains how to measure it.
        """
        measured = {
            "name": name,
            "mass_kg": mass_kg,
            "inertia_kg_m2": listed("inertia_kg_m2", inertia_kg_m2),
            "arm_m": arm_m,
            "layout": layout,
            "thrust_n": thrust_n,
            "hover_throttle": hover_throttle,
            "propeller_inch": propeller_inch,
            "torque_ratio_m": torque_ratio_m,
            "motor_lag_s": motor_lag_s,
            "cells": cells,
        }
        made = json.loads(_native.Vehicle.init(parameters, to_json("measured", measured)))
        if made["missing"]:
            told = (f"{w['key']}, {w['what']}: {w['how']}" for w in made["missing"])
            raise _native.DownwashError("the vehicle file lacks " + "; ".join(told))
        return cls.parse(made["toml"], made["source"])

    @classmethod
    def _of(cls, native: _native.Vehicle) -> Vehicle:
        vehicle = object.__new__(cls)
        vehicle._native = native
        return vehicle

    @property
    def name(self) -> str:
        """Name of the vehicle."""
        return self._native.name

    @property
    def text(self) -> str:
        """Text of the vehicle file."""
        return self._native.text

    def to_dict(self) -> dict[str, Any]:
        """The vehicle file's keys and values."""
        found: dict[str, Any] = json.loads(self._native.to_json())
        return found

    def check(self) -> list[dict[str, Any]]:
        """Remarks on numbers that do not fit each other; empty if all do."""
        found: list[dict[str, Any]] = json.loads(self._native.remarks())
        return found

    def with_effects(self, effects: Effects) -> Vehicle:
        """The vehicle with these effects added to its file or replacing existing ones."""
        return self._of(self._native.with_effects(effects_json(effects)))

    def save(self, path: Path) -> None:
        """Writes the vehicle file: JSON if the name ends in .json, else TOML."""
        _FilePath(path).write_text(self._native.to_text(path), encoding="utf-8")

    def export(self, to: str) -> tuple[str, list[str]]:
        """Exports the vehicle with its modelled effects to another simulator: "rotorpy", "drone-models",
        "px4-sih", "mujoco" or "casadi". Returns the text, and what that simulator cannot express."""
        if not isinstance(to, str):
            raise TypeError(f"to: expected a name, found {type(to).__name__}")
        return self._native.export(to)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Vehicle):
            return NotImplemented
        return self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        return hash(self.name)

    def __repr__(self) -> str:
        return f"<downwash.Vehicle {self.name!r} from {self._native.source!r}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Vehicle.parse, (self.text, self._native.source)


def vehicle_of(given: Vehicle | Path) -> Vehicle:
    """Converts a path to a `Vehicle`, if it is not one already."""
    if isinstance(given, Vehicle):
        return given
    if isinstance(given, (str, os.PathLike)):
        return Vehicle(given)
    raise TypeError(f"vehicle: expected a Vehicle, a path or a name, found {type(given).__name__}")


def effects() -> Rows:
    """The catalogue of effects, one row for each parameter.

    Columns: id, parameter, unit, shape (scalar, vector, index), least and most accepted value, default,
    neutral value, equation, and a description with the source.
    """
    return Rows(json.loads(_native.effects()))
