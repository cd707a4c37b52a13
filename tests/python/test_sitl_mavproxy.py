"""MAVProxy as a client of the vehicle: it connects, lists parameters, changes modes and arms."""

import os
import pty
import subprocess
import sys
import time

import pytest
from conftest import python_tool


class MavProxy:
    """MAVProxy on a pseudo-terminal, without console or map."""

    def __init__(self, master, directory):
        ours, theirs = pty.openpty()
        environment = dict(os.environ, HOME=str(directory), TERM="dumb")
        environment.pop("MAVLINK20", None)
        self.terminal = ours
        self.process = subprocess.Popen(
            [sys.executable, python_tool("mavproxy.py"), f"--master={master}", "--state-basedir", str(directory)],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            cwd=directory,
            env=environment,
        )
        os.close(theirs)
        os.set_blocking(ours, False)
        self.output = ""

    def say(self, line):
        os.write(self.terminal, f"{line}\n".encode())

    def expect(self, word, timeout=15.0):
        """Waits for `word` in the output after the previous match."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            try:
                self.output += os.read(self.terminal, 65536).decode(errors="replace")
            except BlockingIOError:
                time.sleep(0.02)
            _, found, rest = self.output.partition(word)
            if found:
                self.output = rest
                return
        raise AssertionError(f"no {word!r} from MAVProxy:\n{self.output[-3000:]}")

    def stop(self):
        self.process.terminate()
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        os.close(self.terminal)


@pytest.mark.parametrize("link", ["udpin:127.0.0.1:0", "tcpin:127.0.0.1:0"])
def test_a_mavproxy_session(sitl, mavlink_client, tmp_path, link):
    vehicle = sitl(link, "udpin:127.0.0.1:0")
    proxy = MavProxy(vehicle.peer_url(0), tmp_path)
    try:
        proxy.expect("online system 1")
        proxy.expect("Mode LOITER")
        proxy.say("param fetch")
        proxy.expect("Received")
        proxy.say("param show MIS_TAKEOFF_ALT")
        proxy.expect("2.5")
        # Connected only now, because a socket that nobody reads overflows and loses messages.
        watcher = mavlink_client(vehicle.peer_url(1))
        watcher.wait("HEARTBEAT")
        proxy.say("param set COM_OF_LOSS_T 0.5")
        watcher.wait("PARAM_VALUE", lambda v: v.param_id == "COM_OF_LOSS_T" and v.param_value == 0.5)
        # MAVProxy 1.8.75 cannot encode PX4's modes by name.
        proxy.say("long DO_SET_MODE 1 3")
        watcher.wait_mode(3)
        proxy.expect("Mode POSCTL")
        proxy.say("long NAV_LOITER_UNLIM")
        watcher.wait_mode(4, 3)
        proxy.say("arm throttle")
        watcher.wait("HEARTBEAT", lambda beat: beat.base_mode & 128)
        proxy.expect("ARMED")
        proxy.say("disarm")
        watcher.wait("HEARTBEAT", lambda beat: not beat.base_mode & 128)
        proxy.expect("DISARMED")
    finally:
        proxy.stop()
