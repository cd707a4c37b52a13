"""The Kubernetes job and the Containerfile are valid."""

import re
import tomllib
from typing import Any

import pytest

from conftest import ROOT


def test_the_sweep_job_is_a_kubernetes_indexed_job() -> None:
    yaml = pytest.importorskip("yaml")
    job: dict[str, Any] = yaml.safe_load((ROOT / "config/sweep-job.yaml").read_text())
    jsonschema = pytest.importorskip("jsonschema")
    # The part of the batch/v1 Job API that the file uses.
    named = {"type": "string", "pattern": "^[a-z0-9]([-a-z0-9]*[a-z0-9])?$"}
    mount = {"type": "object", "required": ["name", "mountPath"], "properties": {"name": named}}
    container = {
        "type": "object",
        "required": ["name", "image", "command", "args"],
        "properties": {
            "name": named,
            "image": {"type": "string"},
            "command": {"type": "array", "items": {"type": "string"}},
            "args": {"type": "array", "items": {"type": "string"}},
            "resources": {"type": "object"},
            "volumeMounts": {"type": "array", "items": mount},
        },
        "additionalProperties": False,
    }
    pod = {
        "type": "object",
        "required": ["restartPolicy", "containers"],
        "properties": {
            "restartPolicy": {"enum": ["OnFailure", "Never"]},
            "containers": {"type": "array", "minItems": 1, "items": container},
            "volumes": {"type": "array", "items": {"type": "object", "required": ["name"]}},
        },
        "additionalProperties": False,
    }
    spec = {
        "type": "object",
        "required": ["completionMode", "completions", "template"],
        "properties": {
            "completionMode": {"const": "Indexed"},
            "completions": {"type": "integer", "minimum": 1},
            "parallelism": {"type": "integer", "minimum": 1},
            "backoffLimit": {"type": "integer", "minimum": 0},
            "template": {"type": "object", "required": ["spec"], "properties": {"spec": pod}},
        },
        "additionalProperties": False,
    }
    schema = {
        "type": "object",
        "properties": {
            "apiVersion": {"const": "batch/v1"},
            "kind": {"const": "Job"},
            "metadata": {"type": "object", "required": ["name"], "properties": {"name": named}},
            "spec": spec,
        },
        "required": ["apiVersion", "kind", "metadata", "spec"],
        "additionalProperties": False,
    }
    jsonschema.validate(job, schema)
    inner = job["spec"]["template"]["spec"]
    volumes = {volume["name"] for volume in inner["volumes"]}
    assert {mount["name"] for mount in inner["containers"][0]["volumeMounts"]} == volumes
    assert inner["containers"][0]["args"][0].endswith(f"/{job['spec']['completions']}")


def test_the_containerfile_builds_existing_files() -> None:
    lines = (ROOT / "Containerfile").read_text().splitlines()
    words = [line.split() for line in lines if line and not line.startswith("#")]
    assert {word[0] for word in words} <= {"FROM", "WORKDIR", "COPY", "RUN", "ENTRYPOINT", "CMD"}
    with (ROOT / "Cargo.toml").open("rb") as file:
        manifest = tomllib.load(file)
    assert (ROOT / "Cargo.lock").exists()
    (build,) = (" ".join(word) for word in words if word[0] == "RUN")
    assert "--locked" in build and re.search(r"--bin (\S+)", build)[1] == manifest["package"]["name"]  # type: ignore[index]
    copied = [word[-2] for word in words if word[0] == "COPY" and word[1].startswith("--from")]
    assert copied == ["/source/target/release/downwash"]
