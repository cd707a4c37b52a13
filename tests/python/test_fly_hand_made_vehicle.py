"""`downwash fly` on a vehicle that shares no code with the bundled simulator."""

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
    """Starts a vehicle and `downwash fly` on it; yields both and the folder of the log."""
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


def test_px4_is_sent_attitude_and_thrust_only(flight):
    vehicle, daemon, folder = flight
    code, out, err = finish(daemon)
    assert code == 0, err
    # Attitude and rates together are unsafe on a real PX4: only attitude and thrust may be sent.
    assert vehicle.masks == {0x07}
    assert 0.6 < vehicle.highest < 1.2
    assert not vehicle.armed and vehicle.position[2] == 0.0
    assert json.loads(out)["schema"] == "downwash.fly"
    (log,) = folder.glob("*.mcap")
    with log.open("rb") as file:
        topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    assert {"/state", "/setpoint", "/reference", "/mavlink/rx", "/mavlink/tx"} <= topics


def test_arming_refusal_reports_the_vehicles_reason(flight):
    vehicle, daemon, _ = flight
    vehicle.refuse_arming = True
    code, _, err = finish(daemon)
    assert code == 4
    assert "hand-made refusal" in err


@bounds_time
def test_no_setpoints_after_the_pilot_takes_over(flight):
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
def test_setpoints_stop_when_telemetry_stops(flight):
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


def pause_in_flight(vehicle, daemon, pause_s, at=lambda vehicle, since_s: None):
    """Pauses the process once the vehicle is in the air, and calls `at` with the seconds since then. The
    returned list receives the times of the pause and of its end."""
    times = []

    def step(vehicle, _):
        now = time.monotonic()
        if not times and vehicle.armed and vehicle.position[2] < -0.5:
            daemon.send_signal(signal.SIGSTOP)
            times.append(now)
        elif len(times) == 1:
            at(vehicle, now - times[0])
            if now - times[0] >= pause_s:
                times.append(now)
                daemon.send_signal(signal.SIGCONT)

    vehicle.on_step = step
    return times


@bounds_time
def test_a_takeover_during_a_process_pause_is_respected(flight):
    vehicle, daemon, _ = flight

    def take_over(vehicle, since_s):
        if since_s >= 1.0 and vehicle.mode != HOLD:
            vehicle.set_mode(HOLD)
            vehicle.commands.clear()

    times = pause_in_flight(vehicle, daemon, 2.4, take_over)
    code, _, err = finish(daemon)
    assert code == 5 and "the pilot took over" in err, err
    assert vehicle.mode == HOLD
    assert not [command for command in vehicle.commands if command[0] in (176, 400)], vehicle.commands
    assert not [stamp for stamp, _ in vehicle.setpoints if stamp > times[1]]


@bounds_time
def test_a_failsafe_during_a_process_pause_is_respected(flight):
    vehicle, daemon, _ = flight
    returning = 4 << 16 | 5 << 24

    def failsafe(vehicle, since_s):
        if since_s >= 0.3 and vehicle.mode != returning:
            vehicle.link.mav.statustext_send(2, b"Failsafe activated")
            vehicle.set_mode(returning)
            vehicle.commands.clear()

    pause_in_flight(vehicle, daemon, 2.4, failsafe)
    code, _, err = finish(daemon)
    assert code == 5 and "PX4 failsafe: Return; vehicle: Failsafe activated" in err, err
    assert not [command for command in vehicle.commands if command[0] in (176, 400)], vehicle.commands


@bounds_time
@pytest.mark.parametrize("stall_s", [0.07, 0.15])
def test_samples_queued_during_a_short_stall_are_not_answered(flight, stall_s):
    """The stall is too short to invalidate the known mode, and the queued samples look fresh."""
    vehicle, daemon, _ = flight
    times = []

    def step(vehicle, _):
        now = time.monotonic()
        if not times and vehicle.armed and vehicle.position[2] < -0.5:
            daemon.send_signal(signal.SIGSTOP)
            times.append(now)
        elif len(times) == 1 and now - times[0] >= stall_s:
            # For a while only samples from the stall are left to read.
            vehicle.telemetry = False
            times.append(now)
            times.append(len(vehicle.setpoints))
            daemon.send_signal(signal.SIGCONT)
        elif len(times) == 3 and now - times[1] >= 0.2:
            times.append(len(vehicle.setpoints))
            vehicle.telemetry = True

    vehicle.on_step = step
    code, _, err = finish(daemon)
    assert code == 0, err
    assert "this process stalled for" in err, err
    _, _, before, after = times
    assert after == before, f"{after - before} answers to queued samples"
    assert len(vehicle.setpoints) > after + 20, "the flight continues"
