"""Execute the notebooks of docs/notebooks and keep what they show: ``make notebooks``."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"


def execute(path: Path) -> None:
    """Execute a notebook in a folder of its own and write its outputs into it; an error of a cell is raised."""
    notebook = nbformat.read(path, as_version=4)
    with TemporaryDirectory() as folder:
        place = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=300, resources=place, record_timing=False).execute()
    notebook.metadata.pop("language_info", None)  # the version of this Python
    nbformat.write(notebook, path)


if __name__ == "__main__":
    for notebook_path in sorted(FOLDER.glob("*.ipynb")):
        execute(notebook_path)
