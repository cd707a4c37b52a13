"""A serial cable between two pseudo-terminals that can be unplugged and plugged in again.

A separate process moves the bytes (this file run as a program): a thread in the test process would wait for the GIL,
and a terminal buffers only 4 kB."""

import os
import select
import struct
import subprocess
import sys
import threading
import tty

# Bytes that queue for an end that nobody reads. Later bytes are lost, as on a serial port: with a longer queue, a
# reader that stalls once would stay late.
BACKLOG_MAX = 1 << 12


class SerialCable:
    """Two ends with stable paths, as USB adapters have: a path does not exist while its end is unplugged."""

    def __init__(self, folder, on_bytes=None):
        """`on_bytes` is called with the number of the sending end and its bytes."""
        self.paths = [folder / "tty-a", folder / "tty-b"]
        self.masters = [None, None]
        self._slaves = [None, None]
        self._relay = None
        self._listener = None
        self._on_bytes = on_bytes
        for end in (0, 1):
            self._open(end)
        self._start()

    def url(self, end):
        # The daemon requests rates that fit the baud rate. At 921600 baud a terminal buffers a tenth of a second of
        # the messages, too little for a vehicle that is scheduled late and then sends a burst.
        return f"serial:{self.paths[end]}:230400"

    def plug(self, end):
        self._halt()
        self._open(end)
        self._start()

    def pull(self, end):
        self._halt()
        self._close(end)
        self._start()

    def close(self):
        self._halt()
        for end in (0, 1):
            if self.masters[end] is not None:
                self._close(end)

    def _open(self, end):
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self.masters[end], self._slaves[end] = master, slave
        self.paths[end].symlink_to(os.ttyname(slave))

    def _close(self, end):
        self.paths[end].unlink()
        os.close(self.masters[end])
        os.close(self._slaves[end])
        self.masters[end] = self._slaves[end] = None

    def _start(self):
        plugged = [-1 if master is None else master for master in self.masters]
        mode = "copies" if self._on_bytes else "alone"
        self._relay = subprocess.Popen(
            [sys.executable, "-I", "-S", __file__, mode, *map(str, plugged)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=[master for master in plugged if master >= 0],
        )
        self._listener = threading.Thread(target=self._listen, args=(self._relay.stdout,), daemon=True)
        self._listener.start()

    def _halt(self):
        self._relay.stdin.close()
        self._relay.wait(5)
        self._listener.join(5)
        self._relay.stdout.close()

    def _listen(self, copies):
        while header := copies.read(5):
            end, size = struct.unpack("<BI", header)
            self._on_bytes(end, copies.read(size))


def relay(masters, copies):
    """Moves bytes between two terminals (-1: unplugged) until stdin closes; with `copies`, writes each piece to stdout."""
    try:
        # A real cable does not wait for a processor.
        os.nice(-20)
    except PermissionError:
        pass
    stdin, stdout = 0, 1
    os.set_blocking(stdout, False)
    # Bytes queued for each terminal, and for stdout.
    waiting = {masters[0]: bytearray(), masters[1]: bytearray(), stdout: bytearray()}
    plugged = [master for master in masters if master >= 0]
    while True:
        unwritten = [one for one, data in waiting.items() if one >= 0 and data]
        readable, writable, _ = select.select([stdin, *plugged], unwritten, [])
        if stdin in readable:
            return
        for end, master in enumerate(masters):
            if master not in readable:
                continue
            try:
                data = os.read(master, 65536)
            except OSError:
                return  # gone
            other = waiting[masters[1 - end]]
            if masters[1 - end] >= 0 and len(other) < BACKLOG_MAX:
                other += data
            if copies:
                waiting[stdout] += struct.pack("<BI", end, len(data)) + data
        for one in writable:
            try:
                del waiting[one][: os.write(one, waiting[one])]
            except BlockingIOError:
                pass


if __name__ == "__main__":
    relay([int(argument) for argument in sys.argv[2:]], sys.argv[1] == "copies")
