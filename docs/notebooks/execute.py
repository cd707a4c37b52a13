"""Executes the notebooks and stores their output: `python docs/notebooks/execute.py`.

Embedded report pages are dropped because of their size. The last picture of each notebook becomes a file beside
it, which the documentation shows. DOWNWASH_PRACTICE is the folder of the practice flights.
"""

import base64
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).resolve().parent


def execute(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=600, kernel_name="python3").execute()
    picture = None
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "<iframe" in data.get("text/html", ""):
                del data["text/html"]
            picture = data.get("image/png", picture)
        if any(str(HERE.parents[1]) in str(output) or "/tmp/" in str(output) for output in cell.get("outputs", [])):
            sys.exit(f"{path}: an output names a folder of this machine")
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    nbformat.write(notebook, path)
    if picture is not None:
        path.with_suffix(".png").write_bytes(base64.b64decode(picture))
    print(path.name)


if __name__ == "__main__":
    names = sys.argv[1:]
    for path in sorted(HERE.glob("*.ipynb")):
        if not names or path.stem in names:
            execute(path)
