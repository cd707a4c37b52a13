"""`downwash log import`: tables and telemetry logs become logs that other tools read."""

import json
import math
import os
import signal
import subprocess

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from conftest import CRAZYFLIE, DOWNWASH, MOTION_CAPTURE, MOTION_CAPTURE_COLUMNS

pytestmark = pytest.mark.computes


def run(*arguments):
    command = DOWNWASH + ["log", "import", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def messages(path):
    """Topic, log time and content of every message."""
    with open(path, "rb") as log:
        reader = make_reader(log, decoder_factories=[DecoderFactory()])
        return [(c.topic, m.log_time, content) for _, c, m, content in reader.iter_decoded_messages()]


def write_table(path, rows=100):
    lines = [MOTION_CAPTURE_COLUMNS]
    for row in range(rows):
        t = 0.01 * row
        half = 0.1 * t
        cells = [t, 1 + t, 2, 3, 1, 0, 0, 0, 0, math.sin(half), math.cos(half), 0, 0, 0.2]
        lines.append(",".join(map(str, cells + [0.4, 0.5, 0.6, 0.7, 11.1])))
    path.write_text("\n".join(lines) + "\n")


def test_a_table_imports_as_a_readable_mcap_log(tmp_path):
    table, out = tmp_path / "flight.csv", tmp_path / "flight.mcap"
    write_table(table)
    done = run(table, "--mapping", MOTION_CAPTURE, "-o", out, "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["schema"] == "downwash.log.import" and summary["left_out"] == []
    streams = {stream["stream"]: stream for stream in summary["streams"]}
    assert streams["attitude"]["samples"] == 100
    assert abs(streams["outputs"]["rate_hz"] - 100) < 0.1
    assert streams["setpoint"]["samples"] == 0

    topics = {}
    for topic, _, content in messages(out):
        topics.setdefault(topic, []).append(content)
    assert len(topics["/flight/attitude"]) == 100
    position = topics["/flight/position"][50]
    # North, west, up in the table; north, east, down in the log.
    assert (position.p_n_m, position.p_e_m, position.p_d_m) == (1.5, -2, -3)
    assert abs(position.time_s - 0.5) < 1e-12
    assert abs(topics["/flight/attitude"][99].q_z + math.sin(0.099)) < 1e-12
    assert topics["/flight/outputs"][0].output_4 == 0.7
    assert topics["/flight/voltage"][0].voltage_v == 11.1


def test_reimporting_a_log_changes_nothing(tmp_path):
    table, first, second = (tmp_path / name for name in ("a.csv", "b.mcap", "c.mcap"))
    write_table(table)
    assert run(table, "--mapping", MOTION_CAPTURE, "-o", first).returncode == 0
    done = run(first, "-o", second, "--json")
    assert done.returncode == 0, done.stderr
    bodies = [
        [(topic, time, content.SerializeToString()) for topic, time, content in messages(path)]
        for path in (first, second)
    ]
    assert bodies[0] == bodies[1]


def test_import_errors_name_the_file(tmp_path):
    table, out = tmp_path / "flight.csv", tmp_path / "flight.mcap"
    write_table(table)
    done = run(table, "-o", out)
    assert done.returncode == 2 and "--mapping" in done.stderr and "flight.csv" in done.stderr
    mapping = tmp_path / "map.toml"
    mapping.write_text(MOTION_CAPTURE.read_text().replace('world_frame = "nwu"', ""))
    done = run(table, "--mapping", mapping, "-o", out)
    assert done.returncode == 2 and "world_frame" in done.stderr and "map.toml" in done.stderr
    noise = tmp_path / "noise.tlog"
    noise.write_bytes(bytes(range(256)) * 10)
    done = run(noise, "-o", out)
    assert done.returncode == 2 and "not a flight log" in done.stderr
    done = run(table, "--mapping", MOTION_CAPTURE, "-o", table)
    assert done.returncode == 2 and table.read_text().startswith(MOTION_CAPTURE_COLUMNS)
    assert not out.exists()


def test_proposed_and_shipped_mappings_import(tmp_path):
    table, out, mapping = tmp_path / "flight.csv", tmp_path / "flight.mcap", tmp_path / "map.toml"
    write_table(table)
    done = run("--propose", table)
    assert done.returncode == 0 and "CHECK" in done.stdout, done.stderr
    mapping.write_text(done.stdout)
    done = run(table, "--mapping", mapping, "-o", out, "--json")
    assert done.returncode == 0, done.stderr
    streams = {stream["stream"]: stream["samples"] for stream in json.loads(done.stdout)["streams"]}
    assert streams["attitude"] == streams["outputs"] == streams["voltage"] == 100
    # A shipped mapping by its name, from any folder.
    done = run(table, "--mapping", "motion-capture", "-o", out)
    assert done.returncode == 0, done.stderr
    done = run(table)
    assert done.returncode == 2 and "--out" in done.stderr


def test_files_without_a_flight_are_refused_with_the_reason(tmp_path):
    from mcap.writer import Writer

    out = tmp_path / "out.mcap"
    for encoding, schema_encoding in [("json", "jsonschema"), ("cdr", "ros2msg"), ("ros1", "ros1msg")]:
        other = tmp_path / "other.mcap"
        with open(other, "wb") as file:
            writer = Writer(file)
            writer.start()
            schema = writer.register_schema("nav_msgs/Odometry", schema_encoding, b"{}")
            channel = writer.register_channel("/odom", encoding, schema)
            for step in range(50):
                writer.add_message(channel, log_time=step, publish_time=step, data=b"{}")
            writer.finish()
        for command in (["import", other, "-o", out], ["audit", other]):
            done = subprocess.run(
                DOWNWASH + ["log", *map(str, command)], capture_output=True, text=True, timeout=60
            )
            assert done.returncode == 2 and done.stdout == "", done.stdout
            assert "other.mcap" in done.stderr and "it has /odom" in done.stderr, done.stderr
    table = tmp_path / "flight.csv"
    write_table(table)
    lines = table.read_text().splitlines()
    table.write_text("\n".join([lines[0]] + [line + ",7" for line in lines[1:]]))
    done = run(table, "--mapping", MOTION_CAPTURE, "-o", out)
    assert done.returncode == 2 and "20 cells where the header has 19" in done.stderr, done.stderr
    assert not out.exists()


def test_an_audit_of_several_logs_names_the_bad_one(tmp_path):
    table, empty = tmp_path / "flight.csv", tmp_path / "empty.tlog"
    write_table(table)
    empty.write_bytes(b"")
    command = ["log", "audit", table, empty, "--mapping", "motion-capture"]
    done = subprocess.run(DOWNWASH + [*map(str, command)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "empty.tlog" in done.stderr and "an empty file" in done.stderr
    assert "flight.csv" in done.stdout


def test_slow_reads_report_progress(program, tmp_path):
    # A pipe that nobody writes to stands in for a very large file.
    pipe = tmp_path / "flight.ulg"
    os.mkfifo(pipe)
    for command in (["log", "audit"], ["log", "info"], ["onset", "--vehicle", CRAZYFLIE]):
        one = program(*command, pipe)
        with pipe.open("wb"):
            one.says("... ", timeout=5.0)
            one.says("so far", timeout=5.0)
            one.signal(signal.SIGTERM)
            assert one.finish(10)[0] == 130, one.err
