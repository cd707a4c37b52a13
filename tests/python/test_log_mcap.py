"""The flight log as Python's own MCAP reader sees it.

The log comes from `downwash demo` where DOWNWASH_BIN names the program, else from DOWNWASH_LOG.
"""

import math
import os
import pathlib
import subprocess

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

OWN = {
    "/mavlink/rx": "downwash.MavlinkFrame",
    "/mavlink/tx": "downwash.MavlinkFrame",
    "/state": "downwash.State",
    "/reference": "downwash.Reference",
    "/setpoint": "downwash.Setpoint",
    "/control": "downwash.Control",
    "/imu": "downwash.Imu",
    "/actuators": "downwash.Actuators",
    "/battery": "downwash.Battery",
    "/link/stats": "downwash.LinkStats",
    "/timesync": "downwash.Timesync",
    "/sim/truth": "downwash.Truth",
}
VIEWER = {
    "/tf": "foxglove.FrameTransform",
    "/vehicle/pose": "foxglove.PoseInFrame",
    "/reference/pose": "foxglove.PoseInFrame",
    "/scene": "foxglove.SceneUpdate",
    "/log": "foxglove.Log",
}


# One xdist worker makes the log for all.
pytestmark = [pytest.mark.computes, pytest.mark.xdist_group("log")]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    if program := os.environ.get("DOWNWASH_BIN"):
        out = tmp_path_factory.mktemp("demo")
        subprocess.run([program, "demo", "--fly", "model-free", "--out", str(out)], check=True, timeout=300)
        (path,) = out.glob("**/*.mcap")
        return path
    if path := os.environ.get("DOWNWASH_LOG"):
        return pathlib.Path(path)
    pytest.skip("neither DOWNWASH_BIN nor DOWNWASH_LOG is set")


@pytest.fixture(scope="module")
def messages(log):
    """Decoded messages by topic, each with its record."""
    topics = {}
    with log.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            topics.setdefault(channel.topic, []).append((message, decoded))
    return topics


def test_every_channel_is_protobuf_with_a_stable_schema_name(log):
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    found = {}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("protobuf", "protobuf")
        found[channel.topic] = schema.name
    assert found == OWN | VIEWER


def test_run_and_vehicle_file_are_in_the_log(log):
    with log.open("rb") as file:
        reader = make_reader(file)
        runs = [m.metadata for m in reader.iter_metadata() if m.name == "run"]
        attachments = {a.name: a.data for a in reader.iter_attachments()}
    assert {"tool_version", "vehicle", "source", "dialect", "frames", "units"} <= runs[0].keys()
    assert "config.toml" in attachments
    assert len(attachments) == 2


def test_state_has_unit_suffixes_and_a_unit_quaternion(messages):
    assert len(messages["/state"]) > 100
    for _, state in messages["/state"]:
        norm = math.hypot(state.q_w, state.q_x, state.q_y, state.q_z)
        assert norm == pytest.approx(1.0, abs=1e-6)
        assert state.q_w >= 0
        assert all(math.isfinite(v) for v in (state.p_n_m, state.v_e_mps, state.r_radps))


def test_viewer_pose_is_the_state_in_east_north_up(messages):
    states = {record.log_time: state for record, state in messages["/state"]}
    assert len(messages["/vehicle/pose"]) > 50
    for record, pose in messages["/vehicle/pose"]:
        state, position = states[record.log_time], pose.pose.position
        assert pose.frame_id == "map"
        assert (position.x, position.y, position.z) == (state.p_e_m, state.p_n_m, -state.p_d_m)
    children = {transform.child_frame_id for _, transform in messages["/tf"]}
    assert children == {"base_link", "base_link_ref"}


def test_frames_are_whole_mavlink_frames(messages):
    for topic in ("/mavlink/rx", "/mavlink/tx"):
        for _, frame in messages[topic]:
            assert frame.frame[0] in (0xFD, 0xFE)
            assert len(frame.frame) >= 8 + frame.frame[1]


def test_tracking_error_is_state_minus_reference(messages):
    states = {record.log_time: m for record, m in messages["/state"]}
    references = {record.log_time: m for record, m in messages["/reference"]}
    checked = 0
    for record, control in messages["/control"]:
        reference = references.get(record.log_time)
        if reference is None:
            assert math.isnan(control.error_3d_m)
            continue
        error = states[record.log_time].p_n_m - reference.p_n_m
        assert control.error_n_m == pytest.approx(error, abs=1e-12)
        checked += 1
    assert checked > 100


def test_times_ascend_and_samples_precede_their_arrival(messages):
    times = [record.log_time for record, _ in messages["/state"]]
    assert times == sorted(times)
    # Half a millisecond for the error of the clock offset.
    assert all(r.publish_time <= r.log_time + 500_000 for r, _ in messages["/state"])
