"""Attacks a signed MAVLink 2 link, at any peer that answers TIMESYNC.

    python tests/python/signing_conformance.py udpout:127.0.0.1:14580 --key FILE
    python tests/python/signing_conformance.py udpout:127.0.0.1:14540 --key FILE --role vehicle

Each attack is a TIMESYNC request with a unique number: a peer that answers has accepted it. In the role of a
station the script attacks vehicles (the bundled one, ArduCopter, PX4); in the role of a vehicle, the programs
that fly them (downwash). It builds its frames from the published layout, without a library's signing code.
Exit code 1: the peer accepted a frame that it had to refuse, or the reverse."""

import argparse
import hashlib
import json
import os
import struct
import sys
import time
from pathlib import Path

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402
from pymavlink.dialects.v20 import all as dialect  # noqa: E402
from pymavlink.generator.mavcrc import x25crc  # noqa: E402

SECOND = 100_000  # stamps
YEAR = 365 * 86_400 * SECOND
EPOCH_2015_S = 1_420_070_400
WAIT_S = 0.5


def stamp_now():
    return int((time.time() - EPOCH_2015_S) * SECOND)


def signed(frame, crc_extra, key, link, stamp):
    """The unsigned MAVLink 2 `frame` with the signing flag, its checksum and a signature."""
    body = bytearray(frame[:-2])
    body[2] |= 1
    body += struct.pack("<H", x25crc(bytes(body[1:]) + bytes([crc_extra])).crc)
    body += bytes([link]) + stamp.to_bytes(6, "little")
    return bytes(body) + hashlib.sha256(key + bytes(body)).digest()[:6]


class Attacker:
    """One end of a link, in possession of the key."""

    def __init__(self, url, key, role):
        self.key = key
        self.ids = (1, 1) if role == "vehicle" else (255, 190)
        self.role = role
        self.link = mavutil.mavlink_connection(url, source_system=self.ids[0], source_component=self.ids[1],
                                               dialect="all")
        self.mav = dialect.MAVLink(None, srcSystem=self.ids[0], srcComponent=self.ids[1])
        self.old = None
        self.nonce = 0x5160_0000
        self.stamp = stamp_now()
        self.beat = 0.0

    def next_stamp(self):
        self.stamp = max(self.stamp + 1, stamp_now())
        return self.stamp

    def packed(self, message, old=False):
        if old:
            # MAVLink 1, by its layout: TIMESYNC without its extension fields.
            payload = struct.pack("<qq", message.tc1, message.ts1)
            body = bytes([len(payload), self.mav.seq, *self.ids, message.get_msgId()]) + payload
            self.mav.seq = (self.mav.seq + 1) % 256
            crc = x25crc(body + bytes([message.crc_extra])).crc
            return b"\xfe" + body + struct.pack("<H", crc)
        frame = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256
        return frame

    def keep_alive(self):
        """Keeps the peer listening: one signed HEARTBEAT a second, with a separate link id."""
        if time.monotonic() < self.beat:
            return
        self.beat = time.monotonic() + 1.0
        beat = (dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3) if self.role == "vehicle"
                else dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        self.send(signed(self.packed(beat), beat.crc_extra, self.key, 200, self.next_stamp()))

    def send(self, frame):
        self.link.write(frame)

    def probe(self):
        """A new unsigned request, and its number."""
        self.nonce += 1
        return dialect.MAVLink_timesync_message(0, self.nonce), self.nonce

    def answered(self, nonce):
        """Whether the peer answers the request; drops other traffic."""
        until = time.monotonic() + WAIT_S
        while time.monotonic() < until:
            self.keep_alive()
            message = self.link.recv_match(type="TIMESYNC", blocking=True, timeout=0.05)
            if message is not None and message.ts1 == nonce and message.tc1 != 0:
                return True
        return False

    def accepted(self, key=None, link=1, stamp=None, change=None):
        """Whether the peer accepts a request with this signature; `change` edits the signed bytes."""
        message, nonce = self.probe()
        frame = signed(self.packed(message), message.crc_extra, key or self.key, link,
                       self.next_stamp() if stamp is None else stamp)
        self.old = frame
        self.send(change(frame) if change else frame)
        return self.answered(nonce)

    def wait_for_answer(self, timeout_s=15):
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            if self.accepted():
                return
        raise SystemExit("no answer to a correctly signed TIMESYNC: check the key and the URL")

    # -- the attacks: each returns whether the peer accepted its frame --------------------------

    def unsigned(self):
        message, nonce = self.probe()
        self.send(self.packed(message))
        return self.answered(nonce)

    def mavlink_1(self):
        message, nonce = self.probe()
        self.send(self.packed(message, old=True))
        return self.answered(nonce)

    def replay(self):
        message, nonce = self.probe()
        frame = signed(self.packed(message), message.crc_extra, self.key, 1, self.next_stamp())
        self.send(frame)
        if not self.answered(nonce):
            raise SystemExit("no answer to a correctly signed TIMESYNC")
        self.send(frame)
        return self.answered(nonce)

    def repeated_stamp(self):
        stamp = self.next_stamp()
        self.accepted(stamp=stamp)
        return self.accepted(stamp=stamp)

    def truncated(self):
        return self.accepted(change=lambda frame: frame[:-1])

    def stripped(self):
        """The signature removed, its flag kept."""
        return self.accepted(change=lambda frame: frame[:-13])

    def changed(self):
        """Another request under an old signature, with a new checksum."""
        message, nonce = self.probe()
        first = dialect.MAVLink_timesync_message(0, nonce ^ 0xFFFF)
        frame = bytearray(signed(self.packed(first), first.crc_extra, self.key, 1, self.next_stamp()))
        frame[18:26] = struct.pack("<q", nonce)
        end = 10 + frame[1]
        frame[end:end + 2] = struct.pack("<H", x25crc(bytes(frame[1:end]) + bytes([message.crc_extra])).crc)
        self.send(bytes(frame))
        return self.answered(nonce)

    def after_forgery(self):
        """A forged frame with a stamp an hour ahead must not lock out the true sender."""
        if not self.accepted(link=20):
            return False
        self.accepted(key=b"\x55" * 32, link=20, stamp=stamp_now() + 3600 * SECOND)
        return self.accepted(link=20)


# Name, whether the peer should accept the frame, and the attack.
ATTACKS = [
    ("signed, stamp of now", True, Attacker.accepted),
    ("no signature", False, Attacker.unsigned),
    ("MAVLink 1", False, Attacker.mavlink_1),
    ("another key", False, lambda a: a.accepted(key=b"\x55" * 32)),
    ("the same frame again", False, Attacker.replay),
    ("a stamp that does not advance", False, Attacker.repeated_stamp),
    ("a stamp of three seconds ago", False, lambda a: a.accepted(stamp=a.next_stamp() - 3 * SECOND)),
    ("a new link id, stamp of two minutes ago", False, lambda a: a.accepted(link=7, stamp=stamp_now() - 120 * SECOND)),
    ("a new link id, stamp of now", True, lambda a: a.accepted(link=8)),
    ("the first link again", True, Attacker.accepted),
    ("signature cut by a byte", False, Attacker.truncated),
    ("signature taken off, flag left", False, Attacker.stripped),
    ("content changed under its signature", False, Attacker.changed),
    ("true frame after a forged stamp an hour ahead", True, Attacker.after_forgery),
    # Last, because a peer that accepts this accepts nothing after it.
    ("a stamp five years ahead", False, lambda a: a.accepted(link=9, stamp=stamp_now() + 5 * YEAR)),
    ("a new link id after that, stamp of now", True, lambda a: a.accepted(link=10)),
]


def attack(url, key, role):
    """Runs all attacks; returns for each its name, the right result and the peer's."""
    attacker = Attacker(url, key, role)
    try:
        attacker.wait_for_answer()
        return [(name, right, bool(play(attacker))) for name, right, play in ATTACKS]
    finally:
        attacker.link.close()


def respond(url, key):
    """pymavlink as the attacked peer: answers each TIMESYNC request that its signing accepts. Runs until killed."""
    link = mavutil.mavlink_connection(url, source_system=1, source_component=1, dialect="all")
    link.setup_signing(key, sign_outgoing=True, allow_unsigned_callback=None,
                       initial_timestamp=stamp_now(), link_id=0)
    print("ready", flush=True)
    while True:
        message = link.recv_match(type="TIMESYNC", blocking=True, timeout=1.0)
        if message is not None and message.tc1 == 0:
            link.mav.timesync_send(time.time_ns(), message.ts1)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("url", help="pymavlink's: udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT")
    parser.add_argument("--key", required=True, type=Path, help="file of 64 hexadecimal digits")
    parser.add_argument("--role", choices=["station", "vehicle"], default="station", help="role of the attacker")
    parser.add_argument("--respond", action="store_true", help="act as the attacked peer, with pymavlink")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    key = bytes.fromhex(args.key.read_text().strip())
    if args.respond:
        return respond(args.url, key)
    results = attack(args.url, key, args.role)
    if args.json:
        print(json.dumps([{"attack": name, "right": right, "believed": was} for name, right, was in results]))
    else:
        for name, right, was in results:
            verdict = "ok" if was == right else "WRONG"
            print(f"{name:50} {'believed' if was else 'refused':9} {verdict}")
    return int(any(was != right for _, right, was in results))


if __name__ == "__main__":
    sys.exit(main())
