"""`downwash fly` on a vehicle that shares no code with the bundled simulator."""

import signal
import time

import pytest

from conftest import bounds_time, fly_arguments
from hand_made_vehicle import HOLD


@pytest.fixture
def flight(program, hover, hand_made, tmp_path):
    """A vehicle, and `downwash fly` on it."""
    vehicle, url = hand_made
    return vehicle, program(*fly_arguments(hover, url, tmp_path))


def test_arming_refusal_reports_the_vehicles_reason(flight):
    vehicle, daemon = flight
    vehicle.refuse_arming = True
    assert daemon.finish()[0] == 4
    assert "hand-made refusal" in daemon.err


@bounds_time
def test_no_setpoints_after_the_pilot_takes_over(flight):
    vehicle, daemon = flight
    taken = []

    def take_over(vehicle, _):
        if not taken and vehicle.armed and vehicle.position[2] < -0.5:
            vehicle.set_mode(HOLD)
            taken.append(time.monotonic())

    vehicle.on_step = take_over
    assert daemon.finish()[0] == 5 and taken
    late = [stamp for stamp, _ in vehicle.setpoints if stamp > taken[0] + 0.2]
    assert not late, f"{len(late)} setpoints after the pilot took over"
    assert vehicle.mode == HOLD


@bounds_time
def test_setpoints_stop_when_telemetry_stops(flight):
    vehicle, daemon = flight
    stopped = []

    def go_silent(vehicle, _):
        if not stopped and vehicle.position[2] < -0.5:
            vehicle.telemetry = False
            stopped.append(time.monotonic())

    vehicle.on_step = go_silent
    assert daemon.finish()[0] in (3, 5), daemon.err
    late = [stamp for stamp, _ in vehicle.setpoints if stamp > stopped[0] + 0.2]
    assert not late, f"{len(late)} setpoints without telemetry"


def pause_in_flight(vehicle, daemon, pause_s, at=lambda vehicle, since_s: None):
    """Pauses the process once the vehicle is in the air, and calls `at` with the seconds since then. The
    returned list receives the times of the pause and of its end."""
    times = []

    def step(vehicle, _):
        now = time.monotonic()
        if not times and vehicle.armed and vehicle.position[2] < -0.5:
            daemon.signal(signal.SIGSTOP)
            times.append(now)
        elif len(times) == 1:
            at(vehicle, now - times[0])
            if now - times[0] >= pause_s:
                times.append(now)
                daemon.signal(signal.SIGCONT)

    vehicle.on_step = step
    return times


@bounds_time
def test_a_takeover_during_a_process_pause_is_respected(flight):
    vehicle, daemon = flight

    def take_over(vehicle, since_s):
        if since_s >= 1.0 and vehicle.mode != HOLD:
            vehicle.set_mode(HOLD)
            vehicle.commands.clear()

    times = pause_in_flight(vehicle, daemon, 2.4, take_over)
    assert daemon.finish()[0] == 5 and "the pilot took over" in daemon.err, daemon.err
    assert vehicle.mode == HOLD
    assert not [command for command in vehicle.commands if command[0] in (176, 400)], vehicle.commands
    assert not [stamp for stamp, _ in vehicle.setpoints if stamp > times[1]]


@bounds_time
def test_a_failsafe_during_a_process_pause_is_respected(flight):
    vehicle, daemon = flight
    returning = 4 << 16 | 5 << 24

    def failsafe(vehicle, since_s):
        if since_s >= 0.3 and vehicle.mode != returning:
            vehicle.link.mav.statustext_send(2, b"Failsafe activated")
            vehicle.set_mode(returning)
            vehicle.commands.clear()

    pause_in_flight(vehicle, daemon, 2.4, failsafe)
    assert daemon.finish()[0] == 5, daemon.err
    assert "PX4 failsafe: Return; vehicle: Failsafe activated" in daemon.err, daemon.err
    assert not [command for command in vehicle.commands if command[0] in (176, 400)], vehicle.commands


@bounds_time
@pytest.mark.parametrize("stall_s", [0.07, 0.15])
def test_samples_queued_during_a_short_stall_are_not_answered(flight, stall_s):
    """The stall is too short to invalidate the known mode, and the queued samples look fresh."""
    vehicle, daemon = flight
    times = []

    def step(vehicle, _):
        now = time.monotonic()
        if not times and vehicle.armed and vehicle.position[2] < -0.5:
            daemon.signal(signal.SIGSTOP)
            times.append(now)
        elif len(times) == 1 and now - times[0] >= stall_s:
            # For a while only samples from the stall are left to read.
            vehicle.telemetry = False
            times.append(now)
            times.append(len(vehicle.setpoints))
            daemon.signal(signal.SIGCONT)
        elif len(times) == 3 and now - times[1] >= 0.2:
            times.append(len(vehicle.setpoints))
            vehicle.telemetry = True

    vehicle.on_step = step
    assert daemon.finish()[0] == 0, daemon.err
    assert "this process stalled for" in daemon.err, daemon.err
    _, _, before, after = times
    assert after == before, f"{after - before} answers to queued samples"
    assert len(vehicle.setpoints) > after + 20, "the flight continues"
