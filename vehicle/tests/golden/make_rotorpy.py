"""Trajectories of RotorPy, an independent quadrotor simulator, as golden data for the plant.

    python3 -m venv venv && venv/bin/pip install rotorpy==3.0
    venv/bin/python make_rotorpy.py > rotorpy.json

Two flights of RotorPy's Crazyflie 2.x, in this project's conventions:

- no_drag: `aero=False`, four different and changing rotor commands: the vehicle tumbles.
- drag: rotor drag and parasitic drag, a tilted attitude, a steady wind and equal rotor commands. RotorPy adds each hub's
  velocity due to the body rate to its rotor drag, which the catalogue's rotor_drag does not have; with equal
  rotors the body rate stays 0 and both laws agree.

RotorPy's world is x, y, z up and its body front, left, up; mapped to NED and FRD by (x, -y, -z). RotorPy's lag is that of
the rotor's speed. With thrust_curve a = 1 the rotor's state is the speed as a fraction of the maximum, so the lag of
the state is the same equation. Integrated by DOP853 at rtol 1e-11.
"""

import importlib.metadata
import json
import sys

import numpy as np
from rotorpy.vehicles.crazyflie_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

HOLD = 0.02  # s between samples; commands are held
COUNT = 75
AIR_DENSITY = 1.2
FLIP = np.array([1.0, -1.0, -1.0])


def vehicle(params, effects):
    """The vehicle in this project's schema."""
    speed_max = params["rotor_speed_max"]
    thrust_max = params["k_eta"] * speed_max**2
    return {
        "name": "rotorpy_crazyflie",
        "mass": params["mass"],
        "inertia": [params["Ixx"], params["Iyy"], params["Izz"]],
        "rotors": [
            {
                "position_m": (FLIP * position).tolist(),
                "spin": -int(direction),  # about down instead of up
                "thrust_max_N": thrust_max,
                "drag_torque_per_thrust_m": params["k_m"] / params["k_eta"],
            }
            for position, direction in zip(params["rotor_pos"].values(), params["rotor_directions"])
        ],
        "motor_time_constant_s": params["tau_m"],
        "command_delay_s": 0.0,
        "hover_thrust": params["mass"] * 9.81 / (4 * thrust_max),
        "gravity": 9.81,
        "air_density": AIR_DENSITY,
        "rotor_radius_m": 0.0231,
        "rotor_max_rpm": speed_max * 60 / (2 * np.pi),
        "battery": {"cells": 1, "full_V": 4.2, "nominal_V": 3.7},
        "modelled_effects": {"thrust_curve": {"a": 1.0}, **effects},
    }


def fly(params, aero, start, wind, commands):
    """Samples: the state before each command, and the command as fractions of the maximum speed."""
    speed_max = params["rotor_speed_max"]
    simulator = Multirotor(params, aero=aero, integrator_kwargs={"method": "DOP853", "rtol": 1e-11, "atol": 1e-13})
    state = {**start, "wind": wind}
    rows = []
    for command in commands:
        i, j, k, w = state["q"]
        rows.append(
            {
                "command": command.tolist(),
                "position": (FLIP * state["x"]).tolist(),
                "velocity": (FLIP * state["v"]).tolist(),
                "attitude": [w, i, -j, -k],
                "body_rate": (FLIP * state["w"]).tolist(),
                "rotors": (state["rotor_speeds"] / speed_max).tolist(),
            }
        )
        state = simulator.step(state, {"cmd_motor_speeds": command * speed_max}, HOLD)
        state["wind"] = wind
    return rows


def rounded(value):
    if isinstance(value, float):
        return float(f"{value:.10g}")
    if isinstance(value, list):
        return [rounded(item) for item in value]
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    return value


def main():
    params = dict(quad_params)
    speed_max = params["rotor_speed_max"]
    hover = np.sqrt(params["mass"] * 9.81 / (4 * params["k_eta"])) / speed_max
    times = np.arange(COUNT) * HOLD

    tumble = hover + 0.006 * np.stack([np.sin(7 * times + phase) for phase in (0.0, 1.1, 2.5, 4.0)], axis=1)
    tumble_start = {
        "x": np.array([0.3, -0.2, 1.5]),
        "v": np.array([0.4, 0.1, -0.2]),
        "q": np.array([0.05, -0.08, 0.3, 0.95]) / np.linalg.norm([0.05, -0.08, 0.3, 0.95]),
        "w": np.array([0.3, -0.5, 0.8]),
        "rotor_speeds": hover * speed_max * np.array([0.9, 1.0, 1.05, 0.97]),
    }

    draggy = {**params, "c_Dx": 3e-4, "c_Dy": 3e-4, "c_Dz": 3e-4}
    equal = np.repeat((hover + 0.1 * np.sin(5 * times))[:, None], 4, axis=1)
    tilt = np.array([0.12, 0.2, -0.25, 0.9])
    drag_start = {
        "x": np.array([0.0, 0.0, 3.0]),
        "v": np.array([2.5, -1.5, 0.6]),
        "q": tilt / np.linalg.norm(tilt),
        "w": np.zeros(3),
        "rotor_speeds": hover * speed_max * np.ones(4),
    }
    wind = np.array([-1.0, 0.7, 0.2])
    effects = {
        "rotor_drag": {
            "d_xy": 4 * params["k_d"] * speed_max * hover,
            "d_z": 4 * params["k_z"] * speed_max * hover,
        },
        "parasitic_drag": {"cda_m2": 2 * 3e-4 / AIR_DENSITY},
        "wind": dict(zip(("north_m_s", "east_m_s", "down_m_s"), (FLIP * wind).tolist())),
    }

    golden = {
        "provenance": {
            "simulator": f"rotorpy {importlib.metadata.version('rotorpy')}, vehicles/crazyflie_params.py",
            "python": sys.version.split()[0],
            "numpy": np.__version__,
            "scipy": importlib.metadata.version("scipy"),
            "command": "python make_rotorpy.py > rotorpy.json",
        },
        "hold_s": HOLD,
        "flights": [
            {
                "name": "no_drag",
                "vehicle": vehicle(params, {}),
                "samples": fly(params, False, tumble_start, np.zeros(3), tumble),
            },
            {
                "name": "drag",
                "vehicle": vehicle(draggy, effects),
                "samples": fly(draggy, True, drag_start, wind, equal),
            },
        ],
    }
    lines = json.dumps(rounded(golden)).replace('{"command"', '\n{"command"')
    print(lines)


main()
