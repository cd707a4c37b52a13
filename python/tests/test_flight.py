"""Flights in lockstep: rows, seeds, logs, errors and interruption."""

import json
import pickle
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import downwash as dw
import numpy as np
import pytest

from conftest import COMMAND, SHORT


def test_a_row_depends_only_on_its_seed() -> None:
    at_once = dw.fly(trajectory=SHORT, seeds=range(6), jobs=3)
    alone = [dw.fly(trajectory=SHORT, seeds=seed)[0] for seed in range(6)]
    assert list(at_once) == alone
    assert len({row["position_rmse_m"] for row in alone}) == 6
    assert all(row["end"] == "done" and row["exit"] == 0 for row in alone)


def test_effects_and_settings_act_and_are_recorded() -> None:
    wind = {"wind": {"north_m_s": 2.0}, "rotor_drag": {"d_xy": 0.03}}
    (still,) = dw.fly(trajectory=SHORT)
    (blown,) = dw.fly(trajectory=SHORT, effects=wind, controller={"position_m": [1.0, 1.0, 1.0]})
    assert blown["position_rmse_m"] > 2 * still["position_rmse_m"]
    assert blown["effects"]["rotor_drag"]["d_xy"] == 0.03
    assert blown["settings"] == {"control.position_m": [1.0, 1.0, 1.0]}


def test_logs_are_written_to_the_given_folder(tmp_path: Path) -> None:
    rows = dw.fly(trajectory=SHORT, seeds=[3, 4], logs=tmp_path)
    for row, seed in zip(rows, [3, 4]):
        assert Path(row["log"]).parent == tmp_path / f"seed-{seed}"
        assert "position" in dw.read(row["log"])


def test_rows_become_a_table() -> None:
    rows = dw.fly(trajectory=SHORT, effects={"inertia": {"scale": [1.1, 1.0, 1.0]}})
    assert rows.flat()[0]["effects.inertia.scale.0"] == 1.1
    pandas = pytest.importorskip("pandas")
    assert isinstance(rows.to_pandas(), pandas.DataFrame)


def test_the_wheels_command_gives_the_same_row() -> None:
    run = [COMMAND, "simulate", "hover", "--no-log", "--json", "--seed", "5"]
    done = subprocess.run(run, capture_output=True, check=True, text=True)
    assert json.loads(done.stdout) == dw.fly(trajectory="hover", seeds=5)[0]
    wrong = subprocess.run([COMMAND, "simulate", "nowhere.toml"], capture_output=True, text=True)
    assert wrong.returncode == 2 and "nowhere.toml" in wrong.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"vehicle": "nowhere.toml"}, "nowhere.toml"),
        ({"trajectory": "nowhere.toml"}, "nowhere.toml"),
        ({"trajectory": {"family": "spiral"}}, "spiral"),
        ({"trajectory": SHORT | {"altitude_m": 1e9}}, "altitude|height|room|envelope"),
        ({"settings": {"control.thrst": 1}}, "thrst"),
        ({"controller": {"rate_hz": -1}}, "rate_hz"),
    ],
)
def test_unflyable_arguments_give_the_command_lines_errors(
    arguments: dict[str, object], words: str
) -> None:
    with pytest.raises(dw.DownwashError, match=words) as refused:
        dw.fly(**arguments)  # type: ignore[arg-type]
    assert refused.value.exit_code in (2, 4)


def test_vehicles_and_trajectories_can_be_pickled() -> None:
    vehicle = dw.Vehicle().with_effects({"motor_lag": {"tau_s": 0.05}})
    again = pickle.loads(pickle.dumps(vehicle))
    assert again.to_dict() == vehicle.to_dict()
    trajectory = pickle.loads(pickle.dumps(dw.Trajectory(SHORT)))
    assert dw.fly(again, trajectory) == dw.fly(vehicle, SHORT)


def test_a_trajectory_is_sent_with_its_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("line.csv").write_text("t_s,n_m,e_m,d_m\n0,0,0,-1\n4,1,0,-1\n")
    Path("short.toml").write_text("family = 'hover'\naltitude_m = 1.0\nduration_s = 1.0\n")
    trajectories = [dw.Trajectory(given) for given in ("line.csv", "short.toml", "figure-8", SHORT)]
    sent = [pickle.dumps(trajectory) for trajectory in trajectories]
    Path("line.csv").unlink()
    Path("short.toml").write_text("family = 'hover'\naltitude_m = 1.0\nduration_s = 9.0\n")
    monkeypatch.chdir("/")
    for trajectory, text in zip(trajectories, sent):
        again = pickle.loads(text)
        assert again == trajectory and hash(again) == hash(trajectory)
        times = [0.0, 0.5, again.duration_s]
        assert (again.sample(times) == trajectory.sample(times)).all()


def test_trajectories_are_equal_by_their_motion() -> None:
    trajectory = dw.Trajectory(SHORT)
    assert trajectory == dw.Trajectory(dict(SHORT)) and trajectory != "hover"
    assert trajectory != dw.Trajectory(SHORT | {"altitude_m": 0.9})


def test_flights_work_in_a_forked_process() -> None:
    code = f"""
import os, downwash as dw
here = dw.fly(trajectory={SHORT!r}, seeds=[1, 2])
child = os.fork()
if child == 0:
    os._exit(0 if dw.fly(trajectory={SHORT!r}, seeds=[1, 2]) == here else 1)
assert os.waitpid(child, 0)[1] == 0
"""
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True, timeout=120)


def test_progress_reports_every_flight() -> None:
    reported: list[tuple[str, int, int]] = []
    dw.fly(trajectory=SHORT, seeds=range(4), progress=lambda *news: reported.append(news))
    assert sorted(reported) == [("flights", done, 4) for done in range(1, 5)]


def test_an_exception_in_the_progress_callback_propagates() -> None:
    def fail(stage: str, done: int, of: int) -> None:
        raise LookupError(stage)

    with pytest.raises(LookupError, match="flights"):
        dw.fly(trajectory=SHORT, seeds=range(100), progress=fail)


def test_a_short_call_does_not_wait_for_a_long_one() -> None:
    began, over = threading.Event(), threading.Event()
    ended: list[BaseException] = []

    def report(stage: str, done: int, of: int) -> None:
        began.set()
        if over.is_set():
            raise LookupError(stage)

    def fly() -> None:
        try:
            dw.fly(trajectory=SHORT, seeds=range(100_000), progress=report)
        except LookupError as error:
            ended.append(error)

    long = threading.Thread(target=fly)
    long.start()
    assert began.wait(60)
    assert dw.rollouts([[[0.5] * 4]]).shape == (1, 1, 13)
    assert dw.fly(trajectory=SHORT)[0]["end"] == "done"
    assert long.is_alive()
    over.set()
    long.join()
    assert ended


def test_a_progress_callback_may_fly_too() -> None:
    ends: list[str] = []
    dw.fly(
        trajectory=SHORT,
        seeds=range(3),
        progress=lambda *_: ends.append(dw.fly(trajectory=SHORT)[0]["end"]),
    )
    assert ends == ["done"] * 3


def test_threads_end_with_their_calls() -> None:
    def threads() -> int:
        return len(list(Path("/proc/self/task").iterdir()))

    before = threads()
    for jobs in range(20, 40):
        dw.fly(trajectory=SHORT, jobs=jobs)
    # Four pools stay; the threads of the others, 458 in all, take a moment to end.
    deadline = time.monotonic() + 30
    while threads() > before + 4 * 40 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threads() <= before + 4 * 40


@pytest.mark.parametrize("seeds", [1.5, None, np.array(1)])
def test_what_is_no_list_of_seeds_is_refused(seeds: Any) -> None:
    with pytest.raises(TypeError, match="seeds: expected a list"):
        dw.fly(trajectory=SHORT, seeds=seeds)


def test_ctrl_c_ends_flights() -> None:
    def interrupt(stage: str, done: int, of: int) -> None:
        if done >= 3:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        dw.fly(trajectory=SHORT, seeds=range(100_000), progress=interrupt)


def test_flights_release_the_gil() -> None:
    ticks = 0
    over = threading.Event()

    def tick() -> None:
        nonlocal ticks
        while not over.is_set():
            ticks += 1
            time.sleep(0)

    other = threading.Thread(target=tick)
    other.start()
    dw.fly(trajectory=SHORT, seeds=range(20))
    over.set()
    other.join()
    assert ticks > 20
