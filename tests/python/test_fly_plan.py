"""Plans in flight: tracked, refused, replanned towards a moving goal; and the whole demo."""

import json
import subprocess
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from conftest import CRAZYFLIE, DOWNWASH, Sitl

TURN = "family = 'sinusoid-yaw'\naltitude_m = 0.8\nduration_s = 3.0\namplitude_m = 0.4\nperiod_s = 3.0\nyaw_period_s = 6.0\nramp_s = 1.0\n"
STAY = "family = 'waypoints'\npoints = [{point}, {point}]\n"


def stay(north, seconds):
    point = f"{{ north_m = {north}, east_m = 0.0, altitude_m = 0.8, hold_s = {seconds / 2} }}"
    return STAY.format(point=point)


def run(*arguments, code=0):
    done = subprocess.run([*DOWNWASH, *map(str, arguments)], capture_output=True, text=True, timeout=280)
    assert done.returncode == code, done.stderr
    assert "panicked" not in done.stderr
    return done


def states(log):
    """North positions while tracking."""
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        north, tracked = {}, set()
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=["/state", "/control"]):
            if channel.topic == "/state":
                north[message.log_time] = decoded.p_n_m
            elif decoded.phase == "track":
                tracked.add(message.log_time)
    return [position for time, position in sorted(north.items()) if time in tracked]


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    (folder / "turn.toml").write_text(TURN)
    out = folder / "plan.json"
    arguments = ["plan", folder / "turn.toml", "--vehicle", CRAZYFLIE, "-o", out, "--report", folder / "report", "--json"]
    summary = json.loads(run(*arguments).stdout)
    assert (summary["schema"], summary["schema_version"]) == ("downwash.plan.summary", 1)
    assert summary["status"] in ("converged", "stalled") and summary["not_flyable"] is None
    assert summary["violation"]["defect"] <= 1e-6 and summary["violation"]["overrun"] <= 1e-4
    assert "<svg" in (folder / "report/report.html").read_text()
    return out


def test_a_planned_flight_tracks_closer_than_an_unplanned_one(program, plan, sitl, tmp_path):
    # Both at once, each with its own vehicle.
    flights = {}
    for name, trajectory in (("plan", plan), ("desired", plan.parent / "turn.toml")):
        vehicle = sitl("udpin:127.0.0.1:0", file=CRAZYFLIE)
        flights[name] = program(
            "fly", trajectory, "--connect", vehicle.peer_url(), "--vehicle", CRAZYFLIE,
            "--log-dir", tmp_path / name, "--json",
        )
    errors = {}
    for name, flown in flights.items():
        code, out = flown.finish()
        assert code == 0, flown.err
        errors[name] = json.loads(out)["flight"]["tracking"]["rmse_3d_m"]
    assert errors["plan"] < 0.5 * errors["desired"], errors


def test_unflyable_plans_are_refused_with_the_reason(plan, tmp_path):
    good = json.loads(plan.read_text())

    def refused(change, code, words, vehicle=CRAZYFLIE):
        bad = json.loads(json.dumps(good))
        change(bad)
        path = tmp_path / "bad.json"
        path.write_text(json.dumps(bad))
        done = run("fly", path, "--connect", "udpout:127.0.0.1:9", "--vehicle", vehicle, code=code)
        assert words in done.stderr, done.stderr

    refused(lambda bad: bad.update(vehicle="another"), 4, "the plan is for the vehicle")
    refused(lambda bad: bad["violation"].update(defect=0.1), 4, "violates its dynamics")
    refused(lambda bad: bad.update(status="failed"), 4, "failed")
    refused(lambda bad: bad.update(schema_version=99), 2, "99")
    refused(lambda bad: bad["inputs"].pop(), 2, "states")
    refused(lambda bad: bad.update(inputs=[]), 2, "periods")
    refused(lambda bad: bad["body"].update(mass_kg=0.05), 4, "another vehicle with this name")
    refused(lambda bad: bad["states"][3].__setitem__(2, 5.0), 4, "jumps by")
    refused(lambda bad: [state.__setitem__(2, state[2] + 5.0) for state in bad["states"]], 4, "lowest height")


def test_editing_the_goal_file_moves_the_goal(program, tmp_path):
    goal = tmp_path / "goal.toml"
    goal.write_text(stay(0.0, 8.0))
    vehicle = Sitl(CRAZYFLIE, ["udpin:127.0.0.1:0"])
    try:
        flown = program(
            "fly", goal, "--replan", "--connect", vehicle.peer_url(), "--vehicle", CRAZYFLIE,
            "--log-dir", tmp_path, "-v",
        )
        flown.says("track", timeout=60.0)
        # Replaced atomically, as an editor does.
        (tmp_path / "next.toml").write_text(stay(0.5, 8.0))
        Path(tmp_path / "next.toml").rename(goal)
        code, _ = flown.finish()
    finally:
        vehicle.stop()
    assert code == 0, flown.err
    (log,) = tmp_path.glob("*.mcap")
    north = states(log)
    assert abs(north[-1] - north[0] - 0.5) < 0.1, (north[0], north[-1])


@pytest.mark.computes
@pytest.mark.timeout(300)
def test_the_demo_learns_plans_flies_and_compares(tmp_path):
    trajectory = tmp_path / "turn.toml"
    trajectory.write_text(TURN)
    done = run("demo", "--out", tmp_path / "out", "--trajectory", trajectory, "--learn", 60, "--fly", "model-free,physics,replanned", "--json")
    summary = json.loads(done.stdout)
    assert summary["end"] == "done" and summary["learned_from_s"] == 60
    means = {one["name"]: one["mean"]["rmse_3d_m"] for one in summary["contenders"]}
    assert list(means) == ["model-free", "physics", "replanned"]
    assert 3 * means["physics"] < means["model-free"], means
    assert 2 * means["replanned"] < means["model-free"], means
    page = (tmp_path / "out/report.html").read_text()
    for part in ("Comparison", "Observed and predicted", "Trajectories", "Tracking error", "Open loop and feedback"):
        assert part in page
    for row in summary["logs"]:
        assert Path(row["log"]).exists()
