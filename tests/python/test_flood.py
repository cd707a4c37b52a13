"""A flight while 200 sockets send garbage and frames of other systems to the vehicle's port."""

import random
import socket
import threading
import time

from conftest import CRAZYFLIE, SHORT_HOVER, Program, free_port
from hand_made_vehicle import HandMadeVehicle
from pymavlink.dialects.v20 import all as dialect

# Datagrams a second: more than the link's own traffic, and few enough that a busy machine drops none.
RATE_HZ = 2000


def flood(port, stop, sent):
    draw = random.Random(1)
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(200)]
    due = time.monotonic()
    try:
        while not stop.is_set():
            due += 0.02
            for _ in range(int(RATE_HZ * 0.02)):
                if draw.random() < 0.5:
                    data = draw.randbytes(draw.randrange(1, 1400))
                else:
                    mav = dialect.MAVLink(None, srcSystem=draw.randrange(2, 256), srcComponent=draw.randrange(1, 256))
                    data = bytes(dialect.MAVLink_heartbeat_message(2, 12, 128, 6 << 16, 4, 3).pack(mav))
                draw.choice(sockets).sendto(data, ("127.0.0.1", port))
                sent[0] += 1
            stop.wait(max(0.0, due - time.monotonic()))
    finally:
        for each in sockets:
            each.close()


def test_a_flooded_port_does_not_end_the_flight(tmp_path):
    port = free_port()
    (tmp_path / "hover.toml").write_text(SHORT_HOVER)
    vehicle = HandMadeVehicle(f"udpout:127.0.0.1:{port}")
    daemon = Program("fly", tmp_path / "hover.toml", "--vehicle", CRAZYFLIE, "--connect", f"udpin:127.0.0.1:{port}",
                     "--system", 1, "--log-dir", tmp_path)
    stop, sent = threading.Event(), [0]
    flooder = threading.Thread(target=flood, args=(port, stop, sent))
    try:
        deadline = time.monotonic() + 30
        while not vehicle.setpoints and time.monotonic() < deadline:
            time.sleep(0.05)
        flooder.start()
        code = daemon.process.wait(timeout=90)
    finally:
        stop.set()
        if flooder.ident:
            flooder.join()
        vehicle.stop()
        if daemon.process.poll() is None:
            daemon.process.kill()
            daemon.process.wait()
    assert code == 0, "\n".join(daemon.lines)
    assert sent[0] > RATE_HZ
