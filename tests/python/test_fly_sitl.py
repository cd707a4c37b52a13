"""`downwash fly` against `downwash sitl` over every transport, with and without faults."""

import fcntl
import json
import os
import pty
import random
import re
import select
import signal
import socket
import struct
import subprocess
import termios
import time

import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from conftest import (
    CRAZYFLIE,
    DOWNWASH,
    QUICK,
    SHORT_HOVER,
    Program,
    Sitl,
    fly_arguments,
    free_port,
    hover_for,
    only_log,
)
from serial_cable import SerialCable


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """A flight with the default settings over each transport, all at once."""
    running, cleanup = {}, []

    def vehicle(link):
        one = Sitl(CRAZYFLIE, [link])
        cleanup.append(one.stop)
        return one

    def fly(name, url):
        folder = tmp_path_factory.mktemp(name)
        (folder / "hover.toml").write_text(SHORT_HOVER)
        options = ("--json", "--tlog", folder / "link.tlog")
        program = Program(*fly_arguments(folder / "hover.toml", url, folder, *options), settings={})
        cleanup.append(program.close)
        running[name] = (program, folder)
        return program

    try:
        fly("udpout", vehicle("udpin:127.0.0.1:0").peer_url())
        port = free_port()
        vehicle(f"udpout:127.0.0.1:{port}")
        fly("udpin", f"udpin://127.0.0.1:{port}")
        fly("tcp", vehicle("tcpin:127.0.0.1:0").peer_url())
        # The vehicle connects, so downwash must listen first.
        port = free_port(socket.SOCK_STREAM)
        fly("tcpin", f"tcpin:127.0.0.1:{port}").says("link open")
        vehicle(f"tcp:127.0.0.1:{port}")
        cable = SerialCable(tmp_path_factory.mktemp("cable"))
        cleanup.append(cable.close)
        vehicle(cable.url(0))
        fly("serial", cable.url(1))
        yield running
    finally:
        for end in reversed(cleanup):
            end()


# One xdist worker flies them all.
@pytest.mark.xdist_group("flights")
@pytest.mark.parametrize("transport", ["udpout", "udpin", "tcp", "tcpin", "serial"])
def test_a_flight_over_each_transport(flights, transport):
    program, folder = flights[transport]
    code, out = program.finish()
    assert code == 0, program.err
    summary = json.loads(out)
    assert summary["schema"] == "downwash.fly" and summary["end"] == "done"
    assert summary["flight"]["tracking"]["rmse_3d_m"] < 0.1
    # The output names the vehicle, its rates and each phase, and is short.
    first = next(line for line in program.lines if "heard" in line)
    assert "system 1 component 1: autopilot PX4 (12), type quadrotor (2)" in first
    assert any(re.search(r"receiving attitude at \d+ Hz, position at \d+ Hz", line) for line in program.lines), program.err
    for phase in ("standby", "take_off", "track", "land", "done"):
        assert f" {phase}: " in program.err
    assert len(program.lines) < 40, program.err
    log = only_log(folder)
    assert summary["log"] == str(log)
    with log.open("rb") as file:
        counts = {}
        for _, channel, _ in make_reader(file, validate_crcs=True).iter_messages():
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
    # A serial line gets only the rates that it can carry.
    assert counts["/setpoint"] > 500 and counts["/mavlink/rx"] > (2000 if transport == "serial" else 5000)
    from pymavlink import mavutil

    tlog = mavutil.mavlink_connection(str(folder / "link.tlog"))
    assert tlog.recv_match(type="SET_ATTITUDE_TARGET") is not None


def test_after_a_kill_the_log_opens_and_the_vehicle_lands(program, hover, crazyflie, mavlink_client, tmp_path):
    vehicle = crazyflie()
    hover.write_text(hover_for(30))
    flight = program(*fly_arguments(hover, vehicle.peer_url(), tmp_path))
    observer = mavlink_client(vehicle.peer_url())
    flight.says(" track: ")
    # Some seconds of flight in the log.
    observer.wait("HEARTBEAT")
    observer.wait("HEARTBEAT")
    killed_ns = time.time_ns()
    flight.signal(signal.SIGKILL)
    assert flight.finish()[0] == -signal.SIGKILL
    # Offboard loss: the vehicle lands by itself.
    observer.wait_mode(4, 6)
    observer.wait("HEARTBEAT", lambda beat: not beat.base_mode & 128, timeout=20)

    log = only_log(tmp_path)
    newest = 0
    with log.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=False).records:
                newest = max(newest, getattr(record, "log_time", 0))
        except (McapError, EOFError, struct.error):
            pass  # the log ends where the process was killed
    assert 0 <= killed_ns - newest < 1.5e9, f"{(killed_ns - newest) * 1e-9} s of the log are missing"
    info = program("log", "info", log, "--json")
    code, out = info.finish()
    assert code == 0, info.err
    report = json.loads(out)
    assert not report["finished"] and report["messages"] > 1000


@pytest.mark.parametrize("moment", ["heard", "track"])
def test_an_unplugged_serial_line_ends_the_flight(program, crazyflie, tmp_path, hover, moment):
    cable = SerialCable(tmp_path)
    try:
        crazyflie(cable.url(0))
        hover.write_text(hover_for(60))
        # Above the time after which a silent vehicle is lost, 2.5 s.
        search = {"DOWNWASH_LINK__SEARCH_TIMEOUT_S": "4.0"}
        flight = program(*fly_arguments(hover, cable.url(1), tmp_path), settings=QUICK | search)
        flight.says(f" {moment}" + (": " if moment == "track" else " system 1"))
        cable.pull(1)
        # After the search for the vehicle, or after the recording of a vehicle in the air, 10 s.
        code, _ = flight.finish(25)
        assert code == 3, flight.err
        assert "link closed" in flight.err
    finally:
        cable.close()


def with_byte(frame, index, value):
    return frame[:index] + bytes([value]) + frame[index + 1 :]


def garbage(seed):
    """Random, cut, corrupted and foreign datagrams, without end."""
    from pymavlink.dialects.v10 import common as v1
    from pymavlink.dialects.v20 import common as v2

    draw = random.Random(seed)
    old = v1.MAVLink(None, srcSystem=1, srcComponent=1)
    foreign = v2.MAVLink(None, srcSystem=77, srcComponent=1)
    beat = (2, 12, 129, 6 << 16, 4, 3)
    kinds = [
        lambda: draw.randbytes(draw.randint(1, 1400)),
        lambda: b"\xfd\xff" + draw.randbytes(20),
        lambda: b"\xfd" * 60000,
        lambda: v1.MAVLink_heartbeat_message(*beat).pack(old)[: draw.randint(1, 16)],
        # Wrong length bytes, and a signed frame without its signature.
        lambda: with_byte(v1.MAVLink_heartbeat_message(*beat).pack(old), 1, draw.randint(0, 255)),
        lambda: with_byte(v2.MAVLink_heartbeat_message(*beat).pack(foreign), 1, draw.randint(0, 255)),
        lambda: with_byte(v2.MAVLink_heartbeat_message(*beat).pack(foreign), 2, 1),
        lambda: v1.MAVLink_ping_message(0, 0, 0, 0).pack(old),
        lambda: v1.MAVLink_heartbeat_message(*beat).pack(old),
        lambda: v2.MAVLink_heartbeat_message(*beat).pack(foreign),
        lambda: v2.MAVLink_attitude_message(0, 3.0, 3.0, 3.0, 0, 0, 0).pack(foreign),
        lambda: v2.MAVLink_attitude_message(0, 3.0, 3.0, 3.0, 0, 0, 0).pack(foreign)[:-1] + b"\x00",
        lambda: struct.pack("<BBBBBBBBBB", 0xFD, 0, 1, 0, 0, 9, 9, 0xFF, 0xFF, 0xFF),
    ]
    while True:
        yield draw.choice(kinds)()


def test_garbage_is_counted_and_the_flight_continues(program, hover, crazyflie, tmp_path):
    port = free_port()
    vehicle = crazyflie(f"udpout:127.0.0.1:{port}", "udpin:127.0.0.1:0")
    # The garbage includes another autopilot's HEARTBEAT, so --system selects the vehicle.
    flight = program(*fly_arguments(hover, f"udpin:127.0.0.1:{port}", tmp_path, "--json", "--system", 1))
    flight.says("heard system 1 ")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as noise:
        for number, junk in enumerate(garbage(7)):
            noise.sendto(junk, ("127.0.0.1", port if number % 2 else vehicle.port(1)))
            if number % 4 == 0:
                try:
                    flight.process.wait(0.01)
                    break
                except subprocess.TimeoutExpired:
                    continue
    code, out = flight.finish()
    assert code == 0, flight.err
    flown = json.loads(out)["flight"]
    assert flown["tracking"]["rmse_3d_m"] < 0.1
    assert vehicle.process.poll() is None
    rows = program("log", "export", only_log(tmp_path), "--topic", "/link/stats", "--format", "jsonl")
    code, out = rows.finish()
    assert code == 0, rows.err
    last = json.loads(out.strip().splitlines()[-1])
    counts = ["crc_errors", "unframed_bytes", "unknown_frames", "foreign_frames", "stray_frames"]
    for count in counts:
        assert last[count] > 0 and flown["link"][count] == last[count], count


def test_a_terminal_shows_one_status_line(hover, crazyflie, tmp_path):
    """The status line is redrawn in place, and the messages above it stay whole."""
    vehicle = crazyflie()
    command = [*DOWNWASH, *map(str, fly_arguments(hover, vehicle.peer_url(), tmp_path))]
    child, terminal = pty.fork()
    if child == 0:
        fcntl.ioctl(1, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
        os.execve(command[0], command, os.environ | QUICK | {"TERM": "xterm"})
    seen = bytearray()
    end = time.monotonic() + 60
    while time.monotonic() < end:
        if select.select([terminal], [], [], 1.0)[0]:
            try:
                data = os.read(terminal, 4096)
            except OSError:
                break
            if not data:
                break
            seen += data
    os.close(terminal)
    _, status = os.waitpid(child, 0)
    text = seen.decode(errors="replace")
    assert os.waitstatus_to_exitcode(status) == 0, text
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    assert re.search(r"track \| Offboard \| armed \| \d+ Hz \| error \d", plain), plain[-3000:]
    assert "battery" in plain and "heard system 1" in plain and "RMSE" in plain
