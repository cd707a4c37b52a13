"""`downwash doctor` and `downwash inspect`, which report on a vehicle and command nothing."""

import json
import socket

from conftest import free_port
from vehicle_variants import VehicleVariant


def listen(program, traits, command="doctor", seconds="4", parameters=()):
    """Runs the command on a vehicle with `traits` and `parameters`; returns exit code, JSON output and stderr."""
    port = free_port()
    vehicle = VehicleVariant(f"udpout:127.0.0.1:{port}", **traits)
    vehicle.params |= dict(parameters)
    url = f"udpin:127.0.0.1:{port}"
    try:
        running = program(command, "--connect", url, "--json", "--seconds", seconds)
        code, out = running.finish(30)
    finally:
        vehicle.stop()
    changed = [c for c in vehicle.commands if c[0] not in (512,)]
    assert not changed and not vehicle.setpoints, "it requests messages and commands nothing"
    return code, json.loads(out), running.err


def test_doctor_on_a_flyable_vehicle(program):
    code, answer, err = listen(program, {"clock_rate": 0.95})
    assert code == 0, (answer["findings"], err)
    report = answer["report"]
    assert answer["verdict"] == "can be flown"
    assert 80 < report["odometry_hz"] < 110
    assert abs(report["clock_skew"] + 0.05) < 0.02
    assert report["odometry_frames"] == ["MAV_FRAME_LOCAL_NED, child MAV_FRAME_LOCAL_NED"]
    assert report["parameters"]["COM_OF_LOSS_T"] == 1.0
    assert {finding["subject"] for finding in answer["findings"]} >= {"parameter COM_OF_LOSS_T", "clock"}


def test_doctor_lists_reasons_to_refuse_a_flight(program):
    traits = {"autopilot": 3, "mode_from": "HEARTBEAT", "state_from": "attitude and position", "battery": 5}
    code, answer, _ = listen(program, traits, parameters={"GUID_OPTIONS": 0.0})
    refused = {f["subject"] for f in answer["findings"] if f["weight"] == "refuses"}
    assert code == 4 and refused == {"parameter GUID_OPTIONS", "battery"}


def test_doctor_on_a_silent_link(program):
    running = program("doctor", "--connect", f"udpin:127.0.0.1:{free_port()}", "--seconds", "1")
    code, out = running.finish(30)
    assert code == 3 and "0 bytes received" in out
    assert "listening on udpin" in running.err


def test_doctor_on_a_port_in_use(program):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        url = f"udpin:127.0.0.1:{other.getsockname()[1]}"
        code, out = program("doctor", "--connect", url, "--seconds", "1", "--json").finish(30)
    finding = json.loads(out)["findings"][0]
    assert code == 3 and finding["subject"] == "vehicle"
    assert "the port is in use" in finding["text"] and "bytes received" not in finding["text"]


def test_inspect_refuses_a_listening_time_of_zero(program):
    running = program("inspect", "--connect", f"udpin:127.0.0.1:{free_port()}", "--seconds", "0")
    code, _ = running.finish(30)
    assert code == 2 and "found 0" in running.err


def test_inspect_reports_message_rates(program):
    code, answer, _ = listen(program, {}, "inspect", "3")
    assert code == 0
    rows = {row["name"]: row for row in answer["messages"]}
    assert 80 < rows["ODOMETRY"]["rate_hz"] < 110
    assert rows["HEARTBEAT"]["system"] == 1 and "mavtype" in rows["HEARTBEAT"]["value"]
