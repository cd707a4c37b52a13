"""The command line, as it comes with the wheel."""

from __future__ import annotations

import os
import signal
import sys
from typing import NoReturn

from . import _downwash as _native


def main() -> NoReturn:
    """``downwash``: what the program of that name does."""
    # Its own: Python would only note Ctrl-C until the command is over.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(_native.main(os.path.abspath(sys.argv[0]), sys.argv[1:]))
