"""A flight while 200 sockets send garbage and frames of other systems to the vehicle's port."""

import random
import socket
import threading
import time

from conftest import fly_arguments, until
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


def test_a_flooded_port_does_not_end_the_flight(program, hover, hand_made, tmp_path):
    vehicle, url = hand_made
    flight = program(*fly_arguments(hover, url, tmp_path, "--system", 1))
    until(lambda: vehicle.setpoints, "setpoints")
    stop, sent = threading.Event(), [0]
    flooder = threading.Thread(target=flood, args=(int(url.rsplit(":", 1)[1]), stop, sent))
    flooder.start()
    try:
        code, _ = flight.finish(90)
    finally:
        stop.set()
        flooder.join()
    assert code == 0, flight.err
    assert sent[0] > RATE_HZ
