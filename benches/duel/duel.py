"""A duel on the same plant: downwash after a minute of own flight, and RAPTOR's policy without any.

    python duel.py [--vehicles N] [--seed S] [--only K] [--json FILE]

Each vehicle is drawn inside RAPTOR's training range of mass (0.035 to 2.4 kg), with one or two
effects that its file does not say. downwash is given the file: it collects a minute of flight, learns
a model from it, plans each mission through the model and flies the plan, over MAVLink in lockstep,
with simulated sensors, a link's delay and the file's own attitude loop on board. RAPTOR (a recurrent
policy of 2084 weights, PyPI ``foundation-policy``) is given the true state at 100 Hz, without noise or
delay, and commands the motors of the same plant directly; it knows nothing of the vehicle, as it is
made for. Both fly the same missions, and the error is that of the true position against the desired
trajectory.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import downwash as dw
import numpy as np
from foundation_policy import Raptor

MISSIONS = ["sinusoid-yaw", "figure-8", "sinusoid-xz"]
# Without bounds on the error the policy is asked for what it was never trained on.
POSITION_MAX_M, VELOCITY_MAX_M_S = 0.5, 1.0
SETTLE_S = 4.0


def drawn_vehicle(draw: np.random.Generator) -> dict:
    """A quadrotor in X, its numbers scaled from those of the nano quadrotor that is shipped."""
    keys = dw.Vehicle("crazyflie").to_dict()
    mass = math.exp(draw.uniform(math.log(0.035), math.log(2.4)))
    arm = 0.046 * (mass / 0.03) ** (1 / 3) * draw.uniform(0.85, 1.25)
    share = draw.uniform(0.3, 0.55)
    tilt_inertia = mass * (draw.uniform(0.42, 0.6) * arm) ** 2
    inertia = [tilt_inertia * draw.uniform(0.9, 1.1), tilt_inertia, 1.77 * tilt_inertia]
    lag = draw.uniform(0.02, 0.05)
    natural = min(17.0 * math.sqrt(0.046 / arm), 0.6 / lag)
    keys["name"] = "drawn"
    keys["mass"] = mass
    keys["inertia"] = inertia
    keys["motor_time_constant_s"] = lag
    keys["hover_thrust"] = share
    keys["rotor_radius_m"] = 0.5 * arm
    keys["rotor_max_rpm"] = 23873.0 * (0.0231 / (0.5 * arm)) ** 0.9
    keys.pop("provenance", None)
    for rotor in keys["rotors"]:
        x, y, z = rotor["position_m"]
        rotor["position_m"] = [math.copysign(arm, x) / math.sqrt(2), math.copysign(arm, y) / math.sqrt(2), z]
        rotor["thrust_max_N"] = mass * keys["gravity"] / (4.0 * share)
        rotor["drag_torque_per_thrust_m"] = 0.13 * arm
    naturals = [natural, natural, 0.5 * natural]
    keys["attitude_pd"] = {
        "kp": [j * w * w for j, w in zip(inertia, naturals)],
        "kd": [1.8 * j * w for j, w in zip(inertia, naturals)],
        "rate_hz": 250.0,
    }
    return keys


def drawn_effects(draw: np.random.Generator, keys: dict) -> dict:
    """One or two effects that the file does not say."""
    mass, arm = keys["mass"], math.hypot(*keys["rotors"][0]["position_m"][:2])
    drag = mass * draw.uniform(0.15, 0.5)
    wind = draw.uniform(0.0, 2.0 * math.pi)
    effects = [
        {"mass": {"mass_kg": mass * draw.uniform(1.05, 1.25)}},
        {"thrust_scale": {"scale": draw.uniform(0.85, 1.1)}},
        {"rotor_drag": {"d_xy": drag, "d_z": 0.5 * drag}},
        {"motor_lag": {"tau_s": keys["motor_time_constant_s"] + draw.uniform(0.01, 0.03)}},
        {"com_offset": {"x_m": 0.05 * arm * draw.uniform(-1, 1), "y_m": 0.05 * arm * draw.uniform(-1, 1)}},
        {"inertia": {"scale": [draw.uniform(0.8, 1.3)] * 3}},
        {"rotor_loss": {"rotor": int(draw.integers(4)), "scale": draw.uniform(0.9, 0.97)}},
        {
            "rotor_drag": {"d_xy": drag, "d_z": 0.5 * drag},
            "wind": {"north_m_s": 2.0 * math.cos(wind), "east_m_s": 2.0 * math.sin(wind)},
        },
    ]
    chosen = draw.choice(len(effects), size=draw.integers(1, 3), replace=False)
    found: dict = {}
    for index in chosen:
        found |= effects[index]
    return found


def downwash_errors(keys: dict, effects: dict, folder: Path, seed: int) -> tuple[dict, float]:
    """RMS error of each mission, m, after a minute of own flight; and s from flights to the last plan."""
    vehicle_file, effects_file = folder / "vehicle.json", folder / "effects.json"
    vehicle_file.write_text(json.dumps(keys))
    effects_file.write_text(json.dumps(effects))
    command = [sys.executable, "-m", "downwash", "collect", "--seconds", "60", "--seed", str(seed)]
    command += ["--vehicle", str(vehicle_file), "--effects", str(effects_file), "--out", str(folder / "flights")]
    subprocess.run(command, check=True, capture_output=True)
    began = time.monotonic()
    vehicle = dw.Vehicle(vehicle_file)
    learner = dw.Learner(vehicle).fit(sorted((folder / "flights").glob("*.mcap")))
    plans = {mission: dw.plan(mission, vehicle, learner.model_) for mission in MISSIONS}
    seconds = time.monotonic() - began
    errors = {}
    for mission, plan in plans.items():
        row = dw.fly(vehicle, plan, effects, seeds=seed)[0]
        errors[mission] = row["true_position_rmse_m"]
    return errors, seconds


def rotation(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


FLIP = np.diag([1.0, -1.0, -1.0])  # front, right, down and front, left, up; north, east, down and north, west, up


def raptor_error(vehicle: dw.Vehicle, effects: dict, mission: str) -> float:
    """RMS error of a mission, m; infinite where the vehicle is lost."""
    trajectory = dw.Trajectory(mission)
    times = np.arange(-SETTLE_S, trajectory.duration_s, 0.01)
    desired = trajectory.sample(np.maximum(times, 0.0))
    names = {name: index for index, name in enumerate(dw.POINT)}
    position = desired[:, [names[f"{axis}_m"] for axis in ("north", "east", "down")]]
    velocity = desired[:, [names[f"{axis}_m_s"] for axis in ("north", "east", "down")]]
    velocity = np.where(times[:, None] < 0.0, 0.0, velocity)
    yaw = desired[:, names["yaw_rad"]]
    start = [*position[0], 0.0, 0.0, 0.0, math.cos(0.5 * yaw[0]), 0.0, 0.0, math.sin(0.5 * yaw[0]), 0.0, 0.0, 0.0]
    plant = dw.Plant(vehicle, effects, state=start)
    policy = Raptor()
    policy.reset()
    action = np.zeros(4)
    steps = round(0.01 / dw.Plant.step_s)
    errors = []
    for k, t in enumerate(times):
        state = plant.state
        attitude = rotation(state[6:10])
        sin, cos = math.sin(yaw[k]), math.cos(yaw[k])
        heading = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        off = np.clip(FLIP @ heading.T @ (state[:3] - position[k]), -POSITION_MAX_M, POSITION_MAX_M)
        drift = np.clip(FLIP @ heading.T @ (state[3:6] - velocity[k]), -VELOCITY_MAX_M_S, VELOCITY_MAX_M_S)
        turned = FLIP @ heading.T @ attitude @ FLIP
        observation = np.concatenate([off, turned.ravel(), drift, FLIP @ state[10:13], action])
        action = policy.evaluate_step(observation[None, :])[0]
        # Its action is a rotor's speed between rest and full speed; thrust grows with the square.
        outputs = (0.5 * (np.clip(action, -1.0, 1.0) + 1.0)) ** 2
        if t >= 0.0:
            errors.append(np.sum((state[:3] - position[k]) ** 2))
        if not np.all(np.isfinite(state)) or np.linalg.norm(state[:3] - position[k]) > 20.0:
            return math.inf
        plant.step(outputs.tolist(), steps)
    return math.sqrt(float(np.mean(errors)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, help="one vehicle of them")
    parser.add_argument("--json", type=Path, help="where a line for each vehicle is added")
    arguments = parser.parse_args()
    rows = []
    numbers = range(arguments.vehicles) if arguments.only is None else [arguments.only]
    for number in numbers:
        draw = np.random.default_rng([arguments.seed, number])
        keys = drawn_vehicle(draw)
        effects = drawn_effects(draw, keys)
        with tempfile.TemporaryDirectory() as folder:
            try:
                ours, seconds = downwash_errors(keys, effects, Path(folder), number + 1)
            except (dw.DownwashError, subprocess.CalledProcessError) as error:
                print(f"vehicle {number}: downwash does not fly it: {error}", file=sys.stderr)
                ours, seconds = dict.fromkeys(MISSIONS, math.inf), math.nan
            vehicle_file = Path(folder) / "vehicle.json"
            theirs = {mission: raptor_error(dw.Vehicle(vehicle_file), effects, mission) for mission in MISSIONS}
        row = {
            "vehicle": number, "mass_kg": keys["mass"], "effects": effects, "downwash_m": ours,
            "raptor_m": theirs, "learned_in_s": seconds,
        }  # fmt: skip
        rows.append(row)
        if arguments.json:
            with arguments.json.open("a") as file:
                file.write(json.dumps(row) + "\n")
        told = "  ".join(f"{m} {ours[m]:.4f} / {theirs[m]:.4f}" for m in MISSIONS)
        print(f"{number:3} {keys['mass']:6.3f} kg  {' '.join(effects):40} {told}", file=sys.stderr)
    for mission in MISSIONS:
        ours = np.array([row["downwash_m"][mission] or math.inf for row in rows])
        theirs = np.array([row["raptor_m"][mission] for row in rows])
        worse = int(np.sum(ours > theirs))
        print(
            f"{mission:14} downwash {np.median(ours):.4f} m, RAPTOR {np.median(theirs):.4f} m (medians); "
            f"times {np.median(theirs) / np.median(ours):.1f}; worse on {worse} of {len(rows)}; "
            f"lost {int(np.sum(~np.isfinite(ours)))} and {int(np.sum(~np.isfinite(theirs)))}"
        )


if __name__ == "__main__":
    main()
