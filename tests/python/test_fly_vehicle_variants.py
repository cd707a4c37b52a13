"""Vehicles that differ: clock drift, MAVLink 1, two at once, other types; and the reports while `downwash` waits."""

import json
import re
import socket
import time

import pytest

from mcap.reader import make_reader

from conftest import ROOT, SHORT_HOVER, bounds_time, fly_arguments, free_port, hover_for, only_log
from vehicle_variants import VehicleVariant


@pytest.fixture
def flight(tmp_path, program):
    """Starts a vehicle for each set of traits, and `downwash fly` on them."""
    vehicles = []

    def start(*traits, trajectory=SHORT_HOVER, options=()):
        port = free_port()
        url = f"udpin:127.0.0.1:{port}"
        file = tmp_path / "hover.toml"
        file.write_text(trajectory)
        for number, these in enumerate(traits):
            vehicles.append(VehicleVariant(f"udpout:127.0.0.1:{port}", **these))
        return vehicles, program(*fly_arguments(file, url, tmp_path, "--json", *options))

    yield start
    for vehicle in vehicles:
        vehicle.stop()


@pytest.mark.parametrize(
    "rate, answers",
    [
        (0.95, True),
        (1.03, False),
        pytest.param(0.95, False, marks=pytest.mark.long),
        pytest.param(1.03, True, marks=pytest.mark.long),
    ],
)
def test_a_vehicle_with_a_drifting_clock_is_flown(flight, rate, answers):
    _, daemon = flight({"clock_rate": rate, "answers_timesync": answers}, trajectory=hover_for(12))
    code, _ = daemon.finish(90)
    assert code == 0, daemon.err


def test_a_clock_stall_on_the_ground_is_tolerated(flight):
    (vehicle,), daemon = flight({"stall": (1.5, 0.43)})
    code, _ = daemon.finish(60)
    assert code == 0, daemon.err


def supported():
    """The rows of the table of supported autopilots in docs/flying.md."""
    text = (ROOT / "docs/flying.md").read_text()
    table = text.split("## Supported autopilots")[1].split("\n## ")[0]
    rows = [line.strip("|").split("|") for line in table.splitlines() if re.match(r"\| (PX4|ArduCopter)", line)]
    return [tuple(cell.strip() for cell in row)[:4] for row in rows]


@pytest.mark.parametrize("name, protocol, mode_from, state_from", supported())
def test_supported_autopilots_are_flown(flight, tmp_path, name, protocol, mode_from, state_from):
    autopilot = 3 if name.startswith("ArduCopter") else 12
    traits = {"mavlink": int(protocol), "mode_from": mode_from, "state_from": state_from, "autopilot": autopilot}
    (vehicle,), daemon = flight(traits)
    code, out = daemon.finish(60)
    assert code == 0, daemon.err
    assert json.loads(out)["schema"] == "downwash.fly"
    # Attitude and rates together are unsafe on a real PX4: only attitude and thrust may be sent.
    assert vehicle.masks == {0x07}
    assert 0.6 < vehicle.highest < 1.2
    assert not vehicle.armed and vehicle.position[2] == 0.0
    with only_log(tmp_path).open("rb") as file:
        topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    assert {"/state", "/setpoint", "/reference", "/mavlink/rx", "/mavlink/tx"} <= topics
    is_reported = "sends no CURRENT_MODE" in daemon.err
    assert is_reported == (mode_from == "HEARTBEAT" and autopilot == 12), daemon.err


def test_the_table_of_supported_autopilots_is_not_empty():
    assert len(supported()) >= 4


def test_two_vehicles_are_refused_until_one_is_chosen(flight):
    (second, first), daemon = flight({"system": 2}, {"system": 1})
    started = time.monotonic()
    code, _ = daemon.finish(30)
    assert code == 4, daemon.err
    assert time.monotonic() - started < 10
    assert "system 2" in daemon.err and "system 1" in daemon.err and "--system" in daemon.err
    assert not (first.setpoints or second.setpoints or first.highest or second.highest)


def test_a_chosen_vehicle_is_flown_beside_another(flight):
    (second, first), daemon = flight({"system": 2}, {"system": 1}, options=["--system", "1"])
    code, _ = daemon.finish(60)
    assert code == 0, daemon.err
    assert first.highest > 0.6 and second.highest == 0.0 and not second.setpoints


def says_within(daemon, words, seconds):
    started = time.monotonic()
    daemon.says(words, timeout=30)
    took = time.monotonic() - started
    assert took < seconds, f"{words!r} after {took:.1f} s:\n{daemon.err}"


@pytest.mark.parametrize(
    "mav_type, autopilot, kind", [(1, 12, "an aeroplane"), (20, 12, "a VTOL"), (4, 3, "a helicopter"), (10, 3, "a rover")]
)
def test_other_vehicle_types_are_refused(flight, mav_type, autopilot, kind):
    (vehicle,), daemon = flight({"mav_type": mav_type, "autopilot": autopilot})
    assert daemon.finish(20)[0] == 4, daemon.err
    assert f"the vehicle is {kind} (MAV_TYPE {mav_type} in its HEARTBEAT)" in daemon.err, daemon.err
    assert not vehicle.setpoints and not vehicle.armed


@bounds_time
def test_an_unsupported_frame_is_named(flight):
    _, daemon = flight({"frame": 20})
    says_within(daemon, "MAV_FRAME_LOCAL_FRD", 5.0)
    says_within(daemon, "have the vehicle send", 5.0)


@bounds_time
def test_a_silent_port_is_reported_with_its_address(flight):
    _, daemon = flight()
    says_within(daemon, "0 bytes received on udpin:127.0.0.1:", 4.0)


@bounds_time
def test_bytes_other_than_mavlink_are_reported(flight):
    _, daemon = flight()
    port = int(daemon.process.args[daemon.process.args.index("--connect") + 1].rsplit(":", 1)[1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as noise:
        for _ in range(60):
            noise.sendto(b"garbage", ("127.0.0.1", port))
            time.sleep(0.05)
    says_within(daemon, "none of them MAVLink", 4.0)


@bounds_time
def test_a_low_battery_is_reported_at_once(flight):
    _, daemon = flight({"battery": 12})
    says_within(daemon, "waiting: battery: expected at least 30 %, found 12 %", 6.0)


@bounds_time
def test_a_wrong_parameter_is_reported_at_once(flight):
    (vehicle,), daemon = flight({"autopilot": 3, "mode_from": "HEARTBEAT", "state_from": "attitude and position"})
    vehicle.params["GUID_OPTIONS"] = 0.0
    says_within(daemon, "waiting: parameter GUID_OPTIONS", 6.0)


def test_check_sends_no_mode_arming_or_setpoints(flight):
    (vehicle,), daemon = flight({}, options=["--check"])
    code, out = daemon.finish(30)
    assert code == 0, daemon.err
    assert json.loads(out)["schema"] == "downwash.check"
    assert not vehicle.setpoints and not [c for c in vehicle.commands if c[0] in (176, 400)]


def test_a_failed_check_gives_the_reason(flight):
    (vehicle,), daemon = flight({"battery": 12}, options=["--check"])
    code, _ = daemon.finish(30)
    assert code == 4 and "battery" in daemon.err, daemon.err
    assert not vehicle.setpoints


def test_a_signing_vehicle_is_reported(flight):
    (vehicle,), daemon = flight({})
    vehicle.link.setup_signing(b"s" * 32, sign_outgoing=True)
    vehicle.link.mav.signing.allow_unsigned_callback = lambda *_: False
    daemon.says("signs its messages", timeout=20)
    daemon.says("waiting: signing: expected none on this link, or its key in link.signing, found signed messages, and no answer", timeout=20)
