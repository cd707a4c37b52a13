"""Pages in a notebook."""

from __future__ import annotations

import html


def framed(page: str) -> str:
    """A page in a frame of its own, so that its styles do not meet the notebook's."""
    return f'<iframe srcdoc="{html.escape(page, quote=True)}" style="width:100%;height:48em;border:0"></iframe>'
