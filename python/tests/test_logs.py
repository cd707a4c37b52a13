"""Logs as arrays; learning, planning, comparison and diagnosis from them."""

import pickle
import subprocess
import sys
from pathlib import Path

import downwash as dw
import numpy as np
import pytest

from conftest import ROOT


def test_a_log_reads_as_arrays(logs: list[Path]) -> None:
    log = dw.read(logs[0])
    position = log["position"]
    assert position.values.shape == (len(position.time_s), 3)
    assert position.columns == ("north_m", "east_m", "down_m")
    assert np.all(np.diff(position.time_s) > 0)
    # The simulator's truth is in its logs, on the same clock.
    truth = log["truth"]
    down = np.interp(position.time_s, truth.time_s, truth.values[:, 2])
    assert np.abs(position.values[:, 2] - down)[100:-100].max() < 0.1
    assert log.facts["format"] == "mcap" and len(log.facts["sha256"]) == 64
    assert not [f for f in log.audit()["findings"] if f["severity"] == "fault"]
    with pytest.raises(KeyError):
        log["altitude"]


def test_logs_are_compared_by_their_samples(logs: list[Path]) -> None:
    log, same = dw.read(logs[0]), dw.read(logs[0])
    assert log == same and log["position"] == same["position"]
    assert log != dw.read(logs[1]) and log["position"] != log["velocity"]
    assert log["position"] != "position"


def test_a_log_that_was_read_is_not_a_list_of_paths(logs: list[Path]) -> None:
    log = dw.read(logs[0])
    for call in (lambda: dw.audit(log), lambda: dw.compare(log, logs), lambda: dw.diagnose("crazyflie", log)):
        with pytest.raises(TypeError, match="expected a list, found a Log"):
            call()


def test_a_table_is_audited_with_its_mapping(tmp_path: Path) -> None:
    table = tmp_path / "flight.csv"
    lines = ["t,px,py,pz,vx,vy,vz,qx,qy,qz,qw,wx,wy,wz,m1,m2,m3,m4,vbat"]
    lines += [f"{k / 100},0,0,{k / 1000},0,0,0.1,0,0,0,1,0,0,0,0.5,0.5,0.5,0.5,3.9" for k in range(500)]
    table.write_text("\n".join(lines) + "\n")
    log = dw.read(table, mapping=ROOT / "config/mappings/motion-capture.toml")
    assert log.audit()["file"] == str(table)


def test_a_log_converts_to_a_table(logs: list[Path]) -> None:
    pandas = pytest.importorskip("pandas")
    log = dw.read(logs[0])
    frame = log.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert frame["position.down_m"].notna().sum() == len(log["position"])
    assert list(log["voltage"].to_pandas().columns) == ["voltage_v"]


def test_a_learner_learns_and_predicts(logs: list[Path], tmp_path: Path) -> None:
    learner = dw.Learner(hidden=12, passes=8)
    assert learner.get_params()["hidden"] == 12
    with pytest.raises(dw.DownwashError, match="fit"):
        learner.predict(np.zeros((1, 13)))
    learner.fit(logs)
    assert learner.score(logs) > 0.8
    x, u = np.zeros((5, 9)), np.tile([0.3, 0, 0, 0], (5, 1))
    x[:, 0] = np.linspace(-1, 1, 5)
    model = learner.model_
    found, slopes = model.accelerations(x, u, jacobian=True, kind="hybrid")
    assert found.shape == (5, 6) and slopes.shape == (5, 6, 13)
    # The physics is smooth, so its Jacobian equals finite differences.
    _, slopes = model.accelerations(x, u, jacobian=True, kind="physics")
    for column in range(13):
        step = np.zeros(13)
        step[column] = 1e-6
        ahead = model.accelerations(x + step[:9], u + step[9:], kind="physics")
        behind = model.accelerations(x - step[:9], u - step[9:], kind="physics")
        by_differences = (ahead - behind) / 2e-6
        np.testing.assert_allclose(by_differences, slopes[:, :, column], atol=1e-2, rtol=1e-4)
    for x_wrong in (np.nan, np.inf):
        with pytest.raises(ValueError, match="finite"):
            model.accelerations(np.full(9, x_wrong), np.zeros(4))
    with pytest.raises(ValueError, match="kind: expected net, physics, hybrid"):
        model.accelerations(x, u, kind="nets")
    with pytest.raises(ValueError, match="kind: expected net, physics, hybrid"):
        dw.Learner(kind="nets").fit(logs)
    again = pickle.loads(pickle.dumps(model))
    assert again == model and hash(again) == hash(model)
    learner.save(tmp_path / "m.safetensors")
    assert dw.Model(tmp_path / "m.safetensors").preferred == model.preferred
    plan = dw.plan({"family": "hover", "altitude_m": 1.0, "duration_s": 2.0}, model=model)
    assert plan.states.shape == (len(plan.inputs) + 1, 12)


@pytest.mark.long
def test_a_learner_is_one_of_scikit_learn(logs: list[Path]) -> None:
    pytest.importorskip("sklearn")
    from sklearn.base import clone
    from sklearn.exceptions import NotFittedError
    from sklearn.model_selection import GridSearchCV
    from sklearn.pipeline import Pipeline
    from sklearn.utils.validation import check_is_fitted

    learner = dw.Learner(dw.Vehicle(), hidden=4, passes=1)
    assert clone(learner).get_params() == learner.get_params()
    assert "passes=1" in repr(learner)
    with pytest.raises(NotFittedError):
        check_is_fitted(learner)
    steps = Pipeline([("learn", learner)])
    assert "Learner" in steps._repr_html_()
    # The folds are whole flights.
    search = GridSearchCV(steps, {"learn__kind": ["physics", "net"]}, cv=[([0, 1], [2])], error_score="raise")
    search.fit(logs)
    best = search.best_estimator_
    assert best.predict(np.zeros((2, 13))).shape == (2, 6)
    assert best.named_steps["learn"].n_features_in_ == 13
    assert np.isfinite(best.score(logs[2:]))


def test_a_plan_flies_from_its_file_as_from_its_object(tmp_path: Path) -> None:
    plan = dw.plan({"family": "hover", "altitude_m": 1.0, "duration_s": 0.5})
    plan.save(tmp_path / "plan.json")
    assert dw.fly(trajectory=tmp_path / "plan.json") == dw.fly(trajectory=plan)
    with pytest.raises(dw.DownwashError, match="plan nowhere.json"):
        dw.fly(trajectory="nowhere.json")


def test_a_planned_flight_tracks_closer_than_feedback_alone(tmp_path: Path) -> None:
    trajectory = dw.Trajectory("sinusoid-yaw")
    plan = dw.plan(trajectory)
    assert plan.not_flyable is None
    plan.save(tmp_path / "plan.json")
    again = dw.Plan.load(tmp_path / "plan.json")
    np.testing.assert_array_equal(again.states, plan.states)
    sent = pickle.loads(pickle.dumps(plan))
    assert sent == plan == again and hash(sent) == hash(plan) and repr(sent) == repr(plan)
    assert plan != dw.plan({"family": "hover", "altitude_m": 1.0, "duration_s": 0.5})
    with pytest.raises(ValueError, match="kind: expected None"):
        dw.plan(trajectory, kind="net")
    (feedback,), (planned,) = dw.fly(trajectory=trajectory), dw.fly(trajectory=again)
    assert planned["position_rmse_m"] < 0.2 * feedback["position_rmse_m"]


def test_a_comparison_finds_the_worse_flights(tmp_path: Path) -> None:
    seeds = [1, 2, 3]

    def logs_of(name: str, effects: dict[str, dict[str, float]]) -> list[Path]:
        dw.fly(trajectory="figure-8", effects=effects, seeds=seeds, logs=tmp_path / name)
        return sorted((tmp_path / name).rglob("*.mcap"))

    plain, dragged = logs_of("plain", {}), logs_of("drag", {"rotor_drag": {"d_xy": 0.02}})
    worse = dw.compare(plain, dragged)
    assert worse.outcome == "worse" and worse.answer["schema"] == "downwash.compare"
    assert worse.sentence in str(worse) and worse._repr_html_().startswith("<iframe")
    assert dw.compare(plain, plain).outcome == "no_difference"
    with pytest.raises(ValueError, match="align: expected 'time', 'position', 'phase'"):
        dw.compare(plain, dragged, align="way")  # type: ignore[arg-type]


def test_a_diagnosis_finds_the_drag_and_saves_its_vehicle(logs: list[Path], tmp_path: Path) -> None:
    stages: list[str] = []
    found = dw.diagnose("crazyflie", logs, twins=4, progress=lambda stage, *_: stages.append(stage))
    assert found.verdict == "effect" and found.effects[0]["id"] == "rotor_drag"
    assert abs(found.effects[0]["parameters"]["d_xy"] - 0.02) < 0.004
    assert found.gap is not None and found.gap["after"] < found.gap["before"]
    assert "measuring the gap" in stages
    assert found._repr_html_().startswith("<iframe") and "rotor_drag" in found.html
    assert "rotor_drag" in str(found)
    assert found.vehicle.to_dict()["modelled_effects"].keys() == {"rotor_drag"}
    found.save(tmp_path)
    assert dw.Vehicle(tmp_path / "improved.toml").to_dict() == found.vehicle.to_dict()
    assert pickle.loads(pickle.dumps(found)) == found
    assert found.sentence in repr(found)


def test_ctrl_c_ends_a_diagnosis_at_once(logs: list[Path]) -> None:
    code = f"""
import signal, downwash as dw
def stage(*news):
    signal.raise_signal(signal.SIGINT)
try:
    dw.diagnose("crazyflie", {[str(log) for log in logs]!r}, progress=stage)
except KeyboardInterrupt:
    print("interrupted")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout == "interrupted\n", done


def test_the_documented_diagnosis_of_px4_logs(practice: Path) -> None:
    # The five lines of the documentation.
    logs = sorted((practice / "px4_drag").glob("*.ulg"))
    found = dw.diagnose(practice / "px4_drag/vehicle.json", logs, twins=8)
    assert found.answer["schema"] == "downwash.diagnose"
    assert found.verdict == "effect", found
