"""`downwash plan`: the file it writes, which plans `fly` refuses, and the plan after an interrupt."""

import json
import re
import signal
import subprocess

import pytest

from conftest import CRAZYFLIE, DOWNWASH, ROOT

pytestmark = pytest.mark.computes

FAR = "udpout:127.0.0.1:9"
SHORT = """family = 'sinusoid-yaw'
altitude_m = 1.0
duration_s = 3.0
amplitude_m = 0.4
period_s = 3.0
yaw_period_s = 6.0
ramp_s = 0.5
"""


def run(*arguments, code=0):
    done = subprocess.run(
        DOWNWASH + list(map(str, arguments)), capture_output=True, text=True, timeout=120
    )
    assert done.returncode == code, done.stderr
    assert "panicked" not in done.stderr
    return done


@pytest.fixture(scope="module")
def trajectory(tmp_path_factory):
    path = tmp_path_factory.mktemp("trajectory") / "short.toml"
    path.write_text(SHORT)
    return path


@pytest.fixture(scope="module")
def planned(trajectory, tmp_path_factory):
    """A plan through the vehicle's own physics: its file, and the summary on stdout."""
    folder = tmp_path_factory.mktemp("plan")
    done = run("plan", trajectory, "-o", folder / "plan.json", "--report", folder / "report", "--json")
    return folder / "plan.json", json.loads(done.stdout)


def test_the_file_holds_the_plan(planned):
    path, summary = planned
    plan = json.loads(path.read_text())
    assert (plan["schema"], plan["schema_version"]) == ("downwash.plan", 2)
    assert plan["vehicle"] == "crazyflie" and plan["model"] == {"kind": "nominal", "sha256": None}
    assert len(plan["states"]) == len(plan["desired"]) == len(plan["inputs"]) + 1 == 351
    assert {len(state) for state in plan["states"]} == {12}
    assert {len(one) for one in plan["inputs"]} == {7}
    assert plan["violation"]["defect"] <= 1e-6 and plan["violation"]["overrun"] <= 1e-4
    assert summary["schema"] == "downwash.plan.summary" and summary["not_flyable"] is None
    assert summary["cost"] == plan["cost"] and summary["subproblems"] == len(plan["records"])


def test_the_report_loads_nothing_external(planned):
    folder = planned[0].parent / "report"
    page = (folder / "report.html").read_text()
    for word in ("http:", "https:", "<link", "src=", "@import", "url("):
        assert word not in page.replace("http://www.w3.org/2000/svg", "")
    assert "<svg" in page and json.loads((folder / "report.json").read_text()) == planned[1]


def fly(plan, folder, vehicle=CRAZYFLIE, code=4):
    return run(
        "fly", plan, "--connect", FAR, "--vehicle", vehicle, "--log-dir", folder, code=code
    ).stderr


def test_a_plan_is_refused_for_another_vehicle(planned, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text(CRAZYFLIE.read_text().replace('name = "crazyflie"', 'name = "wasp"'))
    error = fly(planned[0], tmp_path, other)
    assert "crazyflie" in error and "wasp" in error
    stiffer = tmp_path / "stiffer.toml"
    text, count = re.subn(r"(?m)^kp = \[0.004797,", "kp = [0.006,", CRAZYFLIE.read_text())
    assert count == 1
    stiffer.write_text(text)
    assert "attitude loop" in fly(planned[0], tmp_path, stiffer)
    assert not list(tmp_path.glob("*.mcap"))


def test_a_plan_that_violates_its_dynamics_is_refused(planned, tmp_path):
    plan = json.loads(planned[0].read_text())
    plan["violation"]["defect"] = 0.02
    invalid = tmp_path / "invalid.json"
    invalid.write_text(json.dumps(plan))
    assert "violates its dynamics by 2.0e-2" in fly(invalid, tmp_path)


def test_damaged_plans_are_refused(planned, tmp_path):
    text = planned[0].read_text()
    damaged = tmp_path / "damaged.json"
    for change in (text[: len(text) // 2], text.replace('"schema_version":2', '"schema_version":9')):
        damaged.write_text(change)
        error = fly(damaged, tmp_path, code=2)
        assert "damaged.json" in error and "plan it again" in error


def test_a_zero_time_limit_gives_an_unflyable_plan(trajectory, tmp_path):
    out = tmp_path / "plan.json"
    summary = json.loads(
        run("plan", trajectory, "-o", out, "--time-limit", 0, "--json", code=6).stdout
    )
    assert summary["status"] == "stopped" and summary["subproblems"] == 0
    assert "violates its dynamics" in summary["not_flyable"]
    assert "violates its dynamics" in fly(out, tmp_path)


def test_an_interrupt_leaves_the_best_plan_so_far(program, tmp_path):
    # The slowest solver, so that the search outlasts the interrupt.
    long = tmp_path / "long.toml"
    long.write_text(SHORT.replace("duration_s = 3.0", "duration_s = 5.0"))
    out = tmp_path / "plan.json"
    one = program("plan", long, "-o", out, "--solver", "penalty", "--json")
    one.says("planning")
    one.signal(signal.SIGINT)
    code, text = one.finish(120)
    assert code == 130, one.err
    summary = json.loads(text)
    plan = json.loads(out.read_text())
    assert summary["status"] == plan["status"] == "stopped"
    assert len(plan["inputs"]) == 550


@pytest.mark.parametrize(
    "text, words",
    [
        ("rate_hz = 0.0", ["rate_hz", "1 to 1000 Hz"]),
        ("weight = [0.0, 0.0, 0.0, 0.0]", ["weight"]),
        ("keep_out = [{ sphere = { centre_m = [0, 0, -1], radius_m = -1 } }]", ["radius"]),
        ("keep_outs = []", ["keep_outs"]),
    ],
)
def test_invalid_settings_are_refused(trajectory, tmp_path, text, words):
    config = tmp_path / "downwash.toml"
    config.write_text(f"[plan]\n{text}\n")
    error = run("plan", trajectory, "--config", config, "-o", tmp_path / "plan.json", code=2).stderr
    for word in words:
        assert word in error


def test_a_trajectory_too_long_to_plan_suggests_replan(tmp_path):
    long = tmp_path / "long.csv"
    rows = (f"{0.05 * n:.2f},{(n % 40) / 100},0,-1\n" for n in range(100_000))
    long.write_text("t_s,n_m,e_m,d_m\n" + "".join(rows))
    error = run("plan", long, "-o", tmp_path / "plan.json", code=2).stderr
    assert "at most 100 s" in error and "--replan" in error and "--time-limit" not in error


def test_an_unflyable_trajectory_gives_the_reason(tmp_path):
    wild = tmp_path / "wild.toml"
    wild.write_text(SHORT.replace("amplitude_m = 0.4", "amplitude_m = 5.0").replace("\nperiod_s = 3.0", "\nperiod_s = 0.6"))
    out = tmp_path / "plan.json"
    done = run("plan", wild, "-o", out, "--json", code=6)
    assert json.loads(done.stdout)["not_flyable"] and "cannot be flown" in done.stderr


def test_the_example_configuration_gives_a_plan(trajectory, tmp_path):
    config = ROOT / "config/downwash.toml"
    run("plan", trajectory, "--config", config, "-o", tmp_path / "plan.json", "--time-limit", 60)
