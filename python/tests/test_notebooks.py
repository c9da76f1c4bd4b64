"""The notebooks run, from their folder, and keep small outputs."""

from __future__ import annotations

import os
import pathlib
import re

import pytest

import pwrfgs

NOTEBOOKS = sorted((pathlib.Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


def test_they_are_there():
    assert len(NOTEBOOKS) == 6


@pytest.mark.skipif(pwrfgs._pwrfgs.real_bytes == 8, reason="once is enough")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path, monkeypatch):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    text = path.read_text(encoding="utf-8")
    for module in ["ipykernel", *re.findall(r'"import (\w+)', text)]:
        pytest.importorskip(module)
    assert len(text) < 300_000 and str(pathlib.Path.home()) not in text
    assert "!pwrfgs" not in text, "a notebook shows functions of Python"
    notebook = nbformat.reads(text, as_version=4)
    # The kernel imports the package that is tested.
    monkeypatch.setenv("PYTHONPATH", os.path.dirname(os.path.dirname(pwrfgs.__file__)), prepend=os.pathsep)
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(path.parent)}}).execute()
    for cell in notebook.cells:
        outputs = cell.get("outputs", [])
        assert not [out for out in outputs if out["output_type"] == "error" or out.get("text", "").startswith("error: ")]
