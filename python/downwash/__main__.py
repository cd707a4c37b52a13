"""``python -m downwash``."""

from ._command import main

main()
