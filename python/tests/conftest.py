"""Shared fixtures of the wheel's tests."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import downwash as dw
import pytest

ROOT = Path(__file__).resolve().parents[2]
SHORT = {"family": "hover", "altitude_m": 1.0, "duration_s": 2.0}
# The program that the wheel installs.
COMMAND = Path(sys.executable).with_name("downwash")


def worker(manifest: Path, out: Path, shard: int, shards: int) -> "subprocess.Popen[bytes]":
    """Starts the worker of one shard of a sweep."""
    run = [COMMAND, "sweep", manifest, "--out", out, "--jobs", "1", "--shard", f"{shard}/{shards}"]
    return subprocess.Popen(run, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "long: only tests/run --all runs it")
    # A job in the background, as under nohup, inherits SIGINT ignored. The tests raise it.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Logs of three flights, 20 s each, of a nano quadrotor with drag that its file does not model."""
    folder = tmp_path_factory.mktemp("logs")
    flown = []
    for index, name in enumerate(["figure-8", "sinusoid-xz", "random-waypoints"]):
        rows = dw.fly(
            trajectory=name,
            effects={"rotor_drag": {"d_xy": 0.02, "d_z": 0.01}},
            seeds=index,
            logs=folder / name,
        )
        flown += [Path(row["log"]) for row in rows]
    return flown


@pytest.fixture(scope="session")
def practice() -> Path:
    """The folder of practice flights of PX4 and ArduCopter; skips the test if it is absent."""
    beside = ROOT / "../shared/practice-autopilot"
    folder = Path(os.environ.get("DOWNWASH_PRACTICE", beside))
    if not (folder / "px4_drag").is_dir():
        pytest.skip("no practice flights; set DOWNWASH_PRACTICE to their folder")
    return folder
