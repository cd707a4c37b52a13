"""HTML pages, in notebooks and as files."""

from __future__ import annotations

import html
import json
from pathlib import Path
from typing import Any


def framed(page: str) -> str:
    """A page in a separate frame, which isolates its styles from the notebook's."""
    return f'<iframe srcdoc="{html.escape(page, quote=True)}" style="width:100%;height:48em;border:0"></iframe>'


def save_report(folder: Path, page: str, answer: dict[str, Any]) -> None:
    """Writes report.html and report.json into a folder, which it creates if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report.html").write_text(page, encoding="utf-8")
    (folder / "report.json").write_text(json.dumps(answer, indent=2) + "\n", encoding="utf-8")
