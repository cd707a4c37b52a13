"""A command that flies no vehicle ends within two seconds of SIGINT or SIGTERM, with exit code 130 and
without a partial file; one that flies reports within a second how it ends.
"""

import errno
import json
import os
import subprocess
import time

import pytest

from conftest import CRAZYFLIE, MOTION_CAPTURE, SIGNALS, SIGNALS_TERM_LONG, fly_arguments, hover_for, run, until


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flights")
    run("collect", "--out", folder, "--seconds", 40)
    return sorted(folder.glob("*.mcap"))


def written(pipe, reader):
    """The writing end of a pipe, once `reader` reads it."""
    ends = []

    def has_reader():
        try:
            ends.append(os.open(pipe, os.O_WRONLY | os.O_NONBLOCK))
        except OSError as error:
            assert error.errno == errno.ENXIO
        return ends

    until(has_reader, f"{reader} reads")
    return ends[0]


def ends_after(one, number):
    """Sends the signal, checks the exit code and the time, and returns stdout."""
    sent = time.monotonic()
    one.signal(number)
    code, out = one.finish(10)
    took = time.monotonic() - sent
    assert code == 130, one.err
    assert "interrupted" in one.err and "panicked" not in one.err
    assert took < 2.0, f"{took:.2f} s"
    return out


@pytest.mark.computes
@SIGNALS
@pytest.mark.parametrize("stage", ["... logs", "... physics", "... networks"])
def test_interrupted_train(program, flights, tmp_path, number, stage):
    model = tmp_path / "model.safetensors"
    one = program("train", "--vehicle", CRAZYFLIE, *flights, "-o", model, "--passes", 100_000)
    one.says(stage)
    ends_after(one, number)
    assert not model.exists() and not list(tmp_path.glob("*.part"))
    if stage == "... networks":
        assert "--resume" in one.err
        assert (tmp_path / "model.safetensors.checkpoint").exists()


@pytest.mark.computes
@SIGNALS_TERM_LONG
def test_interrupted_evaluation_keeps_the_trained_networks(program, flights, tmp_path, number):
    model = tmp_path / "model.safetensors"
    few = ["--passes", 15, "--hidden", 20, "--regularization", "1e-5"]
    one = program("train", "--vehicle", CRAZYFLIE, *flights, "-o", model, *few)
    one.says("... errors")
    ends_after(one, number)
    assert (tmp_path / "model.safetensors.checkpoint").exists() and not model.exists()


@pytest.mark.computes
@SIGNALS
def test_interrupted_diagnose(program, flights, tmp_path, number):
    out = tmp_path / "improved.toml"
    one = program("diagnose", "--vehicle", CRAZYFLIE, *flights, "-o", out)
    one.says("... assessing the vehicle file")
    ends_after(one, number)
    assert not list(tmp_path.iterdir())


@pytest.mark.computes
@SIGNALS_TERM_LONG
@pytest.mark.parametrize("stage", ["... flying", "... diagnosing"])
def test_interrupted_exam(program, tmp_path, number, stage):
    # Child processes do the work of the second stage.
    one = program("exam", "--out", tmp_path / "exam", "--cases", 2, "--nulls", 0, "--seed", 3)
    one.says(stage, timeout=240)
    ends_after(one, number)
    children = subprocess.run(
        ["pgrep", "-f", str(tmp_path)], capture_output=True, text=True
    ).stdout.split()
    assert not children
    if stage == "... diagnosing":
        assert (tmp_path / "exam/commitment.txt").exists() and (tmp_path / "exam/key.json").exists()


@pytest.mark.computes
@SIGNALS
def test_an_interrupted_plan_is_the_best_so_far(program, tmp_path, number):
    # Too long for the slowest solver to end before the signal.
    long, out = tmp_path / "long.toml", tmp_path / "plan.json"
    long.write_text(
        "family = 'sinusoid-yaw'\naltitude_m = 1.0\nduration_s = 5.0\namplitude_m = 0.4\n"
        "period_s = 3.0\nyaw_period_s = 6.0\nramp_s = 0.5\n"
    )
    one = program("plan", long, "-o", out, "--solver", "penalty", "--json")
    one.says("planning")
    summary = json.loads(ends_after(one, number))
    plan = json.loads(out.read_text())
    assert summary["status"] == plan["status"] == "stopped"
    # 5 s and the rest at the end, at 100 Hz.
    assert len(plan["inputs"]) == 550


@pytest.mark.computes
@SIGNALS_TERM_LONG
@pytest.mark.parametrize("stage", ["... flying", "... physics"])
def test_interrupted_demo(program, tmp_path, number, stage):
    one = program("demo", "--out", tmp_path / "demo", "--learn", 40)
    one.says(stage, timeout=240)
    ends_after(one, number)


READERS = {
    "log info": ["log", "info", "INPUT"],
    "log export": ["log", "export", "INPUT", "--topic", "/state", "--out", "OUT"],
    "log report": ["log", "report", "INPUT", "--out", "OUT"],
    "log import": ["log", "import", "INPUT", "--mapping", MOTION_CAPTURE, "-o", "OUT"],
    "log audit": ["log", "audit", "INPUT", "--mapping", MOTION_CAPTURE],
    "model info": ["model", "info", "INPUT"],
    "model eval": ["model", "eval", "LOG", "--model", "INPUT"],
    "model predict": ["model", "predict", "LOG", "--model", "INPUT", "--out", "OUT"],
    "model export": ["model", "export", "INPUT", "--out", "OUT"],
    "plan": ["plan", "hover", "--config", "INPUT", "-o", "OUT"],
    # Commands that fly, before they connect.
    "fly": ["fly", "hover", "--vehicle", CRAZYFLIE, "--connect", "udpin:127.0.0.1:0", "--config", "INPUT"],
    "collect": ["collect", "--out", "OUT", "--config", "INPUT"],
    "daemon": ["daemon", "--config", "INPUT"],
}


@SIGNALS
@pytest.mark.parametrize("command", READERS)
def test_interrupted_while_reading_a_file(program, tmp_path, number, command):
    # A pipe that nobody writes to.
    pipe = tmp_path / "input"
    os.mkfifo(pipe)
    places = {"INPUT": pipe, "LOG": pipe, "OUT": tmp_path / "out"}
    one = program(*(places.get(word, word) for word in READERS[command]))
    end = written(pipe, command)
    ends_after(one, number)
    os.close(end)
    assert list(tmp_path.iterdir()) == [pipe]


@SIGNALS
@pytest.mark.parametrize("command", ["doctor", "inspect"])
def test_interrupted_while_listening(program, number, command):
    one = program(command, "--connect", "udpin:127.0.0.1:0", "--seconds", "60")
    one.says("listening")
    ends_after(one, number)


@SIGNALS
def test_an_interrupted_flight_reports_at_once_and_lands(program, hover, hand_made, tmp_path, number):
    vehicle, url = hand_made
    hover.write_text(hover_for(30))
    one = program(*fly_arguments(hover, url, tmp_path))
    line = one.says(" track: ")
    one.signal(number)
    one.says("land", line, timeout=1.0)
    assert one.finish(30)[0] == 130, one.err
    assert not vehicle.armed and vehicle.position[2] == 0.0


@SIGNALS
def test_an_interrupted_collection_reports_at_once(program, tmp_path, number):
    # Ten flights of a minute, which take seconds; the programme of many more would take longer to make.
    one = program("collect", "--out", tmp_path, "--seconds", 600)
    line = one.says("... flying")
    one.signal(number)
    one.says("stopping", line, timeout=1.0)
    assert one.finish(10)[0] == 130, one.err
