"""A sweep gives the same bytes with any workers and shards, also if workers die."""

import csv
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import downwash as dw
import pytest

from conftest import COMMAND, ROOT, worker

EXAMPLES = ROOT / "python/examples"

MANIFEST = """\
schema_version = 1
trajectory = "short.toml"
seeds = [1, 2]
samples = 3
set = { control.thrust = 0.3 }
effects = { rotor_drag = { d_xy = 0.01 } }
[grid]
"effects.rotor_drag.d_z" = { from = 0.0, to = 0.02, count = 3 }
vehicle = ["crazyflie", "nowhere.toml"]
[draw]
"effects.wind.north_m_s" = { normal = [0.0, 1.0] }
"""
POINTS = 3 * 2 * 3 * 2


@pytest.fixture(scope="module")
def manifest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "short.toml").write_text("family = 'hover'\naltitude_m = 1.0\nduration_s = 1.0\n")
    (folder / "sweep.toml").write_text(MANIFEST)
    return folder / "sweep.toml"


@pytest.fixture(scope="module")
def whole(manifest: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The table of a single worker."""
    out = tmp_path_factory.mktemp("whole")
    summary = dw.sweep(manifest, out)
    assert (summary["points"], summary["done"], summary["failures"]) == (POINTS, POINTS, POINTS // 2)
    return Path(summary["table"]).read_bytes()


def test_rows_hold_results_and_failures(whole: bytes) -> None:
    rows = list(csv.DictReader(whole.decode().splitlines()))
    assert [int(row["point"]) for row in rows] == list(range(POINTS))
    for row in rows:
        failed = row["input.vehicle"] == "nowhere.toml"
        assert ("nowhere.toml" in row["failure"]) == failed
        assert (row["end"] == "done") != failed
    row = rows[0]
    effects = {
        "rotor_drag": {"d_xy": 0.01, "d_z": float(row["input.effects.rotor_drag.d_z"])},
        "wind": {"north_m_s": float(row["input.effects.wind.north_m_s"])},
    }
    hover = {"family": "hover", "altitude_m": 1.0, "duration_s": 1.0}
    (flown,) = dw.fly(trajectory=hover, effects=effects, controller={"thrust": 0.3}, seeds=1)
    assert flown["position_rmse_m"] == float(row["position_rmse_m"])


def test_seven_shards_give_the_same_bytes_as_one(manifest: Path, whole: bytes, tmp_path: Path) -> None:
    workers = [worker(manifest, tmp_path, shard, 7) for shard in range(1, 8)]
    assert all(each.wait(120) == 0 for each in workers)
    assert (tmp_path / "table.csv").read_bytes() == whole


def test_killed_workers_do_not_change_the_table(manifest: Path, whole: bytes, tmp_path: Path) -> None:
    rng = random.Random(1)
    workers = [worker(manifest, tmp_path, shard, 7) for shard in range(1, 8)]
    for each in workers[::3]:
        # As soon as it has started to write rows.
        index = workers.index(each) + 1
        rows = tmp_path / f"rows-{index}-of-7.jsonl"
        while each.poll() is None and not (rows.exists() and rows.stat().st_size > 0):
            time.sleep(0.001)
        each.send_signal(signal.SIGKILL)
    for each in workers:
        each.wait(120)
    # One worker died in the middle of a line.
    torn = tmp_path / "rows-1-of-7.jsonl"
    torn.write_bytes(torn.read_bytes()[: -rng.randint(1, 200)])
    summary = dw.sweep(manifest, tmp_path)
    assert Path(summary["table"]).read_bytes() == whole
    assert not list(tmp_path.glob("*.part"))


def test_rows_of_another_manifest_are_refused(manifest: Path, tmp_path: Path) -> None:
    other = manifest.with_name("other.toml")
    other.write_text(MANIFEST.replace("0.3", "0.4"))
    dw.sweep(manifest, tmp_path, shard=(1, POINTS))
    with pytest.raises(dw.DownwashError, match="rows of another sweep"):
        dw.sweep(other, tmp_path)
    with pytest.raises(dw.DownwashError, match="not whole yet"):
        dw.table(tmp_path)


def test_an_invalid_manifest_is_refused_by_name(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("schema_version = 1\n[grid]\nspeed = [1, 2]\n")
    result = subprocess.run([COMMAND, "sweep", wrong], capture_output=True, text=True, cwd=tmp_path)
    assert result.returncode == 2 and '"speed": expected vehicle' in result.stderr
    wrong.write_text("schema_version = 1\n[grid]\n'effects.wnd.north_m_s' = [1, 2]\n")
    with pytest.raises(dw.DownwashError, match='unknown effect "wnd"'):
        dw.sweep(wrong, tmp_path / "out")
    with pytest.raises(TypeError, match=r"shard: expected \(i, n\)"):
        dw.sweep(wrong, tmp_path / "out", shard=3)  # type: ignore[arg-type]


def test_the_table_converts_to_parquet(manifest: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    dw.sweep(manifest, tmp_path / "out")
    table = dw.table(tmp_path / "out")
    table.to_parquet(tmp_path / "table.parquet")
    read = parquet.read_table(tmp_path / "table.parquet")
    assert read.num_rows == POINTS
    assert read.column("failure").null_count == POINTS // 2
    assert len(read.schema.metadata[b"manifest_sha256"]) == 64


def test_a_column_of_the_table_has_one_type(tmp_path: Path) -> None:
    names = ["2024_11_05", "007", "1e5", "nan", "crazyflie"]
    for name in names[:-1]:
        dw.Vehicle().save(tmp_path / name)
    (tmp_path / "short.toml").write_text("family = 'hover'\naltitude_m = 1.0\nduration_s = 1.0\n")
    manifest = tmp_path / "sweep.toml"
    manifest.write_text(
        f"schema_version = 1\ntrajectory = 'short.toml'\nseeds = [7]\n[list]\nvehicle = {names}\n"
        "'effects.wind.north_m_s' = [0, 0.5, 1, 1.5, 2]\n"
        "'set.control.rate_hz' = [100.0, 100.0, 100.0, -1.0, 100.0]\n"
        "'set.control.adaptive' = [false, true, false, false, false]\n"
    )
    dw.sweep(manifest, tmp_path / "out")
    rows = dw.table(tmp_path / "out")
    assert [row["input.vehicle"] for row in rows] == names
    assert [row["input.effects.wind.north_m_s"] for row in rows] == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert {type(row["input.effects.wind.north_m_s"]) for row in rows} == {float}
    assert [row["input.set.control.adaptive"] for row in rows] == [False, True, False, False, False]
    # What could not be flown has its seed too.
    assert [row["seed"] for row in rows] == [7] * 5 and {type(row["seed"]) for row in rows} == {int}
    assert [row["failure"] is None for row in rows] == [True, True, True, False, True]
    pandas = pytest.importorskip("pandas")
    read = pandas.read_csv(tmp_path / "out/table.csv", dtype={"input.vehicle": str}, keep_default_na=False)
    assert list(read["input.vehicle"]) == names
    pytest.importorskip("pyarrow")
    rows.to_parquet(tmp_path / "table.parquet")
    assert list(pandas.read_parquet(tmp_path / "table.parquet")["input.vehicle"]) == names


@pytest.mark.parametrize(
    ("recipe", "needs"),
    [
        ("sweep_processes.py", "multiprocessing"),
        ("sweep_ray.py", "ray"),
        ("sweep_dask.py", "distributed"),
        ("sweep_submitit.py", "submitit"),
    ],
)
def test_each_recipe_gives_the_same_bytes(
    recipe: str, needs: str, manifest: Path, whole: bytes, tmp_path: Path
) -> None:
    pytest.importorskip(needs)
    run = [sys.executable, EXAMPLES / recipe, manifest, tmp_path / "out", "4"]
    environment = os.environ | {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}
    result = subprocess.run(run, capture_output=True, text=True, env=environment, timeout=300)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "out/table.csv").read_bytes() == whole


def test_slurm_task_indices_give_the_same_bytes(manifest: Path, whole: bytes, tmp_path: Path) -> None:
    for index in range(1, 4):
        line = f'"{COMMAND}" sweep "{manifest}" --out "{tmp_path}" --shard "$SLURM_ARRAY_TASK_ID/3"'
        environment = os.environ | {"SLURM_ARRAY_TASK_ID": str(index)}
        subprocess.run(["sh", "-c", line], check=True, capture_output=True, env=environment)
    assert (tmp_path / "table.csv").read_bytes() == whole


def test_the_kubernetes_job_gives_the_same_bytes(manifest: Path, whole: bytes, tmp_path: Path) -> None:
    job = (ROOT / "config/sweep-job.yaml").read_text()
    (line,) = re.findall(r'args: \["(.*)"\]', job)
    shards = int(line.rpartition("/")[2])
    assert f"completions: {shards}\n" in job
    line = line.replace("downwash", str(COMMAND), 1).replace("/sweep/sweep.toml", str(manifest))
    line = line.replace("/out", str(tmp_path)).replace(f"))/{shards}", "))/3")
    for index in range(3):
        environment = os.environ | {"JOB_COMPLETION_INDEX": str(index)}
        subprocess.run(["sh", "-c", line], check=True, capture_output=True, env=environment)
    assert (tmp_path / "table.csv").read_bytes() == whole


def test_gnu_parallel_gives_the_same_bytes(manifest: Path, whole: bytes, tmp_path: Path) -> None:
    parallel = shutil.which("parallel")
    if parallel is None:
        pytest.skip("GNU parallel is not installed")
    line = f"{COMMAND} sweep {manifest} --out {tmp_path} --jobs 1 --shard {{}}/5"
    run = [parallel, "--will-cite", line, ":::", *map(str, range(1, 6))]
    subprocess.run(run, check=True, capture_output=True, timeout=120)
    assert (tmp_path / "table.csv").read_bytes() == whole


def test_optuna_improves_the_tracking() -> None:
    pytest.importorskip("optuna")
    run = [sys.executable, EXAMPLES / "tune.py", "12"]
    result = subprocess.run(run, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stderr
    shipped, tuned = (float(line.split()[1]) for line in result.stdout.splitlines())
    assert tuned < shipped
