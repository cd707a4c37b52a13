"""Consecutive flights of one vehicle, each from the position and the mode that the last one left."""

import json
import signal

from conftest import CRAZYFLIE, fly_arguments


def test_a_second_flight_leaves_offboard_before_arming(program, hover, crazyflie, mavlink_client, tmp_path):
    vehicle = crazyflie("udpin:127.0.0.1:0", "udpin:127.0.0.1:0")
    watcher = mavlink_client(vehicle.peer_url(1))
    for turn in (1, 2):
        if turn == 2:
            # Like PX4, it returns to the mode selected before arming.
            watcher.hello()
            watcher.wait_mode(6)
        flight = program(*fly_arguments(hover, vehicle.peer_url(), tmp_path, "--json"))
        code, out = flight.finish()
        assert code == 0, flight.err
        assert json.loads(out)["end"] == "done"
        assert len(list(tmp_path.glob("*.mcap"))) == turn


def test_collect_flies_in_sequence_and_resumes(program, crazyflie, tmp_path):
    vehicle = crazyflie()
    logs = tmp_path / "logs"

    def collect():
        # The shortest programme: five flights of at least 4 s.
        return program(
            "collect",
            *("--out", logs, "--connect", vehicle.peer_url(), "--vehicle", CRAZYFLIE),
            *("--seconds", 32, "--json", "-v"),
        )

    first = collect()
    line = first.says("flight 1 of 5: ")
    line = first.says(" done: ", line, timeout=60)
    line = first.says("flight 2 of 5: ", line)
    line = first.says(" done: ", line, timeout=60)
    # Interrupted before the third takes off.
    line = first.says("flight 3 of 5: ", line)
    first.says(" standby: ", line)
    first.signal(signal.SIGINT)
    code, out = first.finish()
    assert code == 130, first.err
    ends = [flight["end"] for flight in json.loads(out)["flights"]]
    assert ends[:2] == ["done", "done"] and ends[3:] == ["planned", "planned"], (ends, first.err)

    # The same command resumes with the third.
    second = collect()
    line = second.says("flight 1 of 3: ")
    second.says(" standby: ", line)
    second.signal(signal.SIGINT)
    code, out = second.finish()
    ends = [flight["end"] for flight in json.loads(out)["flights"]]
    assert code == 130 and ends[:2] == ["kept", "kept"] and ends[3:] == ["planned", "planned"], (ends, second.err)
