"""The plant against closed forms, and batches against single vehicles."""

import copy
import signal
import threading
from collections.abc import Callable
from typing import Any

import downwash as dw
import numpy as np
import pytest


def test_a_vehicle_without_thrust_falls() -> None:
    plant = dw.Plant(state=[0, 0, -100, *[0] * 3, 1, *[0] * 6])
    plant.step([0, 0, 0, 0], 1000)
    gravity = dw.Vehicle().to_dict()["gravity"]
    np.testing.assert_allclose(plant.state[2], -100 + 0.5 * gravity, atol=1e-9)
    np.testing.assert_allclose(plant.state[5], gravity, atol=1e-9)
    np.testing.assert_allclose(plant.specific_force_m_s2, 0, atol=1e-9)
    assert plant.time_s == 1.0


def test_wind_carries_a_falling_vehicle_with_drag() -> None:
    effects = {"wind": {"north_m_s": 3.0}, "parasitic_drag": {"cda_m2": 0.01}}
    start = [0, 0, -100, *[0] * 3, 1, *[0] * 6]
    still, blown = dw.Plant(state=start), dw.Plant(effects=effects, state=start)
    for plant in (still, blown):
        plant.step([0] * 4, 500)
    assert blown.state[3] > 0.1 > abs(still.state[3])
    np.testing.assert_allclose(blown.air_velocity_m_s, [3, 0, 0])


def test_a_batch_matches_single_vehicles() -> None:
    rng = np.random.default_rng(1)
    outputs = rng.uniform(0.3, 0.7, (5, 40, 4))
    start = np.tile(dw.REST, (5, 1))
    start[:, 2] = -10
    drags = [{"rotor_drag": {"d_xy": 0.01 * k}} for k in range(5)]
    states = dw.rollouts(outputs, start, effects=drags, steps=5, airborne=False)
    for vehicle, drag in enumerate(drags):
        plant = dw.Plant(effects=drag, state=start[vehicle])
        plant.rotor_states = outputs[vehicle, 0]
        np.testing.assert_array_equal(plant.rollout(outputs[vehicle], 5), states[vehicle])
    # With one set of effects they are stepped together.
    states = dw.rollouts(outputs, start, effects=drags[3], steps=5, airborne=False)
    for vehicle in range(5):
        plant = dw.Plant(effects=drags[3], state=start[vehicle])
        plant.rotor_states = outputs[vehicle, 0]
        alone = plant.rollout(outputs[vehicle], 5)
        np.testing.assert_allclose(alone, states[vehicle], rtol=1e-10, atol=1e-10)


def test_each_vehicle_of_a_batch_has_its_gust_seed() -> None:
    outputs = np.full((3, 50, 4), 0.5)
    gusts = {"gusts": {"sigma_m_s": 2.0}, "rotor_drag": {"d_xy": 0.05}}
    three = dw.rollouts(outputs, effects=gusts, seed=7)
    second = dw.rollouts(outputs[:1], effects=gusts, seed=8)
    np.testing.assert_array_equal(three[1], second[0])
    assert not np.array_equal(three[0], three[1])


def test_a_copy_is_independent() -> None:
    plant = dw.Plant(state=[0, 0, -10, *[0] * 3, 1, *[0] * 6])
    other = plant.copy()
    other.step([1, 1, 1, 1], 100)
    assert plant.time_s == 0 and other.time_s > 0
    assert plant.state[2] == -10 != other.state[2]


@pytest.mark.parametrize("dtype, apart", [(np.float64, 1e-9), (np.float32, 1e-4)])
def test_a_fleet_matches_single_plants(dtype: type, apart: float) -> None:
    start = np.tile(dw.REST, (100, 1))
    start[:, :3] = np.random.default_rng(3).normal(size=(100, 3))
    start[:, 2] -= 20
    effects = {"gusts": {"sigma_m_s": 1.0}, "rotor_drag": {"d_xy": 0.02}}
    fleet = dw.Fleet(100, effects=effects, state=start, seed=5, dtype=dtype)
    assert fleet.state.dtype == dtype and len(fleet) == 100
    plants = [dw.Plant(effects=effects, state=state, seed=5 + k) for k, state in enumerate(start)]
    for plant in plants:
        plant.rotor_states = [0.5] * 4
    fleet.set_state(start, [0.5] * 4)
    rng = np.random.default_rng(4)
    for _ in range(20):
        outputs = rng.uniform(0.55, 0.6, (100, 4))
        states = fleet.step(outputs.astype(dtype), 10)
        alone = np.array([plant.step(row, 10) for plant, row in zip(plants, outputs)])
        np.testing.assert_allclose(states, alone, atol=apart, rtol=apart)
    np.testing.assert_allclose(fleet.rotor_states, [p.rotor_states for p in plants], atol=apart)


def unaligned(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The same numbers at an odd address, as in a file mapped into memory."""
    return np.frombuffer(b"\0" + array.tobytes(), array.dtype, offset=1).reshape(array.shape)


def test_the_layout_of_an_array_changes_nothing() -> None:
    outputs = np.random.default_rng(5).uniform(0, 1, (6, 4)).astype(np.float32).astype(float)
    wide = np.repeat(outputs, 2, axis=1)
    layouts = [
        outputs.tolist(),
        outputs.astype(np.float32),
        np.asfortranarray(outputs),
        wide[:, ::2],
        unaligned(outputs),
        outputs.astype(">f8"),
        outputs.astype(np.longdouble),
        np.ma.array(outputs),
    ]
    expected = dw.Plant().rollout(outputs)
    together = dw.Fleet(6).step(outputs)
    for layout in layouts:
        np.testing.assert_array_equal(dw.Plant().rollout(layout), expected)
        np.testing.assert_array_equal(dw.Fleet(6).step(layout), together)
    assert not unaligned(outputs).flags.aligned


def test_a_masked_entry_is_no_number() -> None:
    outputs = np.ma.array([0.5] * 4, mask=[False, False, False, True])
    calls: list[Callable[[], object]] = [
        lambda: dw.Plant().step(outputs),
        lambda: dw.Fleet(2).step(outputs),
        lambda: dw.rollouts(np.ma.array(np.full((2, 3, 4), 0.5), mask=True)),
        lambda: dw.rollouts(np.full((2, 3, 4), 0.5), np.ma.array(dw.REST, mask=True)),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="without masked entries"):
            call()


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda of: of.copy()])
@pytest.mark.parametrize("of", [dw.Plant, lambda: dw.Fleet(2)])
def test_every_kind_of_copy_is_independent(of: Callable[[], Any], copied: Callable[[Any], Any]) -> None:
    vehicle = of()
    vehicle.step([0.6] * 4, 100)
    before, other = vehicle.state, copied(vehicle)
    np.testing.assert_array_equal(other.state, before)
    moved = other.step([0.9] * 4, 100)
    np.testing.assert_array_equal(vehicle.state, before)
    np.testing.assert_array_equal(vehicle.step([0.9] * 4, 100), moved)


def test_many_steps_are_steps_one_after_another() -> None:
    effects = {"gusts": {"sigma_m_s": 1.0}, "rotor_drag": {"d_xy": 0.02}}
    at_once, in_parts = dw.Fleet(600, effects=effects), dw.Fleet(600, effects=effects)
    # More than one call of the native part takes.
    states = at_once.step([0.5] * 4, 1700)
    for steps in (1, 999, 700):
        parts = in_parts.step([0.5] * 4, steps)
    np.testing.assert_array_equal(states, parts)


LONG: list[Callable[[], object]] = [
    lambda: dw.Fleet(2000).step([0.5] * 4, 1_000_000),
    lambda: dw.rollouts(np.full((2000, 10, 4), 0.5), steps=1_000_000),
    lambda: dw.rollouts(np.full((20, 10, 4), 0.5), steps=1_000_000, effects=[{}] * 20),
    lambda: dw.Plant().rollout(np.full((1000, 4), 0.5), 1_000_000),
]


@pytest.mark.parametrize("call", LONG)
def test_ctrl_c_ends_many_steps(call: Callable[[], object]) -> None:
    press = threading.Timer(0.3, lambda: signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT))
    press.start()
    with pytest.raises(KeyboardInterrupt):
        call()
    press.join()
