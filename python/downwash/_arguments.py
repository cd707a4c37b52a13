"""Converts arguments for the native part: contiguous float64 arrays, and JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from os import PathLike
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

_T = TypeVar("_T")
# Largest number of items in a list, such as seeds or logs.
_MOST = 1_000_000

Array: TypeAlias = NDArray[np.float64]
Path: TypeAlias = "str | PathLike[str]"
# A number, three numbers, or a law's formulas.
_Value: TypeAlias = "float | Sequence[float] | NDArray[Any] | Mapping[str, str]"
Effects: TypeAlias = "Mapping[str, Mapping[str, _Value]]"


def array_of(what: str, value: ArrayLike) -> NDArray[Any]:
    """Converts ``value`` to an array, and refuses masked entries, which have no value."""
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise ValueError(f"{what}: expected an array without masked entries")
    return np.asarray(value)


def numbers(what: str, value: ArrayLike, *shape: int | str) -> Array:
    """Converts ``value`` to a contiguous, aligned float64 array, without a copy where possible.

    ``shape`` gives the axes: a required length, or a name for an axis of any length.
    """
    array = array_of(what, value)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{what}: expected real numbers, found {array.dtype}")
    axes = "(" + ", ".join(str(axis) for axis in shape) + ")"
    fits = array.ndim == len(shape) and all(
        isinstance(axis, str) or axis == length for axis, length in zip(shape, array.shape)
    )
    if not fits:
        raise ValueError(f"{what}: expected an array of shape {axes}, found {array.shape}")
    return np.require(array, np.float64, ["C", "A"])


def flat(array: Array) -> Array:
    """A one-dimensional view of the array."""
    return array.reshape(-1)


def count(what: str, value: int, least: int, most: int) -> int:
    """Checks a whole number against bounds."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{what}: expected a whole number, found {type(value).__name__}")
    if not least <= value <= most:
        raise ValueError(f"{what}: expected {least} to {most}, found {value}")
    return int(value)


def listed(what: str, given: Iterable[_T]) -> list[_T]:
    """The items of a list, limited in number: a broadcast array may be huge."""
    if isinstance(given, (str, bytes)):
        raise TypeError(f"{what}: expected a list, found one word")
    # A Log would give the names of its streams.
    if isinstance(given, Mapping):
        raise TypeError(f"{what}: expected a list, found a {type(given).__name__}")
    try:
        items = iter(given)
    except TypeError:
        raise TypeError(f"{what}: expected a list, found {given!r}") from None
    found = list(islice(items, _MOST + 1))
    if len(found) > _MOST:
        raise ValueError(f"{what}: expected at most {_MOST} items")
    return found


def seed_of(value: int) -> int:
    """Checks a seed, an unsigned 64-bit integer."""
    return count("seed", value, 0, 2**64 - 1)


def to_json(what: str, value: Any) -> str:
    """Encodes a user's value, including NumPy numbers and arrays, as JSON."""

    def plain(other: Any) -> Any:
        if isinstance(other, (np.ndarray, np.generic)):
            if other.size > _MOST:
                raise ValueError(f"{what}: expected at most {_MOST} numbers, found {other.size}")
            found = other.tolist()
            # A long double remains one.
            return float(found) if isinstance(found, np.floating) else found
        if isinstance(other, Mapping):
            return dict(other)
        raise TypeError(f"{what}: expected numbers, words, lists and tables, found {other!r}")

    try:
        return json.dumps(value, allow_nan=False, default=plain)
    except ValueError as error:
        raise ValueError(f"{what}: expected finite numbers: {error}") from None
    except RecursionError:
        raise ValueError(f"{what}: expected a table that does not hold itself") from None


def effects_json(effects: Effects | None) -> str:
    """Encodes effects as JSON."""
    if effects is None:
        return "{}"
    if not isinstance(effects, Mapping):
        raise TypeError("effects: expected a table {id: {parameter: value}}")
    return to_json("effects", effects)


def paths(what: str, given: Path | Iterable[Path]) -> list[Path]:
    """A list of one or more paths."""
    import os

    if isinstance(given, (str, os.PathLike)):
        return [given]
    found = listed(what, given)
    if not found:
        raise ValueError(f"{what}: expected at least one path")
    return found
