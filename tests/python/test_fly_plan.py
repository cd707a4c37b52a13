"""Plans in flight: tracked, and replanned towards a moving goal; and the whole demo."""

import json
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from conftest import CRAZYFLIE, TURN, fly_arguments, of_the_demo, only_log, run

STAY = "family = 'waypoints'\npoints = [{point}, {point}]\n"


def stay(north, seconds):
    point = f"{{ north_m = {north}, east_m = 0.0, altitude_m = 0.8, hold_s = {seconds / 2} }}"
    return STAY.format(point=point)


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


def test_a_planned_flight_tracks_closer_than_an_unplanned_one(program, crazyflie, tmp_path):
    turn, plan = tmp_path / "turn.toml", tmp_path / "plan.json"
    turn.write_text(TURN)
    run("plan", turn, "--vehicle", CRAZYFLIE, "-o", plan)
    # Both at once, each with its own vehicle.
    flights = {}
    for name, trajectory in (("plan", plan), ("desired", turn)):
        url = crazyflie().peer_url()
        flights[name] = program(*fly_arguments(trajectory, url, tmp_path / name, "--json"))
    errors = {}
    for name, flown in flights.items():
        code, out = flown.finish()
        assert code == 0, flown.err
        errors[name] = json.loads(out)["flight"]["tracking"]["rmse_3d_m"]
    assert errors["plan"] < 0.5 * errors["desired"], errors


def test_editing_the_goal_file_moves_the_goal(program, crazyflie, tmp_path):
    goal = tmp_path / "goal.toml"
    goal.write_text(stay(0.0, 5.0))
    flown = program(*fly_arguments(goal, crazyflie().peer_url(), tmp_path, "--replan", "-v"))
    flown.says("track", timeout=60.0)
    # Replaced atomically, as an editor does.
    (tmp_path / "next.toml").write_text(stay(0.5, 5.0))
    (tmp_path / "next.toml").rename(goal)
    assert flown.finish()[0] == 0, flown.err
    north = states(only_log(tmp_path))
    assert abs(north[-1] - north[0] - 0.5) < 0.1, (north[0], north[-1])


@pytest.mark.computes
@of_the_demo
@pytest.mark.timeout(300)
def test_the_demo_learns_plans_flies_and_compares(demo):
    folder, printed = demo
    summary = json.loads(printed)
    assert summary["end"] == "done" and summary["learned_from_s"] == 60
    means = {one["name"]: one["mean"]["rmse_3d_m"] for one in summary["contenders"]}
    assert list(means) == ["model-free", "physics", "replanned"]
    assert 3 * means["physics"] < means["model-free"], means
    assert 2 * means["replanned"] < means["model-free"], means
    page = (folder / "report.html").read_text()
    for part in ("Comparison", "Observed and predicted", "Trajectories", "Tracking error", "Open loop and feedback"):
        assert part in page
    for row in summary["logs"]:
        assert Path(row["log"]).exists()
