"""Changes in flight, discovered laws, time-optimal plans and adaptation."""

import json
import signal
import time
from pathlib import Path

import downwash as dw
import numpy as np
import pytest

LAW = {
    "law": {
        "drag": {
            "force_x": "-0.012[kg/s]*air_x*(airspeed/1[m/s])^0.4",
            "force_y": "-0.012[kg/s]*air_y*(airspeed/1[m/s])^0.4",
        }
    }
}


def test_the_onset_of_an_effect_is_dated(tmp_path: Path) -> None:
    lost = {"rotor_loss": {"rotor": 2, "scale": 0.9}}
    (row,) = dw.fly("quad1200", "figure-8", onsets=[(22.0, lost)], logs=tmp_path)
    assert row["onsets"] == [{"at_s": 22.0, "effects": lost}]
    found = dw.onset(dw.Vehicle("quad1200"), row["log"])
    (change,) = found.rows
    assert abs(change["at_s"] - 22.0) < 0.5, change
    assert "rotor 2" in str(found) and found._repr_html_().startswith("<iframe")
    found.save(tmp_path / "report")
    assert json.loads((tmp_path / "report/report.json").read_text()) == found.answer
    (steady,) = dw.fly("quad1200", "figure-8", logs=tmp_path / "steady")
    assert not dw.onset("quad1200", steady["log"]).rows


@pytest.mark.parametrize(
    ("onsets", "words"),
    [
        ([(-1.0, {"mass": {"mass_kg": 1.0}})], "onsets: @-1"),
        ([(1.0, {"gusts": {"sigma_m_s": 1.0}})], "gusts cannot start"),
        ([(1.0, {"win": {}})], "onsets"),
    ],
)
def test_an_invalid_onset_is_refused_by_name(onsets: list[tuple[float, dict[str, dict[str, float]]]], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        dw.fly(trajectory={"family": "hover", "altitude_m": 1.0, "duration_s": 2.0}, onsets=onsets)


@pytest.mark.long
def test_a_law_is_discovered_and_saved(tmp_path: Path) -> None:
    logs = []
    for seed, name in enumerate(["figure-8", "sinusoid-xz", "random-waypoints", "sinusoid-yaw"]):
        rows = dw.fly(trajectory=name, effects=LAW, seeds=seed, logs=tmp_path / name)  # type: ignore[arg-type]
        logs += [row["log"] for row in rows]
    found = dw.diagnose("crazyflie", logs, twins=8, discover=True)
    assert found.law is not None and found.law["formulas"], found.answer["finding"]
    assert dw.diagnose("crazyflie", logs[:1], twins=0).law is None
    found.save(tmp_path)
    assert (tmp_path / "law.toml").exists() == (found.law_file is not None) == found.law["named"]


def test_a_time_optimal_plan_is_flown() -> None:
    plan = dw.plan("race")
    assert plan.not_flyable is None and plan.passed_s is not None
    assert plan.passed_s == sorted(plan.passed_s) and plan.passed_s[-1] <= plan.duration_s
    assert plan.cost_m == pytest.approx(plan.duration_s, abs=2 * plan.period_s)
    assert np.isfinite(plan.states).all()
    (row,) = dw.fly(trajectory=plan)
    assert row["end"] == "done" and row["true_position_rmse_m"] < 0.2
    with pytest.raises(dw.DownwashError, match="states where to fly, not when"):
        dw.fly(trajectory="race")


def test_adaptation_reduces_the_error_of_a_wrong_mass() -> None:
    heavy = {"mass": {"mass_kg": 0.036}}
    plain, adaptive = (
        dw.fly(trajectory="hover", effects=heavy, controller={"adaptive": adaptive})[0] for adaptive in (False, True)
    )
    assert adaptive["true_position_rmse_m"] < plain["true_position_rmse_m"]


def test_an_interrupted_diagnosis_stops_computing(logs: list[Path]) -> None:
    def cpu_s(work: object) -> float:
        began = time.process_time()
        with pytest.raises(KeyboardInterrupt):
            dw.diagnose("crazyflie", logs, twins=40, progress=work)  # type: ignore[arg-type]
        # Wait until the process is idle.
        last, quiet = time.process_time(), 0
        while quiet < 5:
            time.sleep(0.05)
            now = time.process_time()
            quiet = quiet + 1 if now - last < 0.005 else 0
            last = now
        return time.process_time() - began

    def interrupt_at(name: str) -> object:
        def interrupt(stage: str, *_: int) -> None:
            if stage == name:
                signal.raise_signal(signal.SIGINT)

        return interrupt

    # Interrupted in the last stage, and in the longest.
    whole = cpu_s(interrupt_at("flying again in simulation"))
    short = cpu_s(interrupt_at("simulating twins without an effect"))
    assert short < 0.5 * whole, (short, whole)
