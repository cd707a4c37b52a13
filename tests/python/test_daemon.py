"""`downwash daemon`: the pilot hands the vehicle over and takes it back."""

import re
import signal
import socket
import time

from conftest import CRAZYFLIE, QUICK, bounds_time, free_port, hover_for, until
from hand_made_vehicle import HOLD, LAND, OFFBOARD
from serial_cable import SerialCable


def configuration(folder, connect, hover):
    path = folder / "daemon.toml"
    path.write_text(
        f"vehicle = '{CRAZYFLIE}'\ntrajectory = '{hover}'\nconnect = '{connect}'\nlog_dir = '{folder}'\n"
    )
    return path


def streamed(vehicle, since):
    return [stamp for stamp, _ in vehicle.setpoints if stamp > since]


@bounds_time
def test_two_flights_and_a_takeover(program, hover, hand_made, tmp_path):
    vehicle, url = hand_made
    daemon = program("daemon", "--config", configuration(tmp_path, url, hover))

    # While the vehicle is on the ground it streams, and sends no command.
    line = daemon.says(" standby: ")
    until(lambda: len(vehicle.setpoints) > 20, "a streamed hold")
    assert not any(command in (176, 400) for command, _, _ in vehicle.commands)
    assert not list(tmp_path.glob("*.mcap"))

    # The pilot engages and arms: the daemon flies the trajectory and lands.
    vehicle.set_mode(OFFBOARD)
    line = daemon.says(" arm: ", line)
    vehicle.armed = True
    line = daemon.says(" track: ", line)
    line = daemon.says(" done: ", line)
    assert not vehicle.armed and 0.6 < vehicle.highest < 1.2
    line = daemon.says(" standby: ", line)

    # In a second flight the pilot takes over, and the stream ends at once.
    vehicle.highest = 0.0
    vehicle.set_mode(OFFBOARD)
    line = daemon.says(" arm: ", line)
    vehicle.armed = True
    until(lambda: vehicle.highest > 0.5, "in the air again")
    vehicle.set_mode(HOLD)
    taken = time.monotonic()
    line = daemon.says(" pilot_control: ", line)
    daemon.says(" standby: ", line)
    until(lambda: streamed(vehicle, taken + 0.2), "streams again")
    assert streamed(vehicle, taken + 0.2)[0] - taken >= 1.0
    assert vehicle.mode == HOLD
    assert len(list(tmp_path.glob("*.mcap"))) == 2

    started = time.monotonic()
    daemon.signal(signal.SIGTERM)
    assert daemon.finish(5)[0] == 0
    assert time.monotonic() - started < 5


def test_no_setpoints_after_a_start_in_offboard(program, hover, hand_made, tmp_path):
    vehicle, url = hand_made
    vehicle.set_mode(OFFBOARD)
    daemon = program("daemon", "--config", configuration(tmp_path, url, hover))
    daemon.says(" await_release: ")
    daemon.says("receiving")
    # Another second of heartbeats in OFFBOARD.
    beats = vehicle.beats
    until(lambda: vehicle.beats >= beats + 2, "heartbeats")
    assert not vehicle.setpoints
    vehicle.set_mode(HOLD)
    other = time.monotonic()
    until(lambda: vehicle.setpoints, "streams after another mode")
    assert vehicle.setpoints[0][0] - other >= 1.0


def test_sigterm_in_flight_lands_before_exit(program, hover, hand_made, tmp_path):
    vehicle, url = hand_made
    daemon = program("daemon", "--config", configuration(tmp_path, url, hover))
    line = daemon.says(" standby: ")
    vehicle.set_mode(OFFBOARD)
    daemon.says(" arm: ", line)
    vehicle.armed = True
    until(lambda: vehicle.highest > 0.5, "in the air")
    daemon.signal(signal.SIGTERM)
    assert daemon.finish(20)[0] == 0, daemon.err
    assert vehicle.mode == LAND and not vehicle.armed


@bounds_time
def test_systemd_notifications(program, hover, hand_made, tmp_path):
    _, url = hand_made
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(path))
        manager.settimeout(10)
        environment = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "2000000"}
        config = configuration(tmp_path, url, hover)
        daemon = program("daemon", "--config", config, settings=QUICK | environment)
        assert b"READY=1" in manager.recv(1024)
        beats = []
        while len(beats) < 3:
            if b"WATCHDOG=1" in manager.recv(1024):
                beats.append(time.monotonic())
        assert beats[-1] - beats[0] < 2.0
        daemon.signal(signal.SIGTERM)
        assert daemon.finish(5)[0] == 0
        received = b""
        while b"STOPPING=1" not in received:
            received += manager.recv(1024)


@bounds_time
def test_unplugging_the_serial_line_in_flight(program, hover, crazyflie, mavlink_client, tmp_path):
    # Finds SET_ATTITUDE_TARGET frames in the daemon's bytes by their header: v2, system 254, component 191, id 82.
    setpoints = []

    def watch(end, data):
        if end == 1:
            found = re.findall(rb"\xfd....\xfe\xbf\x52\x00\x00", data, re.DOTALL)
            setpoints.extend([time.monotonic()] * len(found))

    cable = SerialCable(tmp_path, watch)
    try:
        vehicle = crazyflie("udpin:127.0.0.1:0", cable.url(0))
        hover.write_text(hover_for(60))
        daemon = program("daemon", "--config", configuration(tmp_path, cable.url(1), hover))
        line = daemon.says(" standby: ")
        until(lambda: setpoints, "a streamed hold")
        pilot = mavlink_client(vehicle.peer_url())
        assert pilot.set_mode(6) == 0
        line = daemon.says(" arm: ", line)
        assert pilot.arm() == 0
        line = daemon.says(" track: ", line)

        cable.pull(1)
        pulled = time.monotonic()
        line = daemon.says("link closed", line)
        before = daemon.cpu_s()
        # Offboard loss: the last setpoint is kept for COM_OF_LOSS_T, then the vehicle lands.
        pilot.wait_mode(4, 6)
        lost_s = time.monotonic() - pulled
        assert daemon.cpu_s() - before < 0.25 * lost_s, "the daemon spins while unplugged"

        # Plugged in again while OFFBOARD is still the vehicle's intended mode: no setpoints.
        cable.plug(1)
        plugged = time.monotonic()
        line = daemon.says("link open", line, timeout=10)
        pilot.wait("HEARTBEAT", lambda beat: not beat.base_mode & 128, timeout=25)
        assert pilot.wait("CURRENT_MODE").intended_custom_mode == OFFBOARD
        assert not [stamp for stamp in setpoints if stamp > plugged]
        assert pilot.set_mode(4, 3) == 0
        # Another mode lets the daemon stream again.
        daemon.says(" standby: ", line)
        until(lambda: setpoints[-1] > plugged, "streams again")
        assert pilot.wait("HEARTBEAT").custom_mode != OFFBOARD
        daemon.signal(signal.SIGTERM)
        assert daemon.finish(5)[0] == 0
    finally:
        cable.close()


def test_a_vehicle_that_starts_later_and_restarts(program, hover, crazyflie, tmp_path):
    """Until the vehicle starts, the network refuses the daemon's packets; the daemon keeps sending."""
    url = f"udpin:127.0.0.1:{free_port()}"
    daemon = program("daemon", "--config", configuration(tmp_path, url.replace("udpin", "udpout"), hover))
    daemon.says("link open")
    vehicle = crazyflie(url)
    line = daemon.says(" standby: ")
    vehicle.stop()
    line = daemon.says(" connect: ", line)
    crazyflie(url)
    daemon.says(" standby: ", line)
    assert daemon.cpu_s() < 5
    assert "panicked" not in daemon.err
