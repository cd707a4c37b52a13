"""Untrusted files cost bounded time and memory: lengths of 2^63, a nesting depth of a million, sparse
gigabytes of zeros, and decompression bombs."""

import json
import os
import resource
import struct
import zlib

import pytest

from conftest import CRAZYFLIE, SHORT_HOVER

# Address space of the whole process, including its code and its threads' stacks.
MEMORY = 1 << 30
CPU_S = 20
DEPTH = 1_000_000
HUGE = 1 << 63
SPARSE = 8 << 30


def set_limits():
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))


def exits(program, *arguments, codes=(2,), words=()):
    """The command exits with one of the codes, and not through a signal, a panic or lack of memory."""
    one = program(*arguments, preexec_fn=set_limits)
    code, _ = one.finish(120)
    assert code in codes, (code, one.err)
    assert "panicked" not in one.err, one.err
    assert "Usage:" not in one.err, one.err
    for word in words:
        assert word in one.err, one.err


def sparse(path, head=b""):
    with open(path, "wb") as file:
        file.write(head)
        file.truncate(SPARSE)
    return path


# --- logs ---------------------------------------------------------------------------------------

MAGIC = b"\x89MCAP0\r\n"


def record(opcode, body, length=None):
    return bytes([opcode]) + struct.pack("<Q", len(body) if length is None else length) + body


def text(value):
    return struct.pack("<I", len(value)) + value


def zeros(count):
    """A zstd frame of `count` zeros in run-length blocks: 4 bytes for each 128 KiB."""
    run = 1 << 17
    blocks = [run] * (count // run)
    frame = b"\x28\xb5\x2f\xfd" + b"\x00" + b"\x58"
    for number, size in enumerate(blocks):
        is_last = number + 1 == len(blocks)
        frame += struct.pack("<I", is_last | 1 << 1 | size << 3)[:3] + b"\x00"
    return frame


def chunk(packed, size, compression=b"zstd"):
    return record(6, struct.pack("<QQQI", 0, 1, size, 0) + text(compression) + struct.pack("<Q", len(packed)) + packed)


def mcap(*records):
    return MAGIC + record(1, text(b"") + text(b"")) + b"".join(records)


def dataflash(name=b"BIG\0", length=255):
    head = b"\xa3\x95\x80"
    layout = struct.pack("<BB4s16s64s", 0x80, 89, b"FMT\0", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    other = struct.pack("<BB4s16s64s", 0x81, length, name, b"Q" * 16, b"TimeUS" + b",A" * 15)
    return head + layout + head + other


ULOG = b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", HUGE)


def ulog(*messages):
    return ULOG + b"".join(struct.pack("<HB", len(body), ord(kind)) + body for kind, body in messages)


def heartbeat_at(stamp):
    body = struct.pack("<IBBBBB", 0, 2, 3, 0, 4, 3)
    crc = 0xFFFF
    frame = bytes([9, 0, 1, 1, 0]) + body
    for byte in frame + bytes([50]):
        low = (byte ^ crc) & 0xFF
        low = (low ^ (low << 4)) & 0xFF
        crc = (crc >> 8) ^ (low << 8) ^ (low << 3) ^ (low >> 4)
    return struct.pack(">Q", stamp) + b"\xfe" + frame + struct.pack("<H", crc)


LOGS = {
    "record.mcap": mcap(record(5, b"abc", HUGE)),
    "chunk.mcap": mcap(record(6, b"abc", HUGE)),
    "attachment.mcap": mcap(record(9, struct.pack("<QQ", 0, 0) + text(b"a") + text(b"b") + struct.pack("<Q", HUGE))),
    "zeros.mcap": mcap(chunk(zeros(16 << 30), 16 << 30)),
    "lying.mcap": mcap(chunk(zeros(16 << 30), 1 << 20)),
    "claim.mcap": mcap(chunk(zeros(1 << 20), HUGE)),
    "lz4.mcap": mcap(chunk(b"\x04\x22\x4d\x18\x60\x40\x82" + struct.pack("<I", HUGE >> 32) + b"\0" * 64, HUGE, b"lz4")),
    "topics.mcap": mcap(*(record(4, struct.pack("<HH", n, 0) + text(b"/%d" % n) + text(b"x") + text(b"")) for n in range(65535))),
    "appended.ulg": ulog(("B", bytes(8) + b"\x01" + bytes(7) + struct.pack("<QQQ", HUGE, HUGE - 1, 1))),
    "array.ulg": ulog(("F", b"big:uint64_t[9223372036854775807] a;uint8_t[4294967295] b;"), ("A", b"\0\0\0big"), ("D", b"\0\0" + bytes(65000))),
    "nested.ulg": ulog(("F", b"a:a[1000000] a;"), ("F", b"b:c b;"), ("F", b"c:b c;"), ("A", b"\0\0\0a"), ("A", b"\0\1\0b"), ("D", b"\0\0" + bytes(60))),
    "length.bin": dataflash(),
    "zero.bin": dataflash(length=0) + b"\xa3\x95\x81" * 100_000,
    "stamps.tlog": heartbeat_at(1) + heartbeat_at(HUGE) + heartbeat_at(2**64 - 1) + heartbeat_at(0),
    "columns.csv": b"t" + b",a" * 1_000_000 + b"\n" + b"0" + b",1" * 1_000_000 + b"\n",
    "quote.csv": b't,x\n0,1\n1,"' + b"a" * 5_000_000,
}


@pytest.mark.parametrize("name", LOGS)
def test_hostile_logs(program, tmp_path, name):
    path = tmp_path / name
    path.write_bytes(LOGS[name])
    # Some are empty and some have a little readable data; files that are no log are refused.
    codes = (0, 1, 2, 5, 10)
    exits(program, "log", "import", path, "--out", tmp_path / "out", codes=codes)
    if name.endswith(".mcap"):
        exits(program, "log", "info", path, codes=codes)
    exits(program, "log", "audit", path, codes=codes)


HEADS = {"a.mcap": MAGIC, "a.ulg": ULOG, "a.bin": dataflash(), "a.csv": b"t,x\n0,1\n"}


@pytest.mark.parametrize("name", HEADS)
def test_headers_followed_by_zeros(program, tmp_path, name):
    """A log's header, then zeros, which start no record."""
    path = tmp_path / name
    with open(path, "wb") as file:
        file.write(HEADS[name])
        file.truncate(16 << 20)
    exits(program, "log", "import", path, "--out", tmp_path / "out", codes=(0, 1, 2, 5, 10))


# --- models -------------------------------------------------------------------------------------


def zipped():
    """A zip archive of one file of zeros that is larger than the memory; its checksum is wrong."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    size, part = 2 * MEMORY, 1 << 20
    packed = (packer.compress(bytes(part)) + packer.flush(zlib.Z_FULL_FLUSH)) * (size // part) + packer.flush()
    name = b"weights.npy"
    # Version, flags, deflate, time and date, checksum, both sizes, lengths of the name and of nothing.
    fields = struct.pack("<HHHHHIIIHH", 20, 0, 8, 0, 0, 0, len(packed), size, len(name), 0)
    file = b"PK\x03\x04" + fields + name + packed
    entry = b"PK\x01\x02" + struct.pack("<H", 20) + fields + bytes(14) + name
    return file + entry + b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(entry), len(file), 0)


def safetensors(header, length=None):
    return struct.pack("<Q", len(header) if length is None else length) + header


MODELS = {
    "zip": zipped,
    "length": lambda: safetensors(b"{}", HUGE),
    "depth": lambda: safetensors(b'{"a":' + b"[" * DEPTH),
    "inner": lambda: safetensors(json.dumps({"__metadata__": {"downwash": '{"format":' + "[" * DEPTH}}).encode()),
    "shape": lambda: safetensors(
        json.dumps({"w": {"dtype": "F64", "shape": [HUGE, HUGE], "data_offsets": [0, HUGE]}}).encode()
    ),
    "names": lambda: safetensors(
        json.dumps({str(n): {"dtype": "F64", "shape": [0], "data_offsets": [0, 0]} for n in range(200_000)}).encode()
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_hostile_models(program, tmp_path, name):
    path = tmp_path / "model.safetensors"
    path.write_bytes(MODELS[name]())
    exits(program, "model", "info", path, words=["model.safetensors"])


# --- text files ---------------------------------------------------------------------------------


def deep_toml(key="a"):
    return f"{key} = " + "[" * DEPTH + "]" * DEPTH


def dotted_toml():
    return ".".join("a" * DEPTH) + " = 1"


def deep_json(key="mass"):
    return f'{{"{key}": ' + "[" * DEPTH + "]" * DEPTH + "}"


TEXTS = {"deep": deep_toml, "dotted": dotted_toml, "json": deep_json, "sparse": None, "tables": lambda: "[" + ".".join("a" * DEPTH) + "]\nb = 1"}


@pytest.fixture(params=TEXTS)
def hostile_file(request, tmp_path):
    """Writes hostile text of one kind to a file of a given name."""

    def make(name):
        path = tmp_path / name
        if TEXTS[request.param] is None:
            return sparse(path, b"# ")
        path.write_text(TEXTS[request.param]())
        return path

    return make


def test_hostile_vehicle_files(program, hostile_file):
    for name in ("vehicle.toml", "vehicle.json"):
        exits(program, "sitl", "--vehicle", hostile_file(name), "--link", "udpin:127.0.0.1:0", words=[name])


def test_hostile_trajectory_files(program, hostile_file, tmp_path):
    arguments = ["--vehicle", CRAZYFLIE, "--connect", "udpout:127.0.0.1:9", "--log-dir", tmp_path]
    for name in ("trajectory.toml", "trajectory.csv", "plan.json"):
        exits(program, "fly", hostile_file(name), *arguments, words=[name])


def test_hostile_effects_files(program, hostile_file):
    path = hostile_file("effects.toml")
    exits(program, "sitl", "--vehicle", CRAZYFLIE, "--link", "udpin:127.0.0.1:0", "--effect", f"@{path}", words=["effects.toml"])


def test_hostile_configurations(program, hostile_file):
    path = hostile_file("downwash.toml")
    exits(program, "daemon", "--config", path, words=["downwash.toml"])
    exits(program, "sitl", "--vehicle", CRAZYFLIE, "--link", "udpin:127.0.0.1:0", "--config", path, words=["downwash.toml"])


def test_hostile_sweep_manifests(program, hostile_file, tmp_path):
    exits(program, "sweep", hostile_file("manifest.toml"), "--out", tmp_path / "out", words=["manifest.toml"])


def test_hostile_campaign_scripts(program, hostile_file):
    for name in ("script.json", "script.toml"):
        exits(program, "campaign", "--script", hostile_file(name), words=[name])


def test_hostile_mappings(program, hostile_file, tmp_path):
    table = tmp_path / "flight.csv"
    table.write_text("t,x\n0,1\n1,2\n")
    path = hostile_file("mapping.toml")
    exits(program, "log", "import", table, "--mapping", path, "--out", tmp_path / "out", words=["mapping.toml"])


LAWS = {
    "depth": "(" * DEPTH + "tilt" + ")" * DEPTH,
    "chain": "tilt" + "+tilt" * (DEPTH // 2),
    "powers": "tilt" + "^tilt" * (DEPTH // 2),
    "number": "9" * DEPTH,
}


@pytest.mark.parametrize("name", LAWS)
def test_hostile_laws(program, tmp_path, name):
    path = tmp_path / "vehicle.toml"
    path.write_text(CRAZYFLIE.read_text() + f'\n[[laws]]\nname = "wide"\nthrust = "{LAWS[name]}"\n')
    exits(program, "sitl", "--vehicle", path, "--link", "udpin:127.0.0.1:0", words=["vehicle.toml"])


TRAJECTORIES = {
    "long": "family = 'hover'\naltitude_m = 0.8\nduration_s = 1e300\n",
    "many": SHORT_HOVER.replace("hover", "steps") + "offsets = [" + "[0.0, 0.0, 0.0, 0.0]," * 200_000 + "]\n",
    "fast": "family = 'figure-8'\naltitude_m = 1.0\nduration_s = 8000.0\nlength_m = 1.0\nwidth_m = 1.0\nperiod_s = 1e-300\nclimb_m = 0.3\n",
}


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_trajectories_of_extreme_size(program, tmp_path, name):
    path = tmp_path / "trajectory.toml"
    path.write_text(TRAJECTORIES[name])
    arguments = ["--vehicle", CRAZYFLIE, "--connect", "udpout:127.0.0.1:9", "--log-dir", tmp_path]
    exits(program, "fly", path, *arguments, codes=(2, 4), words=["trajectory.toml"])


def test_the_memory_limit_catches_an_unbounded_read(program, tmp_path):
    """A sparse file of 8 GiB takes no disk space, and a process limited to 1 GiB cannot read it whole."""
    path = sparse(tmp_path / "zeros")
    assert os.stat(path).st_blocks * 512 < 1 << 20
    with pytest.raises(MemoryError):
        # Reads the whole file, as an unbounded program would.
        before = resource.getrlimit(resource.RLIMIT_AS)
        try:
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, before[1]))
            path.read_bytes()
        finally:
            resource.setrlimit(resource.RLIMIT_AS, before)
