"""Every kind of log that downwash writes opens in the programs that the README names.

`rerun` comes with rerun-sdk, and Python's reader with mcap; a missing one fails these tests.
"""

import signal
import struct
import subprocess
from concurrent.futures import ThreadPoolExecutor

import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from conftest import (
    CRAZYFLIE,
    DOWNWASH,
    SHORT_HOVER,
    Program,
    Sitl,
    fly_arguments,
    free_port,
    hover_for,
    only_log,
    python_tool,
)
from hand_made_vehicle import OFFBOARD, HandMadeVehicle

# One xdist worker makes the logs for all.
pytestmark = pytest.mark.xdist_group("readers")

KINDS = ["demo", "collect", "fly", "daemon", "import", "table", "killed"]
# Topics in the log of any flight.
FLOWN = {"/mavlink/rx", "/state", "/setpoint", "/control", "/tf", "/vehicle/pose"}
STREAMS = {"/flight/attitude", "/flight/position", "/flight/velocity"}
MAPPING = """
world_frame = "ned"
body_frame = "frd"
[time]
column = "t"
unit = "s"
[position]
columns = ["x", "y", "z"]
unit = "m"
[attitude]
quaternion = ["w", "i", "j", "k"]
order = "wxyz"
rotates = "body_to_world"
[velocity]
columns = ["vx", "vy", "vz"]
unit = "m/s"
axes = "world"
"""


def run(*arguments):
    done = subprocess.run([*map(str, arguments)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done


def flown(folder, landing, kill):
    """The log of a flight over a link; with `kill`, of one whose program was killed in flight."""
    trajectory = folder / "hover.toml"
    trajectory.write_text(hover_for(30) if kill else SHORT_HOVER)
    vehicle = Sitl(CRAZYFLIE, ["udpin:127.0.0.1:0"], landing)
    program = Program(*fly_arguments(trajectory, vehicle.peer_url(), folder))
    try:
        if kill:
            program.says(" track: ")
            program.signal(signal.SIGKILL)
        assert program.finish()[0] == (-signal.SIGKILL if kill else 0), program.err
    finally:
        program.close()
        vehicle.stop()
    return only_log(folder)


def from_the_daemon(folder):
    trajectory, settings = folder / "hover.toml", folder / "daemon.toml"
    trajectory.write_text(SHORT_HOVER)
    port = free_port()
    settings.write_text(
        f"vehicle = '{CRAZYFLIE}'\ntrajectory = '{trajectory}'\nconnect = 'udpin:127.0.0.1:{port}'\n"
        f"log_dir = '{folder}'\n"
    )
    vehicle = HandMadeVehicle(f"udpout:127.0.0.1:{port}")
    daemon = Program("daemon", "--config", settings)
    try:
        line = daemon.says(" standby: ")
        vehicle.set_mode(OFFBOARD)
        line = daemon.says(" arm: ", line)
        vehicle.armed = True
        line = daemon.says(" done: ", line)
        daemon.says(" standby: ", line)
        daemon.signal(signal.SIGTERM)
        assert daemon.finish()[0] == 0, daemon.err
    finally:
        daemon.close()
        vehicle.stop()
    return only_log(folder)


def from_a_table(folder):
    table, mapping, out = folder / "flight.csv", folder / "map.toml", folder / "flight.mcap"
    rows = [f"{0.01 * row:.2f},{0.1 * row:.1f},0,-1,1,0,0,0,10,0,0" for row in range(40)]
    table.write_text("\n".join(["t,x,y,z,w,i,j,k,vx,vy,vz", *rows]) + "\n")
    mapping.write_text(MAPPING)
    run(*DOWNWASH, "log", "import", table, "--mapping", mapping, "-o", out)
    return out


@pytest.fixture(scope="module")
def logs(tmp_path_factory, quick_landing):
    """A log of each kind."""
    folder = {kind: tmp_path_factory.mktemp(kind) for kind in KINDS}
    hover = tmp_path_factory.mktemp("trajectory") / "hover.toml"
    hover.write_text(SHORT_HOVER)
    # The shortest flights: the readers below take seconds for each of flight.
    run(*DOWNWASH, "demo", "--fly", "model-free", "--trajectory", hover, "--out", folder["demo"])
    run(*DOWNWASH, "collect", "--out", folder["collect"], "--seconds", 32)
    logs = {kind: sorted(folder[kind].glob("**/*.mcap"))[0] for kind in ("demo", "collect")}
    with ThreadPoolExecutor() as at_once:
        whole = at_once.submit(flown, folder["fly"], quick_landing, kill=False)
        killed = at_once.submit(flown, folder["killed"], quick_landing, kill=True)
        daemon = at_once.submit(from_the_daemon, folder["daemon"])
    logs |= {"fly": whole.result(), "killed": killed.result(), "daemon": daemon.result()}
    logs["import"] = folder["import"] / "flight.mcap"
    run(*DOWNWASH, "log", "import", logs["demo"], "-o", logs["import"])
    logs["table"] = from_a_table(folder["table"])
    return logs


def expected(kind):
    return STREAMS if kind in ("import", "table") else FLOWN


def recovery(kind):
    return ["--recover"] if kind == "killed" else []


@pytest.mark.parametrize("kind", KINDS)
def test_rerun_check_passes(logs, kind):
    done = run(python_tool("rerun"), "mcap", "check", "--full", *recovery(kind), logs[kind])
    rows = [line.split() for line in done.stdout.splitlines()]
    states = {row[3]: row[0] for row in rows if len(row) > 3 and row[3].startswith("/")}
    assert expected(kind) <= states.keys(), done.stdout
    assert set(states.values()) == {"ok"}, done.stdout


@pytest.mark.parametrize("kind", KINDS)
def test_rerun_converts_every_kind(logs, kind, tmp_path):
    out = tmp_path / "flight.rrd"
    done = run(python_tool("rerun"), "mcap", "convert", *recovery(kind), logs[kind], "-o", out)
    output = done.stdout + done.stderr
    assert "ERROR" not in output and all(topic in output for topic in expected(kind)), output
    # Not much smaller than its source.
    assert out.stat().st_size > logs[kind].stat().st_size / 2


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "killed"])
def test_python_decodes_every_message(logs, kind):
    with logs[kind].open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        stated = reader.get_summary().statistics
        decoded = [channel.topic for _, channel, _, _ in reader.iter_decoded_messages()]
        names = {attachment.name for attachment in reader.iter_attachments()}
        runs = [metadata for metadata in reader.iter_metadata() if metadata.name == "run"]
    assert len(decoded) == stated.message_count
    assert expected(kind) <= set(decoded)
    assert runs and (kind == "table" or names)


def test_python_reads_a_killed_log_to_its_last_chunk(logs):
    decoders, topics = {}, {}
    schemas, found = {}, {}
    with logs["killed"].open("rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                assert not isinstance(record, Chunk)
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    topics[record.id] = record.topic
                    schema = schemas[record.schema_id]
                    decoders[record.id] = DecoderFactory().decoder_for(record.message_encoding, schema)
                elif isinstance(record, Message):
                    assert decoders[record.channel_id](record.data) is not None
                    found[topics[record.channel_id]] = found.get(topics[record.channel_id], 0) + 1
        except (EndOfFile, struct.error):
            pass  # the log ends where the process was killed
    assert FLOWN <= found.keys() and found["/state"] > 100
