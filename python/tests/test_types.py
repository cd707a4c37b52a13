"""What a type checker sees of the package."""

import subprocess
import sys

import pytest

from conftest import ROOT


def test_the_package_and_its_examples_are_typed() -> None:
    pytest.importorskip("mypy")
    python = ROOT / "python"
    files = [python / "downwash", *sorted((python / "examples").glob("*.py"))]
    run = [sys.executable, "-m", "mypy", "--strict", "--config-file", python / "pyproject.toml", *files]
    told = subprocess.run(run, capture_output=True, text=True, cwd=python)
    assert told.returncode == 0, told.stdout


def test_the_stub_names_what_the_native_part_has() -> None:
    stubtest = [sys.executable, "-m", "mypy.stubtest", "downwash._downwash"]
    pytest.importorskip("mypy")
    told = subprocess.run(stubtest, capture_output=True, text=True, cwd=ROOT / "docs")
    assert told.returncode == 0, told.stdout
