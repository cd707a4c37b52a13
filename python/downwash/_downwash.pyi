"""The native part: flat arrays in, flat arrays and JSON out. Use the package's own functions."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

_Path: TypeAlias = str | PathLike[str]
_Array: TypeAlias = NDArray[np.float64]
_Floats: TypeAlias = NDArray[np.floating[Any]]
_Progress: TypeAlias = Callable[[str, int, int], object]

__all__ = [
    "Diagnosis",
    "DownwashError",
    "Fleet",
    "Log",
    "Model",
    "Plan",
    "Plant",
    "Trajectory",
    "Vehicle",
    "__version__",
    "audit",
    "compare",
    "diagnose",
    "effects",
    "evaluate",
    "fly",
    "main",
    "plan",
    "rollouts",
    "sweep",
    "train",
]

__version__: str

class DownwashError(Exception):
    exit_code: int

@final
class Vehicle:
    @staticmethod
    def load(path: _Path) -> Vehicle: ...
    @staticmethod
    def parse(text: str, name: str) -> Vehicle: ...
    @staticmethod
    def init(parameters: _Path | None, measured: str) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def source(self) -> str: ...
    @property
    def text(self) -> str: ...
    def to_json(self) -> str: ...
    def remarks(self) -> str: ...
    def with_effects(self, effects: str) -> Vehicle: ...
    def to_text(self, path: _Path) -> str: ...
    def export(self, peer: str) -> tuple[str, list[str]]: ...

@final
class Plant:
    STEP_S: float
    def __new__(cls, vehicle: Vehicle, effects: str, seed: int) -> Plant: ...
    def step(self, outputs: _Array, every: int, states: _Array) -> None: ...
    def state(self, state: _Array) -> None: ...
    def set_state(self, state: _Array) -> None: ...
    def set_rotor_states(self, states: _Array) -> None: ...
    @property
    def rotor_states(self) -> list[float]: ...
    @property
    def specific_force_m_s2(self) -> list[float]: ...
    @property
    def acceleration_m_s2(self) -> list[float]: ...
    @property
    def angular_acceleration_rad_s2(self) -> list[float]: ...
    @property
    def air_velocity_m_s(self) -> list[float]: ...
    @property
    def voltage_v(self) -> float: ...
    @property
    def time_s(self) -> float: ...
    def copy(self) -> Plant: ...

@final
class Fleet:
    def __new__(
        cls,
        vehicle: Vehicle,
        count: int,
        effects: str,
        seed: int,
        airborne: bool,
        single: bool,
    ) -> Fleet: ...
    def step(self, outputs: _Floats, every: int, states: _Floats) -> None: ...
    def state(self, states: _Floats) -> None: ...
    def set_state(self, states: _Floats, rotors: _Floats) -> None: ...
    @property
    def rotor_states(self) -> list[list[float]]: ...
    @property
    def instructions(self) -> str: ...

@final
class Log:
    @staticmethod
    def read(path: _Path, mapping: _Path | None, boot: int | None) -> Log: ...
    @property
    def streams(self) -> list[tuple[str, list[str]]]: ...
    def stream(self, name: str) -> tuple[_Array, _Array]: ...
    def facts(self) -> str: ...
    @property
    def vehicle_file(self) -> str | None: ...

@final
class Trajectory:
    @staticmethod
    def load(path: _Path) -> Trajectory: ...
    @staticmethod
    def parse(keys: str, name: _Path) -> Trajectory: ...
    @property
    def name(self) -> str: ...
    @property
    def duration_s(self) -> float: ...
    def sample(self, times: _Array, points: _Array) -> None: ...

@final
class Plan:
    @staticmethod
    def load(path: _Path) -> Plan: ...
    def to_json(self) -> str: ...
    @property
    def trajectory(self) -> str: ...
    @property
    def status(self) -> str: ...
    @property
    def cost(self) -> float: ...
    @property
    def period_s(self) -> float: ...
    @property
    def not_flyable(self) -> str | None: ...
    def states(self) -> _Array: ...
    def desired(self) -> _Array: ...
    def inputs(self) -> _Array: ...

@final
class Model:
    @staticmethod
    def load(path: _Path) -> Model: ...
    def info(self) -> str: ...
    @property
    def preferred(self) -> str: ...
    def accelerations(
        self,
        motions: _Array,
        inputs: _Array,
        kind: str | None,
        accelerations: _Array,
        jacobians: _Array | None,
    ) -> None: ...

@final
class Diagnosis:
    def to_json(self) -> str: ...
    def to_html(self) -> str: ...
    def to_text(self) -> str: ...
    def improved(self, name: _Path) -> str: ...

def main(program: _Path, args: Sequence[str]) -> int: ...
def effects() -> str: ...
def rollouts(
    vehicle: Vehicle,
    effects: list[str],
    seed: int,
    start: _Array,
    outputs: _Array,
    every: int,
    states: _Array,
    airborne: bool,
) -> None: ...
def audit(paths: list[_Path], mapping: _Path | None) -> tuple[str, list[str]]: ...
def compare(
    a: list[_Path], b: list[_Path], align: str, pair: str, mapping: _Path | None
) -> tuple[str, str]: ...
def fly(
    vehicle: Vehicle,
    trajectory: Trajectory | Plan,
    effects: str,
    settings: str,
    config: _Path | None,
    sitl_config: str | None,
    seeds: list[int],
    logs: _Path | None,
    jobs: int | None,
    progress: _Progress | None,
) -> list[str]: ...
def sweep(
    manifest: _Path,
    out: _Path,
    index: int,
    count: int,
    jobs: int | None,
    progress: _Progress | None,
) -> str: ...
def plan(
    trajectory: Trajectory,
    vehicle: Vehicle,
    model: Model | None,
    kind: str | None,
    config: _Path | None,
    settings: str,
    progress: _Progress | None,
) -> Plan: ...
def train(
    logs: list[_Path], vehicle: _Path, out: _Path, mapping: _Path | None, settings: str
) -> str: ...
def evaluate(model: _Path, logs: list[_Path], mapping: _Path | None) -> str: ...
def diagnose(
    vehicle: _Path,
    logs: list[_Path],
    holdout: list[_Path],
    new: list[_Path],
    mapping: _Path | None,
    twins: int | None,
    seed: int,
    without: list[str],
    next_flight: _Path | None,
    progress: _Progress | None,
) -> Diagnosis: ...
