"""The simulated vehicle as PX4 and as ArduCopter, over MAVLink."""

import struct
import time

import pytest
from conftest import Sitl

ACCEPTED, REJECTED, DENIED = 0, 1, 2
ARM_DISARM, SET_MODE, SET_INTERVAL, REQUEST_MESSAGE = 400, 176, 511, 512
PX4, ARDUPILOT = 12, 3


@pytest.fixture
def autopilot(vehicle_file, tmp_path):
    """Starts a vehicle with options; it must end cleanly."""
    running = []

    def start(*options, config=None):
        options = list(options)
        if config is not None:
            path = tmp_path / "sitl.toml"
            path.write_text(config)
            options += ["--config", str(path)]
        running.append(Sitl(vehicle_file, ("udpin:127.0.0.1:0",), options))
        return running[-1]

    yield start
    assert all(vehicle.stop() == 130 for vehicle in running)


def answers(gcs, number, *params):
    """Every result of a command within half a second, and the texts that arrive in that time."""
    params = list(params) + [0.0] * (7 - len(params))
    gcs.link.mav.command_long_send(1, 1, number, 0, *params)
    results, texts, end = [], "", time.monotonic() + 0.5
    while time.monotonic() < end:
        message = gcs.link.recv_match(type=["COMMAND_ACK", "STATUSTEXT"], blocking=True, timeout=0.1)
        if message is not None and message.get_type() == "STATUSTEXT":
            texts += message.text
        elif message is not None and message.command == number:
            results.append(message.result)
    return results, texts


def test_px4_behaviour(autopilot, mavlink_client):
    gcs = mavlink_client(autopilot("--autopilot", "px4").peer_url())
    assert gcs.wait("HEARTBEAT").autopilot == PX4
    gcs.link.mav.command_long_send(1, 1, REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
    version = gcs.wait("AUTOPILOT_VERSION")
    assert (version.vendor_id, version.product_id) == (0, 0)
    value = gcs.parameter("NAV_RCL_ACT").param_value
    assert struct.unpack("<i", struct.pack("<f", value)) == (2,), "byte cast"
    assert gcs.parameter("MC_ROLL_P").param_value == pytest.approx(8.0)
    # Disarmed, any mode is accepted; arming then needs setpoints.
    assert answers(gcs, SET_MODE, 1, 6)[0] == [ACCEPTED]
    results, texts = answers(gcs, ARM_DISARM, 1)
    assert results == [REJECTED]
    assert "Arming denied: Resolve system health failures first" in texts
    assert gcs.wait("SERVO_OUTPUT_RAW").servo1_raw == 900


def test_arducopter_behaviour(autopilot, mavlink_client):
    gcs = mavlink_client(autopilot("--autopilot", "arducopter").peer_url())
    heartbeat = gcs.wait("HEARTBEAT")
    assert (heartbeat.autopilot, heartbeat.custom_mode) == (ARDUPILOT, 0)
    assert gcs.parameter("GUID_OPTIONS").param_value == 0.0
    gcs.link.mav.param_set_send(1, 1, b"GUID_OPTIONS", 8.0, gcs.mav.MAV_PARAM_TYPE_REAL32)
    assert gcs.wait("PARAM_VALUE", lambda value: value.param_id == "GUID_OPTIONS").param_value == 8.0
    assert answers(gcs, SET_MODE, 1, 4)[0] == [ACCEPTED], "exactly one answer"
    gcs.wait("HEARTBEAT", lambda beat: beat.custom_mode == 4)
    assert gcs.command(SET_INTERVAL, 331, 10_000) == DENIED, "no ODOMETRY"
    assert gcs.command(SET_INTERVAL, 36, 20_000) == ACCEPTED
    assert gcs.wait("SERVO_OUTPUT_RAW").servo1_raw == 1000
    assert gcs.arm() == ACCEPTED
    gcs.texts("Arming motors")


def test_timesync_shows_clock_drift(autopilot, mavlink_client):
    gcs = mavlink_client(autopilot(config="autopilot = 'px4'\n[clock]\nrate = 0.9\n").peer_url())

    def vehicle_and_host_ns():
        gcs.link.mav.timesync_send(0, time.monotonic_ns())
        answer = gcs.wait("TIMESYNC", lambda message: message.tc1 != 0)
        return answer.tc1, time.monotonic_ns()

    first = vehicle_and_host_ns()
    # The vehicle's own clock paces the wait: two of its seconds.
    boot_ms = gcs.wait("ATTITUDE").time_boot_ms
    gcs.wait("ATTITUDE", lambda message: message.time_boot_ms > boot_ms + 2000)
    last = vehicle_and_host_ns()
    rate = (last[0] - first[0]) / (last[1] - first[1])
    assert rate == pytest.approx(0.9, abs=0.02)


def test_an_unknown_parameter_is_named(vehicle_file, tmp_path):
    path = tmp_path / "sitl.toml"
    path.write_text("autopilot = 'px4'\n[parameters]\nGUID_OPTIONS = 8\n")
    with pytest.raises(RuntimeError, match="parameters.GUID_OPTIONS"):
        Sitl(vehicle_file, ("udpin:127.0.0.1:0",), ["--config", str(path)])
