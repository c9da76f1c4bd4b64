"""Sweeps from values, and what notebooks and logs show."""

from __future__ import annotations

import base64
import io
import logging
import re

import numpy as np
import pytest
from conftest import SMALL

import pwrfgs
from pwrfgs import _html, _sweep

QUICK = {"training.steps": 3, "training.densify_until": 1, "training.prune_until": 2, "training.validate_every": 0}


def test_sweep_of_values_runs_every_combination(tmp_path, pipeline):
    axes = {"initializer.Random.count": [20, 30], "pruners": {"none": []}}
    call = dict(set=QUICK, out=tmp_path / "sweep", axes=axes, seeds=[3], name="counts")
    runs = pwrfgs.sweep(pipeline, **call)
    assert all(run.finished for run in runs)
    assert [re.sub(r".*/", "", run.folder) for run in runs] == ["count=20,pruners=none,seed=3", "count=30,pruners=none,seed=3"]
    assert runs[-1].pipeline.initializer.count == 30 and runs[-1].pipeline.pruners == []
    assert (tmp_path / "sweep/report/report.html").is_file()
    started = [run.facts["started"] for run in runs]
    assert [run.facts["started"] for run in pwrfgs.sweep(pipeline, **call)] == started


def test_labels_are_short_and_distinct():
    voxels = [pwrfgs.Voxel(size_m=0.2), pwrfgs.Voxel(size_m=0.4), pwrfgs.Random(test=0.2)]
    assert _sweep._labels(voxels) == ["Voxel size_m=0.2", "Voxel size_m=0.4", "Random"]
    assert _sweep._labels([[], [pwrfgs.OpacityThreshold()]]) == ["none", "OpacityThreshold"]
    assert _sweep._labels([0.01, np.float32(0.5), True, "Real"]) == ["0.01", "0.5", "True", "Real"]


@pytest.mark.parametrize(
    ("axes", "said"),
    [
        ({"training.steps": 5}, "axes: training.steps is 5; give a list of values"),
        ({"training.stps": [5]}, "stps"),
        ({"training.steps": []}, "has no variant"),
        ({"training.steps": [5, 5]}, "name the folder `5`"),
    ],
)
def test_invalid_axes_are_reported(axes, said, tmp_path):
    with pytest.raises(pwrfgs.InputError, match=said):
        pwrfgs.sweep(SMALL, axes=axes, out=tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_course_of_a_run_is_logged(tmp_path, caplog):
    with caplog.at_level(logging.DEBUG, logger="pwrfgs"):
        pwrfgs.run(SMALL, set={**QUICK, "training.validate_every": 2}, out=tmp_path / "run", progress=False)
    lines = [(record.levelname, record.getMessage()) for record in caplog.records if record.name == "pwrfgs"]
    assert [text for level, text in lines if level == "DEBUG"][0].startswith("step 1: loss 0.")
    info = "\n".join(text for level, text in lines if level == "INFO")
    assert "training on" in info and "validation mean" in info and "scoring" in info


def images(page):
    plot = pytest.importorskip("matplotlib.image")
    return [plot.imread(io.BytesIO(base64.b64decode(data)), format="png") for data in re.findall(r"base64,([^\"]+)", page)]


def test_png_has_the_pixels_of_the_image():
    (image,) = images(_html.figure(np.array([[0.0, 1.0, np.nan], [0.5, 2.0, -1.0]]), "a < b"))
    assert image.shape[:2] == (2, 3) and np.allclose(image[0, 1, :3] * 255, [253, 231, 37]) and np.allclose(image[0, 0], image[1, 2])
    assert np.allclose(image[1, 0, :3] * 255, [33, 145, 140])


def test_notebooks_show_spectra_positions_and_models(dataset, model, run):
    assert [image.shape[:2] for image in images(dataset._repr_html_())] == [(15, 60)] * 4
    assert [image.shape[:2] for image in images(model._repr_html_())] == [(15, 60)] and "<circle" in model._repr_html_()
    assert "ssim" in run._repr_html_() and "<img" in run._repr_html_()
    powers = pwrfgs.Dataset.from_arrays([[0, 0, 1], [1, 0, 1]], rssi=[[-40.0], [-50.0]], receivers=[[0, 0, 3]])
    assert powers._repr_html_().count("<circle") == 2
