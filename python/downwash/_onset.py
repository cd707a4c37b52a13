"""Changes of a vehicle, within a flight or between flights."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path as _FilePath
from tempfile import TemporaryDirectory
from typing import Any

from . import _downwash as _native
from ._arguments import Path, paths
from ._page import framed, save_report
from ._rows import Rows
from ._vehicle import Vehicle


@dataclass(frozen=True, repr=False)
class Changes:
    """The changes found. `answer` has every field of the JSON of ``downwash onset``. In a notebook it shows
    its report."""

    answer: dict[str, Any]
    """The answer's JSON."""
    html: str
    """The report, a self-contained HTML page."""
    text: str
    """The answer in words."""

    @property
    def rows(self) -> Rows:
        """A row for each change within a flight: its ``log`` and its fields in the JSON."""
        flights = self.answer["flights"]
        return Rows({"log": of["log"]} | change for of in flights for change in of["changes"])

    @property
    def steps(self) -> list[dict[str, Any]]:
        """The changes between flights."""
        found: list[dict[str, Any]] = self.answer["steps"]
        return found

    def save(self, folder: Path) -> None:
        """Writes report.html and report.json into a folder."""
        save_report(_FilePath(folder), self.html, self.answer)

    def __repr__(self) -> str:
        return f"<downwash.Changes: {len(self.rows)} within flights, {len(self.steps)} between>"

    def __str__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        return framed(self.html)


def onset(
    vehicle: Vehicle | Path,
    logs: Path | Iterable[Path],
    *,
    mapping: Path | None = None,
    false_alarm_h: float | None = None,
) -> Changes:
    """Finds when the vehicle changed, what changed, and by how much, as ``downwash onset`` does: within
    each log, and between logs in the order of their dates. ``false_alarm_h`` is the mean time between false
    alarms, in h of flight, which sets the threshold on the evidence."""
    with TemporaryDirectory() as folder:
        if isinstance(vehicle, Vehicle):
            file: Path = _FilePath(folder, "vehicle.toml")
            vehicle.save(file)
        else:
            file = vehicle
        hours = None if false_alarm_h is None else float(false_alarm_h)
        native = _native.onset(file, paths("logs", logs), mapping, hours)
    answer: dict[str, Any] = json.loads(native.to_json())
    return Changes(answer, native.to_html(), native.to_text())
