"""Random fault scripts in real time: downwash is a process on a socket, which the scripts stop and kill."""

import json
import os

import pytest

# A fixed seed makes a commit pass or fail the same everywhere; the variable sets another.
SEED = os.environ.get("DOWNWASH_CAMPAIGN_SEED", "1")


def campaign(program, folder, *options):
    """Starts a campaign. The environment must not change the settings that a script states."""
    return program("campaign", "--real-time", *options, "--out", folder, "--json", settings={})


def fly(program, folder, flights, seed=SEED):
    one = campaign(program, folder, "--flights", flights, "--seed", seed)
    code, out = one.finish(60 * (2 + flights // 5))
    summary = json.loads(out)
    assert summary["real_time"] and summary["done"] == flights
    assert summary["failed"] == [], f"seed {seed}: {json.dumps(summary['failed'], indent=2)}\n{one.err}"
    assert code == 0, one.err
    return summary


@pytest.mark.long
def test_ten_random_fault_scripts(program, tmp_path):
    summary = fly(program, tmp_path / "out", 10)
    assert summary["setpoints"] > 1000
    # Flights that break no rule leave nothing but their rows.
    assert sorted(path.suffix for path in (tmp_path / "out").iterdir()) == [".json", ".jsonl"]


@pytest.mark.long
@pytest.mark.computes
def test_two_hundred_random_fault_scripts(program, tmp_path):
    fly(program, tmp_path / "out", 200)


def test_a_script_with_a_restart_a_pause_and_a_takeover(program, tmp_path):
    """Faults that only a real process can have, then a takeover by the pilot."""

    def at(at_s, for_s, **fault):
        return {"at_s": at_s, "for_s": for_s, "fault": fault}

    script = {
        "schema_version": 1,
        "seed": 7,
        "vehicle": "quad1200",
        "autopilot": "px4",
        "law": "lqr",
        "policy": "command",
        "clock_rate": 1.0,
        "signed": True,
        "trajectory": "family = 'hover'\naltitude_m = 1.0\nduration_s = 4.0\n",
        "faults": [
            at(1.0, 0.2, kind="restart"),
            at(8.0, 0.15, kind="pause"),
            at(9.0, 2.0, kind="delay", way="both", least_s=0.01, jitter_s=0.03),
            at(11.0, 0.0, kind="pilot", act="position"),
        ],
    }
    path = tmp_path / "script.json"
    path.write_text(json.dumps(script))
    one = campaign(program, tmp_path / "out", "--script", path)
    code, out = one.finish(120)
    flight = json.loads(out)
    assert code == 0 and flight["violations"] == [], one.err
    assert flight["ending"] == "pilot" and flight["setpoints"] > 100
