"""`downwash mocap` between a simulated room and a simulated vehicle, over real sockets, with `downwash fly` beside it."""

import json
import math
import signal
import socket
import struct
import threading
import time

import pytest

from conftest import CRAZYFLIE, Sitl, bounds_time, fly_arguments, free_port, hover_for


def room_in(sitl_options, autopilot="bundled", links=2):
    """A vehicle in a room, with a link for `fly` and one for `mocap`."""
    options = ["--autopilot", autopilot, "--seed", "3", *map(str, sitl_options)]
    return Sitl(CRAZYFLIE, ["udpin:127.0.0.1:0"] * links, options)


@pytest.fixture
def vehicle():
    running = []

    def start(*options, **named):
        running.append(room_in(options, **named))
        return running[-1]

    yield start
    for one in running:
        one.stop()


def bridge(program, vehicle, room, body="quad", *options):
    return program("mocap", "--room", room, "--body", body, "--connect", vehicle.peer_url(1), "--json", *options)


def fly(program, vehicle, folder, seconds):
    trajectory = folder / "hover.toml"
    trajectory.write_text(hover_for(seconds))
    return program(*fly_arguments(trajectory, vehicle.peer_url(0), folder, "--json"))


def summary(one, number=signal.SIGINT, code=130):
    began = time.monotonic()
    one.signal(number)
    got, out = one.finish(10)
    assert got == code, one.err
    assert time.monotonic() - began < 2.0, "it ends within two seconds"
    report = json.loads(out)
    assert report["schema"] == "downwash.mocap"
    return report


@bounds_time
def test_a_hover_on_motion_capture_poses(program, vehicle, tmp_path):
    port = free_port()
    quad = vehicle("--mocap", f"127.0.0.1:{port}", "--mocap-x-heading", "30")
    one = bridge(program, quad, f"stream:127.0.0.1:{port}", "quad", "--x-heading", "30")
    one.says("the body is seen", timeout=20)
    # With take-off and landing, some twelve seconds of poses.
    flight = fly(program, quad, tmp_path, 4)
    code, out = flight.finish(90)
    assert code == 0, f"{flight.err}\n{one.err}"
    assert json.loads(out)["flight"]["tracking"]["rmse_3d_m"] < 0.1
    report = summary(one)
    found = json.dumps(report)
    # A busy machine may make frames late; nothing else is wrong with this room.
    wrong = {name: count for name, count in report["poses"]["faults"].items() if count}
    assert set(wrong) <= {"old", "settling"}, f"{found}\n{one.err}"
    assert report["sent"] > 500 and report["clock"] == "TIMESYNC", found
    assert report["poses"]["losses"] == 0 and report["poses"]["resets"] == 0, found
    assert report["poses"]["forwarded"] <= 51 * report["seconds"], found


@bounds_time
@pytest.mark.long
@pytest.mark.parametrize("fault, words", [("freeze", "the tracker hangs"), ("swap", "swapped the two")])
def test_frozen_or_swapped_poses_end_the_flight(program, vehicle, tmp_path, fault, words):
    port = free_port()
    quad = vehicle("--mocap", f"127.0.0.1:{port}", "--mocap-fault", f"{fault}@5")
    one = bridge(program, quad, f"stream:127.0.0.1:{port}")
    one.says("the body is seen", timeout=20)
    # Longer than until the fault, five seconds after arming.
    flight = fly(program, quad, tmp_path, 20)
    # The bridge reports the fault once; the vehicle coasts, then reports its position unhealthy; `fly` lands it.
    one.says(words, timeout=60)
    code, out = flight.finish(60)
    assert code == 5, flight.err
    flight.says("reports an unhealthy position estimate")
    report = summary(one)
    assert sum("not forwarded" in line for line in one.lines) == 1, one.err
    key = {"freeze": "frozen", "swap": "swapped"}[fault]
    faults = report["poses"]["faults"]
    assert faults[key] >= 1 and report["poses"]["losses"] == 1, report
    # Nothing was forwarded after it: the counters account for every received pose.
    counted = report["poses"]
    refused = sum(count for name, count in faults.items() if name not in ("malformed", "silent"))
    assert counted["good"] + refused == counted["heard"], report


@bounds_time
def test_natnet_poses_give_a_px4_its_position(program, vehicle, mavlink_client):
    port = free_port()
    quad = vehicle("--mocap-natnet", f"127.0.0.1:{port}", "--mocap-up", "y", autopilot="px4")
    watcher = mavlink_client(quad.peer_url(0))
    # Without a pose there is no position, and no arming.
    with pytest.raises(AssertionError):
        watcher.wait("LOCAL_POSITION_NED", timeout=1.5)
    assert watcher.arm() != 0
    one = bridge(program, quad, f"natnet:127.0.0.1:{port}", "1", "--up", "y", "--as", "odometry")
    one.says("the body is seen", timeout=20)
    place = watcher.wait("LOCAL_POSITION_NED", timeout=5)
    assert math.dist((place.x, place.y, place.z), (0, 0, 0)) < 0.05
    # Once the bridge has ended, the vehicle notices within its timeout.
    report = summary(one, signal.SIGTERM, 0)
    assert report["as"] == "odometry" and report["sent"] > 0
    gone = time.monotonic()
    health = watcher.mav.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
    watcher.wait("SYS_STATUS", lambda status: not status.onboard_control_sensors_health & health, 15)
    assert 4.0 < time.monotonic() - gone < 9.0


def sender(port, stop, body="quad"):
    """The ten-line script of docs/mocap.md."""
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    count = 0
    while not stop.wait(0.01):
        count += 1
        pose = {"body": body, "t": time.monotonic(), "p": [1.0 + 1e-6 * count, 2.0, 0.5], "q": [1.0, 0.0, 0.0, 0.0]}
        out.sendto(json.dumps(pose).encode(), ("127.0.0.1", port))


@bounds_time
def test_each_wait_is_reported(program, vehicle, tmp_path):
    port = free_port()
    quad = vehicle("--mocap", f"127.0.0.1:{free_port()}")
    no_vehicle = program("mocap", "--room", f"stream:127.0.0.1:{port}", "--body", "quad", "--connect", f"udpin:127.0.0.1:{free_port()}")
    began = time.monotonic()
    no_vehicle.says("waiting for the vehicle: 0 bytes received", timeout=5)
    assert time.monotonic() - began < 3.5
    no_vehicle.signal(signal.SIGINT)
    assert no_vehicle.finish(5)[0] == 130

    one = bridge(program, quad, f"stream:127.0.0.1:{port}")
    one.says("waiting for the room: nothing arrives", timeout=5)
    stop = threading.Event()
    thread = threading.Thread(target=sender, args=(port, stop))
    thread.start()
    try:
        one.says("the body is seen", timeout=10)
        out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        for bad in [b"\xff\xfe", b'{"body":"quad"}', struct.pack("<HH", 7, 900), b'{"body":"quad","t":NaN}']:
            out.sendto(bad, ("127.0.0.1", port))
        one.says("the room's data violates its protocol", timeout=5)
    finally:
        stop.set()
        thread.join()
    one.says("no pose of the body arrives any more", timeout=5)
    report = summary(one)
    assert report["poses"]["faults"]["malformed"] == 4 and report["poses"]["losses"] == 1, report


@pytest.mark.parametrize(
    "options, code, words",
    [
        (["--room", "vrpn:host"], 2, "expected stream:"),
        (["--room", "stream:127.0.0.1:0", "--rate", "0"], 2, "mocap.rate_hz"),
        (["--room", "stream:198.51.100.1:5005"], 2, "cannot open"),
        (["--room", "natnet:127.0.0.1"], 2, "streaming id"),
    ],
)
def test_invalid_options_are_refused(program, options, code, words):
    one = program("mocap", "--body", "quad", "--connect", f"udpin:127.0.0.1:{free_port()}", *options)
    assert one.finish(10)[0] == code
    assert words in one.err


def test_odometry_is_refused_for_arducopter(program, vehicle):
    quad = vehicle("--mocap", f"127.0.0.1:{free_port()}", autopilot="arducopter")
    one = bridge(program, quad, "stream:127.0.0.1:0", "quad", "--as", "odometry")
    assert one.finish(20)[0] == 4, one.err
    assert "--as vision" in one.err
