"""Bad files, flags and environments: a clear error with a stable exit code, never a panic."""

import json
import re
import socket

import pytest

from conftest import CRAZYFLIE, SHORT_HOVER

GOOD_URL = "udpout:127.0.0.1:9"


def refused(program, arguments, code, *words, timeout=20):
    one = program(*arguments)
    found, _ = one.finish(timeout)
    assert found == code, one.err
    assert "panicked" not in one.err
    for word in words:
        assert word in one.err, one.err


def fly(trajectory, folder, connect=GOOD_URL, vehicle=CRAZYFLIE):
    return ["fly", trajectory, "--connect", connect, "--vehicle", vehicle, "--log-dir", folder]


def changed_vehicle(folder, pattern, text):
    path = folder / "vehicle.toml"
    content, count = re.subn(pattern, text, CRAZYFLIE.read_text(), count=1, flags=re.MULTILINE)
    assert count == 1
    path.write_text(content)
    return path


@pytest.mark.parametrize(
    "pattern, text, words",
    [
        ("^mass = .*", "mass = -0.03", ["mass", "-0.03"]),
        ("^mass = .*", "mass = nan", ["mass"]),
        ("^mass = .*", "mass = 0.03\nmasss = 0.03", ["masss"]),
        ("^inertia = .*", "inertia = [1.66e-5, inf, 2.93e-5]", ["inertia"]),
        (r"^position_m = \[0.0325, 0.0325, 0.0\]", "position_m = [0.0, 0.0, 0.0]", ["vehicle.toml"]),
        ("^gravity = .*", "gravity = 'down'", ["gravity"]),
    ],
)
def test_bad_vehicle_files_are_refused(program, hover, tmp_path, pattern, text, words):
    vehicle = changed_vehicle(tmp_path, pattern, text)
    if "0.0, 0.0" in text:
        # With all rotors at one point, no thrusts make a roll or pitch torque.
        vehicle.write_text(re.sub(r"position_m = .*", text, CRAZYFLIE.read_text()))
    refused(program, fly(hover, tmp_path, vehicle=vehicle), 2, "vehicle.toml", *words)
    refused(program, ["sitl", "--vehicle", vehicle, "--link", "udpin:127.0.0.1:0"], 2, *words)


@pytest.mark.parametrize(
    "text, code, words",
    [
        (SHORT_HOVER + "colour = 'red'\n", 2, ["colour", "hover.toml"]),
        (SHORT_HOVER.replace("0.8", "nan"), 2, ["altitude_m"]),
        (SHORT_HOVER.replace("0.8", "-1.0"), 2, ["altitude_m", "-1"]),
        (SHORT_HOVER.replace("0.8", "0.05"), 4, ["0.05"]),
        (SHORT_HOVER.replace("0.8", "500.0"), 4, ["height"]),
        ("family = 'sinusoid-yaw'\naltitude_m = 1.0\nduration_s = 20.0\namplitude_m = 5.0\nperiod_s = 1.0\nyaw_period_s = 9.0\n", 4, []),
        ("family = 'loop'\n", 2, ["loop"]),
        ("\x00\x01", 2, ["hover.toml"]),
    ],
)
def test_bad_trajectory_files_are_refused(program, hover, tmp_path, text, code, words):
    hover.write_text(text)
    refused(program, fly(hover, tmp_path), code, *words)
    # Refused before anything is connected or logged.
    assert not list(tmp_path.glob("*.mcap"))


@pytest.mark.parametrize(
    "text, words",
    [
        ("trajektory = 'a.toml'\n", ["trajektory"]),
        ("[control]\nrate_hz = nan\n", ["rate_hz"]),
        ("[control]\nrate_hz = -100.0\n", ["rate_hz"]),
        ("[offboard.safety]\ntilt_max_rad = nan\n", ["tilt_max_rad"]),
        ("[link]\nlost_after_s = -1.0\n", ["lost_after_s"]),
        ("schema_version = 99\n", ["99"]),
    ],
)
def test_bad_configuration_files_are_refused(program, hover, tmp_path, text, words):
    path = tmp_path / "config.toml"
    path.write_text(text)
    refused(program, [*fly(hover, tmp_path), "--config", path], 2, "config.toml", *words)


def test_settings_of_another_schema_are_refused_on_the_command_line(program, tmp_path):
    args = ["simulate", "--set", "schema_version=2", "--no-log", "--out", tmp_path / "flights"]
    refused(program, args, 2, "schema_version", "expected 1, found 2")


def test_onset_after_the_end_of_a_flight_is_reported(program, hover, tmp_path):
    args = ["simulate", hover, "--no-log", "--effect", "wind:north_m_s=1@500"]
    one = program(*args, cwd=tmp_path)
    code, _ = one.finish(60)
    assert code == 0 and "before the onset of wind at 500.0 s" in one.err, one.err


@pytest.mark.parametrize(
    "url, word",
    [
        ("udp:127.0.0.1:14540", "udpin"),
        ("serial:/dev/ttyACM0", "baud"),
        ("http://127.0.0.1", "udpin"),
        ("udpin:127.0.0.1:99999", "99999"),
        ("tcp:127.0.0.1", "port"),
    ],
)
def test_bad_urls_are_refused(program, hover, tmp_path, url, word):
    refused(program, fly(hover, tmp_path, connect=url), 2, word)


@pytest.mark.parametrize("flag", ["--view", "--metrics"])
@pytest.mark.parametrize("address", ["99999", "127.0.0.1:99999", "lab:http"])
def test_impossible_ports_are_refused(program, hover, tmp_path, flag, address):
    refused(program, [*fly(hover, tmp_path), f"{flag}={address}"], 2, flag, "port", address.rsplit(":")[-1])


def test_a_busy_port_without_a_vehicle_is_reported(program, hover, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        url = f"udpin:127.0.0.1:{other.getsockname()[1]}"
        config = tmp_path / "config.toml"
        # Longer than the wait after which a silent link is explained.
        config.write_text("[link]\nsearch_timeout_s = 4.0\n")
        one = program(*fly(hover, tmp_path, connect=url), "--config", config)
        code, _ = one.finish(20)
        assert code == 3, one.err
        assert all(words in one.err for words in (url, "in use", "no vehicle")), one.err
        # Nothing about the vehicle is wrong as far as is known.
        assert "bytes received" not in one.err and "check that" not in one.err, one.err


@pytest.mark.parametrize("content, code", [(b"", 2), (b"\x89MCAP0\r\n", 2), (b"not a log" * 99, 2), (b"\x89MCAP0\r\n" + b"\xff" * 999, 0)])
def test_log_info_on_incomplete_logs_and_other_files(program, tmp_path, content, code):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    one = program("log", "info", path)
    found, out = one.finish(20)
    assert found == code and "panicked" not in one.err
    assert "unfinished" in out if found == 0 else "a.mcap" in one.err


def test_an_unusable_output_is_refused_before_the_work(program, hover, tmp_path):
    file = tmp_path / "file"
    file.write_text("no folder")
    config = tmp_path / "config.toml"
    config.write_text(f"vehicle = '{CRAZYFLIE}'\ntrajectory = '{hover}'\nconnect = '{GOOD_URL}'\nlog_dir = '{file}'\n")
    refused(program, fly(hover, file), 2, "--log-dir", str(file))
    refused(program, [*fly(hover, tmp_path), "--tlog", file / "a.tlog"], 2, "telemetry log", str(file))
    refused(program, ["daemon", "--config", config], 2, "log_dir", str(file))
    for command in (["simulate", hover], ["collect"], ["demo"], ["exam"]):
        refused(program, [*command, "--out", file], 2, "--out", str(file))
    refused(program, ["plan", hover, "-o", tmp_path / "none/plan.json"], 2, "there is no folder", "none")
    one = ["diagnose", hover, "--vehicle", CRAZYFLIE, "--evidence"]
    refused(program, [*one, hover], 2, "it would overwrite", str(hover))
    refused(program, [*one, tmp_path / "none/evidence.json"], 2, "there is no folder", "none")
    assert file.read_text() == "no folder"


def test_missing_files_are_named(program, hover, tmp_path):
    refused(program, fly(tmp_path / "none.toml", tmp_path), 2, "none.toml")
    refused(program, fly(hover, tmp_path, vehicle=tmp_path / "none.toml"), 2, "none.toml")
    refused(program, ["daemon", "--config", tmp_path / "none.toml"], 2, "none.toml")
    refused(program, ["log", "info", tmp_path / "none.mcap"], 2, "none.mcap")
    # Among several logs, too, a name that is wrong is no log to leave out.
    none, vehicle = tmp_path / "none.mcap", ["--vehicle", CRAZYFLIE]
    for arguments in (
        ["diagnose", *vehicle, hover, none],
        ["diagnose", *vehicle, hover, "--holdout", none],
        ["diagnose", *vehicle, hover, "--new", none],
        ["onset", *vehicle, hover, none],
        ["train", *vehicle, hover, none, "--out", tmp_path / "model.safetensors"],
        ["tube", "fit", *vehicle, hover, none, "--out", tmp_path / "tube.json"],
        ["log", "audit", hover, none],
        ["compare", hover, none, "--", hover],
    ):
        refused(program, arguments, 2, "cannot read", "none.mcap")
    refused(program, ["onset", *vehicle, hover, tmp_path], 2, "cannot read", str(tmp_path), "folder")
    refused(program, ["onset", *vehicle, hover, "--mapping", tmp_path / "none.toml"], 2, "none.toml")
    assert not (tmp_path / "model.safetensors").exists()


def test_options_without_effect_are_refused(program, hover, tmp_path):
    code, out = program("simulate", hover, "--json", "--no-report", "--out", tmp_path).finish(60)
    assert code == 0
    log = json.loads(out)["log"]
    for option in (["--mapping", "motive"], ["--boot", "2"]):
        refused(program, ["log", "report", log, "-o", tmp_path / "r.html", *option], 2, log, option[0])
    refused(program, ["replay", log, "--mapping", "motive"], 2, log, "--mapping")
    refused(program, ["log", "audit", log, "--mapping", tmp_path / "none.toml"], 2, "none.toml")
    refused(program, ["compare", log, "--mapping", tmp_path / "none.toml", "--", log], 2, "none.toml")
    fit = ["tube", "fit", log, "-o", tmp_path / "tube.json"]
    refused(program, [*fit, "--effect", "mass:mass_kg=0.04"], 2, "--along")
    refused(program, ["diagnose", log, "--vehicle", CRAZYFLIE, "--rows", tmp_path], 2, "--rows")
    assert not list(tmp_path.glob("*.html"))


def test_effects_and_settings_given_twice_are_refused(program, hover):
    simulate = ["simulate", hover, "--no-log"]
    lags = ["--effect", "motor_lag:tau_s=0.02", "--effect", "motor_lag:tau_s=0.03"]
    refused(program, [*simulate, *lags], 2, "motor_lag is given twice")
    refused(program, ["sitl", "--vehicle", CRAZYFLIE, "--link", "udpin:127.0.0.1:0", *lags], 2, "motor_lag is given twice")
    shares = ["--set", "control.thrust=0.4", "--set", "control.thrust=0.5"]
    refused(program, [*simulate, *shares], 2, "control.thrust is given twice")


def test_an_effect_without_numbers_is_reported_with_those_that_it_takes(program, hover):
    simulated = program("simulate", hover, "--no-log", "--effect", "rotor_drag")
    code, _ = simulated.finish(60)
    assert code == 0, simulated.err
    assert "--effect rotor_drag" in simulated.err and "d_xy 0 kg/s, d_z 0 kg/s" in simulated.err


def test_a_file_twice_in_one_group_is_no_second_flight(program, tmp_path):
    first, copy, other = (tmp_path / name for name in ("a.ulg", "copy.ulg", "b.ulg"))
    for path, content in ((first, b"one flight"), (copy, b"one flight"), (other, b"another flight")):
        path.write_bytes(content)
    out = ["--baseline", "-o", tmp_path / "compare.html", "--"]
    refused(program, ["compare", first, first, *out, other], 2, "a.ulg", "the same file as")
    refused(program, ["compare", other, *out, first, copy], 2, "copy.ulg", "the same file as", "a.ulg")
    assert not (tmp_path / "compare.html").exists()
