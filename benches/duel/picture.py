"""The rows of `duel.py` as a picture: each vehicle's error under RAPTOR and under downwash.

    python picture.py ROWS PICTURE
"""

from __future__ import annotations

import sys

import matplotlib
import numpy as np
from missions import MISSIONS
from table import errors, rows

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

# Where a crash is drawn, m.
CRASH_M = 2.0


def main() -> None:
    flown = [row for row in rows(sys.argv[1]) if "failure" not in row]
    figure, axes = plt.subplots(1, len(MISSIONS), figsize=(9.6, 3.5), sharey=True)
    line = np.array([0.003, 3.0])
    for axis, mission in zip(axes, MISSIONS, strict=True):
        theirs = np.minimum(errors(flown, mission, "raptor"), CRASH_M)
        own = np.minimum(errors(flown, mission, "downwash"), CRASH_M)
        axis.loglog(line, line, color="0.6", linewidth=1)
        axis.loglog(line, line / 5, color="0.6", linewidth=1, linestyle="--")
        axis.loglog(theirs, own, "o", markersize=4, alpha=0.6, color="#1f6f8b", markeredgewidth=0)
        axis.set(title=mission, xlabel="RAPTOR, RMS m", xlim=(0.05, 3), ylim=(0.003, 3))
        axis.text(0.055, 0.065, "equal", fontsize=8, color="0.4")
        axis.text(0.055, 0.0075, "a fifth", fontsize=8, color="0.4")
    axes[0].set_ylabel("downwash, RMS m")
    figure.tight_layout()
    figure.savefig(sys.argv[2], dpi=120)


if __name__ == "__main__":
    main()
