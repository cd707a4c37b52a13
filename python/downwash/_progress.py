"""Progress display: a bar if tqdm is installed, else a line on stderr."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TypeAlias

Progress: TypeAlias = "bool | Callable[[str, int, int], object] | None"


def teller(progress: Progress) -> Callable[[str, int, int], object] | None:
    """The function to call with ``(stage, done, of)``; ``of`` is 0 if the end is unknown."""
    if progress is None or progress is False:
        return None
    if progress is not True:
        if not callable(progress):
            raise TypeError("progress: expected True, or a function of (stage, done, of)")
        return progress
    try:
        from tqdm.auto import tqdm
    except ImportError:
        return _line
    bar = tqdm()

    def tell(stage: str, done: int, of: int) -> None:
        bar.total, bar.n = of or None, done
        bar.set_description(stage)
        if of and done == of:
            bar.close()

    return tell


def _line(stage: str, done: int, of: int) -> None:
    end = "\n" if done == of else "\r"
    steps = f" {done}/{of}" if of else ""
    print(f"... {stage}{steps}", end=end, file=sys.stderr, flush=True)
