"""Shared fixtures: `downwash` and its simulated vehicle as processes, and a pymavlink client."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def pytest_configure(config):
    config.addinivalue_line("markers", "long: only tests/run --all runs it")
    config.addinivalue_line("markers", "computes: uses every core, so it never runs beside a real-time flight")


# Where both signals take the same code path, only tests/run --all tests SIGTERM.
SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["int", "term"])
SIGNALS_TERM_LONG = pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)], ids=["int", "term"]
)

# The test vehicle, in the schema of vehicle files.
VEHICLE = {
    "name": "test_quad",
    "mass": 0.5,
    "inertia": [0.003, 0.003, 0.005],
    "rotors": [
        {
            "position_m": [0.1 * x, 0.1 * y, 0.0],
            "spin": spin,
            "thrust_max_N": 2.5,
            "drag_torque_per_thrust_m": 0.015,
        }
        for x, y, spin in [(1, 1, 1), (-1, 1, -1), (-1, -1, 1), (1, -1, -1)]
    ],
    "motor_time_constant_s": 0.03,
    "command_delay_s": 0.005,
    "attitude_pd": {"kp": [0.6, 0.6, 0.3], "kd": [0.075, 0.075, 0.06], "rate_hz": 250.0},
    "hover_thrust": 0.4905,
    "gravity": 9.81,
    "air_density": 1.2,
    "rotor_radius_m": 0.06,
    "rotor_max_rpm": 20000.0,
    "battery": {"cells": 3, "full_V": 12.6, "nominal_V": 11.1},
}
HOVER = VEHICLE["hover_thrust"]


def downwash_command():
    """The command that starts `downwash`: DOWNWASH_BIN, else the newest build."""
    if "DOWNWASH_BIN" in os.environ:
        return [os.environ["DOWNWASH_BIN"]]
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    built = [path for path in (target / "release/downwash", target / "debug/downwash") if path.exists()]
    # No error if there is no build: most tests need only the vehicle.
    return [str(max(built, key=lambda path: path.stat().st_mtime, default="downwash"))]


DOWNWASH = downwash_command()


def run(*arguments, code=0, timeout=280):
    """Runs `downwash` to its end, which must have this exit code."""
    done = subprocess.run([*DOWNWASH, *map(str, arguments)], capture_output=True, text=True, timeout=timeout)
    assert done.returncode == code, done.stderr
    assert "panicked" not in done.stderr
    return done


def sitl_command():
    """The command that starts the simulated vehicle: `downwash sitl`, or the `downwash-sitl` program."""
    if "DOWNWASH_BIN" in os.environ:
        return [os.environ["DOWNWASH_BIN"], "sitl"]
    if "DOWNWASH_SITL_BIN" in os.environ:
        return [os.environ["DOWNWASH_SITL_BIN"]]
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    for profile in ("release", "debug"):
        alone = target / profile / "downwash-sitl"
        if alone.exists():
            return [str(alone)]
        whole = target / profile / "downwash"
        if whole.exists():
            return [str(whole), "sitl"]
    pytest.exit("no vehicle to test: build it, or set DOWNWASH_BIN or DOWNWASH_SITL_BIN", 2)


class Sitl:
    """A running simulated vehicle. `urls` are its links as it prints them, with the ports the system chose."""

    def __init__(self, vehicle_file, links, options=()):
        command = sitl_command() + ["--vehicle", str(vehicle_file)]
        for link in links:
            command += ["--link", link]
        self.process = subprocess.Popen(
            command + list(options), stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.urls = []
        for _ in links:
            line = self.process.stderr.readline()
            found = re.search(r"(?:listening on|talking to) (\S+)", line)
            if not found:
                raise RuntimeError(f"{line}{self.process.communicate(timeout=5)[1]}")
            self.urls.append(found.group(1))

    def port(self, index=0):
        return int(self.urls[index].rsplit(":", 1)[1])

    def peer_url(self, index=0):
        """The URL at which pymavlink reaches a link."""
        scheme, _, address = self.urls[index].partition(":")
        return {"udpin": "udpout", "tcpin": "tcp"}[scheme] + ":" + address

    def stop(self, how=signal.SIGINT):
        if self.process.poll() is None:
            self.process.send_signal(how)
        try:
            self.process.communicate(timeout=5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()
            raise
        return self.process.returncode


CRAZYFLIE = ROOT / "config/vehicles/crazyflie.toml"
# The shipped mapping of a motion-capture table, and its columns.
MOTION_CAPTURE = ROOT / "config/mappings/motion-capture.toml"
MOTION_CAPTURE_COLUMNS = "t,px,py,pz,vx,vy,vz,qx,qy,qz,qw,wx,wy,wz,m1,m2,m3,m4,vbat"
# The parts of a flight that most tests wait for and do not check: thrust rises, the vehicle climbs 0.8 m, settles
# and holds in 3 s instead of 7 s. It climbs no faster than a segment takes at least, 1 s.
QUICK = {
    "DOWNWASH_OFFBOARD__GUIDANCE__SPOOL_S": "0.3",
    "DOWNWASH_OFFBOARD__GUIDANCE__CLIMB_SPEED_M_S": "1.5",
    "DOWNWASH_OFFBOARD__GUIDANCE__SETTLE_S": "0.2",
    "DOWNWASH_OFFBOARD__SUPERVISOR__HOLD_S": "0.5",
}
# The same for the simulated vehicle: it lands and disarms in 2 s instead of 6 s.
QUICK_LANDING = "[parameters]\nMPC_LAND_SPEED = 1.5\nCOM_DISARM_LAND = 0.5\n"


def hover_for(seconds):
    """A trajectory: a hover."""
    return f"family = 'hover'\naltitude_m = 0.8\nduration_s = {seconds:.1f}\n"


SHORT_HOVER = hover_for(1)


def fly_arguments(trajectory, url, folder, *options):
    """The arguments of `downwash fly` for a Crazyflie."""
    return ["fly", trajectory, "--connect", url, "--vehicle", CRAZYFLIE, "--log-dir", folder, *options]


# A turn along which a plan tracks more closely than feedback alone.
TURN = """family = 'sinusoid-yaw'
altitude_m = 0.8
duration_s = 3.0
amplitude_m = 0.4
period_s = 3.0
yaw_period_s = 6.0
ramp_s = 1.0
"""


def only_log(folder):
    (log,) = folder.glob("*.mcap")
    return log


def until(condition, what, timeout=20.0):
    """Waits for something that sends no event."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f"not within {timeout} s: {what}"
        time.sleep(0.01)


class Program:
    """A running `downwash`, by default with `QUICK` flights. A thread reads its stderr line by line."""

    def __init__(self, *arguments, settings=QUICK, **options):
        self.process = subprocess.Popen(
            [*DOWNWASH, *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | settings,
            **options,
        )
        self.lines = []
        self._news = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        for line in self.process.stderr:
            with self._news:
                self.lines.append(line.rstrip("\n"))
                self._news.notify_all()
        with self._news:
            self._ended = True
            self._news.notify_all()

    @property
    def err(self):
        return "\n".join(self.lines)

    def says(self, words, since=0, timeout=30.0):
        """Waits for a line with `words`, from line number `since` on; returns the number of the next line."""
        end = time.monotonic() + timeout
        with self._news:
            while True:
                for number in range(since, len(self.lines)):
                    if words in self.lines[number]:
                        return number + 1
                left = end - time.monotonic()
                if self._ended or left <= 0:
                    raise AssertionError(f"no line with {words!r}:\n{self.err}")
                since = len(self.lines)
                self._news.wait(left)

    def cpu_s(self):
        """Processor time so far, user and system."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def signal(self, number):
        self.process.send_signal(number)

    def finish(self, timeout=60.0):
        """Waits for the program to end; returns its exit code and stdout."""
        out = self.process.stdout.read() if self._wait(timeout) else ""
        return self.process.returncode, out

    def _wait(self, timeout):
        try:
            self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"still running after {timeout} s:\n{self.err}") from None
        self._thread.join(5)
        return True

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._thread.join(5)
        self.process.stdout.close()
        self.process.stderr.close()


@pytest.fixture
def program():
    """Starts `downwash` with the given arguments, and kills what still runs after the test."""
    running = []

    def start(*arguments, **options):
        running.append(Program(*arguments, **options))
        return running[-1]

    yield start
    for one in running:
        one.close()


@pytest.fixture
def hover(tmp_path):
    """A trajectory file: a short hover."""
    path = tmp_path / "hover.toml"
    path.write_text(SHORT_HOVER)
    return path


@pytest.fixture(scope="session")
def vehicle_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("vehicle") / "vehicle.json"
    path.write_text(json.dumps(VEHICLE))
    return path


def started(file, *options):
    """Starts simulated vehicles, stops them after the test, and requires a clean exit."""
    running = []

    def start(*links, speed=1, effects=()):
        links = links or ("udpin:127.0.0.1:0",)
        hidden = [word for effect in effects for word in ("--effect", effect)]
        running.append(Sitl(file, links, [*options, *hidden, "--speed", str(speed)]))
        return running[-1]

    yield start
    codes = [vehicle.stop() for vehicle in running]
    assert all(code == 130 for code in codes), f"exit codes {codes}"


@pytest.fixture
def sitl(vehicle_file):
    """Starts simulated vehicles for MAVLink clients."""
    yield from started(vehicle_file)


@pytest.fixture(scope="session")
def quick_landing(tmp_path_factory):
    """The options of a simulated vehicle with `QUICK_LANDING`."""
    path = tmp_path_factory.mktemp("landing") / "sitl.toml"
    path.write_text(QUICK_LANDING)
    return ["--config", str(path)]


@pytest.fixture
def crazyflie(quick_landing):
    """Starts simulated Crazyflies for `downwash fly`."""
    yield from started(CRAZYFLIE, *quick_landing)


@pytest.fixture
def hand_made():
    """A hand-made vehicle, and the URL on which a daemon receives it."""
    from hand_made_vehicle import HandMadeVehicle

    port = free_port()
    vehicle = HandMadeVehicle(f"udpout:127.0.0.1:{port}")
    yield vehicle, f"udpin:127.0.0.1:{port}"
    vehicle.stop()


# Marks the tests of `demo`: one xdist worker runs it for all.
of_the_demo = pytest.mark.xdist_group("demo")


@pytest.fixture(scope="session")
def demo(tmp_path_factory):
    """A demo on a vehicle with a hidden drag: its folder, and the JSON that it printed."""
    folder = tmp_path_factory.mktemp("demo")
    (folder / "turn.toml").write_text(TURN)
    options = ("--trajectory", folder / "turn.toml", "--learn", 60, "--fly", "model-free,physics,replanned")
    drag = ("--effect", "rotor_drag:d_xy=0.02,d_z=0.01")
    return folder / "out", run("demo", "--out", folder / "out", *options, *drag, "--json").stdout


@pytest.fixture(scope="module")
def browser():
    from browser import Browser

    one = Browser()
    yield one
    one.close()


# Widths in pixels of a desktop and of a phone, each in the light and in the dark scheme.
LOOKS = [(width, dark) for width in (1400, 400) for dark in (False, True)]


def free_port(kind=socket.SOCK_DGRAM):
    """A free port chosen by the system, which no other xdist worker gets."""
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 1))
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    while True:
        with socket.socket(socket.AF_INET, kind) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        # Halved, because Linux hands out TCP ports of one parity.
        if port // 2 % workers == worker:
            return port


def bounds_time(test):
    """Marks a test that bounds a reaction time of the control loop: one at a time of each file."""
    return pytest.mark.xdist_group(f"bounds_time in {test.__module__}")(test)


class MavlinkClient:
    """A pymavlink client that can wait for messages. Times are host seconds."""

    def __init__(self, url, version=2, system=255):
        self._select(version)
        from pymavlink import mavutil

        self.mav = mavutil.mavlink
        self.link = mavutil.mavlink_connection(url, source_system=system, source_component=190)
        self.link.target_system = self.link.target_component = 1
        self.hello()

    @staticmethod
    def _select(version):
        from pymavlink import mavutil

        if version == 2:
            os.environ["MAVLINK20"] = "1"
        else:
            os.environ.pop("MAVLINK20", None)
        # No smaller dialect has CURRENT_MODE.
        mavutil.set_dialect("all")

    def hello(self):
        self.link.mav.heartbeat_send(self.mav.MAV_TYPE_GCS, self.mav.MAV_AUTOPILOT_INVALID, 0, 0, 0)

    def close(self):
        self.link.close()

    def wait(self, kind, accept=lambda message: True, timeout=10.0, between=None):
        """Returns the next message of type `kind` that `accept` accepts; calls `between` every 10 ms until then."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if between:
                between()
            slice_end = min(end, time.monotonic() + (0.01 if between else timeout))
            while time.monotonic() < slice_end:
                remaining = max(slice_end - time.monotonic(), 0.0)
                message = self.link.recv_match(type=kind, blocking=True, timeout=remaining)
                if message is not None and accept(message):
                    return message
        raise AssertionError(f"no matching {kind} within {timeout} s")

    def command(self, number, *params):
        """Sends a COMMAND_LONG and returns its result."""
        params = list(params) + [0.0] * (7 - len(params))
        self.link.mav.command_long_send(1, 1, number, 0, *params)
        return self.wait("COMMAND_ACK", lambda ack: ack.command == number, 3.0).result

    def arm(self):
        return self.command(self.mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def set_mode(self, main, sub=0):
        return self.command(self.mav.MAV_CMD_DO_SET_MODE, 1, main, sub)

    def wait_mode(self, main, sub=0, timeout=20.0, between=None):
        word = main << 16 | sub << 24
        return self.wait("HEARTBEAT", lambda beat: beat.custom_mode == word, timeout, between)

    def setpoint(self, roll=0.0, thrust=HOVER, mask=0, rates=(0.0, 0.0, 0.0)):
        from pymavlink.quaternion import QuaternionBase

        q = list(QuaternionBase([roll, 0.0, 0.0]).q)
        self.link.mav.set_attitude_target_send(0, 1, 1, mask, q, *rates, thrust)

    def texts(self, word, timeout=5.0):
        return self.wait("STATUSTEXT", lambda message: word in message.text, timeout).text

    def parameter(self, name):
        self.link.mav.param_request_read_send(1, 1, name.encode(), -1)
        return self.wait("PARAM_VALUE", lambda value: value.param_id == name, 3.0)


@pytest.fixture
def mavlink_client():
    """Connects pymavlink clients, and closes them after the test."""
    open_links = []

    def connect(url, **options):
        open_links.append(MavlinkClient(url, **options))
        return open_links[-1]

    yield connect
    for link in open_links:
        link.close()


def python_tool(name):
    """The path of a program in this Python's environment."""
    return str(Path(sys.executable).parent / name)
