"""MAVProxy as a client of the vehicle: it connects, lists parameters, changes modes and arms."""

import os
import pty
import subprocess
import sys
import time

import pytest
from conftest import python_tool


class MavProxy:
    """MAVProxy on a terminal of its own, without console or map."""

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

    def expect(self, *words, timeout=20.0, repeat=None):
        """Waits for one of the words, repeating a line every second if told to."""
        end = time.monotonic() + timeout
        start, said = len(self.output), 0.0
        while time.monotonic() < end:
            if repeat and time.monotonic() - said > 1.0:
                self.say(repeat)
                said = time.monotonic()
            try:
                self.output += os.read(self.terminal, 65536).decode(errors="replace")
            except BlockingIOError:
                time.sleep(0.02)
            except OSError:
                break
            if any(word in self.output[start:] for word in words):
                return
        raise AssertionError(f"MAVProxy did not say {words}:\n{self.output[-3000:]}")

    def stop(self):
        self.process.terminate()
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        os.close(self.terminal)


@pytest.mark.parametrize("link", ["udpin:127.0.0.1:0", "tcpin:127.0.0.1:0"])
def test_session(sitl, pilot, tmp_path, link):
    vehicle = sitl(link, "udpin:127.0.0.1:0")
    watcher = pilot(vehicle.peer_url(1))
    proxy = MavProxy(vehicle.peer_url(0), tmp_path)
    try:
        proxy.expect("Received", "parameters", repeat="param fetch")
        proxy.expect("MIS_TAKEOFF_ALT", repeat="param show MIS_TAKEOFF_ALT")
        proxy.say("param set COM_OBL_RC_ACT 5")
        proxy.say("mode POSCTL")
        watcher.wait_mode(3)
        proxy.say("mode LOITER")
        watcher.wait_mode(4, 3)
        proxy.say("arm throttle")
        watcher.wait("HEARTBEAT", lambda beat: beat.base_mode & 128)
        proxy.say("disarm")
        watcher.wait("HEARTBEAT", lambda beat: not beat.base_mode & 128)
    finally:
        proxy.stop()
