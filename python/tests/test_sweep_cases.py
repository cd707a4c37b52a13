"""Sweeps of diagnoses and exams give the same guarantees as sweeps of flights."""

import csv
import json
import shutil
import signal
import subprocess
import time
from pathlib import Path

import downwash as dw
import pytest

from conftest import COMMAND, worker

# One xdist worker makes the table of diagnoses for all.
pytestmark = pytest.mark.xdist_group("cases")

DIAGNOSES = """\
schema_version = 1
of = "diagnose"
twins = 0
[grid]
case = "cases/*"
without = [[], ["rotor_drag"]]
"""
CASES = ["empty", "one", "three"]
EXAM = """\
schema_version = 1
of = "exam"
cases = 1
nulls = 1
twins = 0
seeds = [5]
[grid]
seconds = [10.0]
"""


@pytest.fixture(scope="module")
def folder(logs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three cases: one flight, all flights, and a file that is no log."""
    folder = tmp_path_factory.mktemp("diagnoses")
    for name, flights in [("one", logs[:1]), ("three", logs), ("empty", [])]:
        case = folder / "cases" / name
        case.mkdir(parents=True)
        dw.Vehicle().save(case / "vehicle.toml")
        for index, log in enumerate(flights):
            shutil.copy(log, case / f"flight_{index}.mcap")
    (folder / "cases/empty/flight_0.tlog").write_bytes(b"no log")
    (folder / "diagnoses.toml").write_text(DIAGNOSES)
    (folder / "exam.toml").write_text(EXAM)
    return folder


@pytest.fixture(scope="module")
def whole(folder: Path) -> bytes:
    """The table of the diagnoses of a single worker."""
    summary = dw.sweep(folder / "diagnoses.toml", folder / "whole")
    assert (summary["points"], summary["done"], summary["failures"]) == (6, 6, 2)
    return Path(summary["table"]).read_bytes()


def test_every_case_has_its_row(whole: bytes) -> None:
    rows = list(csv.DictReader(whole.decode().splitlines()))
    assert [row["input.case"] for row in rows] == [f"cases/{name}" for name in CASES for _ in (0, 1)]
    for row in rows:
        assert bool(row["failure"]) == row["input.case"].endswith("empty")
    named = rows[4]
    assert named["verdict"] == "effect" and float(named["effects.rotor_drag.d_xy"]) == pytest.approx(0.02, rel=0.1)
    assert float(named["gap_before"]) > float(named["gap_after"])
    without = rows[5]
    assert without["input.without.0"] == "rotor_drag" and not without["effects.rotor_drag.d_xy"]


def test_a_row_matches_diagnose(folder: Path, whole: bytes) -> None:
    rows = list(csv.DictReader(whole.decode().splitlines()))
    case = folder / "cases/one"
    found = dw.diagnose(case / "vehicle.toml", sorted(case.glob("*.mcap")), twins=0)
    assert rows[2]["sentence"] == found.sentence
    assert float(rows[2]["gap_after"]) == found.answer["gap"]["after"]


@pytest.mark.long
def test_seven_shards_and_killed_workers_give_the_same_bytes(folder: Path, whole: bytes, tmp_path: Path) -> None:
    manifest = folder / "diagnoses.toml"
    workers = [worker(manifest, tmp_path, shard, 7) for shard in range(1, 8)]
    for index in (0, 3, 5):
        # In the middle of its case.
        while workers[index].poll() is None and not (tmp_path / f"rows-{index + 1}-of-7.jsonl").exists():
            time.sleep(0.001)
        workers[index].send_signal(signal.SIGKILL)
    for each in workers:
        each.wait(120)
    summary = dw.sweep(manifest, tmp_path)
    assert Path(summary["table"]).read_bytes() == whole
    assert dw.table(tmp_path)[4]["verdict"] == "effect"


def test_a_changed_case_is_another_sweep(folder: Path, whole: bytes) -> None:
    with (folder / "cases/empty/flight_0.tlog").open("ab") as file:
        file.write(b"!")
    try:
        with pytest.raises(dw.DownwashError, match="rows of another sweep"):
            dw.sweep(folder / "diagnoses.toml", folder / "whole")
    finally:
        (folder / "cases/empty/flight_0.tlog").write_bytes(b"no log")


@pytest.mark.long
def test_an_exam_does_not_depend_on_its_workers(folder: Path, tmp_path: Path) -> None:
    manifest = folder / "exam.toml"
    one = dw.sweep(manifest, tmp_path / "one")
    assert one["points"] == one["done"] == 2 and one["failures"] == 0
    workers = [worker(manifest, tmp_path / "shards", shard, 2) for shard in (1, 2)]
    workers[0].send_signal(signal.SIGKILL)
    for each in workers:
        each.wait(120)
    dw.sweep(manifest, tmp_path / "shards")
    for file in ("table.csv", "summary.json"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "shards" / file).read_bytes()
    rows = dw.table(tmp_path / "one")
    assert sorted(row["kind"] for row in rows).count("null") == 1
    # The same as `downwash exam` with the same seed.
    run = [COMMAND, "exam", "--cases", "1", "--nulls", "1", "--seconds", "10", "--twins", "0", "--seed", "5"]
    result = subprocess.run([*run, "--out", tmp_path / "exam", "--json"], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    cases = {case["case"]: case for case in json.loads(result.stdout)["cases"]}
    for row in rows:
        case = cases[row["case"]]
        assert (row["verdict"], row["grade"], row["brier"]) == (case["verdict"], case["grade"], case["brier"])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('of = "diagnose"\nspeed = 1\n', '"speed": expected one of case, vehicle'),
        ('of = "diagnose"\n[grid]\nkinds = ["null"]\n', '"kinds": expected one of case'),
        ('of = "diagnose"\n[grid]\ncase = "nowhere/*"\n', "nowhere"),
        ('of = "exam"\n[grid]\ncases = [1, 2]\n', '"cases": expected one of seconds'),
        ('of = "exam"\ncases = -1\n', "cases"),
        ('of = "audit"\n', "simulate"),
    ],
)
def test_an_invalid_manifest_is_refused_by_name(text: str, words: str, tmp_path: Path) -> None:
    manifest = tmp_path / "wrong.toml"
    manifest.write_text("schema_version = 1\n" + text)
    with pytest.raises(dw.DownwashError) as refused:
        dw.sweep(manifest, tmp_path / "out")
    assert words in str(refused.value)
