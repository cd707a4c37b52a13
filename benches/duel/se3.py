"""RotorPy's SE3 controller, with the parameters of the vehicle's file."""

from __future__ import annotations

import numpy as np
from missions import Array
from rotorpy.controllers.quadrotor_control import SE3Control
from vehicles import Drawn


class Geometric:
    """Motor outputs, 100 times a second. Its axes: north, west, up; front, left, up."""

    FLU = np.diag([1.0, -1.0, -1.0])

    def __init__(self, drawn: Drawn) -> None:
        namespace: dict[str, object] = {}
        exec(drawn.vehicle().export("rotorpy")[0], namespace)
        self._control = SE3Control(namespace["quad_params"])
        self._full = np.array([rotor["thrust_max_N"] for rotor in drawn.file["rotors"]])

    def outputs(self, states: Array, points: Array) -> Array:
        return np.array([self._one(*each) for each in zip(states, points, strict=True)])

    def _one(self, state: Array, point: Array) -> Array:
        w, x, y, z = state[6:10]
        now = {
            "x": self.FLU @ state[0:3],
            "v": self.FLU @ state[3:6],
            "q": np.array([x, -y, -z, w]),
            "w": self.FLU @ state[10:13],
        }
        wanted = {
            "x": self.FLU @ point[0:3],
            "x_dot": self.FLU @ point[3:6],
            "x_ddot": self.FLU @ point[6:9],
            "yaw": -point[9],
            "yaw_dot": -point[10],
        }
        thrusts: Array = self._control.update(0.0, now, wanted)["cmd_motor_thrusts"]
        return thrusts / self._full
