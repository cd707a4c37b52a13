"""Checks that RAPTOR flies in downwash's plant as elsewhere: on vehicles of its kind, without effects.

Its authors' deployment flies a figure of eight of 2 m by 1 m in 10 s by default. RotorPy has its own adapter
for the policy; its results in RotorPy are printed for comparison.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import downwash as dw
import numpy as np
import onboard
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from missions import MISSIONS, RATE_HZ, Array, error_m
from raptor import Policy
from rotorpy.controllers.raptor import RaptorFoundationPolicy
from rotorpy.vehicles.crazyflie_params import quad_params as CRAZYFLIE
from rotorpy.vehicles.multirotor import Multirotor
from vehicles import Drawn

HOVER_S = 10.0
SLOW = {**MISSIONS["figure-8"], "duration_s": 20.0, "period_s": 10.0}
FAST = MISSIONS["figure-8"]
FLU = np.diag([1.0, -1.0, -1.0])


def points(keys: dict[str, object]) -> Array:
    course = dw.Trajectory(keys)
    return course.sample(np.arange(0.0, course.duration_s + 1e-9, 1 / RATE_HZ))


def like_x500() -> dict[str, object]:
    """An x500 with the parameters of the authors' simulator: 2 kg, arms of 0.25 m, 50 N in total."""
    file = dw.Vehicle("quad1200").to_dict()
    side, mass, inertia, full = 0.1768, 2.0, np.array([0.02448, 0.02448, 0.04396]), 12.8
    rotors = [
        {
            **rotor,
            "position_m": [float(np.sign(p)) * side for p in rotor["position_m"][:2]] + [0.0],
            "thrust_max_N": full,
        }
        for rotor in file["rotors"]
    ]
    loop = {"kp": (inertia * 144).tolist(), "kd": (inertia * 21.6).tolist(), "rate_hz": 250.0}
    changed = {"name": "x500", "mass": mass, "inertia": inertia.tolist(), "rotors": rotors}
    changed |= {"hover_thrust": mass * file["gravity"] / (4 * full), "attitude_pd": loop}
    return file | changed | {"modelled_effects": {}}


def in_rotorpy(course: Array) -> float:
    """RAPTOR through RotorPy's own adapter, in RotorPy's simulator, on RotorPy's Crazyflie."""
    hover = float(np.sqrt(CRAZYFLIE["mass"] * 9.81 / 4 / CRAZYFLIE["k_eta"]))
    state = {
        "x": FLU @ course[0, :3],
        "v": np.zeros(3),
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": np.full(4, hover),
    }
    vehicle, policy = Multirotor(CRAZYFLIE, initial_state=state), RaptorFoundationPolicy(CRAZYFLIE)
    before = round(onboard.HOVER_S * RATE_HZ)
    flown = []
    for tick in range(-before, len(course)):
        point = course[max(tick, 0)]
        if tick >= 0:
            flown.append(FLU @ state["x"])
        moving = tick >= 0
        wanted = {"x": FLU @ point[:3], "x_dot": (FLU @ point[3:6]) * moving}
        state = vehicle.step(state, policy.update(0.0, state, wanted), 1 / RATE_HZ)
    return error_m(np.array(flown), course)


def same_air_m_s2() -> float:
    """Largest difference in acceleration, gusts included, between a flight from the ground and the plant
    of the on-board controllers, at the same states and times."""
    effects = {
        "wind": {"north_m_s": 1.0},
        "gusts": {"sigma_m_s": 0.8},
        "rotor_drag": {"d_xy": 0.02, "d_z": 0.01},
        "mass": {"mass_kg": 0.033},
    }
    full = dw.Vehicle("crazyflie").to_dict()["rotors"][0]["thrust_max_N"]
    plant, now_ms, most = dw.Plant("crazyflie", effects, seed=7), 0, 0.0
    with TemporaryDirectory() as folder:
        row = dw.fly("crazyflie", FAST, effects, seeds=7, logs=folder)[0]
        with Path(row["log"]).open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            found = reader.iter_decoded_messages(topics=["/sim/truth"])
            truths = [true for _, _, _, true in found][1000:2500:50]
    for true in truths:
        time_ms = round(true.vehicle_time_us / 1000)
        plant.step(np.zeros(4), time_ms - now_ms)
        now_ms = time_ms
        at = plant.copy()
        place = [true.p_n_m, true.p_e_m, true.p_d_m, true.v_n_mps, true.v_e_mps, true.v_d_mps]
        turn = [true.q_w, true.q_x, true.q_y, true.q_z, true.p_radps, true.q_radps, true.r_radps]
        at.state = place + turn
        thrusts = [true.rotor_1_n, true.rotor_2_n, true.rotor_3_n, true.rotor_4_n]
        at.rotor_states = np.array(thrusts) / full
        logged = np.array([true.a_n_mps2, true.a_e_mps2, true.a_d_mps2])
        most = max(most, float(np.abs(at.acceleration_m_s2 - logged).max()))
    return most


def main() -> None:
    hover = points({"family": "hover", "altitude_m": 1.2, "duration_s": HOVER_S})
    courses = {
        "hover": hover,
        "figure-8 in 10 s": points(SLOW),
        "figure-8 in 5 s": points(FAST),
    }
    print("| RMS m | " + " | ".join(courses) + " |")
    print("|" + "---|" * (1 + len(courses)))
    crazyflie = {**dw.Vehicle("crazyflie").to_dict(), "modelled_effects": {}}
    for name, file in (("crazyflie", crazyflie), ("x500", like_x500())):
        for curve in ("linear", "square", "trained"):
            flown = onboard.fly(
                Drawn(name, file, {}, ()),
                list(courses.values()),
                [onboard.HOVER_S + 1.0] * len(courses),
                1,
                lambda count, curve=curve: Policy(count, curve),
            )
            cells = [f"{e['error_m']:.3f}" if not e["crashed"] else "crash" for e in flown]
            print(f"| {name}, thrust {curve} over the command | " + " | ".join(cells) + " |")
    cells = [f"{in_rotorpy(course):.3f}" for course in courses.values()]
    print("| RotorPy's Crazyflie and adapter in RotorPy | " + " | ".join(cells) + " |")
    difference = same_air_m_s2()
    print(f"\nThe same gusts, wind, drag and mass for both: to {difference:.1e} m/s^2")
    assert difference < 1e-9


if __name__ == "__main__":
    main()
