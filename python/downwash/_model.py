"""Learned models of a vehicle's accelerations."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path as _FilePath
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from . import _downwash as _native
from ._arguments import Array, Path, flat, numbers, paths, to_json
from ._vehicle import Vehicle, vehicle_of

MOTION: Final = (
    "north_m_s",
    "east_m_s",
    "down_m_s",
    "roll_rad_s",
    "pitch_rad_s",
    "yaw_rad_s",
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
)
"""Names of a model's motion inputs: velocity in world axes, body rate, Euler angles."""

INPUT: Final = ("thrust_n", "roll_n_m", "pitch_n_m", "yaw_n_m")
"""Names of a model's control inputs: collective thrust along -z body, moments about the body axes."""

ACCELERATIONS: Final = (
    "north_m_s2",
    "east_m_s2",
    "down_m_s2",
    "roll_rad_s2",
    "pitch_rad_s2",
    "yaw_rad_s2",
)
"""Names of a model's outputs: linear acceleration in world axes, angular acceleration in body axes."""


class Model:
    """A model file with three models: a network, fitted physics, and their sum."""

    __slots__ = ("_bytes", "_native")

    def __init__(self, path: Path) -> None:
        self._native = _native.Model.load(path)
        self._bytes = _FilePath(path).read_bytes()

    @classmethod
    def load(cls, path: Path) -> Model:
        """Reads a model file."""
        return cls(path)

    def save(self, path: Path) -> None:
        """Writes the model file."""
        _FilePath(path).write_bytes(self._bytes)

    def to_onnx(self, path: Path, kind: Literal["net", "hybrid"] = "net") -> None:
        """Writes the networks as an ONNX file: those of the net, or those that the hybrid adds to the
        physics."""
        _FilePath(path).write_bytes(self._native.to_onnx(kind))

    @property
    def preferred(self) -> str:
        """The model with the best validation result: net, physics or hybrid."""
        return self._native.preferred

    def info(self) -> dict[str, Any]:
        """Facts about the training: the JSON of ``downwash model info``."""
        found: dict[str, Any] = json.loads(self._native.info())
        return found

    @overload
    def accelerations(
        self, x: ArrayLike, u: ArrayLike, *, jacobian: Literal[False] = False, kind: str | None = None
    ) -> Array: ...

    @overload
    def accelerations(
        self, x: ArrayLike, u: ArrayLike, *, jacobian: Literal[True], kind: str | None = None
    ) -> tuple[Array, Array]: ...

    def accelerations(
        self, x: ArrayLike, u: ArrayLike, *, jacobian: bool = False, kind: str | None = None
    ) -> Array | tuple[Array, Array]:
        """Accelerations, shape (n, 6), at motions ``x``, shape (n, 9), under inputs ``u``, shape (n, 4).
        With ``jacobian``, also the exact derivatives with respect to ``x`` and ``u``, shape (n, 6, 13). A
        single motion and input, of shapes (9,) and (4,), return results without the axis n."""
        single = np.ndim(x) == 1
        motions = numbers("x", np.atleast_2d(np.asarray(x)), "n", len(MOTION))
        inputs = numbers("u", np.atleast_2d(np.asarray(u)), len(motions), len(INPUT))
        found = np.empty((len(motions), len(ACCELERATIONS)))
        slopes = None
        if jacobian:
            slopes = np.empty((len(motions), len(ACCELERATIONS), len(MOTION) + len(INPUT)))
        self._native.accelerations(
            flat(motions), flat(inputs), kind, flat(found), None if slopes is None else flat(slopes)
        )
        if slopes is None:
            return found[0] if single else found
        return (found[0], slopes[0]) if single else (found, slopes)

    def evaluate(self, logs: Path | Iterable[Path], *, mapping: Path | None = None) -> dict[str, Any]:
        """Errors on logs, one-step and open-loop: the JSON of ``downwash model eval``."""
        with TemporaryDirectory() as folder:
            path = _FilePath(folder, "model.safetensors")
            self.save(path)
            text = _native.evaluate(path, paths("logs", logs), mapping)
        found: dict[str, Any] = json.loads(text)
        return found

    def __repr__(self) -> str:
        return f"<downwash.Model of {self.info()['vehicle']!r}>"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Model):
            return NotImplemented
        return self._bytes == other._bytes

    def __hash__(self) -> int:
        return hash(self._bytes)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self._bytes,)


def _restored(file: bytes) -> Model:
    with TemporaryDirectory() as folder:
        path = _FilePath(folder, "model.safetensors")
        path.write_bytes(file)
        return Model(path)


_KINDS = ("net", "physics", "hybrid")
_PARAMETERS = (
    "vehicle",
    "features",
    "method",
    "hidden",
    "passes",
    "regularization",
    "window_ms",
    "seed",
    "kind",
)


class Learner:
    """Learns a vehicle's dynamics from flight logs, with scikit-learn's interface.

    A parameter that is None takes the default of ``downwash train``. After `fit`, ``model_`` is the
    `Model`, and ``summary_`` describes the data and the result. `GridSearchCV` and its like take a list of
    logs as X.
    """

    def __init__(
        self,
        vehicle: Vehicle | Path = "crazyflie",
        *,
        features: str | None = None,
        method: str | None = None,
        hidden: int | None = None,
        passes: int | None = None,
        regularization: Sequence[float] | None = None,
        window_ms: Sequence[float] | None = None,
        seed: int | None = None,
        kind: str | None = None,
    ) -> None:
        self.vehicle = vehicle
        self.features = features
        self.method = method
        self.hidden = hidden
        self.passes = passes
        self.regularization = regularization
        self.window_ms = window_ms
        self.seed = seed
        self.kind = kind
        self.model_: Model
        self.n_features_in_: int
        self.summary_: dict[str, Any]

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The parameters by name."""
        return {name: getattr(self, name) for name in _PARAMETERS}

    def set_params(self, **params: Any) -> Learner:
        """Sets parameters by name."""
        for name, value in params.items():
            if name not in _PARAMETERS:
                raise ValueError(f"a Learner has no parameter {name!r}; it has {', '.join(_PARAMETERS)}")
            setattr(self, name, value)
        return self

    def fit(self, logs: Path | Iterable[Path], y: None = None, *, mapping: Path | None = None) -> Learner:
        """Learns from flight logs, split by whole flights into training, validation and test sets."""
        params = self.get_params()
        settings = {key: value for key, value in params.items() if value is not None}
        settings = {key: value for key, value in settings.items() if key not in ("vehicle", "kind")}
        if self.kind not in (None, *_KINDS):
            raise ValueError(f"kind: expected {', '.join(_KINDS)} or None, found {self.kind!r}")
        with TemporaryDirectory() as folder:
            vehicle, out = _FilePath(folder, "vehicle.toml"), _FilePath(folder, "model.safetensors")
            vehicle_of(self.vehicle).save(vehicle)
            text = _native.train(
                paths("logs", logs), vehicle, out, mapping, to_json("parameters", settings)
            )
            self.model_ = Model(out)
        self.n_features_in_ = len(MOTION) + len(INPUT)
        self.summary_ = json.loads(text)
        return self

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "model_")

    def __sklearn_tags__(self) -> Any:
        from sklearn.utils import InputTags, RegressorTags, Tags, TargetTags

        return Tags(
            estimator_type="regressor",
            target_tags=TargetTags(required=False),
            regressor_tags=RegressorTags(),
            input_tags=InputTags(two_d_array=False),
        )

    def __repr__(self) -> str:
        given = ((name, value) for name, value in self.get_params().items() if value is not None)
        return f"Learner({', '.join(f'{name}={value!r}' for name, value in given)})"

    def _fitted(self) -> Model:
        if not hasattr(self, "model_"):
            raise _native.DownwashError("this Learner is not fitted; call fit with flight logs first")
        return self.model_

    def predict(self, X: ArrayLike) -> Array:
        """Accelerations, shape (n, 6), at points of 9 motion and 4 input numbers, shape (n, 13)."""
        points = numbers("X", X, "n", len(MOTION) + len(INPUT))
        motions, inputs = points[:, : len(MOTION)], points[:, len(MOTION) :]
        return self._fitted().accelerations(motions, inputs, kind=self.kind)

    def score(self, logs: Path | Iterable[Path], y: None = None) -> float:
        """Share of the accelerations' variance that the model explains on these logs, averaged over the six
        components: 1 is perfect, 0 is no better than the means."""
        model = self._fitted()
        kind = self.kind or model.preferred
        for errors in model.evaluate(logs)["one_step"]:
            if errors["model"] == kind and errors["labels"] is not None:
                return 1.0 - float(np.mean(errors["labels"]["each"]))
        raise _native.DownwashError(f"these logs hold no labels to judge the {kind} model by")

    def save(self, path: Path) -> None:
        """Writes the model file."""
        self._fitted().save(path)
