"""A serial cable between two pseudo-terminals that can be pulled and plugged in again.

The bytes are moved by a process of its own, this file run as a program: a thread beside the tests would wait for
their turns of the interpreter, and a terminal holds but 4 kB."""

import os
import select
import struct
import subprocess
import sys
import threading
import tty

# So many bytes wait for a line that nobody reads, and what comes after them is lost, as on a serial port: a longer
# queue would make a reader that was held up for a moment late for good.
BACKLOG_MAX = 1 << 12


class SerialCable:
    """Two ends with stable paths, as of USB adapters: a path is gone while its end is pulled."""

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
        # The speed decides what the daemon asks for. A terminal holds a tenth of a second of what it asks for at
        # 921600 baud, and then loses what a vehicle sends that had to wait for its processor.
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
    """Moves bytes between two terminals (-1: pulled) until stdin is closed; `copies` puts each piece on stdout too."""
    try:
        # A cable takes no processor, so it has not to wait for one either.
        os.nice(-20)
    except PermissionError:
        pass
    stdin, stdout = 0, 1
    os.set_blocking(stdout, False)
    # What waits for each terminal, and for stdout.
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
