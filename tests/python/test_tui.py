"""`--tui` on a pseudo-terminal: its screen, its keys, and a restored terminal after every exit."""

import os
import signal
import termios
import time

import pexpect
import pyte
import pytest

from conftest import DOWNWASH, QUICK, fly_arguments, hover_for

ROWS, COLUMNS = 30, 110


class Screen:
    """A program on a pseudo-terminal, and the screen that it draws."""

    def __init__(self, *arguments):
        self.child = pexpect.spawn(
            DOWNWASH[0],
            [*DOWNWASH[1:], *map(str, arguments)],
            dimensions=(ROWS, COLUMNS),
            env=os.environ | QUICK | {"TERM": "xterm-256color"},
            timeout=60,
        )
        self.before = termios.tcgetattr(self.child.child_fd)
        self.display = pyte.Screen(COLUMNS, ROWS)
        self.stream = pyte.ByteStream(self.display)
        self.raw = b""

    def feed(self):
        try:
            data = self.child.read_nonblocking(65536, timeout=0.2)
        except pexpect.TIMEOUT:
            return True
        except pexpect.EOF:
            return False
        self.raw += data
        self.stream.feed(data)
        return True

    @property
    def text(self):
        return "\n".join(self.display.display)

    def until(self, *words, timeout=60.0):
        end = time.monotonic() + timeout
        while not all(word in self.text for word in words):
            assert self.feed() and time.monotonic() < end, f"not on the screen: {words}\n{self.text}"

    def finish(self):
        while self.feed():
            pass
        self.child.wait()
        return self.child.exitstatus

    def is_restored(self):
        """Whether the program left the alternate screen and shows the cursor."""
        left = self.raw.rindex(b"\x1b[?1049l") > self.raw.rindex(b"\x1b[?1049h")
        shown = self.raw.rindex(b"\x1b[?25h") > self.raw.rindex(b"\x1b[?25l")
        return left and shown


@pytest.fixture
def flight(hover, hand_made, tmp_path):
    """Starts `fly --tui` with a hand-made vehicle."""
    _, url = hand_made

    def start(duration_s=30):
        hover.write_text(hover_for(duration_s))
        return Screen(*fly_arguments(hover, url, tmp_path, "--tui"))

    return start


def test_the_screen_follows_a_flight_to_its_landing(flight):
    screen = flight(duration_s=1)
    screen.until("state", "link", "events", "q or Ctrl-C: land and stop")
    screen.until("state track", "mode Offboard", "armed", "link connected", "attitude roll", "error n")
    assert screen.finish() == 0
    assert screen.is_restored()
    # The messages and the result follow on the restored screen.
    after = screen.raw[screen.raw.rindex(b"\x1b[?1049l") :].decode()
    assert "INFO track: at the start" in after and "flight  done" in after


@pytest.mark.parametrize("key", ["q", "\x03"], ids=["q", "ctrl-c"])
def test_the_quit_key_lands_with_exit_code_130(flight, key):
    screen = flight()
    screen.until("state track")
    screen.child.send(key)
    screen.until("state land")
    assert screen.finish() == 130, screen.text
    assert screen.is_restored()


def test_a_signal_restores_the_terminal(flight):
    screen = flight()
    screen.until("state track")
    for _ in range(2):
        screen.child.kill(signal.SIGTERM)
        screen.until("stopping", timeout=20)
    assert screen.finish() is not None
    assert screen.is_restored()


def test_terminal_settings_are_restored(flight):
    """A shell continues in the same terminal, so its settings must be as before."""
    screen = flight()
    screen.until("state")
    during = termios.tcgetattr(screen.child.child_fd)
    assert during[3] & termios.ICANON == 0
    screen.child.send("q")
    while b"\x1b[?1049l" not in screen.raw:
        assert screen.feed()
    # The program still runs for a moment, or its terminal keeps the last settings.
    after = None
    try:
        after = termios.tcgetattr(screen.child.child_fd)
    except termios.error:
        pytest.skip("the terminal closed with the program")
    finally:
        screen.finish()
    assert after[3] & termios.ICANON
    assert after[3] & termios.ECHO


def test_without_a_terminal_it_is_refused(program, hover, tmp_path):
    flight = program(*fly_arguments(hover, "udpin:127.0.0.1:0", tmp_path, "--tui"))
    code, _ = flight.finish()
    assert code == 2
    assert "--tui: expected a terminal" in flight.err
