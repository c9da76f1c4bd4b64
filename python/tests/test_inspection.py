"""`inspect` and `init` give what the command line gives."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest
from conftest import SMALL
from test_tasks import check_result
from test_unsaved import SPECTRA, TX, made

import pwrfgs

POSES = np.concatenate([TX, np.tile([0, 0, 0, 1.0], (30, 1))], axis=1)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Data folders of each kind."""
    parent = tmp_path_factory.mktemp("data")
    for kind in ("spectrum", "power", "channel"):
        made(kind).save(parent / kind)
    pwrfgs.Dataset.from_arrays(spectra=SPECTRA, rx_pose=POSES, transmitter=(0, 0, 2)).save(parent / "moving")
    pwrfgs.simulate("office", parent / "points", samples=40, points=200, progress=False)
    made("spectrum")[10:].save(parent / "subset")
    return parent


KINDS = ["spectrum", "power", "channel", "moving", "points", "subset"]


@pytest.mark.parametrize("kind", KINDS)
def test_inspect_equals_the_command(kind, folders, cli):
    data = pwrfgs.Dataset.load(folders / kind)
    printed = subprocess.run([cli, "inspect", str(folders / kind)], check=True, capture_output=True, encoding="utf-8")
    result = pwrfgs.inspect(data)
    assert str(result) == printed.stdout
    assert result.splits[0].endswith(" *") or result.refused[0][0].endswith(" *")
    assert result.scores.shape == (len(result.splits), len(result.baselines))
    check_result(result, ["split", "train", "test", "nearest_m"], len(result.splits))


def test_inspect_takes_data_in_memory_and_a_pipeline():
    data = made("spectrum")
    result = pwrfgs.inspect(data)
    assert result.title == "arrays" and dict(result.facts)["samples"] == "30 spectra of 36 x 9 pixels, ids 1 to 30"
    assert (result.metric, result.train[0] + result.test[0] <= 30) == ("ssim", True)
    assert result.pose["spectra"] == 30 and result.pose["orientation"].shape == (4,)
    pipeline = pwrfgs.Pipeline(SMALL)
    chosen = pwrfgs.inspect(data, pipeline)
    partition = data.split(pipeline.split, seed=pipeline.seed)
    assert chosen.baselines == ["mean spectrum", "3-NN"] and chosen.splits[0].startswith("Random(test: 0.2")
    assert (chosen.train[0], chosen.test[0]) == (len(partition.train), len(partition.test))
    baseline = pwrfgs.baselines.knn(data, data.tx[partition.test], np.r_[partition.train, partition.validation], k=3)
    assert chosen.scores[0, 1] == pytest.approx(np.mean(pwrfgs.metrics.ssim(baseline, data.observations(partition.test))))
    assert pwrfgs.inspect(made("power")).pose is None


@pytest.mark.parametrize("kind", KINDS)
def test_init_equals_the_command(kind, folders, cli, tmp_path):
    subprocess.run([cli, "init", str(folders / kind), "--out", str(tmp_path / "p.ron"), "-q"], check=True, capture_output=True)
    pipeline = pwrfgs.Pipeline.for_data(pwrfgs.Dataset.load(folders / kind), name=kind)
    assert str(pipeline) == str(pwrfgs.Pipeline(tmp_path / "p.ron"))
    assert pwrfgs.init(pwrfgs.Dataset.load(folders / kind), name=kind) == pipeline


def test_pipeline_for_points_in_memory_starts_on_them():
    data = pwrfgs.Dataset.from_arrays(TX, SPECTRA, points=np.random.default_rng(3).uniform(0, 4, (50, 3)))
    pipeline = pwrfgs.Pipeline.for_data(data)
    assert isinstance(pipeline.initializer, pwrfgs.PointCloud)
    assert len(pwrfgs.Trainer(pipeline).cloud) == 50
