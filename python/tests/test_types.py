"""The package type-checks, and its stub matches the native module."""

import subprocess
import sys

import pytest

from conftest import ROOT


def test_the_package_and_its_examples_are_typed() -> None:
    pytest.importorskip("mypy")
    python = ROOT / "python"
    files = [python / "downwash", *sorted((python / "examples").glob("*.py"))]
    run = [sys.executable, "-m", "mypy", "--strict", "--config-file", python / "pyproject.toml", *files]
    done = subprocess.run(run, capture_output=True, text=True, cwd=python)
    assert done.returncode == 0, done.stdout


def test_the_stub_matches_the_native_module() -> None:
    stubtest = [sys.executable, "-m", "mypy.stubtest", "downwash._downwash"]
    pytest.importorskip("mypy")
    done = subprocess.run(stubtest, capture_output=True, text=True, cwd=ROOT / "docs")
    assert done.returncode == 0, done.stdout


def test_a_users_program_is_typed() -> None:
    pytest.importorskip("mypy")
    tests = ROOT / "python/tests"
    run = [sys.executable, "-m", "mypy", "--strict", tests / "typed_program.py"]
    done = subprocess.run(run, capture_output=True, text=True, cwd=ROOT / "docs")
    assert done.returncode == 0, done.stdout
