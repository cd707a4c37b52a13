"""`downwash plan`: the file it writes, and which plans `fly` refuses."""

import json
import re

import pytest

from conftest import CRAZYFLIE, ROOT, run

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
    assert (summary["schema"], summary["schema_version"]) == ("downwash.plan.summary", 1)
    assert summary["status"] in ("converged", "stalled") and summary["not_flyable"] is None
    assert summary["cost"] == plan["cost"] and summary["subproblems"] == len(plan["records"])


def test_the_report_loads_nothing_external(planned):
    folder = planned[0].parent / "report"
    page = (folder / "report.html").read_text()
    for word in ("http:", "https:", "<link", "src=", "@import", "url("):
        assert word not in page.replace("http://www.w3.org/2000/svg", "")
    assert "<svg" in page and json.loads((folder / "report.json").read_text()) == planned[1]


def fly(plan, folder, vehicle=CRAZYFLIE, code=4):
    return run("fly", plan, "--connect", FAR, "--vehicle", vehicle, "--log-dir", folder, code=code).stderr


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


def test_unflyable_plans_are_refused_with_the_reason(planned, tmp_path):
    good = planned[0].read_text()
    bad = tmp_path / "bad.json"

    def refused(change, code, *words):
        plan = json.loads(good)
        change(plan)
        bad.write_text(json.dumps(plan))
        error = fly(bad, tmp_path, code=code)
        assert all(word in error for word in words), error

    refused(lambda plan: plan.update(vehicle="another"), 4, "the plan is for the vehicle")
    refused(lambda plan: plan["violation"].update(defect=0.02), 4, "violates its dynamics by 2.0e-2")
    refused(lambda plan: plan.update(status="failed"), 4, "failed")
    refused(lambda plan: plan.update(schema_version=99), 2, "99", "bad.json", "plan it again")
    refused(lambda plan: plan["inputs"].pop(), 2, "states")
    refused(lambda plan: plan.update(inputs=[]), 2, "periods")
    refused(lambda plan: plan["body"].update(mass_kg=0.05), 4, "another vehicle with this name")
    refused(lambda plan: plan["states"][3].__setitem__(2, 5.0), 4, "jumps by")
    refused(lambda plan: [state.__setitem__(2, state[2] + 5.0) for state in plan["states"]], 4, "lowest height")
    bad.write_text(good[: len(good) // 2])
    error = fly(bad, tmp_path, code=2)
    assert "bad.json" in error and "plan it again" in error
    assert not list(tmp_path.glob("*.mcap"))


def test_a_zero_time_limit_gives_an_unflyable_plan(trajectory, tmp_path):
    out = tmp_path / "plan.json"
    summary = json.loads(
        run("plan", trajectory, "-o", out, "--time-limit", 0, "--json", code=6).stdout
    )
    assert summary["status"] == "stopped" and summary["subproblems"] == 0
    assert "violates its dynamics" in summary["not_flyable"]
    assert "violates its dynamics" in fly(out, tmp_path)


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
