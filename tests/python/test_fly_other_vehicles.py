"""Vehicles that differ: clock drift, MAVLink 1, two at once, other types; and the reports while `downwash` waits."""

import json
import math
import re
import socket
import time

import pytest

from conftest import CRAZYFLIE, ROOT, SHORT_HOVER, bounds_time, free_port
from hand_made_vehicle import HOLD, LAND, OFFBOARD, HandMadeVehicle

LONG_HOVER = "family = 'hover'\naltitude_m = 0.8\nduration_s = 12.0\n"
COPTER_MODES = {HOLD: 17, LAND: 9, OFFBOARD: 4}


class Vehicle(HandMadeVehicle):
    """The hand-made vehicle with other traits, which hold from its first message."""

    def __init__(self, url, system=1, **traits):
        # Rate of its clock over real time; and when the clock stalls and for how long, in s.
        self.clock_rate = traits.pop("clock_rate", 1.0)
        self.stall = traits.pop("stall", (math.inf, 0.0))
        self.answers_timesync = traits.pop("answers_timesync", True)
        self.mode_from = traits.pop("mode_from", "CURRENT_MODE")
        self.state_from = traits.pop("state_from", "ODOMETRY")
        self.mavlink = traits.pop("mavlink", 2)
        self.autopilot = traits.pop("autopilot", 12)
        self.frame = traits.pop("frame", None)
        self.battery = traits.pop("battery", None)
        self.mav_type = traits.pop("mav_type", 2)
        assert not traits
        super().__init__(url)
        self.link.mav.srcSystem = system
        if self.autopilot == 3:
            self.params = {"GUID_OPTIONS": 8.0, "ATC_ANGLE_BOOST": 0.0, "GUID_TIMEOUT": 0.2, "FS_GCS_ENABLE": 5.0}
            self.params |= {"FS_GCS_TIMEOUT": 5.0, "SYSID_MYGCS": 254.0}
        if self.mavlink == 1:
            send = self.link.mav.send
            self.link.mav.send = lambda message, force_mavlink1=False: send(message, force_mavlink1=True)

    def _ns(self):
        elapsed = time.monotonic() - self._start
        at, lost = self.stall
        elapsed -= lost if elapsed > at + lost else max(0.0, elapsed - at)
        return int((5.0 + elapsed * self.clock_rate) * 1e9)

    def _custom_mode(self):
        return COPTER_MODES.get(self.mode, 0) if self.autopilot == 3 else self.mode

    def _send_heartbeat(self):
        base = 1 | (128 if self.armed else 0)
        self.link.mav.heartbeat_send(self.mav_type, self.autopilot, base, self._custom_mode(), 4 if self.armed else 3)
        if self.battery is not None:
            cells = [3700] + [65535] * 9
            self.link.mav.battery_status_send(0, 0, 1, 32767, cells, -1, -1, -1, self.battery)

    def _send_mode(self):
        if self.mode_from == "CURRENT_MODE":
            super()._send_mode()
        elif hasattr(self, "_stop"):
            self._send_heartbeat()

    def _handle(self, message):
        if message.get_type() == "TIMESYNC" and not self.answers_timesync:
            return
        if message.get_type() == "PARAM_REQUEST_READ" and self.autopilot == 3:
            name = message.param_id
            if name in self.params:
                self.link.mav.param_value_send(name.encode(), self.params[name], 9, len(self.params), 0)
            return
        super()._handle(message)

    def _command(self, message):
        if message.command == 176 and self.autopilot == 3:
            internal = {word: mode for mode, word in COPTER_MODES.items()}
            mode = internal[int(message.param2)]
            message.param2, message.param3 = mode >> 16 & 0xFF, mode >> 24
        super()._command(message)

    def _send_odometry(self):
        if self.frame is not None:
            unknown = [math.nan] * 21
            self.link.mav.odometry_send(
                self._ns() // 1000, self.frame, 12, *self.position, [1, 0, 0, 0], *self.velocity, 0, 0, 0, unknown, unknown, 0, 8, 100
            )
        elif self.state_from == "ODOMETRY":
            super()._send_odometry()
        else:
            roll, pitch, yaw = self.attitude
            ms = self._ns() // 1_000_000
            self.link.mav.attitude_send(ms, roll, pitch, yaw, 0.0, 0.0, 0.0)
            self.link.mav.local_position_ned_send(ms, *self.position, *self.velocity)


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
            vehicles.append(Vehicle(f"udpout:127.0.0.1:{port}", **these))
        daemon = program(
            "fly", file, "--connect", url, "--vehicle", CRAZYFLIE, "--log-dir", tmp_path, "--json", *options
        )
        return vehicles, daemon

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
    _, daemon = flight({"clock_rate": rate, "answers_timesync": answers}, trajectory=LONG_HOVER)
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
def test_supported_autopilots_are_flown(flight, name, protocol, mode_from, state_from):
    autopilot = 3 if name.startswith("ArduCopter") else 12
    traits = {"mavlink": int(protocol), "mode_from": mode_from, "state_from": state_from, "autopilot": autopilot}
    (vehicle,), daemon = flight(traits)
    code, _ = daemon.finish(60)
    assert code == 0, daemon.err
    assert 0.6 < vehicle.highest < 1.2
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


class TestDoctor:
    def listen(self, program, traits, command="doctor", seconds="4"):
        port = free_port()
        vehicle = Vehicle(f"udpout:127.0.0.1:{port}", **traits)
        url = f"udpin:127.0.0.1:{port}"
        try:
            running = program(command, "--connect", url, "--json", "--seconds", seconds)
            code, out = running.finish(30)
        finally:
            vehicle.stop()
        changed = [c for c in vehicle.commands if c[0] not in (512,)]
        assert not changed and not vehicle.setpoints, "it requests messages and commands nothing"
        return code, json.loads(out), running.err

    def test_a_flyable_vehicle(self, program):
        code, answer, err = self.listen(program, {"clock_rate": 0.95}, seconds="8")
        assert code == 0, (answer["findings"], err)
        report = answer["report"]
        assert answer["verdict"] == "can be flown"
        assert 80 < report["odometry_hz"] < 110
        assert abs(report["clock_skew"] + 0.05) < 0.02
        assert report["odometry_frames"] == ["MAV_FRAME_LOCAL_NED, child MAV_FRAME_LOCAL_NED"]
        assert report["parameters"]["COM_OF_LOSS_T"] == 1.0
        assert {finding["subject"] for finding in answer["findings"]} >= {"parameter COM_OF_LOSS_T", "clock"}

    def test_findings_that_refuse_the_flight(self, program):
        traits = {"autopilot": 3, "mode_from": "HEARTBEAT", "state_from": "attitude and position", "battery": 5}
        port = free_port()
        vehicle = Vehicle(f"udpout:127.0.0.1:{port}", **traits)
        vehicle.params["GUID_OPTIONS"] = 0.0
        try:
            running = program("doctor", "--connect", f"udpin:127.0.0.1:{port}", "--json", "--seconds", "4")
            code, out = running.finish(30)
        finally:
            vehicle.stop()
        refused = {f["subject"] for f in json.loads(out)["findings"] if f["weight"] == "refuses"}
        assert code == 4 and refused == {"parameter GUID_OPTIONS", "battery"}

    def test_no_vehicle_on_the_link(self, program):
        running = program("doctor", "--connect", f"udpin:127.0.0.1:{free_port()}", "--seconds", "1")
        code, out = running.finish(30)
        assert code == 3 and "0 bytes received" in out
        assert "listening on udpin" in running.err

    def test_inspect_reports_message_rates(self, program):
        code, answer, _ = self.listen(program, {}, "inspect", "3")
        assert code == 0
        rows = {row["name"]: row for row in answer["messages"]}
        assert 80 < rows["ODOMETRY"]["rate_hz"] < 110
        assert rows["HEARTBEAT"]["system"] == 1 and "mavtype" in rows["HEARTBEAT"]["value"]
