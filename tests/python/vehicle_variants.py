"""Variants of the hand-made vehicle: other clocks, protocols, autopilots and types."""

import math
import time

from hand_made_vehicle import HOLD, LAND, OFFBOARD, HandMadeVehicle

COPTER_MODES = {HOLD: 17, LAND: 9, OFFBOARD: 4}


class VehicleVariant(HandMadeVehicle):
    """The hand-made vehicle with other traits, which hold from its first message."""

    def __init__(self, url, system=1, **traits):
        # Rate of its clock over real time; and when the clock stalls and for how long, in s.
        self.clock_rate = traits.pop("clock_rate", 1.0)
        self.stall = traits.pop("stall", (math.inf, 0.0))
        self.answers_timesync = traits.pop("answers_timesync", True)
        self.mode_from = traits.pop("mode_from", "CURRENT_MODE")
        self.state_from = traits.pop("state_from", "ODOMETRY")
        self.mavlink = traits.pop("mavlink", 2)
        self.autopilot = traits.pop("autopilot", 12)
        self.frame = traits.pop("frame", None)
        self.battery = traits.pop("battery", None)
        self.mav_type = traits.pop("mav_type", 2)
        assert not traits
        super().__init__(url)
        self.link.mav.srcSystem = system
        if self.autopilot == 3:
            self.params = {"GUID_OPTIONS": 8.0, "ATC_ANGLE_BOOST": 0.0, "GUID_TIMEOUT": 0.2, "FS_GCS_ENABLE": 5.0}
            self.params |= {"FS_GCS_TIMEOUT": 5.0, "SYSID_MYGCS": 254.0}
        if self.mavlink == 1:
            send = self.link.mav.send
            self.link.mav.send = lambda message, force_mavlink1=False: send(message, force_mavlink1=True)

    def _ns(self):
        elapsed = time.monotonic() - self._start
        at, lost = self.stall
        elapsed -= lost if elapsed > at + lost else max(0.0, elapsed - at)
        return int((5.0 + elapsed * self.clock_rate) * 1e9)

    def _custom_mode(self):
        return COPTER_MODES.get(self.mode, 0) if self.autopilot == 3 else self.mode

    def _send_heartbeat(self):
        base = 1 | (128 if self.armed else 0)
        self.link.mav.heartbeat_send(self.mav_type, self.autopilot, base, self._custom_mode(), 4 if self.armed else 3)
        if self.battery is not None:
            cells = [3700] + [65535] * 9
            self.link.mav.battery_status_send(0, 0, 1, 32767, cells, -1, -1, -1, self.battery)

    def _send_mode(self):
        if self.mode_from == "CURRENT_MODE":
            super()._send_mode()
        elif hasattr(self, "_stop"):
            self._send_heartbeat()

    def _handle(self, message):
        if message.get_type() == "TIMESYNC" and not self.answers_timesync:
            return
        if message.get_type() == "PARAM_REQUEST_READ" and self.autopilot == 3:
            name = message.param_id
            if name in self.params:
                self.link.mav.param_value_send(name.encode(), self.params[name], 9, len(self.params), 0)
            return
        super()._handle(message)

    def _command(self, message):
        if message.command == 176 and self.autopilot == 3:
            internal = {word: mode for mode, word in COPTER_MODES.items()}
            mode = internal[int(message.param2)]
            message.param2, message.param3 = mode >> 16 & 0xFF, mode >> 24
        super()._command(message)

    def _send_odometry(self):
        if self.frame is not None:
            unknown = [math.nan] * 21
            self.link.mav.odometry_send(
                self._ns() // 1000, self.frame, 12, *self.position, [1, 0, 0, 0], *self.velocity, 0, 0, 0, unknown, unknown, 0, 8, 100
            )
        elif self.state_from == "ODOMETRY":
            super()._send_odometry()
        else:
            roll, pitch, yaw = self.attitude
            ms = self._ns() // 1_000_000
            self.link.mav.attitude_send(ms, roll, pitch, yaw, 0.0, 0.0, 0.0)
            self.link.mav.local_position_ned_send(ms, *self.position, *self.velocity)
