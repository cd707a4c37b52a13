"""The documentation's notebooks run from the first cell to the last, and contain their plots."""

from pathlib import Path

import pytest

from conftest import ROOT

NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient").NotebookClient
    pytest.importorskip("matplotlib")
    if path.stem == "diagnose-px4":
        monkeypatch.setenv("DOWNWASH_PRACTICE", str(request.getfixturevalue("practice")))
    notebook = nbformat.read(path, as_version=4)
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in shown), "run docs/notebooks/execute.py"
    assert path.with_suffix(".png").exists()
    client(notebook, timeout=300, kernel_name="python3").execute()
    drawn = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in drawn)
