"""Closed-loop flights of RotorPy, an independent quadrotor simulator, under a controller written here.

    python3 -m venv venv && venv/bin/pip install rotorpy==3.0
    venv/bin/python make_closed_loop.py > closed_loop.json

Everything between desired trajectory and motion is of this file or of RotorPy's: the trajectory, the near-hover model
with the attitude loop inside, its discretisation (SciPy's expm), the gain (SciPy's solve_discrete_are), the rotation of
the horizontal errors by yaw, the on-board PD and its mixer, and the equations of motion (RotorPy's, integrated by DOP853
at rtol 1e-11). All of it works in RotorPy's frames: world x, y, z up; body front, left, up. Turning by pi about x, which
maps a vector (x, y, z) to (x, -y, -z), gives this project's world and body axes; only what is written is turned.

The vehicle is RotorPy's Crazyflie 2.x without aerodynamics. Its lag, which is of the rotor's speed and not of its
thrust, is taken away by setting the rotors' speeds to the commanded ones at each tick of the on-board loop.

Timing, in ms from the first sample of the trajectory: samples at 0, 10, 20, ...; ticks of the on-board loop each 4 ms,
the first PD_PHASE_MS after that sample. A tick uses the newest setpoint that was made before it; a sample at the very
time of a tick comes too late for it: a setpoint is 2 or 4 ms under way, in turn. The flight begins at rest at the
trajectory's start.
"""

import importlib.metadata
import json
import sys

import numpy as np
from rotorpy.vehicles.crazyflie_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor
from scipy.linalg import expm, solve_discrete_are
from scipy.spatial.transform import Rotation

SAMPLE_MS = 10
PD_MS = 4
PD_PHASE_MS = 0
FLIP = np.array([1.0, -1.0, -1.0])

KP = np.array([0.0042, 0.0042, 0.0019])  # N m/rad: 17 rad/s in roll and pitch, 8 rad/s in yaw
KD = np.array([0.00044, 0.00044, 0.00042])  # N m s/rad: damping ratio 0.9

# Acceptable deviations, in this project's names. Each weight is 1 / deviation^2.
FEEDBACK = {
    "rate_hz": 1000 / SAMPLE_MS,
    "position_m": [0.3, 0.3, 0.2],
    "velocity_m_s": [3.0, 3.0, 1.0],
    "attitude_rad": [5.0, 5.0, 2.0],
    "body_rate_rad_s": [50.0, 50.0, 20.0],
    "thrust": 0.35,  # of the weight
    "attitude_command_rad": [0.25, 0.25, 0.3],
    "body_rate_command_rad_s": [0.05, 0.05, 0.05],
}

ALTITUDE = 1.0
# North, east, up in m, yaw about down in degrees; a dwell at the start goes before them.
STEPS = {"dwell_s": 2.5, "offsets": [[0.5, -0.3, 0.2, 30.0], [0.0, 0.0, 0.0, 0.0]]}
SINUSOID_YAW = {"duration_s": 20.0, "amplitude_m": 1.0, "period_s": 5.0, "yaw_period_s": 10.0, "ramp_s": 2.0}


def steps(t_ms):
    """Desired position, velocity, yaw and yaw rate."""
    offsets = [[0.0, 0.0, 0.0, 0.0], *STEPS["offsets"]]
    index = min(int(t_ms // (1000 * STEPS["dwell_s"])), len(offsets) - 1)
    north, east, up, yaw = offsets[index]
    return np.array([north, -east, ALTITUDE + up]), np.zeros(3), -np.radians(yaw), 0.0


def sinusoid_yaw(t_ms):
    """A circle while turning, through phase time, whose rate rises to 1 and falls to 0 by a smooth step."""
    t, ramp = t_ms / 1000, SINUSOID_YAW["ramp_s"]
    total = SINUSOID_YAW["duration_s"] + ramp

    def rising(t):
        x = t / ramp
        return ramp * (x**6 - 3 * x**5 + 2.5 * x**4), 6 * x**5 - 15 * x**4 + 10 * x**3

    if t < ramp:
        phase, rate = rising(t)
    elif t > total - ramp:
        left, rate = rising(total - t)
        phase = SINUSOID_YAW["duration_s"] - left
    else:
        phase, rate = t - ramp / 2, 1.0
    radius, w = SINUSOID_YAW["amplitude_m"], 2 * np.pi / SINUSOID_YAW["period_s"]
    turn = -2 * np.pi / SINUSOID_YAW["yaw_period_s"]
    position = np.array([radius * np.sin(w * phase), radius * (np.cos(w * phase) - 1), ALTITUDE])
    velocity = np.array([radius * w * np.cos(w * phase), -radius * w * np.sin(w * phase), 0.0]) * rate
    return position, velocity, turn * phase, turn * rate


def wrap(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def angles(quaternion):
    """Roll, pitch, yaw about front, left, up."""
    return Rotation.from_quat(quaternion).as_euler("ZYX")[::-1]


class Controller:
    """u_hat = u_hat* - G T_R (s - s*), G from the Riccati equation of the near-hover model."""

    def __init__(self, mass, gravity, inertia):
        self.weight = mass * gravity
        a, b = np.zeros((12, 12)), np.zeros((12, 7))
        a[0:3, 3:6] = a[6:9, 9:12] = np.eye(3)
        a[3, 7] = gravity  # nose down: forwards
        a[4, 6] = -gravity  # right side down: to the right
        b[5, 0] = 1 / mass
        a[9:12, 6:9], a[9:12, 9:12] = -np.diag(KP / inertia), -np.diag(KD / inertia)
        b[9:12, 1:4], b[9:12, 4:7] = np.diag(KP / inertia), np.diag(KD / inertia)
        held = np.zeros((19, 19))
        held[:12, :12], held[:12, 12:] = a, b
        held = expm(held * SAMPLE_MS / 1000)
        a, b = held[:12, :12], held[:12, 12:]

        def weights(*deviations):
            return np.diag(np.concatenate([np.atleast_1d(d) for d in deviations]) ** -2.0)

        f = {name: np.array(value) for name, value in FEEDBACK.items()}
        q = weights(f["position_m"], f["velocity_m_s"], f["attitude_rad"], f["body_rate_rad_s"])
        r = weights(f["thrust"] * self.weight, f["attitude_command_rad"], f["body_rate_command_rad_s"])
        p = solve_discrete_are(a, b, q, r)
        self.gain = np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)

    def setpoint(self, state, desired):
        position, velocity, yaw, yaw_rate = desired
        zeta = angles(state["q"])
        turn = Rotation.from_euler("Z", -zeta[2])
        rate = np.array([0.0, 0.0, yaw_rate])
        error = np.concatenate(
            [
                turn.apply(state["x"] - position),
                turn.apply(state["v"] - velocity),
                wrap(zeta - np.array([0.0, 0.0, yaw])),
                state["w"] - rate,
            ]
        )
        ahead = np.concatenate([[self.weight, 0.0, 0.0, yaw], rate])
        return ahead - self.gain @ error


class Mixer:
    """Rotor thrusts for a collective and moments, clipped one by one."""

    def __init__(self, params):
        positions = np.array(list(params["rotor_pos"].values()))
        torque = params["k_m"] / params["k_eta"] * np.array(params["rotor_directions"])
        # A thrust up at (x, y): moment y about front, -x about left.
        self.wrench = np.vstack([np.ones(4), positions[:, 1], -positions[:, 0], torque])
        self.thrust_max = params["k_eta"] * params["rotor_speed_max"] ** 2
        self.k_eta = params["k_eta"]
        self.clipped = 0

    def speeds(self, wrench):
        thrusts = np.linalg.solve(self.wrench, wrench)
        clipped = np.clip(thrusts, 0.0, self.thrust_max)
        self.clipped += int(np.any(thrusts != clipped))
        return np.sqrt(clipped / self.k_eta)


def moments(setpoint, state):
    """The on-board loop."""
    return KP * wrap(setpoint[1:4] - angles(state["q"])) + KD * (setpoint[4:7] - state["w"])


def fly(params, desired, duration_ms, row_ms):
    """Rows in this project's axes: the state at a sample, and the setpoint made from it."""
    simulator = Multirotor(params, aero=False, integrator_kwargs={"method": "DOP853", "rtol": 1e-11, "atol": 1e-13})
    inertia = np.array([params["Ixx"], params["Iyy"], params["Izz"]])
    controller, mixer = Controller(params["mass"], simulator.g, inertia), Mixer(params)
    position, _, yaw, _ = desired(0)
    state = {
        "x": position,
        "v": np.zeros(3),
        "q": Rotation.from_euler("Z", yaw).as_quat(),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": mixer.speeds([controller.weight, 0.0, 0.0, 0.0]),
    }
    setpoint = np.array([controller.weight, 0.0, 0.0, yaw, 0.0, 0.0, 0.0])
    speeds = state["rotor_speeds"]
    rows, now = [], 0
    while now <= duration_ms:
        if now % PD_MS == PD_PHASE_MS:
            speeds = mixer.speeds([setpoint[0], *moments(setpoint, state)])
        if now % SAMPLE_MS == 0:
            setpoint = controller.setpoint(state, desired(now))
            if now % row_ms == 0:
                rows.append(row(now, state, setpoint))
        until = min(now + SAMPLE_MS - now % SAMPLE_MS, now + PD_MS - (now - PD_PHASE_MS) % PD_MS)
        state = {**state, "rotor_speeds": speeds, "wind": np.zeros(3)}
        state = simulator.step(state, {"cmd_motor_speeds": speeds}, (until - now) / 1000)
        now = until
    return rows, mixer.clipped


def decimals(values):
    # Adding 0 takes the sign off a zero.
    return (np.round(values, 9) + 0.0).tolist()


def row(now, state, setpoint):
    x, y, z, w = state["q"]
    return {
        "t": now / 1000,
        "position": decimals(FLIP * state["x"]),
        "velocity": decimals(FLIP * state["v"]),
        "attitude": decimals([w, x, -y, -z]),
        "body_rate": decimals(FLIP * state["w"]),
        "thrust_n": round(float(setpoint[0]), 10),
        "desired_attitude": decimals(wrap(FLIP * setpoint[1:4])),
        "desired_body_rate": decimals(FLIP * setpoint[4:7]),
    }


def vehicle(params):
    """The vehicle in this project's schema."""
    thrust_max = params["k_eta"] * params["rotor_speed_max"] ** 2
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
        "motor_time_constant_s": 0.0,
        "command_delay_s": 0.0,
        "hover_thrust": params["mass"] * 9.81 / (4 * thrust_max),
        "gravity": 9.81,
        "air_density": 1.2,
        "rotor_radius_m": 0.0231,
        "attitude_pd": {"kp": KP.tolist(), "kd": KD.tolist(), "rate_hz": 1000 / PD_MS},
        "battery": {"cells": 1, "full_V": 4.2, "nominal_V": 3.7},
        "modelled_effects": {},
    }


def rounded(value):
    if isinstance(value, float):
        return float(f"{value:.10g}")
    if isinstance(value, list):
        return [rounded(item) for item in value]
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    return value


def toml(family, parameters):
    lines = [f'family = "{family}"', f"altitude_m = {ALTITUDE}"]
    return "\n".join(lines + [f"{key} = {value}" for key, value in parameters.items()]) + "\n"


def main():
    params = dict(quad_params)
    step_ms = int(1000 * STEPS["dwell_s"] * (1 + len(STEPS["offsets"])))
    sinusoid_ms = int(1000 * (SINUSOID_YAW["duration_s"] + SINUSOID_YAW["ramp_s"]))
    flights = [
        ("steps", STEPS, steps, step_ms - SAMPLE_MS, 50),
        ("sinusoid-yaw", SINUSOID_YAW, sinusoid_yaw, sinusoid_ms, 200),
    ]
    golden = {
        "provenance": {
            "simulator": f"rotorpy {importlib.metadata.version('rotorpy')}, vehicles/crazyflie_params.py, aero=False",
            "python": sys.version.split()[0],
            "numpy": np.__version__,
            "scipy": importlib.metadata.version("scipy"),
            "command": "python make_closed_loop.py > closed_loop.json",
        },
        "pd_phase_ms": PD_PHASE_MS,
        "vehicle": vehicle(params),
        "feedback": FEEDBACK,
        "flights": [],
    }
    for family, parameters, desired, duration_ms, row_ms in flights:
        rows, clipped = fly(params, desired, duration_ms, row_ms)
        golden["flights"].append(
            {"trajectory": toml(family, parameters), "clipped_ticks": clipped, "samples": rows}
        )
    print(json.dumps(rounded(golden)).replace('{"t"', '\n{"t"').replace('{"trajectory"', '\n{"trajectory"'))


main()
