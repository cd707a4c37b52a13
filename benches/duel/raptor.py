"""RAPTOR, the foundation policy, zero-shot, with the inputs of its deployment on PX4."""

from __future__ import annotations

import numpy as np
from foundation_policy import Raptor
from missions import Array

POSITION_ERROR_MAX_M = 0.5
VELOCITY_ERROR_MAX_M_S = 1.0
# Thrust over rotor command of its training vehicles, which share one curve up to scale: the constant,
# linear and quadratic coefficients, whose sum is full thrust.
THRUST_CURVE = np.array([0.00352526, 0.01437313, 0.09223048])


def rotation(q: Array) -> Array:
    """Rotation matrices of unit quaternions w, x, y, z, shape (n, 3, 3)."""
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


class Policy:
    """Motor outputs, 100 times a second.

    Axes are front, left, up. Position and velocity errors are clipped, in axes of the desired heading.
    Motors: front right, rear right, rear left, front left, as in downwash.
    """

    FLU = np.diag([1.0, -1.0, -1.0])

    def __init__(self, count: int, curve: str = "linear") -> None:
        self._policy = Raptor()
        self._policy.reset()
        self._action = np.zeros((count, 4))
        self._curve = curve

    def outputs(self, states: Array, points: Array) -> Array:
        half = -0.5 * points[:, 9]
        zero = np.zeros_like(half)
        target = rotation(np.array([np.cos(half), zero, zero, np.sin(half)]).T)
        back = np.swapaxes(target, 1, 2)
        attitude = back @ (self.FLU @ rotation(states[:, 6:10]) @ self.FLU)
        position = np.einsum("nij,nj->ni", back, (states[:, 0:3] - points[:, 0:3]) @ self.FLU)
        velocity = np.einsum("nij,nj->ni", back, (states[:, 3:6] - points[:, 3:6]) @ self.FLU)
        observation = np.hstack(
            [
                np.clip(position, -POSITION_ERROR_MAX_M, POSITION_ERROR_MAX_M),
                attitude.reshape(-1, 9),
                np.clip(velocity, -VELOCITY_ERROR_MAX_M_S, VELOCITY_ERROR_MAX_M_S),
                states[:, 10:13] @ self.FLU,
                self._action,
            ]
        )
        self._action = np.clip(self._policy.evaluate_step(observation), -1.0, 1.0)
        command = 0.5 * (self._action + 1.0)
        if self._curve == "linear":
            return command
        if self._curve == "square":
            return command**2
        constant, linear, square = THRUST_CURVE / THRUST_CURVE.sum()
        return constant + command * (linear + command * square)
