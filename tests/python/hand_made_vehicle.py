"""A test vehicle on pymavlink that shares no code with the bundled one: a point mass whose attitude follows the
setpoint with a first-order lag, with as much of PX4's protocol as an offboard controller needs."""

import math
import os
import struct
import threading
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402
from pymavlink.dialects.v20 import all as dialect  # noqa: E402

MASS = 0.0343  # kg
GRAVITY = 9.80665
THRUST_MAX = 0.66  # N at thrust field 1
ATTITUDE_LAG_S = 0.12
OFFBOARD = 6 << 16
HOLD = 4 << 16 | 3 << 24
LAND = 4 << 16 | 6 << 24


class HandMadeVehicle:
    """Runs in its own thread until stopped, and records what it receives in public attributes."""

    def __init__(self, url, rate_hz=100):
        # An earlier test of this worker may have switched pymavlink to MAVLink 1, which has no CURRENT_MODE.
        os.environ["MAVLINK20"] = "1"
        mavutil.set_dialect("all")
        self.link = mavutil.mavlink_connection(url, source_system=1, source_component=1, dialect="all")
        self.rate_hz = rate_hz
        self.position = [0.0, 0.0, 0.0]
        self.velocity = [0.0, 0.0, 0.0]
        self.attitude = [0.0, 0.0, 0.0]  # roll, pitch, yaw
        self.thrust = 0.0
        self.armed = False
        self.mode = HOLD
        self.refuse_arming = False
        self.telemetry = True
        self.params = {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 4, "MPC_THR_HOVER": 0.51, "MIS_TAKEOFF_ALT": 2.5}
        self.masks = set()
        self.setpoints = []  # (time, thrust)
        self.commands = []  # (command, param1, param2)
        self.highest = 0.0
        self.beats = 0
        self.on_step = lambda vehicle, elapsed: None
        self._start = time.monotonic()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self):
        self._stop.set()
        self._thread.join(5)
        self.link.close()

    def set_mode(self, mode):
        self.mode = mode
        self._send_mode()

    # -- the loop ------------------------------------------------------------------------------

    def _run(self):
        tick, beat = time.monotonic(), 0.0
        while not self._stop.is_set():
            now = time.monotonic()
            if now >= beat:
                beat = now + 1.0
                self._send_heartbeat()
                self._send_mode()
                self._send_landed()
                self.beats += 1
            if now >= tick:
                tick += 1.0 / self.rate_hz
                self._step(1.0 / self.rate_hz)
                self.on_step(self, now - self._start)
                if self.telemetry:
                    self._send_odometry()
            try:
                message = self.link.recv_match(blocking=True, timeout=max(0.0, min(tick, beat) - time.monotonic()))
            except ConnectionError:
                message = None
            if message is not None:
                self._handle(message)

    def _step(self, dt):
        on_ground = self.position[2] >= 0.0
        live = self.setpoints and time.monotonic() - self.setpoints[-1][0] < 1.0
        if not self.armed:
            self.thrust = 0.0
        elif self.mode == LAND or not live and self.mode == OFFBOARD:
            self.attitude[0] = self.attitude[1] = 0.0
            self.thrust = MASS * (GRAVITY + 2.0 * (self.velocity[2] - 0.5))
        roll, pitch, yaw = self.attitude
        force = self.thrust / MASS
        acceleration = [
            -force * (math.cos(roll) * math.sin(pitch) * math.cos(yaw) + math.sin(roll) * math.sin(yaw)),
            -force * (math.cos(roll) * math.sin(pitch) * math.sin(yaw) - math.sin(roll) * math.cos(yaw)),
            GRAVITY - force * math.cos(roll) * math.cos(pitch),
        ]
        for axis in range(3):
            self.velocity[axis] += acceleration[axis] * dt - 0.2 * self.velocity[axis] * dt
            self.position[axis] += self.velocity[axis] * dt
        if self.position[2] > 0.0:
            self.position[2], self.velocity = 0.0, [0.0, 0.0, 0.0]
        self.highest = max(self.highest, -self.position[2])
        if self.armed and self.mode == LAND and on_ground:
            self.armed = False
            self._send_heartbeat()
            self._send_landed()

    def _handle(self, message):
        kind = message.get_type()
        mav = self.link.mav
        if kind == "SET_ATTITUDE_TARGET":
            self.masks.add(message.type_mask)
            self.setpoints.append((time.monotonic(), message.thrust))
            if self.mode == OFFBOARD and self.armed:
                w, x, y, z = message.q
                wanted = [
                    math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
                    math.asin(max(-1.0, min(1.0, 2 * (w * y - x * z)))),
                    math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
                ]
                gain = 1.0 / (self.rate_hz * ATTITUDE_LAG_S)
                for axis in range(3):
                    error = (wanted[axis] - self.attitude[axis] + math.pi) % (2 * math.pi) - math.pi
                    self.attitude[axis] += gain * error
                self.thrust = message.thrust * THRUST_MAX
        elif kind == "TIMESYNC" and message.tc1 == 0:
            mav.timesync_send(self._ns(), message.ts1)
        elif kind == "PARAM_REQUEST_READ":
            name = message.param_id
            if name in self.params:
                value = self.params[name]
                integer = isinstance(value, int)
                number = struct.unpack("<f", struct.pack("<i", value))[0] if integer else value
                mav.param_value_send(name.encode(), number, 6 if integer else 9, len(self.params), 0)
        elif kind == "COMMAND_LONG":
            self._command(message)

    def _command(self, message):
        mav, command = self.link.mav, message.command
        self.commands.append((command, message.param1, message.param2))
        result = 0
        if command == 400:
            if message.param1 == 1 and self.refuse_arming:
                mav.statustext_send(3, b"Arming denied: hand-made refusal")
                result = 1
            else:
                self.armed = message.param1 == 1
        elif command == 176:
            self.mode = int(message.param2) << 16 | int(message.param3) << 24
        elif command == 21:
            self.mode = LAND
        elif command == 512:
            if int(message.param1) == 148:
                mav.autopilot_version_send(0, 0x01110000, 0, 0, 0, bytes(8), bytes(8), bytes(8), 0, 0, 0)
        elif command != 511:
            result = 3
        mav.command_ack_send(command, result)
        self._send_mode()
        if command == 400:
            self._send_heartbeat()
            self._send_landed()

    # -- messages ------------------------------------------------------------------------------

    def _ns(self):
        return int((time.monotonic() - self._start + 5.0) * 1e9)

    def _send_heartbeat(self):
        base = 1 | (128 if self.armed else 0)
        self.link.mav.heartbeat_send(2, 12, base, self.mode, 4 if self.armed else 3)

    def _send_mode(self):
        self.link.mav.current_mode_send(0, self.mode, self.mode)

    def _send_landed(self):
        self.link.mav.extended_sys_state_send(0, 2 if self.position[2] < -0.05 else 1)

    def _send_odometry(self):
        roll, pitch, yaw = (0.5 * angle for angle in self.attitude)
        cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
        cy, sy = math.cos(yaw), math.sin(yaw)
        q = [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
        unknown = [math.nan] * 21
        frame = dialect.MAV_FRAME_LOCAL_NED
        self.link.mav.odometry_send(
            self._ns() // 1000, frame, frame, *self.position, q, *self.velocity, 0.0, 0.0, 0.0, unknown, unknown, 0, 8, 100
        )
