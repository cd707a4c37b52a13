"""`--forward`: a pymavlink ground station sees the vehicle, and cannot command it."""

import time

import pytest

from conftest import CRAZYFLIE, free_port
from hand_made_vehicle import mavutil

STATION = {"source_system": 255, "source_component": 190, "dialect": "all"}


@pytest.fixture
def forwarding(program, hover, hand_made, tmp_path):
    """Starts a daemon that forwards to a ground station; returns daemon, station and vehicle."""
    stations = []

    def start(allow):
        vehicle, url = hand_made
        config = tmp_path / "daemon.toml"
        config.write_text(
            f"vehicle = '{CRAZYFLIE}'\ntrajectory = '{hover}'\nconnect = '{url}'\nlog_dir = '{tmp_path}'\n"
            f"[forward]\nallow = {allow}\n"
        )
        port = free_port()
        station = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", **STATION)
        stations.append(station)
        daemon = program("daemon", "--config", config, "--forward", f"udpout:127.0.0.1:{port}")
        return daemon, station, vehicle

    yield start
    for station in stations:
        station.close()


def receive(station, kind, accept=lambda message: True, timeout=20.0):
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        message = station.recv_match(type=kind, blocking=True, timeout=timeout)
        if message is not None and accept(message):
            return message
    raise AssertionError(f"no {kind}")


def test_a_station_sees_the_vehicle_but_cannot_command_it(forwarding):
    daemon, station, vehicle = forwarding([])
    beat = receive(station, "HEARTBEAT")
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 1)
    receive(station, ["ATTITUDE", "ATTITUDE_QUATERNION", "ODOMETRY"])
    # Its messages are reported, and not forwarded.
    before = dict(vehicle.params)
    station.mav.param_set_send(1, 1, b"MIS_TAKEOFF_ALT", 9.0, 9)
    daemon.says("PARAM_SET from udpout:127.0.0.1:")
    station.mav.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    daemon.says("COMMAND_LONG from udpout:127.0.0.1:")
    station.mav.set_attitude_target_send(0, 1, 1, 0, [1, 0, 0, 0], 0, 0, 0, 1.0)
    daemon.says("SET_ATTITUDE_TARGET from udpout:127.0.0.1:")
    assert vehicle.params == before
    assert not any(command == 400 for command, _, _ in vehicle.commands)
    # The station does not get the daemon's own frames.
    assert station.messages.get("HEARTBEAT").get_srcSystem() == 1


def test_only_allowed_messages_pass(forwarding):
    daemon, station, vehicle = forwarding(["COMMAND_LONG"])
    receive(station, "HEARTBEAT")
    station.mav.param_set_send(1, 1, b"MIS_TAKEOFF_ALT", 9.0, 9)
    daemon.says("PARAM_SET from udpout:127.0.0.1:")
    # MAV_CMD_REQUEST_MESSAGE for a message that nothing else requests.
    station.mav.command_long_send(1, 1, 512, 0, 77, 0, 0, 0, 0, 0, 0)
    end = time.monotonic() + 20.0
    while not any(command == 512 and first == 77 for command, first, _ in vehicle.commands):
        assert time.monotonic() < end, "the command did not arrive"
        station.recv_match(blocking=True, timeout=0.1)
    assert vehicle.params["MIS_TAKEOFF_ALT"] == 2.5


def test_garbage_from_a_station_is_ignored(forwarding):
    daemon, station, vehicle = forwarding(["COMMAND_LONG"])
    receive(station, "HEARTBEAT")
    for size in (1, 7, 280, 1500, 60000):
        station.write(bytes((7 * index + size) % 256 for index in range(size)))
    station.mav.param_set_send(1, 1, b"MIS_TAKEOFF_ALT", 9.0, 9)
    daemon.says("PARAM_SET from udpout:127.0.0.1:")
    receive(station, "HEARTBEAT")


@pytest.mark.parametrize(
    "allow, words",
    [(["HEARTBEET"], "no message is called"), (["SET_ATTITUDE_TARGET"], "only this program may send")],
)
def test_a_list_with_invalid_messages_is_refused(forwarding, allow, words):
    daemon, _, _ = forwarding(allow)
    code, _ = daemon.finish()
    assert code == 2
    assert words in daemon.err
