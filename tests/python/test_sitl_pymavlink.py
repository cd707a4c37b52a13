"""pymavlink as a client of the vehicle, with MAVLink 1 and 2, over UDP, TCP and a serial line."""

import os
import pty
import signal
import struct
import subprocess
import threading
import time

import pytest
from conftest import Sitl, bounds_time, sitl_command

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
AUTO, POSCTL, OFFBOARD = 4, 3, 6
TAKEOFF, HOLD, LAND = 2, 3, 6
ARM_DISARM, NAV_LAND, NAV_TAKEOFF, SET_INTERVAL, REQUEST_MESSAGE = 400, 21, 22, 511, 512


def as_int(value):
    """A parameter's integer, from PX4's byte cast."""
    return struct.unpack("<i", struct.pack("<f", value))[0]


def as_float(value):
    return struct.unpack("<f", struct.pack("<i", value))[0]


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("link", ["udpin:127.0.0.1:0", "tcpin:127.0.0.1:0"])
def test_a_pymavlink_flight(sitl, mavlink_client, version, link):
    """Arm, take off, fly in OFFBOARD, land, disarm."""
    speed = 8
    vehicle = sitl(link, speed=speed)
    gcs = mavlink_client(vehicle.peer_url(), version=version)
    beat = gcs.wait("HEARTBEAT")
    assert (beat.autopilot, beat.type, beat.get_srcSystem()) == (12, 2, 1)
    assert beat.custom_mode == HOLD << 24 | AUTO << 16
    assert gcs.arm() == ACCEPTED
    gcs.wait("HEARTBEAT", lambda beat: beat.base_mode & 128)
    assert gcs.command(NAV_TAKEOFF) == ACCEPTED
    gcs.wait_mode(AUTO, HOLD)
    gcs.wait("LOCAL_POSITION_NED", lambda at: abs(at.z + 2.5) < 0.3)

    stream = lambda: gcs.setpoint(roll=0.1)
    gcs.wait("ATTITUDE_TARGET", lambda echo: abs(echo.q[1] - 0.05) > 1e-3, between=stream)
    gcs.link.mav.command_long_send(1, 1, 176, 0, 1, OFFBOARD, 0, 0, 0, 0, 0)
    gcs.wait("COMMAND_ACK", lambda ack: ack.result == ACCEPTED, between=stream)
    gcs.wait("ATTITUDE", lambda at: abs(at.roll - 0.1) < 0.02, between=stream)
    gcs.wait("ATTITUDE_TARGET", lambda echo: abs(echo.q[1] - 0.05) < 1e-3, between=stream)

    # The stream stops: after COM_OF_LOSS_T the vehicle lands and disarms by itself.
    gcs.wait_mode(AUTO, LAND)
    gcs.wait("HEARTBEAT", lambda beat: not beat.base_mode & 128, timeout=20)
    gcs.wait("EXTENDED_SYS_STATE", lambda state: state.landed_state == 1)
    if version == 1:
        assert all(msg.get_msgId() < 256 for msg in gcs.link.messages.values() if hasattr(msg, "get_msgId"))


@pytest.mark.parametrize("version", [1, 2])
def test_refused_commands(sitl, mavlink_client, version):
    gcs = mavlink_client(sitl(speed=4).peer_url(), version=version)
    assert gcs.set_mode(OFFBOARD) == ACCEPTED, "any mode may be chosen while disarmed"
    assert gcs.arm() == REJECTED
    assert "no offboard signal" in gcs.texts("Arming denied")
    assert gcs.set_mode(1) == DENIED, "MANUAL"
    assert gcs.command(31010) == UNSUPPORTED
    assert gcs.command(SET_INTERVAL, 0, 10000) == FAILED, "HEARTBEAT"

    assert gcs.set_mode(AUTO, HOLD) == ACCEPTED
    assert gcs.arm() == ACCEPTED
    assert gcs.command(NAV_TAKEOFF) == ACCEPTED
    gcs.wait_mode(AUTO, HOLD)
    assert gcs.command(ARM_DISARM, 0) == REJECTED, "in the air"
    assert gcs.set_mode(OFFBOARD) == REJECTED, "no stream"
    assert gcs.command(ARM_DISARM, 0, 21196) == ACCEPTED


@pytest.mark.parametrize("version", [1, 2])
def test_parameter_protocol(sitl, mavlink_client, version):
    gcs = mavlink_client(sitl().peer_url(), version=version)
    action = gcs.parameter("COM_OBL_RC_ACT")
    assert (action.param_type, as_int(action.param_value)) == (6, 4)
    gcs.link.mav.param_set_send(1, 1, b"COM_OBL_RC_ACT", as_float(5), 6)
    gcs.wait("PARAM_VALUE", lambda v: v.param_id == "COM_OBL_RC_ACT" and as_int(v.param_value) == 5)
    loss = gcs.parameter("COM_OF_LOSS_T")
    assert (loss.param_type, loss.param_value) == (9, 1.0)
    gcs.link.mav.param_set_send(1, 1, b"COM_OF_LOSS_T", float("nan"), 9)
    assert "out of range" in gcs.texts("COM_OF_LOSS_T")
    assert gcs.parameter("COM_OF_LOSS_T").param_value == 1.0
    assert gcs.parameter("MPC_THR_HOVER").param_value == pytest.approx(0.4905)
    assert gcs.parameter("DW_PD_RATE").param_value == 250.0

    gcs.link.mav.param_request_list_send(1, 1)
    names = {}
    count = gcs.wait("PARAM_VALUE").param_count
    while len(names) < count - 1:
        value = gcs.wait("PARAM_VALUE")
        names[value.param_index] = value.param_id
    assert "MIS_TAKEOFF_ALT" in names.values()


@bounds_time
def test_message_intervals_are_met(sitl, mavlink_client):
    gcs = mavlink_client(sitl().peer_url())
    requested = {"ATTITUDE_QUATERNION": (31, 250), "HIGHRES_IMU": (105, 250), "ODOMETRY": (331, 100)}
    for number, rate in requested.values():
        assert gcs.command(SET_INTERVAL, number, 1e6 / rate) == ACCEPTED
    assert gcs.command(SET_INTERVAL, 30, -1) == ACCEPTED
    counts, first, last = {}, {}, {}
    end = time.monotonic() + 2.0
    while time.monotonic() < end:
        message = gcs.link.recv_match(blocking=True, timeout=0.1)
        if message is None:
            continue
        name = message.get_type()
        counts[name] = counts.get(name, 0) + 1
        stamp = getattr(message, "time_usec", 1000 * getattr(message, "time_boot_ms", 0))
        first.setdefault(name, stamp)
        last[name] = stamp
    for name, (_, rate) in requested.items():
        got = (counts[name] - 1) / (last[name] - first[name]) * 1e6
        assert got == pytest.approx(rate, rel=0.02), name
    assert counts.get("ATTITUDE", 0) <= 1


def test_mode_version_and_timesync_replies(sitl, mavlink_client):
    gcs = mavlink_client(sitl().peer_url())
    assert gcs.wait("CURRENT_MODE", timeout=3).intended_custom_mode == HOLD << 24 | AUTO << 16
    gcs.link.mav.command_long_send(1, 1, REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
    version = gcs.wait("AUTOPILOT_VERSION")
    assert (version.vendor_id, version.product_id) == (0x4457, 1)
    gcs.link.mav.timesync_send(0, 123456789)
    answer = gcs.wait("TIMESYNC", lambda sync: sync.tc1 != 0)
    assert answer.ts1 == 123456789


def test_several_peers_over_several_links(sitl, mavlink_client):
    vehicle = sitl("udpin:127.0.0.1:0", "tcpin:127.0.0.1:0", speed=4)
    peers = [
        mavlink_client(vehicle.peer_url(0), system=255),
        mavlink_client(vehicle.peer_url(0), system=254),
        mavlink_client(vehicle.peer_url(1), system=253),
        mavlink_client(vehicle.peer_url(1), system=252),
    ]
    for peer in peers:
        assert peer.command(REQUEST_MESSAGE, 148) == ACCEPTED
    # One stops its stream; the others keep theirs.
    assert peers[0].command(SET_INTERVAL, 30, -1) == ACCEPTED
    peers[1].wait("ATTITUDE")
    # A mode that one peer selects reaches all peers at once.
    assert peers[2].set_mode(POSCTL) == ACCEPTED
    for peer in peers:
        peer.wait("CURRENT_MODE", lambda mode: mode.custom_mode == POSCTL << 16, timeout=3)
    # A client that disconnects does not affect the others.
    peers[3].close()
    assert peers[2].arm() == ACCEPTED
    assert peers[0].command(ARM_DISARM, 0) == ACCEPTED


def test_the_pilot_takes_over(sitl, mavlink_client):
    vehicle = sitl(speed=4)
    daemon, pilot = mavlink_client(vehicle.peer_url(), system=250), mavlink_client(vehicle.peer_url())
    assert pilot.arm() == ACCEPTED
    assert pilot.command(NAV_TAKEOFF) == ACCEPTED
    pilot.wait_mode(AUTO, HOLD)
    daemon.setpoint()
    daemon.link.mav.command_long_send(1, 1, 176, 0, 1, OFFBOARD, 0, 0, 0, 0, 0)
    word = OFFBOARD << 16
    daemon.wait("CURRENT_MODE", lambda m: m.custom_mode == word, between=daemon.setpoint)
    pilot.link.mav.command_long_send(1, 1, 176, 0, 1, POSCTL, 0, 0, 0, 0, 0)
    word = POSCTL << 16
    daemon.wait("CURRENT_MODE", lambda m: m.custom_mode == word, between=daemon.setpoint)
    daemon.wait_mode(POSCTL, between=daemon.setpoint)


def test_a_serial_line(sitl, mavlink_client):
    """The vehicle at one end of a pseudo-terminal, pymavlink's bytes at the other."""
    ours, theirs = pty.openpty()
    name = os.ttyname(theirs)
    sitl(f"serial:{name}:57600")
    from pymavlink.dialects.v20 import common

    received = bytearray()
    parser = common.MAVLink(None)
    got = threading.Event()

    def read():
        while not got.is_set():
            try:
                received.extend(os.read(ours, 4096))
            except OSError:
                return
            for message in parser.parse_buffer(bytes(received)) or []:
                if message.get_type() == "AUTOPILOT_VERSION":
                    got.set()
            received.clear()

    parser.robust_parsing = True
    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    sender = common.MAVLink(None, srcSystem=255, srcComponent=190)
    request = common.MAVLink_command_long_message(1, 1, REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
    os.write(ours, request.pack(sender))
    assert got.wait(5), "an answer through the pseudo-terminal"
    thread.join(5)
    os.close(theirs)


def test_a_busy_port_is_an_error(sitl, vehicle_file):
    port = sitl("tcpin:127.0.0.1:0").port()
    command = sitl_command() + ["--vehicle", str(vehicle_file), "--link", f"tcpin:127.0.0.1:{port}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=10)
    assert done.returncode == 3
    assert f"tcpin:127.0.0.1:{port}" in done.stderr and "in use" in done.stderr


@pytest.mark.parametrize(
    "options, words",
    [
        (["--link", "udp:127.0.0.1:14540"], "udpin"),
        (["--speed", "0"], "0.01 to 1000"),
        (["--vehicle", "/nonexistent.toml"], "/nonexistent.toml"),
        (["--effect", "no_such_effect:a=1"], "no_such_effect"),
        (["--effect", "mass:mass_kg=-1"], "mass_kg"),
        (["--mocap-fault", "swap@8"], "--mocap <HOST:PORT>"),
        (["--mocap-rate", "50"], "--mocap <HOST:PORT>"),
        (["--mocap", "127.0.0.1:1", "--mocap-x-heading", "nan"], "--mocap-x-heading"),
    ],
)
def test_invalid_options_are_explained(vehicle_file, options, words):
    command = sitl_command()
    if "--vehicle" not in options:
        command += ["--vehicle", str(vehicle_file)]
    done = subprocess.run(command + options, capture_output=True, text=True, timeout=10)
    assert done.returncode == 2
    assert words in done.stderr


def test_sigterm_ends_cleanly(vehicle_file):
    vehicle = Sitl(vehicle_file, ["udpin:127.0.0.1:0"])
    assert vehicle.stop(signal.SIGTERM) == 0
