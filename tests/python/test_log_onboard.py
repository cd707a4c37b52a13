"""`downwash log import` of PX4 and ArduPilot logs, against those projects' own readers."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from pymavlink import DFReader
from pyulog import ULog

from conftest import DOWNWASH, ROOT

pytestmark = pytest.mark.computes

PRACTICE = Path(os.environ.get("DOWNWASH_PRACTICE", ROOT / "../shared/practice-autopilot"))
ULOGS = sorted(PRACTICE.glob("*/*.ulg"))
DATAFLASHES = sorted(PRACTICE.glob("*/*.BIN"))
ABSENT = "no practice flights of autopilots; set DOWNWASH_PRACTICE to their folder"


def imported(path, tmp_path):
    """Summary of the import, and each topic's columns."""
    out = tmp_path / "flight.mcap"
    command = DOWNWASH + ["log", "import", str(path), "-o", str(out), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    rows = {}
    with open(out, "rb") as log:
        reader = make_reader(log, decoder_factories=[DecoderFactory()])
        for _, channel, _, content in reader.iter_decoded_messages():
            fields = [field.name for field in content.DESCRIPTOR.fields]
            rows.setdefault(channel.topic, []).append([getattr(content, name) for name in fields])
    return json.loads(done.stdout), {topic: np.array(table, float) for topic, table in rows.items()}


def assert_close(found, expected, most):
    assert found.shape == expected.shape
    assert np.nanmax(np.abs(found - expected)) < most


@pytest.mark.skipif(not ULOGS, reason=ABSENT)
@pytest.mark.parametrize("path", ULOGS, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_ulog_import_matches_pyulog(path, tmp_path):
    summary, topics = imported(path, tmp_path)
    assert summary["format"] == "ulog" and summary["tier"] == "T2"
    assert "PX4" in summary["vehicle"]["autopilot"]
    log = ULog(str(path))
    data = {d.name: d.data for d in log.data_list if d.multi_id == 0}

    def columns(topic, *names):
        return np.column_stack([np.asarray(data[topic][name], float) for name in names])

    attitude = columns("vehicle_attitude", *(f"q[{i}]" for i in range(4)))
    assert_close(topics["/flight/attitude"][:, 0], data["vehicle_attitude"]["timestamp_sample"] * 1e-6, 1e-9)
    assert_close(topics["/flight/attitude"][:, 1:], attitude, 1e-6)
    assert_close(topics["/flight/position"][:, 1:], columns("vehicle_local_position", "x", "y", "z"), 1e-9)
    assert_close(topics["/flight/velocity"][:, 1:], columns("vehicle_local_position", "vx", "vy", "vz"), 1e-9)
    sensors = data["sensor_combined"]
    middle = sensors["timestamp"] * 1e-6 - 0.5e-6 * sensors["gyro_integral_dt"]
    assert_close(topics["/flight/body_rate"][:, 0], middle, 1e-9)
    assert_close(topics["/flight/body_rate"][:, 1:], columns("sensor_combined", *(f"gyro_rad[{i}]" for i in range(3))), 1e-9)
    force = columns("sensor_combined", *(f"accelerometer_m_s2[{i}]" for i in range(3)))
    assert_close(topics["/flight/specific_force"][:, 1:], force, 1e-9)
    outputs = columns("actuator_motors", *(f"control[{i}]" for i in range(4)))
    assert_close(topics["/flight/outputs"][:, 1:], np.nan_to_num(outputs), 1e-9)
    voltage = columns("battery_status", "voltage_v")
    assert_close(topics["/flight/voltage"][:, 1:], voltage[voltage[:, 0] > 0], 1e-9)


@pytest.mark.skipif(not DATAFLASHES, reason=ABSENT)
@pytest.mark.parametrize("path", DATAFLASHES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_dataflash_import_matches_dfreader(path, tmp_path):
    summary, topics = imported(path, tmp_path)
    assert summary["format"] == "dataflash"
    assert "ArduCopter" in summary["vehicle"]["autopilot"] and summary["vehicle"]["motors"] == 4
    wanted = {"ANG", "RATE", "IMU", "XKF1", "RCOU", "BAT"}
    rows, reader = {name: [] for name in wanted}, DFReader.DFReader_binary(str(path))
    while (message := reader.recv_match(type=list(wanted))) is not None:
        rows[message.get_type()].append(message)

    def columns(name, *fields, keep=lambda message: True):
        kept = [message for message in rows[name] if keep(message)]
        return np.array([[getattr(message, field) for field in ("TimeUS", *fields)] for message in kept], float)

    def check(topic, expected, scale=1.0, most=1e-9):
        assert_close(topics[topic][:, 0], expected[:, 0] * 1e-6, 1e-9)
        assert_close(topics[topic][:, 1:], expected[:, 1:] * scale, most)

    degree = np.pi / 180
    first = lambda message: message.C == 0  # noqa: E731
    check("/flight/position", columns("XKF1", "PN", "PE", "PD", keep=first))
    check("/flight/velocity", columns("XKF1", "VN", "VE", "VD", keep=first))
    check("/flight/body_rate", columns("RATE", "R", "P", "Y"), degree)
    check("/flight/specific_force", columns("IMU", "AccX", "AccY", "AccZ", keep=lambda m: m.I == 0))
    check("/flight/voltage", columns("BAT", "Volt"))
    pulses = columns("RCOU", "C1", "C2", "C3", "C4")
    pulses[:, 1:] = np.clip((pulses[:, 1:] - 1150) / 800, 0, 1)
    check("/flight/outputs", pulses, most=1e-6)
    _, w, x, y, z = topics["/flight/attitude"].T
    expected = columns("ANG", "Roll", "Pitch", "Yaw")
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - x * z), -1, 1))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    apart = np.column_stack([roll, pitch, yaw]) - expected[:, 1:] * degree
    assert np.max(np.abs((apart + np.pi) % (2 * np.pi) - np.pi)) < 1e-6
