"""Adds an effect as CONTRIBUTING describes, one file and one line, to a copy of the sources."""

import os
import shutil
import subprocess

import pytest

from conftest import ROOT

EFFECT = ROOT / "examples/effect/arm_drag.rs"


@pytest.mark.long
@pytest.mark.computes
def test_an_added_effect_is_flown_learned_and_diagnosed(tmp_path):
    assert len(EFFECT.read_text().splitlines()) <= 80
    sources = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    for name in sources.stdout.decode().split("\0"):
        if name and (ROOT / name).is_file():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tmp_path / name)
    shutil.copy(EFFECT, tmp_path / "vehicle/src/effects/arm_drag.rs")
    catalogue = tmp_path / "vehicle/src/effects/mod.rs"
    text = catalogue.read_text()
    last = "            ParasiticDrag parasitic_drag body,\n"
    assert text.count(last) == 1
    catalogue.write_text(text.replace(last, last + "            ArmDrag arm_drag body,\n"))

    environment = {**os.environ, "CARGO_TARGET_DIR": str(ROOT / "target/added-effect")}
    command = ["cargo", "test", "--test", "integration", "effects_everywhere"]
    tested = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert tested.returncode == 0, tested.stdout + tested.stderr
    assert "3 passed" in tested.stdout

    flown = subprocess.run(
        [str(ROOT / "target/added-effect/debug/downwash"), "simulate", "hover"]
        + ["--effect", "arm_drag:cda_m2=0.01", "--no-log"],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert flown.returncode == 0, flown.stderr
