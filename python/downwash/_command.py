"""The command line of the wheel."""

from __future__ import annotations

import os
import signal
import sys
from typing import NoReturn

from . import _downwash as _native


def main() -> NoReturn:
    """Runs the command line ``downwash``."""
    # The default handler: Python's would only record Ctrl-C until the command ends.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(_native.main(os.path.abspath(sys.argv[0]), sys.argv[1:]))
