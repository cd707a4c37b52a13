"""Noise-free motion about one axis, and very short logs: a result, or an error that names the file."""

import math

import pytest

from conftest import CRAZYFLIE, MOTION_CAPTURE, MOTION_CAPTURE_COLUMNS

pytestmark = pytest.mark.computes

TIMEOUT_S = 120


def table(path, axis, seconds=8.0, size=0.4):
    """A noise-free oscillation about and along one axis, as a table."""
    rows = [MOTION_CAPTURE_COLUMNS]
    for row in range(round(seconds * 100)):
        t = 0.01 * row
        angle, rate = size * math.sin(3 * t), 3 * size * math.cos(3 * t)
        along = lambda value: [value if place == axis else 0.0 for place in range(3)]
        attitude = [*along(math.sin(angle / 2)), math.cos(angle / 2)]
        # Outputs that vary, as those of motors do.
        outputs = [0.5 + 0.01 * math.sin(7 * t + motor) for motor in range(4)]
        cells = [t, *along(angle), *along(rate), *attitude, *along(rate), *outputs, 3.9]
        rows.append(",".join(f"{cell:.8g}" for cell in cells))
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("axis", [0, 1, 2], ids=["roll", "pitch", "yaw"])
@pytest.mark.parametrize("command", ["train", "diagnose"])
def test_training_and_diagnosis_of_one_axis_motion_end(program, tmp_path, command, axis):
    path = table(tmp_path / "flight.csv", axis)
    few = ["-o", tmp_path / "model", "--passes", 5, "--hidden", 5, "--regularization", "1e-5"]
    more = few if command == "train" else ["--twins", 4]
    one = program(command, "--vehicle", CRAZYFLIE, path, "--mapping", MOTION_CAPTURE, *more)
    code, _ = one.finish(TIMEOUT_S)
    assert code in (0, 2) and "panicked" not in one.err, one.err


@pytest.mark.parametrize("command", ["train", "diagnose"])
def test_a_log_that_is_too_short_is_named(program, tmp_path, command):
    path = table(tmp_path / "short.csv", 1, seconds=4.0)
    more = ["-o", tmp_path / "model"] if command == "train" else []
    one = program(command, "--vehicle", CRAZYFLIE, path, "--mapping", MOTION_CAPTURE, *more)
    assert one.finish(TIMEOUT_S)[0] == 2, one.err
    assert "short.csv" in one.err.splitlines()[-1]
