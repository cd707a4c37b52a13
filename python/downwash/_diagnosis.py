"""Diagnoses: where simulator and flights differ, which effect explains it, and how much of the gap it
closes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path as _FilePath
from tempfile import TemporaryDirectory
from typing import Any

from . import _downwash as _native
from ._arguments import Path, count, listed, paths, seed_of
from ._page import framed, save_report
from ._progress import Progress, teller
from ._vehicle import Vehicle


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """The result of a diagnosis. `answer` has every field of the JSON of ``downwash diagnose``; the most
    common ones are properties. In a notebook it shows its report."""

    answer: dict[str, Any]
    """The answer's JSON."""
    html: str
    """The report, a self-contained HTML page."""
    text: str
    """The answer in words."""
    vehicle: Vehicle
    """The vehicle with the effects found."""
    law_file: str | None = None
    """With ``discover``, if a law is named: the text of an effects file with the law."""

    @property
    def verdict(self) -> str:
        """effect, none or unknown."""
        found: str = self.answer["verdict"]
        return found

    @property
    def sentence(self) -> str:
        """The verdict in a sentence or two."""
        found: str = self.answer["finding"]["sentence"]
        return found

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Effects with probabilities, parameters and 90 % intervals, most probable first."""
        found: list[dict[str, Any]] = self.answer["effects"]
        return found

    @property
    def gap(self) -> dict[str, Any] | None:
        """The gap on the hold-out flights, before and after, in units of the noise."""
        found: dict[str, Any] | None = self.answer["gap"]
        return found

    @property
    def attribution(self) -> list[dict[str, Any]]:
        """Shares of the squared gap, by effect."""
        found: list[dict[str, Any]] = self.answer["attribution"]
        return found

    @property
    def law(self) -> dict[str, Any] | None:
        """With ``discover``: the law that explains what no effect does, if the search found one, with its
        formulas and whether it is ``named``."""
        found: dict[str, Any] | None = self.answer.get("law")
        return found

    @property
    def not_testable(self) -> list[dict[str, Any]]:
        """Effects that these logs cannot show, and why."""
        found: list[dict[str, Any]] = self.answer["not_testable"]
        return found

    def save(self, folder: Path) -> None:
        """Writes report.html, report.json and the vehicle file improved.toml into a folder, and law.toml if
        a law is named."""
        out = _FilePath(folder)
        save_report(out, self.html, self.answer)
        self.vehicle.save(out / "improved.toml")
        if self.law_file is not None:
            (out / "law.toml").write_text(self.law_file, encoding="utf-8")

    def __repr__(self) -> str:
        return f"<downwash.Diagnosis: {self.sentence}>"

    def __str__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        return framed(self.html)


def diagnose(
    vehicle: Vehicle | Path,
    logs: Path | Iterable[Path],
    *,
    holdout: Iterable[Path] = (),
    new: Iterable[Path] = (),
    mapping: Path | None = None,
    twins: int | None = None,
    seed: int = 1,
    without: Iterable[str] = (),
    discover: bool = False,
    next_flight: Path | None = None,
    progress: Progress = None,
) -> Diagnosis:
    """Diagnoses flight logs against a vehicle file, as ``downwash diagnose`` does.

    The hold-out set is the last log, or the second half of a single log, unless ``holdout`` names others.
    ``twins`` simulated flights without an effect calibrate how large the evidence gets by chance. With
    ``discover`` it also searches for a law, a formula that explains what no effect of the catalogue does.
    It writes the trajectory file of the most informative next flight to ``next_flight``. Ctrl-C returns at
    once, and the work ends soon after.
    """
    with TemporaryDirectory() as folder:
        if isinstance(vehicle, Vehicle):
            file: Path = _FilePath(folder, "vehicle.toml")
            vehicle.save(file)
        else:
            file = vehicle
        native = _native.diagnose(
            file,
            paths("logs", logs),
            listed("holdout", holdout),
            listed("new", new),
            mapping,
            None if twins is None else count("twins", twins, 0, 100_000),
            seed_of(seed),
            listed("without", without),
            bool(discover),
            next_flight,
            teller(progress),
        )
        improved = Vehicle.parse(native.improved("improved.toml"), "improved.toml")
        law = native.law()
    answer: dict[str, Any] = json.loads(native.to_json())
    return Diagnosis(answer, native.to_html(), native.to_text(), improved, law)
