"""Flight logs of any format as arrays."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import _downwash as _native
from ._arguments import Array, Path, count, paths


@dataclass(frozen=True, eq=False)
class Stream:
    """Samples of one quantity at its native rate, on the flight's common clock. Streams are equal if all their
    samples are, NaN included."""

    name: str
    time_s: Array
    """Times, shape (n,)."""
    values: Array
    """Values, shape (n, columns)."""
    columns: tuple[str, ...]
    """Names of the columns, with units."""

    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Stream):
            return NotImplemented
        return (
            (self.name, self.columns) == (other.name, other.columns)
            and np.array_equal(self.time_s, other.time_s)
            and np.array_equal(self.values, other.values, equal_nan=True)
        )

    def __len__(self) -> int:
        return len(self.time_s)

    def to_pandas(self) -> Any:
        """A pandas DataFrame over time_s."""
        import pandas

        index = pandas.Index(self.time_s, name="time_s")
        return pandas.DataFrame(self.values, index=index, columns=list(self.columns))

    def to_arrow(self) -> Any:
        """A pyarrow Table."""
        import pyarrow

        columns = {"time_s": self.time_s}
        columns |= {name: self.values[:, index] for index, name in enumerate(self.columns)}
        return pyarrow.table(columns)


class Log(Mapping[str, Stream]):
    """A flight: streams by name (``log["position"]``), and facts about the log."""

    def __init__(self, native: _native.Log, mapping: Path | None = None) -> None:
        if not isinstance(native, _native.Log):
            raise TypeError("a Log is made by read()")
        self._native = native
        self._mapping = mapping
        self._columns = {name: tuple(columns) for name, columns in native.streams}

    @property
    def facts(self) -> dict[str, Any]:
        """Format, SHA-256, facts about the vehicle, and data dropped from the file."""
        found: dict[str, Any] = json.loads(self._native.facts())
        return found

    def __getitem__(self, name: str) -> Stream:
        columns = self._columns[name]
        times, values = self._native.stream(name)
        return Stream(name, times, values.reshape(len(times), len(columns)), columns)

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def to_pandas(self) -> Any:
        """One pandas DataFrame of all streams over all their times, with NaN between samples."""
        import pandas

        frames = [stream.to_pandas().add_prefix(f"{stream.name}.") for stream in self.values()]
        return pandas.concat(frames, axis=1).sort_index()

    def audit(self) -> dict[str, Any]:
        """The problems of this log; see `audit`."""
        found: dict[str, Any] = audit(self.facts["path"], mapping=self._mapping)["logs"][0]
        return found

    def __repr__(self) -> str:
        return f"<downwash.Log {self.facts['run']!r}: {', '.join(self)}>"


def read(
    path: Path,
    *,
    mapping: Path | None = None,
    boot: int | None = None,
    system: int | None = None,
) -> Log:
    """Reads a flight log of any format: .mcap, .tlog, ULog, DataFlash, or a table with the mapping file
    that defines its columns. ``boot`` selects a boot of the vehicle, counted from 1, and
    ``system`` a vehicle by its system id, in telemetry of several."""
    if boot is not None:
        boot = count("boot", boot, 1, 2**32)
    if system is not None:
        system = count("system", system, 1, 255)
    return Log(_native.Log.read(path, mapping, boot, system), mapping)


def audit(logs: Path | Iterable[Path], *, mapping: Path | None = None) -> dict[str, Any]:
    """The problems of logs, before any physics: the JSON of ``downwash log audit``, with unreadable logs
    under ``refused``."""
    text, refused = _native.audit(paths("logs", logs), mapping)
    found: dict[str, Any] = json.loads(text)
    if not found["logs"]:
        raise _native.DownwashError("; ".join(refused))
    return found | {"refused": refused}
