"""Whatever an argument is, the answer is an exception of Python's kinds, never a panic."""

import math
import random
from collections.abc import Callable
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
    """An array, or what looks like one."""
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
    return rng.choice(["", "\0", "nowhere", ".", "/", b"bytes", 3, None, [], ["nowhere"], "\ud800", "x" * 10_000])


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
    lambda r: dw.read(paths(r), mapping=paths(r), boot=scalars(r)),
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


def test_results_are_finite_where_arguments_are() -> None:
    states = dw.rollouts(np.linspace(0, 1, 2 * 5 * 4).reshape(2, 5, 4), steps=100)
    assert np.isfinite(states).all() and states.shape == (2, 5, 13)


def test_what_is_contiguous_is_not_copied_and_nothing_is_written_to() -> None:
    outputs = np.full((10, 4), 0.5)
    outputs.setflags(write=False)
    turned = np.full((4, 10), 0.5).T
    assert np.array_equal(PLANT.copy().rollout(outputs), PLANT.copy().rollout(turned))


def test_kept_arrays_do_not_change_later() -> None:
    plant = dw.Plant(state=[0, 0, -10, *[0] * 3, 1, *[0] * 6])
    first = plant.step([0.5] * 4)
    kept = first.copy()
    plant.step([0.9] * 4, 100)
    assert np.array_equal(first, kept)
