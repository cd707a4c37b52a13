"""Exported vehicles fly in other simulators as in downwash.

Each simulator replays the windows of a flight with unmodelled effects twice: with the file's vehicle, and
with the effects found. The effects must reduce its error by nearly as much as they reduce downwash's.
"""

import importlib
import re
import tomllib
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import downwash as dw

VEHICLE = "quad1200"
WINDOW = 0.3
STEP = 0.001
NUMBERS = np.ndarray[Any, np.dtype[np.float64]]
# Maps a state, rotor states and a window's outputs to the state at the window's end.
Replay = Callable[[NUMBERS, NUMBERS, NUMBERS], NUMBERS]

HEAVIER = {"mass": {"mass_kg": 1.4}, "inertia": {"scale": [1.3, 1.2, 1.1]}}
# The file's vehicle has a drag, which MuJoCo does not express.
NO_DRAG = {"rotor_drag": {"d_xy": 0.0, "d_z": 0.0}}
DRAGGED = {"rotor_drag": {"d_xy": 0.5, "d_z": 0.2}, **HEAVIER}
BENT = {
    "parasitic_drag": {"cda_m2": 0.03},
    "blade_flapping": {"moment_Nms_m": 0.02},
    "translational_lift": {"k_s2_m2": 0.004},
}
CURVED = {"thrust_curve": {"a": 0.2}}
EVERY = {
    **DRAGGED,
    "motor_lag": {"tau_s": 0.03},
    "parasitic_drag": {"cda_m2": 0.03},
    "wind": {"north_m_s": 2.0, "east_m_s": -1.0},
    "blade_flapping": {"moment_Nms_m": 0.01, "tilt_rad_s_m": 0.004},
    "translational_lift": {"k_s2_m2": 0.004},
    "com_offset": {"x_m": 0.002, "y_m": -0.001},
    "thrust_curve": {"a": 0.2},
    "rotor_loss": {"rotor": 1, "scale": 0.97},
}


def flown(effects: dict[str, Any]) -> list[tuple[NUMBERS, NUMBERS, NUMBERS, NUMBERS]]:
    """For each window: state and rotor states at its start, its outputs, and the state at its end."""
    hover = dw.Vehicle(VEHICLE).to_dict()["hover_thrust"]
    plant = dw.Plant(VEHICLE, effects, state=[0, 0, -50, 3, -2, 0.5, 1] + [0] * 6)
    plant.rotor_states = [hover] * 4
    rng = np.random.default_rng(1)
    windows = []
    for _ in range(20):
        # Each window starts level, with its own velocity and outputs.
        start = plant.state
        start[3:6] = rng.normal(0.0, 3.0, 3)
        start[6:] = [1, 0, 0, 0, *rng.normal(0.0, 0.3, 3)]
        plant.state = start
        rotors = plant.rotor_states
        row = hover * rng.uniform(0.97, 1.03, 4) * rng.uniform(0.8, 1.3)
        outputs = np.tile(row, (round(WINDOW / STEP), 1))
        windows.append((start, rotors, outputs, plant.rollout(outputs)[-1]))
    return windows


def own(effects: dict[str, Any]) -> Replay:
    def replay(state: NUMBERS, rotors: NUMBERS, outputs: NUMBERS) -> NUMBERS:
        plant = dw.Plant(VEHICLE, effects, state=state)
        plant.rotor_states = rotors
        return plant.rollout(outputs)[-1]

    return replay


def thrust_curve(text: str) -> float:
    """The a of the thrust curve, as the file states it for whoever drives its rotors."""
    stated = re.search(r"with a = ([-+.e0-9]+[0-9])", text)
    assert stated
    return float(stated[1])


def module(text: str, name: str) -> ModuleType:
    made = ModuleType(name)
    exec(compile(text, name, "exec"), made.__dict__)
    return made


def casadi(effects: dict[str, Any]) -> Replay:
    text, lost = dw.Vehicle(VEHICLE).with_effects(effects).export("casadi")
    assert not lost
    vehicle = module(text, "casadi_vehicle")
    slope = vehicle.dynamics()
    lags = vehicle.STATES > 13

    def replay(state: NUMBERS, rotors: NUMBERS, outputs: NUMBERS) -> NUMBERS:
        x = np.concatenate([state, rotors]) if lags else state
        for u in outputs:
            k1 = np.array(slope(x, u, 16.8)).ravel()
            k2 = np.array(slope(x + STEP / 2 * k1, u, 16.8)).ravel()
            x = x + STEP * k2
        return np.asarray(x[:13])

    return replay


def mirrored(state: NUMBERS) -> NUMBERS:
    """Converts between north-east-down and north-west-up, and the body axes likewise; its own inverse."""
    turned = state.copy()
    turned[[1, 2, 4, 5, 8, 9, 11, 12]] *= -1
    return turned


def drone_models(effects: dict[str, Any]) -> Replay:
    from drone_models.first_principles.model import dynamics

    text, _ = dw.Vehicle(VEHICLE).with_effects(effects).export("drone-models")
    (table,) = tomllib.loads(text).values()
    keys = ["mass", "L", "prop_inertia", "gravity_vec", "J", "rpm2thrust", "rpm2torque"]
    keys += ["mixing_matrix", "drag_matrix", "rotor_dyn_coef"]
    parameters = {key: np.asarray(table[key], float) for key in keys}
    parameters["J_inv"] = np.linalg.inv(parameters["J"])
    full = np.sqrt(table["thrust_max"] / table["rpm2thrust"][2])
    curve = thrust_curve(text)

    def replay(state: NUMBERS, rotors: NUMBERS, outputs: NUMBERS) -> NUMBERS:
        turned = mirrored(state)
        x = np.concatenate([turned[:6], turned[[7, 8, 9, 6]], turned[10:13]])
        speed = full * np.sqrt(rotors * (1 - curve) + curve * rotors**2)
        for u in outputs:
            command = full * np.sqrt(u * (1 - curve) + curve * u**2)

            def at(x: NUMBERS, speed: NUMBERS) -> tuple[NUMBERS, NUMBERS]:
                q = x[6:10] / np.linalg.norm(x[6:10])
                p, _, a, b, w = dynamics(
                    x[:3], q, x[3:6], x[10:13], command, speed, **parameters
                )
                # Its documentation says not to integrate its quaternion rate.
                turn = np.append(q[3] * x[10:13] + np.cross(q[:3], x[10:13]), -q[:3] @ x[10:13])
                return np.concatenate([p, a, turn / 2, b]), w

            k1, w1 = at(x, speed)
            k2, w2 = at(x + STEP / 2 * k1, speed + STEP / 2 * w1)
            x, speed = x + STEP * k2, speed + STEP * w2
        q = x[6:10] / np.linalg.norm(x[6:10])
        return mirrored(np.concatenate([x[:6], q[[3, 0, 1, 2]], x[10:13]]))

    return replay


def mujoco(effects: dict[str, Any]) -> Replay:
    engine = importlib.import_module("mujoco")
    text, _ = dw.Vehicle(VEHICLE).with_effects(effects).export("mujoco")
    model = engine.MjModel.from_xml_string(text)
    curve = thrust_curve(text)

    def bent(u: NUMBERS) -> NUMBERS:
        return u * (1 - curve) + curve * u**2

    def replay(state: NUMBERS, rotors: NUMBERS, outputs: NUMBERS) -> NUMBERS:
        data = engine.MjData(model)
        turned = mirrored(state)
        data.qpos[:], data.qvel[:] = turned[[0, 1, 2, 6, 7, 8, 9]], turned[[3, 4, 5, 10, 11, 12]]
        if model.na:
            data.act[:] = bent(rotors)
        for u in outputs:
            data.ctrl[:] = bent(u)
            engine.mj_step(model, data)
        moved = np.concatenate([data.qpos[:3], data.qvel[:3], data.qpos[3:], data.qvel[3:]])
        return mirrored(moved)

    return replay


def rotorpy(effects: dict[str, Any]) -> Replay:
    from rotorpy.vehicles.multirotor import Multirotor

    text, _ = dw.Vehicle(VEHICLE).with_effects(effects).export("rotorpy")
    parameters = module(text, "rotorpy_vehicle").quad_params
    curve = thrust_curve(text)

    def speeds(u: NUMBERS) -> NUMBERS:
        return np.asarray(parameters["rotor_speed_max"] * np.sqrt(u * (1 - curve) + curve * u**2))

    def replay(state: NUMBERS, rotors: NUMBERS, outputs: NUMBERS) -> NUMBERS:
        turned = mirrored(state)
        moving = {
            "x": turned[:3],
            "v": turned[3:6],
            "q": turned[[7, 8, 9, 6]],
            "w": turned[10:13],
            "wind": np.zeros(3),
            "rotor_speeds": speeds(rotors),
        }
        vehicle = Multirotor(parameters, initial_state=moving)
        for u in outputs[::10]:
            moving = vehicle.step(moving, {"cmd_motor_speeds": speeds(u)}, 10 * STEP)
        q = moving["q"][[3, 0, 1, 2]]
        return mirrored(np.concatenate([moving["x"], moving["v"], q, moving["w"]]))

    return replay


def error(replay: Replay, windows: list[tuple[NUMBERS, NUMBERS, NUMBERS, NUMBERS]]) -> float:
    """RMS error at the windows' ends, m: of the position, and of the attitude with a lever arm of 1 m."""
    total = 0.0
    for start, rotors, outputs, flown_to in windows:
        end = replay(start, rotors, outputs)
        total += float(np.sum((end[:3] - flown_to[:3]) ** 2))
        total += 8 * (1 - min(1.0, abs(float(np.dot(end[6:10], flown_to[6:10])))))
    return float(np.sqrt(total / len(windows)))


@pytest.mark.parametrize(
    "peer, nominal, found",
    [
        (casadi, {}, EVERY),
        (casadi, {"motor_lag": {"tau_s": 0.0}}, {"motor_lag": {"tau_s": 0.0}, **DRAGGED}),
        (drone_models, {}, {**DRAGGED, **CURVED}),
        (mujoco, NO_DRAG, {**NO_DRAG, **HEAVIER, **CURVED}),
        (rotorpy, {}, {**DRAGGED, **BENT, **CURVED}),
    ],
    ids=["casadi", "casadi-without-lag", "drone-models", "mujoco", "rotorpy"],
)
def test_exports_reproduce_the_found_effects(
    peer: Callable[[dict[str, Any]], Replay], nominal: dict[str, Any], found: dict[str, Any]
) -> None:
    windows = flown(found)
    ours = error(own(nominal), windows) - error(own(found), windows)
    assert ours > 0.02, "the effects matter"
    theirs = error(peer(nominal), windows) - error(peer(found), windows)
    assert theirs >= 0.8 * ours, f"error reduced by {theirs} m, ours by {ours} m"


@pytest.mark.parametrize("name", ["rotorpy", "drone-models", "px4-sih", "mujoco", "casadi"])
@pytest.mark.parametrize("vehicle", ["crazyflie", "quad1200"])
def test_every_shipped_vehicle_is_exported(name: str, vehicle: str) -> None:
    text, lost = dw.Vehicle(vehicle).export(name)
    assert "Not expressed" in text or not lost
    assert len(text.splitlines()) > 15


def test_an_unknown_simulator_is_refused() -> None:
    with pytest.raises(ValueError, match="rotorpy"):
        dw.Vehicle().export("gazebo")
