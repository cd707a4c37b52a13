"""Sweeps: many flights, diagnoses or exam cases, on any number of workers, in one table."""

from __future__ import annotations

import csv
import json
import re
import sysconfig
from collections.abc import Callable
from pathlib import Path as _FilePath
from typing import Any

from . import _downwash as _native
from ._arguments import Path, count
from ._progress import Progress, teller
from ._rows import Rows


def sweep(
    manifest: Path,
    out: Path,
    *,
    shard: tuple[int, int] = (1, 1),
    jobs: int | None = None,
    progress: Progress = None,
) -> dict[str, Any]:
    """Computes one worker's share of a sweep, as ``downwash sweep`` does. Of n workers on one folder
    ``out``, the i-th has ``shard=(i, n)``, with i from 1. A point is a flight, a diagnosis or an exam case,
    according to the manifest. Existing rows are kept. The worker that finds all rows present writes the
    table.

    Returns the summary: ``points``, ``done``, ``failures``, ``ended_early``, and ``table``, the table's
    path once it is complete.
    """
    if not isinstance(shard, (tuple, list)) or len(shard) != 2:
        raise TypeError(f"shard: expected (i, n), found {shard!r}")
    index, of = shard
    text = _native.sweep(
        manifest,
        out,
        count("shard", index, 1, 2**31),
        count("shard", of, 1, 2**31),
        None if jobs is None else count("jobs", jobs, 1, 1024),
        _FilePath(sysconfig.get_path("scripts"), "downwash"),
        teller(progress),
    )
    found: dict[str, Any] = json.loads(text)
    return found


# As JSON writes them: other words, such as 2024_11_05, nan and 007, are names.
_WHOLE = re.compile(r"-?(0|[1-9][0-9]*)")
_NUMBER = re.compile(r"-?(0|[1-9][0-9]*)(\.[0-9]+)?([eE][-+]?[0-9]+)?")


def _typed(cells: list[str]) -> list[Any]:
    """The values of a column: whole numbers, numbers, booleans or words. An empty cell is None."""
    present = [cell for cell in cells if cell]
    kind: Callable[[str], Any] = str
    if all(_WHOLE.fullmatch(cell) for cell in present):
        kind = int
    elif all(_NUMBER.fullmatch(cell) for cell in present):
        kind = float
    elif all(cell in ("true", "false") for cell in present):
        kind = "true".__eq__
    return [kind(cell) if cell else None for cell in cells]


def table(out: Path) -> Rows:
    """Reads the complete table of a sweep's folder, one row for each point, in order. ``to_parquet`` writes
    it with the manifest's hash and the version in the file's metadata. The values of a column are of one
    type."""
    folder = _FilePath(out)
    header = json.loads((folder / "sweep.json").read_text(encoding="utf-8"))
    path = folder / "table.csv"
    if not path.exists():
        raise _native.DownwashError(f"{path}: the sweep is not whole yet; run its other shards")
    with path.open(newline="", encoding="utf-8") as file:
        names, *lines = csv.reader(file)
    columns = [_typed([line[at] for line in lines]) for at in range(len(names))]
    rows = Rows(dict(zip(names, row)) for row in zip(*columns))
    rows.metadata = {key: str(header[key]) for key in ("manifest_sha256", "version")}
    return rows
