"""Sweeps: many flights, diagnoses or exam cases, on any number of workers, in one table."""

from __future__ import annotations

import csv
import json
import sysconfig
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


def _cell(text: str) -> Any:
    if text == "":
        return None
    try:
        return int(text)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError:
        return text


def table(out: Path) -> Rows:
    """Reads the complete table of a sweep's folder, one row for each point, in order. ``to_parquet`` writes
    it with the manifest's hash and the version in the file's metadata."""
    folder = _FilePath(out)
    header = json.loads((folder / "sweep.json").read_text(encoding="utf-8"))
    path = folder / "table.csv"
    if not path.exists():
        raise _native.DownwashError(f"{path}: the sweep is not whole yet; run its other shards")
    with path.open(newline="", encoding="utf-8") as file:
        rows = Rows({k: _cell(v) for k, v in row.items()} for row in csv.DictReader(file))
    rows.metadata = {key: str(header[key]) for key in ("manifest_sha256", "version")}
    return rows
