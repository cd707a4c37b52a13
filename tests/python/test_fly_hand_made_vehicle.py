"""`downwash fly` against a vehicle that this project's SITL had no part in."""

import json
import signal
import subprocess
import time

import pytest
from mcap.reader import make_reader

from conftest import DOWNWASH, ROOT, SHORT_HOVER, bounds_time, free_port
from hand_made_vehicle import HOLD, HandMadeVehicle

VEHICLE = ROOT / "config/vehicles/crazyflie.toml"



@pytest.fixture
def flight(tmp_path):
    """Starts a vehicle and `downwash fly` on it; yields both and cleans up."""
    port = free_port()
    trajectory = tmp_path / "hover.toml"
    trajectory.write_text(SHORT_HOVER)
    vehicle = HandMadeVehicle(f"udpout:127.0.0.1:{port}")
    command = [*DOWNWASH, "fly", str(trajectory), "--connect", f"udpin:127.0.0.1:{port}", "--vehicle", str(VEHICLE)]
    command += ["--log-dir", str(tmp_path), "--json"]
    daemon = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    yield vehicle, daemon, tmp_path
    if daemon.poll() is None:
        daemon.kill()
    daemon.wait()
    vehicle.stop()


def finish(daemon, timeout=60):
    out, err = daemon.communicate(timeout=timeout)
    return daemon.returncode, out, err


def test_flies_a_foreign_px4_with_attitude_and_thrust_only(flight):
    vehicle, daemon, folder = flight
    code, out, err = finish(daemon)
    assert code == 0, err
    # Attitude + rates is unsafe on a real PX4: only attitude + thrust may have been sent.
    assert vehicle.masks == {0x07}
    assert 0.6 < vehicle.highest < 1.2
    assert not vehicle.armed and vehicle.position[2] == 0.0
    assert json.loads(out)["schema"] == "downwash.fly"
    (log,) = folder.glob("*.mcap")
    with log.open("rb") as file:
        topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    assert {"/state", "/setpoint", "/reference", "/mavlink/rx", "/mavlink/tx"} <= topics


def test_arming_refusal_is_reported_in_the_vehicles_words(flight):
    vehicle, daemon, _ = flight
    vehicle.refuse_arming = True
    code, _, err = finish(daemon)
    assert code == 4
    assert "hand-made refusal" in err


@bounds_time
def test_pilot_takes_over_and_control_never_comes_back(flight):
    vehicle, daemon, _ = flight
    taken = []

    def take_over(vehicle, _):
        if not taken and vehicle.armed and vehicle.position[2] < -0.5:
            vehicle.set_mode(HOLD)
            taken.append(time.monotonic())

    vehicle.on_step = take_over
    code, _, _ = finish(daemon)
    assert code == 5 and taken
    late = [stamp for stamp, _ in vehicle.setpoints if stamp > taken[0] + 0.2]
    assert not late, f"{len(late)} setpoints after the pilot took over"
    assert vehicle.mode == HOLD


@bounds_time
def test_telemetry_that_stops_ends_the_setpoints(flight):
    vehicle, daemon, _ = flight
    stopped = []

    def go_silent(vehicle, _):
        if not stopped and vehicle.position[2] < -0.5:
            vehicle.telemetry = False
            stopped.append(time.monotonic())

    vehicle.on_step = go_silent
    code, _, err = finish(daemon)
    assert code in (3, 5), err
    late = [stamp for stamp, _ in vehicle.setpoints if stamp > stopped[0] + 0.2]
    assert not late, f"{len(late)} setpoints without telemetry"


def test_interrupt_lands_the_vehicle(flight):
    vehicle, daemon, _ = flight
    deadline = time.monotonic() + 30
    while vehicle.highest < 0.5 and time.monotonic() < deadline and daemon.poll() is None:
        time.sleep(0.05)
    daemon.send_signal(signal.SIGINT)
    code, _, err = finish(daemon)
    assert code == 130, err
    assert not vehicle.armed and vehicle.position[2] == 0.0
