"""Random vehicles, each a file and effects that the file does not state. SI."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import downwash as dw
import numpy as np

GRAVITY = 9.80665
LIGHTEST_KG, HEAVIEST_KG = 0.035, 2.4
# Ranges of thrust over weight and of angular acceleration at full roll in RAPTOR's training.
THRUST_TO_WEIGHT = (1.5, 5.0)
TORQUE_TO_INERTIA_RAD_S2 = (40.0, 1200.0)


@dataclass(frozen=True)
class Drawn:
    """A vehicle: its file, and its hidden effects."""

    name: str
    file: dict[str, Any]
    effects: dict[str, dict[str, Any]]
    kinds: tuple[str, ...]

    def vehicle(self) -> dw.Vehicle:
        """The vehicle according to its file."""
        return dw.Vehicle.parse(json.dumps(self.file), f"{self.name}.json")


def _file(name: str, mass: float, rng: np.random.Generator) -> dict[str, Any]:
    # Mass scales with the cube of the length; a Crazyflie has 0.040 m at 31 g.
    arm = 0.0396 * np.cbrt(mass / 0.0306) * rng.uniform(0.9, 1.3)
    roll = rng.uniform(0.16, 0.28) * mass * arm**2
    inertia = roll * np.array([1.0, rng.uniform(0.95, 1.15), rng.uniform(1.6, 2.0)])
    lag = rng.uniform(0.03, 0.06)
    thrust_to_weight = rng.uniform(2.2, 4.0)
    thrust_max = thrust_to_weight * mass * GRAVITY / 4
    side = arm / np.sqrt(2)
    torque = rng.uniform(0.006, 0.02)
    # An on-board loop as fast as the rotors allow.
    roll_rad_s = min(16.0, 0.55 / lag)
    frequency = np.array([roll_rad_s, roll_rad_s, 0.4 * roll_rad_s])
    kp, kd = inertia * frequency**2, inertia * 2 * 0.9 * frequency
    cells = 1 if mass < 0.1 else 4
    # Front right, rear right, rear left, front left.
    corners = [(1, 1, 1), (-1, 1, -1), (-1, -1, 1), (1, -1, -1)]
    return {
        "name": name,
        "mass": mass,
        "inertia": inertia.tolist(),
        "motor_time_constant_s": lag,
        "command_delay_s": 0.005,
        "hover_thrust": 1 / thrust_to_weight,
        "gravity": GRAVITY,
        "air_density": 1.2,
        "rotor_radius_m": 0.6 * arm,
        "rotors": [
            {
                "position_m": [x * side, y * side, 0.0],
                "spin": spin,
                "thrust_max_N": thrust_max,
                "drag_torque_per_thrust_m": torque,
            }
            for x, y, spin in corners
        ],
        "attitude_pd": {"kp": kp.tolist(), "kd": kd.tolist(), "rate_hz": 250.0},
        "battery": {"cells": cells, "full_V": 4.2 * cells, "nominal_V": 3.7 * cells},
        "modelled_effects": {},
    }


def _drag(file: dict[str, Any], rng: np.random.Generator) -> dict[str, float]:
    across = file["mass"] * rng.uniform(0.15, 0.6)
    return {"d_xy": across, "d_z": 0.5 * across}


def _motor_lag(file, rng):
    return {"motor_lag": {"tau_s": file["motor_time_constant_s"] * rng.uniform(1.2, 1.6)}}


def _rotor_drag(file, rng):
    return {"rotor_drag": _drag(file, rng)}


def _mass(file, rng):
    return {"mass": {"mass_kg": file["mass"] * rng.uniform(0.85, 1.2)}}


def _payload(file, rng):
    arm = np.hypot(*file["rotors"][0]["position_m"][:2])
    x, y = rng.uniform(-0.08, 0.08, 2) * arm
    heavier = file["mass"] * rng.uniform(1.05, 1.2)
    return {"mass": {"mass_kg": heavier}, "com_offset": {"x_m": x, "y_m": y}}


def _trim(file, rng):
    roll, pitch = rng.uniform(-0.035, 0.035, 2)
    return {"attitude_trim": {"roll_rad": roll, "pitch_rad": pitch}}


def _thrust_scale(file, rng):
    return {"thrust_scale": {"scale": rng.uniform(0.85, 1.15)}}


def _thrust_map(file, rng):
    return {"thrust_curve": {"a": rng.uniform(0.1, 0.5)}}


def _battery_sag(file, rng):
    return {"battery_sag": {"exponent": rng.uniform(1.0, 2.0)}}


def _weak_rotor(file, rng):
    return {"rotor_loss": {"rotor": int(rng.integers(4)), "scale": rng.uniform(0.88, 0.97)}}


def _inertia(file, rng):
    return {"inertia": {"scale": rng.uniform(0.8, 1.25, 3).tolist()}}


# Moving air acts through drag, so it comes with some.
def _wind(file, rng):
    speed, towards = rng.uniform(0.5, 3.0), rng.uniform(0, 2 * np.pi)
    wind = {"north_m_s": speed * np.cos(towards), "east_m_s": speed * np.sin(towards)}
    return {"wind": wind, "rotor_drag": _drag(file, rng)}


def _gusts(file, rng):
    return {"gusts": {"sigma_m_s": rng.uniform(0.3, 1.0)}, "rotor_drag": _drag(file, rng)}


KINDS = {
    "motor lag": _motor_lag,
    "drag": _rotor_drag,
    "mass": _mass,
    "payload": _payload,
    "trim": _trim,
    "thrust scale": _thrust_scale,
    "thrust map": _thrust_map,
    "battery sag": _battery_sag,
    "weak rotor": _weak_rotor,
    "inertia": _inertia,
    "wind": _wind,
    "gusts": _gusts,
}


def within(drawn: Drawn) -> bool:
    """Whether the vehicle, its effects included, is within RAPTOR's training range."""
    file, effects = drawn.file, drawn.effects
    mass = effects.get("mass", {}).get("mass_kg", file["mass"])
    scale = effects.get("thrust_scale", {}).get("scale", 1.0)
    thrust = scale * file["rotors"][0]["thrust_max_N"]
    # As in its training: two of four rotors at full thrust, on arms at 45 degrees.
    side = file["rotors"][0]["position_m"][0]
    factors = effects.get("inertia", {}).get("scale", [1.0, 1.0, 1.0])
    turns = [np.sqrt(2) * side * thrust / (file["inertia"][i] * factors[i]) for i in (0, 1)]
    low, high = TORQUE_TO_INERTIA_RAD_S2
    return (
        LIGHTEST_KG <= mass <= HEAVIEST_KG
        and THRUST_TO_WEIGHT[0] <= 4 * thrust / (mass * GRAVITY) <= THRUST_TO_WEIGHT[1]
        and low <= min(turns)
        and max(turns) <= high
    )


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {key: float(v) if isinstance(v, np.floating) else v for key, v in values.items()}


def draw(seed: int, index: int) -> Drawn:
    """Vehicle ``index`` of a seed; independent of all other draws."""
    rng = np.random.default_rng([seed, index])
    while True:
        # Uniform in size, as in RAPTOR's training.
        mass = float(rng.uniform(np.cbrt(LIGHTEST_KG), np.cbrt(HEAVIEST_KG)) ** 3)
        file = _file(f"duel-{seed}-{index:03d}", mass, rng)
        kinds = tuple(rng.choice(list(KINDS), size=rng.integers(1, 3), replace=False).tolist())
        sets = [KINDS[kind](file, rng) for kind in kinds]
        effects = {name: _plain(values) for each in sets for name, values in each.items()}
        drawn = Drawn(file["name"], file, effects, kinds)
        # Two kinds that set the same effect would count as one.
        if len(effects) == sum(map(len, sets)) and within(drawn):
            return drawn
