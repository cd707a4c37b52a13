"""A serial cable between two pseudo-terminals that can be pulled and plugged in again."""

import os
import select
import threading
import tty


class SerialCable:
    """Two ends with stable paths, as of USB adapters: a path is gone while its end is pulled."""

    def __init__(self, folder):
        self.paths = [folder / "tty-a", folder / "tty-b"]
        self.masters = [None, None]
        self._slaves = [None, None]
        self._lock = threading.Lock()
        # Called with the number of the sending end and its bytes.
        self.on_bytes = lambda end, data: None
        self._stop = threading.Event()
        for end in (0, 1):
            self.plug(end)
        self._thread = threading.Thread(target=self._relay, daemon=True)
        self._thread.start()

    def url(self, end):
        return f"serial:{self.paths[end]}:921600"

    def plug(self, end):
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        with self._lock:
            self.masters[end], self._slaves[end] = master, slave
            self.paths[end].symlink_to(os.ttyname(slave))

    def pull(self, end):
        with self._lock:
            self.paths[end].unlink()
            os.close(self.masters[end])
            os.close(self._slaves[end])
            self.masters[end] = self._slaves[end] = None

    def close(self):
        self._stop.set()
        self._thread.join(5)
        for end in (0, 1):
            if self.masters[end] is not None:
                self.pull(end)

    def _relay(self):
        while not self._stop.is_set():
            open_ends = [master for master in self.masters if master is not None]
            try:
                ready, _, _ = select.select(open_ends, [], [], 0.02)
            except (OSError, ValueError):
                continue  # pulled while waiting
            with self._lock:
                for end, master in enumerate(self.masters):
                    if master is not None and master in ready:
                        self._move(end, master)

    def _move(self, end, master):
        try:
            data = os.read(master, 4096)
        except OSError:
            return
        self.on_bytes(end, data)
        other = self.masters[1 - end]
        if other is not None:
            try:
                os.write(other, data)
            except BlockingIOError:
                pass  # an unread line loses bytes
