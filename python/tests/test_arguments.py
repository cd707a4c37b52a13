"""Any argument gives a result or a Python exception, never a panic or a hang."""

import inspect
import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import downwash as dw
import numpy as np
import pytest

from conftest import SHORT

REFUSED = (dw.DownwashError, ValueError, TypeError, OverflowError, MemoryError, OSError, KeyError)


def read_only(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    array.setflags(write=False)
    return array


def arrays(rng: random.Random) -> Any:
    """A random array, or an object that resembles one."""
    shape = tuple(rng.choice([0, 1, 3, 4, 6, 9, 13, 14]) for _ in range(rng.randint(0, 4)))
    dtype = rng.choice([float, np.float32, np.float16, int, np.uint8, bool, complex, object, "U3", "M8[s]"])
    plain = np.ones(shape, dtype=dtype if dtype not in ("U3", "M8[s]") else float)
    return rng.choice(
        [
            lambda: plain,
            lambda: plain.astype(dtype) if dtype != "M8[s]" else plain.astype("i8").astype(dtype),
            lambda: read_only(np.full(shape, 0.5)),
            lambda: np.full((*shape, 2), 0.5)[..., 0],
            lambda: np.full(shape, 0.5)[::-1] if shape else 0.5,
            lambda: np.asfortranarray(np.full(shape, 0.5)),
            lambda: np.full(shape, rng.choice([math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324])),
            lambda: np.broadcast_to(0.5, (2**40, 4)),
            lambda: np.full(shape, 0.5, dtype=">f8"),
            lambda: np.full(shape, 0.5, dtype=np.dtype("f4").newbyteorder()),
            lambda: np.zeros(shape, dtype=[("a", "f8"), ("b", "i4")]),
            lambda: np.full((*shape, 0), 0.5),
            lambda: np.full((7, 13), 0.5)[::-2, ::-1],
            lambda: np.ma.masked_invalid(np.full(shape, math.nan)),
            lambda: memoryview(b"12345678"),
            lambda: np.float64(0.5),
            lambda: [[1, 2], [3]],
            lambda: None,
            lambda: "text",
            lambda: {},
            lambda: object(),
            lambda: iter([1.0]),
        ]
    )()


def scalars(rng: random.Random) -> Any:
    return rng.choice([0, 1, -1, 2**31, 2**63, 2**64, 2**200, 1.5, math.nan, "1", None, True, [], np.int8(1), b"x"])


def tables(rng: random.Random) -> Any:
    itself: dict[str, Any] = {}
    itself["wind"] = itself
    return rng.choice(
        [
            {},
            {"wind": {"north_m_s": math.nan}},
            {"wind": {"north_m_s": 1e300}},
            {"wind": {"north_m_s": [1, 2, 3]}},
            {"wind": {"north_m_s": np.float32(1)}},
            {"wind": {"north_m_s": np.array([1.0, 2.0])}},
            {"wind": 3},
            {"win": {}},
            {"rotor_loss": {"rotor": 1.5, "scale": 0.5}},
            {"rotor_loss": {"rotor": 2**70, "scale": 0.5}},
            {"mass": {}},
            {"mass": {"mass_kg": 1e-9}},
            {3: {}},
            {"wind": {None: 1}},
            itself,
            [("wind", {})],
            "wind",
            7,
            {"wind": {"north_m_s": object()}},
            {"\ud800": {}},
            {"\0": {}},
        ]
    )


def paths(rng: random.Random) -> Any:
    wrong = ["", "\0", "nowhere", ".", "/proc/nowhere", b"bytes", 3, None, [], ["nowhere"], [3], "\ud800", "x" * 10_000]
    return rng.choice(wrong)


PLANT = dw.Plant()
CALLS: list[Callable[[random.Random], object]] = [
    lambda r: dw.Plant().step(arrays(r), scalars(r)),
    lambda r: PLANT.copy().step(arrays(r)),
    lambda r: PLANT.copy().rollout(arrays(r), r.choice([1, 2, 0, -1, 10**12])),
    lambda r: setattr(PLANT.copy(), "state", arrays(r)),
    lambda r: setattr(PLANT.copy(), "rotor_states", arrays(r)),
    lambda r: dw.Plant(effects=tables(r), seed=scalars(r), state=arrays(r)),
    lambda r: dw.Plant(effects=tables(r)),
    lambda r: dw.Plant(paths(r)),
    lambda r: dw.rollouts(arrays(r), arrays(r), steps=scalars(r)),
    lambda r: dw.Fleet(scalars(r), state=arrays(r), dtype=r.choice(["f4", "f8", "i4", None])),
    lambda r: dw.Fleet(3, effects=tables(r), seed=scalars(r)),
    lambda r: dw.Fleet(3, dtype="f4").step(arrays(r), scalars(r)),
    lambda r: dw.Fleet(3).set_state(arrays(r), arrays(r)),
    lambda r: dw.rollouts(np.full((2, 3, 4), 0.5), arrays(r), seed=scalars(r)),
    lambda r: dw.rollouts(arrays(r), effects=r.choice([tables(r), [tables(r), tables(r)]])),
    lambda r: dw.rollouts(np.full((2, 3, 4), 0.5), effects=[tables(r), tables(r)]),
    lambda r: dw.Trajectory(SHORT).sample(arrays(r)),
    lambda r: dw.Trajectory(r.choice([tables(r), paths(r)])),
    lambda r: dw.Trajectory(SHORT | {"duration_s": scalars(r)}),
    lambda r: dw.Vehicle(paths(r)),
    lambda r: dw.Vehicle.parse(r.choice(["", "{", "x = ", "\0", "{}", "name = 1", "[" * 10_000])),
    lambda r: dw.Vehicle().with_effects(tables(r)),
    lambda r: dw.Vehicle.init(paths(r), mass_kg=scalars(r), cells=scalars(r)),
    lambda r: dw.Vehicle.init(mass_kg=scalars(r), inertia_kg_m2=arrays(r), layout=scalars(r)),
    lambda r: dw.fly(trajectory=SHORT, effects=tables(r), seeds=scalars(r)),
    lambda r: dw.fly(trajectory=SHORT, controller=tables(r)),
    lambda r: dw.fly(trajectory=SHORT, settings=tables(r)),
    lambda r: dw.fly(trajectory=SHORT, simulation=tables(r), jobs=scalars(r)),
    lambda r: dw.fly(trajectory=SHORT, config=paths(r)),
    lambda r: dw.fly(paths(r), paths(r)),
    lambda r: dw.plan(SHORT, settings=tables(r), kind=scalars(r)),
    lambda r: dw.plan(paths(r)),
    lambda r: dw.Plan.load(paths(r)),
    lambda r: dw.Model(paths(r)),
    lambda r: dw.read(paths(r), mapping=paths(r), boot=scalars(r), system=scalars(r)),
    lambda r: dw.audit(paths(r)),
    lambda r: dw.Learner(hidden=scalars(r), passes=scalars(r), features=scalars(r)).fit(paths(r)),
    lambda r: dw.Learner().predict(arrays(r)),
    lambda r: dw.Learner().set_params(**{r.choice(["hidden", "x"]): scalars(r)}),
    lambda r: dw.diagnose(paths(r), paths(r), twins=scalars(r), seed=scalars(r)),
    lambda r: dw.compare(paths(r), paths(r), align=r.choice(["time", "way", 3]), mapping=paths(r)),
    lambda r: dw.diagnose("crazyflie", paths(r), without=r.choice([["win"], "wind", [3]])),
]


@pytest.mark.parametrize("call", range(len(CALLS)))
def test_any_argument_gives_a_result_or_an_exception(
    call: int, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rng = random.Random(call)
    for _ in range(40):
        try:
            CALLS[call](rng)
        except REFUSED as refused:
            assert "internal error" not in str(refused)


ARRAYS = {"outputs", "start", "state", "rotor_states", "x", "u", "X", "time_s", "inertia_kg_m2"}
TABLES = {"effects", "onsets", "settings", "controller", "simulation", "params"}
PATHS = {"path", "logs", "vehicle", "trajectory", "manifest", "out", "mapping", "config", "folder", "file"}
PATHS |= {"a", "b", "holdout", "new", "next_flight", "parameters", "without", "source", "model"}
# Values that pass the first checks, so that later ones run; and settings that keep slow functions short.
GOOD: dict[str, Any] = {
    "outputs": np.full((2, 3, 4), 0.5),
    "x": np.zeros((2, 9)),
    "u": np.zeros((2, 4)),
    "X": np.zeros((2, 13)),
    "time_s": np.arange(3.0),
    "state": dw.REST,
    "vehicle": "crazyflie",
    "vehicles": 3,
    "trajectory": SHORT,
    "source": SHORT,
    "effects": {"wind": {"north_m_s": 1.0}},
    "onsets": [(1.0, {"wind": {"north_m_s": 1.0}})],
    "text": "{}",
    "to": "mujoco",
    "twins": 0,
    "passes": 1,
    "jobs": 1,
}
FEW = {"passes": [0, -1, 1.5, "1"], "twins": [0, -1, 1.5, 2**70, "1"], "steps": [0, -1, 1, 2**70, 1.5, None, "1"]}


def public() -> dict[str, tuple[type | None, Any]]:
    """Every function of the package and every method of its classes, by name."""
    found: dict[str, tuple[type | None, Any]] = {}
    for name in dw.__all__:
        member = getattr(dw, name)
        if not callable(member) or member is dw.DownwashError:
            continue
        found[name] = (None, member)
        if inspect.isclass(member):
            for inner, method in vars(member).items():
                if inner.startswith("_") and inner not in ("__getitem__", "__len__", "__repr__", "__copy__"):
                    continue
                if isinstance(method, (classmethod, staticmethod)):
                    found[f"{name}.{inner}"] = (None, getattr(member, inner))
                elif callable(method) or isinstance(method, property):
                    found[f"{name}.{inner}"] = (member, method)
    return found


@pytest.fixture(scope="module")
def instances(logs: list[Path]) -> dict[type, Any]:
    """One instance of each class."""
    log = dw.read(logs[0])
    learner = dw.Learner(hidden=8, passes=1).fit(logs)
    return {
        dw.Changes: dw.Changes({"flights": [], "steps": []}, "<p>", "text"),
        dw.Comparison: dw.compare(logs[0], logs[1]),
        dw.Diagnosis: dw.Diagnosis(
            {"verdict": "none", "finding": {"sentence": ""}, "effects": [], "gap": None}
            | {"attribution": [], "not_testable": []},
            "<p>",
            "text",
            dw.Vehicle(),
        ),
        dw.Fleet: dw.Fleet(3),
        dw.Learner: learner,
        dw.Log: log,
        dw.Model: learner.model_,
        dw.Plan: dw.plan(SHORT),
        dw.Plant: dw.Plant(),
        dw.Rows: dw.Rows([{"a": {"b": 1}}]),
        dw.Stream: log["position"],
        dw.Trajectory: dw.Trajectory(SHORT),
        dw.Vehicle: dw.Vehicle(),
    }


def drawn(name: str, rng: random.Random) -> Any:
    """A random value for an argument of this name, mostly wrong."""
    if name in FEW and rng.random() < 0.9:
        return rng.choice(FEW[name])
    if name in GOOD and rng.random() < 0.5:
        return GOOD[name]
    pools = [arrays, scalars, tables, paths]
    for names, pool in [(ARRAYS, arrays), (TABLES, tables), (PATHS, paths)]:
        if name in names and rng.random() < 0.7:
            return pool(rng)
    return rng.choice(pools)(rng)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", sorted(public()))
def test_every_function_gives_a_result_or_an_exception(
    name: str, instances: dict[type, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    owner, function = public()[name]
    rng = random.Random(name)
    before = [] if owner is None else [instances[owner]]
    if isinstance(function, property):
        function.fget and function.fget(*before)
        if function.fset is None:
            return
        function, parameters = function.fset, [inspect.Parameter("state", inspect.Parameter.POSITIONAL_ONLY)]
    else:
        parameters = list(inspect.signature(function).parameters.values())[len(before) :]
    # Without arguments there is only one result.
    for _ in range(40 if parameters else 1):
        positional, named = [], {}
        for parameter in parameters:
            if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                continue
            if parameter.default is not parameter.empty and rng.random() < 0.6:
                continue
            value = drawn(parameter.name, rng)
            if parameter.kind is parameter.POSITIONAL_ONLY:
                positional.append(value)
            else:
                named[parameter.name] = value
        try:
            function(*before, *positional, **named)
        except REFUSED as refused:
            assert "internal error" not in str(refused), named


def test_finite_arguments_give_finite_results() -> None:
    states = dw.rollouts(np.linspace(0, 1, 2 * 5 * 4).reshape(2, 5, 4), steps=100)
    assert np.isfinite(states).all() and states.shape == (2, 5, 13)


def test_read_only_and_strided_arrays_are_accepted() -> None:
    outputs = np.full((10, 4), 0.5)
    outputs.setflags(write=False)
    turned = np.full((4, 10), 0.5).T
    assert np.array_equal(PLANT.copy().rollout(outputs), PLANT.copy().rollout(turned))


def test_returned_arrays_do_not_change_later() -> None:
    plant = dw.Plant(state=[0, 0, -10, *[0] * 3, 1, *[0] * 6])
    first = plant.step([0.5] * 4)
    kept = first.copy()
    plant.step([0.9] * 4, 100)
    assert np.array_equal(first, kept)
