"""Comparisons of two groups of flights."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path as _FilePath
from typing import Any, Literal

from . import _downwash as _native
from ._arguments import Path, paths
from ._page import framed


@dataclass(frozen=True, repr=False)
class Comparison:
    """The differences between two groups of flights. `answer` has every field of the JSON of ``downwash
    compare``. In a notebook it shows its page."""

    answer: dict[str, Any]
    """The comparison's JSON."""
    html: str
    """The page, a self-contained HTML document."""

    @property
    def outcome(self) -> str:
        """B compared with A: worse, better, no_difference or undecided."""
        found: str = self.answer["outcome"]
        return found

    @property
    def sentence(self) -> str:
        """The outcome in a sentence or two."""
        found: str = self.answer["sentence"]
        return found

    def save(self, file: Path) -> None:
        """Writes the page."""
        _FilePath(file).write_text(self.html, encoding="utf-8")

    def __repr__(self) -> str:
        return f"<downwash.Comparison: {self.sentence}>"

    def __str__(self) -> str:
        return self.sentence

    def _repr_html_(self) -> str:
        return framed(self.html)


def compare(
    a: Path | Iterable[Path],
    b: Path | Iterable[Path],
    *,
    align: Literal["time", "position", "phase"] = "time",
    pair: Literal["auto", "order", "none"] = "auto",
    mapping: Path | None = None,
) -> Comparison:
    """Compares the flights ``b`` with the flights ``a``, from logs of any format, as ``downwash compare``
    does: errors with intervals for chance, and the differences between vehicles, settings and versions."""
    text, html = _native.compare(paths("a", a), paths("b", b), align, pair, mapping)
    answer: dict[str, Any] = json.loads(text)
    return Comparison(answer, html)
