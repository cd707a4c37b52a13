"""The commands' --json output matches their schemas, key by key."""

import json
import subprocess

import jsonschema
import pytest

from conftest import CRAZYFLIE, DOWNWASH, ROOT, of_the_demo

DRAG = ["--effect", "rotor_drag:d_xy=0.02,d_z=0.01"]


def run(*arguments):
    done = subprocess.run([*DOWNWASH, *map(str, arguments)], capture_output=True, text=True, timeout=600)
    assert done.returncode in (0, 4, 10), done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def schemas():
    return json.loads(run("schema", "--json"))


def closed(schema):
    """The schema, with keys that it does not name forbidden."""
    if isinstance(schema, list):
        return [closed(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    schema = {key: closed(value) for key, value in schema.items()}
    if "properties" in schema and "additionalProperties" not in schema:
        schema["unevaluatedProperties"] = False
    return schema


def check(schemas, name, text):
    value = json.loads(text)
    assert value.get("schema", name) == name
    validator = jsonschema.Draft202012Validator(closed(schemas[name]))
    errors = [f"{'/'.join(map(str, error.path))}: {error.message[:200]}" for error in validator.iter_errors(value)]
    assert not errors, "\n".join(errors)
    return value


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """The logs of a short flight programme, and the JSON that `collect` printed."""
    folder = tmp_path_factory.mktemp("flights")
    collected = run("collect", "--out", folder, "--seconds", 60, "--json", *DRAG)
    return sorted(folder.glob("*.mcap")), collected


def test_every_schema_is_valid(schemas):
    for schema in schemas.values():
        jsonschema.Draft202012Validator.check_schema(schema)


def test_the_reference_pages_are_current(tmp_path):
    run("reference", "--out", tmp_path)
    made = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*.*"))
    kept = sorted(path.relative_to(ROOT / "docs/reference") for path in (ROOT / "docs/reference").rglob("*.*"))
    assert kept == made
    for page in made:
        text = (ROOT / "docs/reference" / page).read_text()
        assert text == (tmp_path / page).read_text(), f"{page}: downwash reference --out docs/reference"


def test_vehicle_and_config_output(schemas):
    check(schemas, "downwash.vehicle.list", run("vehicle", "list", "--json"))
    check(schemas, "downwash.vehicle.check", run("vehicle", "check", CRAZYFLIE, "--json"))
    check(schemas, "downwash.vehicle.init", run("vehicle", "init", "--mass", 1, "--arm", 0.2, "--json"))
    check(schemas, "downwash.config", run("config", "--json"))


@pytest.mark.computes
def test_diagnosis_and_exam_sweep_output(schemas, flights, tmp_path):
    (logs, _) = flights
    diagnoses, exam = tmp_path / "diagnoses.toml", tmp_path / "exam.toml"
    names = json.dumps([str(log) for log in logs[:2]])
    diagnoses.write_text(f'schema_version = 1\nof = "diagnose"\ntwins = 0\nvehicle = "{CRAZYFLIE}"\nlogs = {names}\n')
    exam.write_text('schema_version = 1\nof = "exam"\ntwins = 0\ncases = 1\nnulls = 1\n')
    for manifest, row_schema in [(diagnoses, "downwash.diagnose.row"), (exam, "downwash.exam.case")]:
        out = tmp_path / manifest.stem
        check(schemas, "downwash.sweep.summary", run("sweep", manifest, "--out", out, "--json"))
        for line in next(out.glob("rows-*.jsonl")).read_text().splitlines():
            assert json.loads(line)["failure"] is None, line
            check(schemas, "downwash.sweep.row", line)
            check(schemas, row_schema, json.dumps(json.loads(line)["row"]))
    check(schemas, "downwash.sweep.exam", (tmp_path / "exam/summary.json").read_text())


def test_simulate_and_sweep_output(schemas, tmp_path):
    check(schemas, "downwash.simulate", run("simulate", "hover", "--out", tmp_path / "s", "--json", *DRAG))
    manifest = tmp_path / "sweep.toml"
    manifest.write_text("schema_version = 1\ntrajectory = 'hover'\n[grid]\nvehicle = ['crazyflie', 'none']\n")
    summary = check(schemas, "downwash.sweep.summary", run("sweep", manifest, "--out", tmp_path / "out", "--json"))
    assert summary["failures"] == 1
    rows = (tmp_path / "out/rows-1-of-1.jsonl").read_text().splitlines()
    for row in rows:
        check(schemas, "downwash.sweep.row", row)
        if json.loads(row)["row"]:
            check(schemas, "downwash.simulate", json.dumps(json.loads(row)["row"]))
    for line in run("sweep", manifest, "--list", "--json").splitlines():
        check(schemas, "downwash.sweep.point", line)


@pytest.mark.computes
def test_log_output(schemas, flights, tmp_path):
    logs, collected = flights
    check(schemas, "downwash.collect", collected)
    check(schemas, "downwash.log.info", run("log", "info", logs[0], "--json"))
    check(schemas, "downwash.log.audit", run("log", "audit", *logs, "--json"))
    check(schemas, "downwash.log.import", run("log", "import", logs[0], "-o", tmp_path / "i.mcap", "--json"))
    check(schemas, "downwash.report.flight", run("log", "report", logs[0], "-o", tmp_path / "r.html", "--json"))


@pytest.mark.computes
def test_model_and_plan_output(schemas, flights, tmp_path):
    logs, _ = flights
    model = tmp_path / "m.safetensors"
    train = ["--hidden", 8, "--passes", 4, "--vehicle", CRAZYFLIE, "-o", model, "--json"]
    check(schemas, "downwash.training", run("train", *logs[:2], *train))
    check(schemas, "downwash.model_info", run("model", "info", model, "--json"))
    check(schemas, "downwash.model_eval", run("model", "eval", logs[0], "--model", model, "--json"))
    check(schemas, "downwash.plan.summary", run("plan", "hover", "-o", tmp_path / "p.json", "--json"))
    tube, plan = tmp_path / "tube.json", tmp_path / "tubed.json"
    fitted = run("tube", "fit", "--along", tmp_path / "p.json", "--flights", 19, "-o", tube, "--json")
    check(schemas, "downwash.tube.fit", fitted)
    check(schemas, "downwash.plan.summary", run("plan", "hover", "--tube", tube, "-o", plan, "--json"))
    # One of two flights may leave the tube, still with exit code 0.
    check(schemas, "downwash.tube.check", run("tube", "check", plan, "--flights", 2, "--json"))


@pytest.mark.computes
def test_diagnose_output(schemas, flights, tmp_path):
    logs, _ = flights
    options = ["--vehicle", CRAZYFLIE, "--twins", 4, "--next-flight", tmp_path / "next.toml", "--json"]
    answer = check(schemas, "downwash.diagnose", run("diagnose", *logs[:3], *options))
    assert answer["verdict"] == "effect"
    # One flight without effects, only noise.
    still = run("simulate", "figure-8", "--out", tmp_path / "s", "--json")
    log = json.loads(still)["log"]
    check(schemas, "downwash.diagnose", run("diagnose", log, "--vehicle", CRAZYFLIE, "--twins", 4, "--json"))


@pytest.mark.computes
@of_the_demo
@pytest.mark.timeout(300)
def test_demo_output(schemas, demo):
    check(schemas, "downwash.demo", demo[1])


@pytest.mark.computes
@pytest.mark.long
def test_repair_demo_and_exam_output(schemas, tmp_path):
    repair = ["--diagnose", "--excite", 60, "--out", tmp_path / "repair", "--json"]
    check(schemas, "downwash.demo.diagnose", run("demo", *repair))
    exam = ["--cases", 2, "--nulls", 1, "--seed", 1, "--twins", 4, "--out", tmp_path / "exam", "--json"]
    check(schemas, "downwash.exam", run("exam", *exam))
