"""From simulated flights to a model: its file, report, predictions and ONNX as other tools see them."""

import csv
import json
import math
import signal
from types import SimpleNamespace

import numpy as np
import onnxruntime
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from safetensors import safe_open
from safetensors.numpy import load_file

from conftest import CRAZYFLIE, run

EFFECTS = ["rotor_drag:d_xy=0.012,d_z=0.008", "motor_lag:tau_s=0.05", "command_delay:delay_s=0.02"]
SMALL = ["--passes", "15", "--hidden", "20", "--regularization", "1e-5"]
PREDICTIONS = "run,start,h,x,y,z,vx,vy,vz,qw,qx,qy,qz,wx,wy,wz"

# One xdist worker flies and trains for all.
pytestmark = [pytest.mark.computes, pytest.mark.xdist_group("model"), pytest.mark.timeout(300)]


def train(out, logs, *more, vehicle=CRAZYFLIE, code=0):
    return run("train", "--vehicle", vehicle, *logs, "-o", out, *SMALL, *more, code=code)


@pytest.fixture(scope="session")
def flights(tmp_path_factory):
    """Logs of a short flight programme."""
    folder = tmp_path_factory.mktemp("flights")
    effects = [word for effect in EFFECTS for word in ("--effect", effect)]
    run("collect", "--out", folder, "--seconds", 60, *effects)
    return sorted(folder.glob("*.mcap"))


@pytest.fixture(scope="session")
def trained(flights, tmp_path_factory):
    """One model for each choice of features, and the report of the first."""
    folder = tmp_path_factory.mktemp("model")
    models = {features: folder / f"{features}.safetensors" for features in ("world", "heading", "body")}
    train(models["world"], flights, "--features", "world", "--report", folder / "report")
    train(models["heading"], flights[:2], "--features", "heading")
    train(models["body"], flights[:2], "--features", "body")
    return SimpleNamespace(world=models["world"], report=folder / "report", models=models)


def test_model_info_matches_the_training_report(trained):
    info = json.loads(run("model", "info", trained.world, "--json").stdout)
    assert (info["schema"], info["schema_version"]) == ("downwash.model_info", 1)
    assert info["vehicle"] == "crazyflie" and info["hidden"] == [20, 20]
    assert [len(names) for names in info["features"]] == [13, 15]
    assert info["training"]["schema"] == "downwash.training"
    assert len(info["training"]["data"]["logs"]) == 5
    assert all(len(log["sha256"]) == 64 for log in info["training"]["data"]["logs"])
    assert info["training"] == json.loads((trained.report / "report.json").read_text())
    text = run("model", "info", "--model", trained.world).stdout
    assert "normalised MSE" in text and "open loop" in text


def test_the_file_is_plain_safetensors(trained):
    with safe_open(trained.world, framework="numpy") as file:
        header = json.loads(file.metadata()["downwash"])
        assert header["format"] == "downwash.model" and header["version"] == 1
        assert file.get_tensor("net.nn1.hidden.weight").shape == (20, 13)
        assert file.get_tensor("residual.nn2.output.weight").shape == (3, 20)


def rotations(roll, pitch, yaw):
    """Matrices from body to world axes."""
    zero, one = np.zeros_like(yaw), np.ones_like(yaw)
    matrix = lambda rows: np.moveaxis(np.array(rows), -1, 0)
    about_z = matrix([[np.cos(yaw), -np.sin(yaw), zero], [np.sin(yaw), np.cos(yaw), zero], [zero, zero, one]])
    about_y = matrix([[np.cos(pitch), zero, np.sin(pitch)], [zero, one, zero], [-np.sin(pitch), zero, np.cos(pitch)]])
    about_x = matrix([[one, zero, zero], [zero, np.cos(roll), -np.sin(roll)], [zero, np.sin(roll), np.cos(roll)]])
    return about_z @ about_y @ about_x


def by_hand(weights, model, features, velocity, body_rate, attitude, control):
    """Both networks in numpy, from the file's tensors and the definition of the features."""
    turned = {"world": attitude * 0, "heading": attitude * [0, 0, 1], "body": attitude}[features]
    to_world = rotations(*turned.T)
    velocity = np.einsum("nij,ni->nj", to_world, velocity)
    angles = attitude if features == "world" else attitude[:, :2]
    tilt = np.hstack([np.sin(angles), np.cos(angles)])
    if features == "body":
        tilt = to_world[:, 2, :]
    results = []
    for name, inputs in (("nn1", control[:, :1]), ("nn2", control[:, 1:])):
        part = {key.split(".", 2)[2]: w.astype(float) for key, w in weights.items() if key.startswith(f"{model}.{name}.")}
        x = np.hstack([velocity, body_rate, tilt, inputs])
        x = (x - part["input_mean"]) / part["input_deviation"]
        hidden = np.maximum(x @ part["hidden.weight"].T + part["hidden.bias"], 0)
        y = hidden @ part["output.weight"].T + part["output.bias"]
        results.append(y * part["output_deviation"] + part["output_mean"])
    linear, angular = results
    return np.einsum("nij,nj->ni", to_world, linear), angular


@pytest.mark.parametrize("features", ["world", "heading", "body"])
@pytest.mark.parametrize("kind, model", [("net", "net"), ("hybrid", "residual")])
def test_onnx_matches_the_weights(trained, tmp_path, features, kind, model):
    path, onnx = trained.models[features], tmp_path / "model.onnx"
    run("model", "export", "--model", path, "--onnx", onnx, "--kind", kind)
    session = onnxruntime.InferenceSession(str(onnx), providers=["CPUExecutionProvider"])
    random = np.random.default_rng(1)
    count = 300
    points = {
        "velocity": random.normal(0, 1, (count, 3)),
        "body_rate": random.normal(0, 2, (count, 3)),
        "attitude": random.uniform(-1, 1, (count, 3)) * [0.4, 0.4, math.pi],
        "input": random.normal(0, 1, (count, 4)) * [0.05, 2e-4, 2e-4, 5e-5] + [0.3, 0, 0, 0],
    }
    points = {name: values.astype(np.float32) for name, values in points.items()}
    outputs = session.run(["linear_acceleration", "angular_acceleration"], points)
    columns = [points[name].astype(float) for name in ("velocity", "body_rate", "attitude", "input")]
    for found, expected in zip(outputs, by_hand(load_file(path), model, features, *columns)):
        assert found.shape == (count, 3)
        scale = np.abs(expected).max(axis=0)
        # A model that corrects nothing gives about 1e-308 here and 0 in single precision.
        assert (np.abs(found - expected) <= 1e-4 * scale + 1e-12).all()


def test_exporting_the_physics_model_is_refused(trained, tmp_path):
    done = run("model", "export", "--model", trained.world, "--onnx", tmp_path / "a.onnx", "--kind", "physics", code=2)
    assert "[possible values: net, hybrid]" in done.stderr and not (tmp_path / "a.onnx").exists()


def predictions(path):
    with open(path, newline="") as file:
        assert file.readline().strip() == PREDICTIONS
        rows = [(r[0], int(r[1]), int(r[2]), *map(float, r[3:])) for r in csv.reader(file)]
    return rows


def truth(log):
    """The messages of the simulator's truth."""
    with open(log, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [content for *_, content in reader.iter_decoded_messages(topics=["/sim/truth"])]


def test_predictions_start_at_every_sample(trained, flights, tmp_path):
    out = tmp_path / "predictions.csv"
    run("model", "predict", "--model", trained.world, flights[0], "--horizon", 0.1, "--out", out)
    rows = predictions(out)
    assert {row[0] for row in rows} == {flights[0].stem}
    assert {row[2] for row in rows} == set(range(1, 11))
    starts = [row[1] for row in rows]
    assert starts == sorted(starts) and len(set(starts)) > 1500
    for row in rows[::97]:
        assert abs(math.hypot(*row[9:13]) - 1) < 1e-5
    # A prediction starts where the vehicle is: its tenth step meets the first step of the prediction
    # that starts nine samples later.
    first = {row[1]: np.array(row[3:6]) for row in rows if row[2] == 1}
    last = {row[1]: np.array(row[3:6]) for row in rows if row[2] == 10}
    gaps = [np.linalg.norm(last[s] - first[s + 9]) for s in last if s + 9 in first]
    assert len(gaps) > 1500 and np.median(gaps) < 0.01
    places = np.array([[t.p_n_m, t.p_e_m, t.p_d_m] for t in truth(flights[0])])
    for start in list(first)[300:1500:200]:
        assert np.linalg.norm(places - first[start], axis=1).min() < 0.03


def write_table(log, folder):
    """The flight as a table at 100 Hz, with motor outputs, as a motion-capture system writes it."""
    imported = folder / "imported.mcap"
    run("log", "import", log, "-o", imported)
    streams = {}
    with open(imported, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, content in reader.iter_decoded_messages():
            if channel.topic.startswith("/flight/") and hasattr(content, "time_s"):
                streams.setdefault(channel.topic[len("/flight/"):], []).append(content)

    def stream(name, *fields):
        times = np.array([content.time_s for content in streams[name]])
        values = np.array([[getattr(content, field) for field in fields] for content in streams[name]])
        return lambda t: np.stack([np.interp(t, times, column) for column in values.T], axis=1)

    # Only the time in the air, because a table does not mark it.
    position = stream("position", "p_n_m", "p_e_m", "p_d_m")
    times = np.array([content.time_s for content in streams["attitude"]])
    times = np.arange(times[0], times[-1], 0.01)
    up = times[-position(times)[:, 2] > 0.3]
    times = times[(times >= up[0]) & (times <= up[-1])]
    fields = {
        "position": ["p_n_m", "p_e_m", "p_d_m"],
        "velocity": ["v_n_mps", "v_e_mps", "v_d_mps"],
        "attitude": ["q_w", "q_x", "q_y", "q_z"],
        "body_rate": ["p_radps", "q_radps", "r_radps"],
        "outputs": ["output_1", "output_2", "output_3", "output_4"],
    }
    names = ["t"] + [name for columns in fields.values() for name in columns]
    columns = [times[:, None]] + [stream(name, *columns)(times) for name, columns in fields.items()]
    np.savetxt(folder / f"{log.stem}.csv", np.hstack(columns), delimiter=",", header=",".join(names), comments="")
    return folder / f"{log.stem}.csv", len(times)


MAPPING = """
world_frame = "ned"
body_frame = "frd"
[time]
column = "t"
unit = "s"
[position]
columns = ["p_n_m", "p_e_m", "p_d_m"]
unit = "m"
[velocity]
columns = ["v_n_mps", "v_e_mps", "v_d_mps"]
unit = "m/s"
axes = "world"
[attitude]
quaternion = ["q_w", "q_x", "q_y", "q_z"]
order = "wxyz"
rotates = "body_to_world"
[body_rate]
columns = ["p_radps", "q_radps", "r_radps"]
unit = "rad/s"
axes = "body"
[motors]
columns = ["output_1", "output_2", "output_3", "output_4"]
meaning = "thrust_fraction"
"""


def test_training_and_prediction_from_tables(flights, tmp_path):
    mapping = tmp_path / "mapping.toml"
    mapping.write_text(MAPPING)
    tables = [write_table(log, tmp_path) for log in flights]
    model = tmp_path / "model.safetensors"
    done = train(model, [path for path, _ in tables], "--mapping", mapping, "--json")
    summary = json.loads(done.stdout)
    assert summary["data"]["refused"] == [] and len(summary["data"]["logs"]) == 5
    assert {log["source"] for log in summary["data"]["logs"]} == {"motor outputs"}
    physics = summary["one_step"][1]["labels"][2]
    # Roll and pitch: the only flight that yaws may be the test flight.
    assert physics["linear"] < 0.1 and max(physics["each"][3:5]) < 0.1

    out = tmp_path / "predictions.csv"
    path, count = tables[0]
    run("model", "predict", "--model", model, path, "--mapping", mapping, "--horizon", 0.05, "--out", out)
    rows = predictions(out)
    assert {row[2] for row in rows} == {1, 2, 3, 4, 5}
    assert rows[0][1] == 0 and rows[0][2] == 1
    # A sample is a row of the table; a prediction of h = 1 is of the next row.
    assert max(row[1] for row in rows) >= count - 10
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    errors = [np.linalg.norm(np.array(row[3:6]) - table[row[1] + row[2], 1:4]) for row in rows]
    assert np.median(errors) < 0.01


def test_eval_scores_every_predictor(trained, flights):
    found = json.loads(run("model", "eval", "--model", trained.world, *flights[:2], "--json").stdout)
    assert (found["schema"], len(found["logs"]), found["refused"]) == ("downwash.model_eval", 2, [])
    assert sorted(found["logs"]) == sorted(str(log) for log in flights[:2])
    assert [one["model"] for one in found["one_step"]] == ["net", "physics", "hybrid"]
    assert found["one_step"][1]["truth"]["linear"] < 0.05
    assert [p["predictor"] for p in found["multi_step"]] == ["net", "physics", "hybrid", "hold", "constant velocity"]


def test_damaged_and_foreign_models_are_refused(trained, flights, tmp_path):
    good = trained.world.read_bytes()
    other = tmp_path / "vehicle.toml"
    other.write_text(CRAZYFLIE.read_text().replace("mass = 0.030", "mass = 0.045"))
    flipped = bytearray(good)
    flipped[-100] ^= 1
    files = {
        "flipped": bytes(flipped),
        "cut": good[: len(good) // 2],
        "empty": b"",
        "noise": bytes(range(256)) * 9,
        "delay": good.replace(rb"\"preferred\":\"", rb"\"preferrod\":\""),
    }
    for name, content in files.items():
        path = tmp_path / f"{name}.safetensors"
        path.write_bytes(content)
        for command in (
            ["info", path],
            ["eval", "--model", path, flights[0]],
            ["predict", "--model", path, flights[0], "--out", tmp_path / "p.csv"],
            ["export", "--model", path, "--onnx", tmp_path / "m.onnx"],
        ):
            assert path.name in run("model", *command, code=2).stderr
    for command in (["eval"], ["predict"]):
        done = run("model", *command, "--model", trained.world, "--vehicle", other, flights[0], code=2)
        assert "mass" in done.stderr and "crazyflie" in done.stderr
    assert not list(tmp_path.glob("*.csv")) and not list(tmp_path.glob("*.onnx"))


def test_logs_of_another_vehicle_are_refused(flights, tmp_path):
    other = tmp_path / "vehicle.toml"
    other.write_text(CRAZYFLIE.read_text().replace("mass = 0.030", "mass = 0.045"))
    model = tmp_path / "model.safetensors"
    done = train(model, flights, vehicle=other, code=2)
    assert "another vehicle" in done.stderr and "mass" in done.stderr and not model.exists()


@pytest.mark.long
def test_a_resumed_training_gives_the_same_file(program, flights, tmp_path):
    long = ["--passes", "60", "--hidden", "24", "--regularization", "1e-5"]
    whole, model = tmp_path / "whole.safetensors", tmp_path / "model.safetensors"
    run("train", "--vehicle", CRAZYFLIE, *flights, "-o", whole, *long)
    checkpoint = tmp_path / "model.safetensors.checkpoint"
    arguments = ["train", "--vehicle", CRAZYFLIE, *flights, "-o", model, *long]
    one = program(*arguments)
    one.says("... networks")
    one.process.send_signal(signal.SIGINT)
    code, _ = one.finish(120)
    assert code == 130 and checkpoint.exists() and not model.exists(), one.err
    assert "--resume" in one.err
    refused = run(*arguments, "--seed", 2, "--resume", code=2)
    assert "--resume" in refused.stderr
    run(*arguments, "--resume")
    assert model.read_bytes() == whole.read_bytes() and not checkpoint.exists()
    assert "no checkpoint" in run(*arguments, "--resume", code=2).stderr


def test_the_report_loads_nothing_external(trained):
    page = (trained.report / "report.html").read_text()
    for word in ("http:", "https:", "<link", "src=", "@import", "url("):
        assert word not in page.replace("http://www.w3.org/2000/svg", "")
    for word in ("Open loop", "Learning", "sinusoid-xy", "SHA-256", "hold"):
        assert word in page
