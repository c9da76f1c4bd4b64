"""Data in memory: pipelines for them, runs, sweeps and trainers on them, and subsets with their IDs."""

from __future__ import annotations

import json
import logging
import os
import pathlib
import pickle
import re
import subprocess

import numpy as np
import pytest
from conftest import SMALL, files

import pwrfgs

RNG = np.random.default_rng(0)
TX = RNG.uniform((0, 0, 1), (4, 3, 2), (30, 3))
SPECTRA = RNG.uniform(0, 1, (30, 9, 36)).astype(np.float32)
GATEWAYS = [[0, 0, 2.5], [4, 3, 2.5], [0, 3, 2.5]]
ARRAY = pwrfgs.Receiver(position=(0, 0, 2), antennas=[[0, 0, 0], [0.06, 0, 0]])
SHORT = {"training.scale": 0.005}


def made(kind, count=30):
    """A data set in memory."""
    if kind == "power":
        return pwrfgs.Dataset.from_arrays(TX[:count], rssi=-90 + 50 * SPECTRA[:count, 0, :3], receivers=GATEWAYS)
    if kind == "channel":
        csi = (SPECTRA[:count, 0, :8] + 1j * SPECTRA[:count, 1, :8]).reshape(-1, 2, 4)
        return pwrfgs.Dataset.from_arrays(TX[:count], csi=csi, frequencies_hz=2.4e9 + 1e6 * np.arange(4), receivers=ARRAY)
    return pwrfgs.Dataset.from_arrays(TX[:count], SPECTRA[:count])


@pytest.fixture()
def small():
    pipeline = pwrfgs.Pipeline(SMALL)
    pipeline.data = made("spectrum")
    return pipeline


@pytest.mark.parametrize("kind", ["spectrum", "power", "channel"])
def test_arrays_to_scores_in_three_statements(kind, tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    data = made(kind)
    short = {**SHORT, "initializer.step": 1.0} if kind == "channel" else SHORT
    pipeline = pwrfgs.Pipeline.for_data(data)
    run = pwrfgs.run(pipeline, set=short, progress=False)
    assert run.folder == "runs/pipeline" and run.finished and run.scores["model"]
    assert data._source is None and pipeline.load_data() is data
    (stored,) = (tmp_path / "runs/pipeline/data").iterdir()
    loaded = run.pipeline.load_data()
    assert run.pipeline.data.root == str(stored) and loaded.title == data.title == "arrays"
    assert np.array_equal(loaded.positions, data.positions) and np.array_equal(loaded.ids, data.ids)
    # The same call, the folder and the program open the run.
    again = pwrfgs.Pipeline.for_data(made(kind))
    assert again == pipeline and hash(again) == hash(pipeline)
    model = (tmp_path / "runs/pipeline/model.safetensors").read_bytes()
    for pipeline in (again, "runs/pipeline"):
        assert pwrfgs.run(pipeline, set=short if pipeline is again else None, progress=False).finished
    subprocess.run([cli, "run", "runs/pipeline", "-q"], check=True, capture_output=True)
    subprocess.run([cli, "report", "runs/pipeline", "--out", "page", "-q"], check=True, capture_output=True)
    assert (tmp_path / "runs/pipeline/model.safetensors").read_bytes() == model


def test_run_on_data_in_memory_equals_one_on_saved_data(small, tmp_path, caplog):
    with caplog.at_level(logging.INFO, "pwrfgs"):
        run = pwrfgs.run(small, out=tmp_path / "a", progress=False)
    assert re.search(f"writing the data to {re.escape(str(tmp_path / 'a'))}.data.[0-9a-f]{{16}}$", caplog.text, re.MULTILINE)
    data = small.load_data()
    data.save(tmp_path / "data")
    assert pwrfgs.run(small, out=tmp_path / "a", progress=False).finished
    small.data = data
    saved = pwrfgs.run(small, out=tmp_path / "b", progress=False)
    assert saved.pipeline.data.root == str(tmp_path / "data") and not (tmp_path / "b/data").exists()
    assert {n: b for n, b in files(run.folder).items() if n != "pipeline.ron"} == {
        n: b for n, b in files(saved.folder).items() if n != "pipeline.ron"
    }


def test_interrupted_run_resumes_with_equal_data_only(small, tmp_path):
    def stop(event):
        if event["what"] == "step" and event["step"] == 30:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pwrfgs.run(small, out=tmp_path / "a", callback=stop, progress=False)
    other = small.copy()
    other.data = small.load_data().subset(np.arange(29))
    with pytest.raises(pwrfgs.InputError, match="a holds a run on other data; choose another folder with `out`"):
        pwrfgs.run(other, out=tmp_path / "a", progress=False)
    (stored,) = (tmp_path / "a/data").iterdir()
    written = os.stat(stored / "spectra.npy").st_mtime_ns
    small.data = made("spectrum")
    assert pwrfgs.run(small, out=tmp_path / "a", progress=False).finished
    assert os.stat(stored / "spectra.npy").st_mtime_ns == written
    pwrfgs.run(small, out=tmp_path / "b", progress=False)
    resumed, whole = files(tmp_path / "a"), files(tmp_path / "b")
    assert all(resumed[name] == whole[name] for name in whole if name != "pipeline.ron")


def test_other_data_of_a_callback_are_not_written(small, tmp_path):
    others = []

    def build(event):
        if not others:
            others.append(pwrfgs.Pipeline.for_data(made("power")))

    pwrfgs.run(small, out=tmp_path / "a", callback=build, progress=False)
    assert len(list((tmp_path / "a/data").iterdir())) == 1 and others[0].data.root.startswith("unsaved:")


def test_failed_start_leaves_no_files(small, tmp_path):
    (tmp_path / "foreign").mkdir()
    (tmp_path / "empty").mkdir()
    (tmp_path / "foreign/thesis.tex").write_text("x")
    ridge = {"baselines": [pwrfgs.Ridge()]}  # needs features
    for out, set, problem in [("new", ridge, "Ridge"), ("empty", ridge, "Ridge"), ("foreign", {}, "holds `thesis.tex`")]:
        with pytest.raises(pwrfgs.InputError, match=problem):
            pwrfgs.run(small, set=set, out=tmp_path / out, progress=False)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["empty", "foreign", "thesis.tex"]


def test_subset_trains_everywhere(small, tmp_path):
    small.data = part = small.load_data()[5:25]
    trainer = pwrfgs.Trainer(small)
    trainer.step()
    assert trainer.dataset is part
    run = pwrfgs.evaluate(trainer.model(), small, out=tmp_path / "scored", progress=False)
    assert run.finished and run.pipeline.load_data().ids.tolist() == part.ids.tolist() == list(range(6, 26))
    axes = {"data": {"ten": part[:10], "all": part}}
    runs = pwrfgs.sweep(small, {"training.steps": 45}, tmp_path / "sweep", axes=axes)
    assert [len(run.pipeline.load_data()) for run in runs] == [10, 20]
    assert len(list((tmp_path / "sweep/data").iterdir())) == 2  # of base and variant, once
    assert [run.finished for run in pwrfgs.sweep(small, {"training.steps": 45}, tmp_path / "sweep", axes=axes)] == [True, True]


def test_sweep_of_an_experiment_file_takes_data_in_memory(tmp_path):
    (tmp_path / "base.ron").write_text(SMALL)
    (tmp_path / "e.ron").write_text('Experiment(name: "e", base: "base.ron", seeds: [0, 1])')
    change = {"data": made("spectrum"), "training.steps": 45}
    with pytest.raises(pwrfgs.InputError, match="give it as `out`"):
        pwrfgs.sweep(tmp_path / "e.ron", change)
    runs = pwrfgs.sweep(tmp_path / "e.ron", change, tmp_path / "sweep")
    assert [len(run.pipeline.load_data()) for run in runs] == [30, 30]


def test_subset_in_memory_and_saved_trains_alike(tmp_path):
    whole = made("spectrum")
    part = whole[whole.positions[:, 0] < 2]
    part.save(tmp_path / "part")
    models = []
    for data in (part, pwrfgs.Dataset.load(tmp_path / "part")):
        trainer = pwrfgs.Trainer(pwrfgs.Pipeline(SMALL), data, train=np.arange(len(data)))
        trainer.step()
        models.append(trainer.model().gaussians().means)
    assert np.array_equal(*models), "bounds of the room are kept"
    assert json.loads((tmp_path / "part/manifest.json").read_text())["bounds"][1][0] > 2


def test_subset_that_no_folder_holds_refers_to_its_source(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pwrfgs.simulate("office-csi", "data/csi", layout="csi", samples=60, progress=False)
    whole = pwrfgs.Dataset.load(pwrfgs.Nerf2Csi(root="data/csi"))
    part = whole[10:][:40]
    with pytest.raises(pwrfgs.InputError, match="no layout holds transmitters without positions"):
        part.save("data/part")
    pipeline = pwrfgs.Pipeline.for_data(part)
    run = pwrfgs.run(pipeline, set=SHORT, progress=False)
    loaded = run.pipeline.load_data()
    assert isinstance(run.pipeline.data, pwrfgs.Subset) and run.pipeline.data.data.root == str(tmp_path / "data/csi")
    assert np.array_equal(loaded.csi, part.csi) and np.array_equal(loaded.features, part.features)
    assert loaded.ids.tolist() == part.ids.tolist() == whole.ids[10:50].tolist()
    assert pwrfgs.run(pipeline, set=SHORT, progress=False).finished
    links = pathlib.Path(run.pipeline.data.links)
    for text, problem in [("", "at least one"), (f"{len(whole)}\n", f"indices of links below {len(whole)}"), ("2\n1\n", ":2:1: `1` is not above")]:
        links.write_text(text)
        with pytest.raises(pwrfgs.InputError, match=problem):
            run.pipeline.load_data()


def test_pipeline_keeps_data_in_memory(small, tmp_path):
    data = small.load_data()
    for copy in (small.copy(), pickle.loads(pickle.dumps(small)), pwrfgs.Pipeline(str(small))):
        assert copy == small and np.array_equal(copy.load_data().spectra, data.spectra)
    small.training.steps = 50
    assert small.load_data() is data and repr(small.data).startswith("pwrfgs.Arrays(root='unsaved:")
    with pytest.raises(pwrfgs.InputError, match=r"call save\(path\) of the data first"):
        small.save(tmp_path / "p.ron")
    data.save(tmp_path / "data")
    small.save(tmp_path / "p.ron")
    assert pwrfgs.Pipeline(tmp_path / "p.ron").data.root == str(tmp_path / "data")
    text = str(pwrfgs.Pipeline.for_data(made("power")))
    with pytest.raises(pwrfgs.InputError, match="no longer in memory; set its `data`"):
        pwrfgs.Pipeline(text)
    small.data = pwrfgs.Teacher()
    assert small._data is None and len(small.load_data()) == pwrfgs.Teacher().samples


@pytest.mark.parametrize("kind", ["spectrum", "power", "channel"])
@pytest.mark.parametrize("count", [2, 7])
def test_small_data_train_without_repairs(kind, count, tmp_path):
    data = made(kind, count)
    pipeline = pwrfgs.Pipeline.for_data(data)
    if kind == "channel":
        pipeline.initializer.step = 1.0  # the search takes most of the time
    pwrfgs.Trainer(pipeline, data, train=np.arange(len(data))).step()
    assert pwrfgs.run(pipeline, set=SHORT, out=tmp_path / "run", progress=False).finished


def test_trainer_takes_all_links_of_a_small_data_set(tmp_path):
    data = pwrfgs.simulate("office", tmp_path / "office", samples=60, progress=False)
    again = pwrfgs.Dataset.from_arrays(data.tx, data.spectra, receivers=data.receivers, points=data.points)
    trainer = pwrfgs.Trainer(pwrfgs.Pipeline.for_data(again), again, train=np.arange(60))
    assert trainer.step()["step"] == 1


def walk():
    """A walk out and back: 25 positions, 40 spectra elsewhere, and the same positions again."""
    line = np.stack([np.linspace(1, 3, 25), np.ones(25), np.ones(25)], axis=1)
    elsewhere = np.random.default_rng(1).uniform((0, 2, 1), (4, 3, 2), (40, 3))
    rows = np.arange(90)[:, None, None]
    spectra = np.clip(SPECTRA[rows[:, 0, 0] % 30] + 0.01 * np.sin(rows), 0, 1).astype(np.float32)
    return pwrfgs.Dataset.from_arrays(np.concatenate([line, elsewhere, line[::-1] + 0.001]), spectra)


@pytest.mark.parametrize("kind", ["spectrum", "power", "channel"])
def test_subset_and_saved_subset_keep_ids(kind, tmp_path):
    whole = made(kind)
    part = whole.subset(whole.receiver * 0 + np.arange(len(whole)) % 7 > 2)
    part.save(tmp_path / "part")
    loaded = pwrfgs.Dataset.load(tmp_path / "part")
    assert np.array_equal(part.ids, whole.ids[np.arange(len(whole)) % 7 > 2])
    assert np.array_equal(loaded.ids, part.ids) and np.array_equal(loaded.receiver, part.receiver)
    whole.save(tmp_path / "whole")
    assert not (tmp_path / "whole/ids.txt").exists() and (tmp_path / "part/ids.txt").exists()
    assert np.array_equal(pwrfgs.Dataset.load(tmp_path / "whole").ids, whole.ids)


def test_saved_subset_keeps_its_noise_ceiling(tmp_path):
    whole = walk()
    part = whole.subset(np.r_[0:25, 65:90])  # without the spectra elsewhere, consecutive numbers would be near in time
    part.save(tmp_path / "part")
    loaded = pwrfgs.Dataset.load(tmp_path / "part")
    there = [pwrfgs.repeatability(data)["far"] for data in (whole, part, loaded)]
    assert there[0]["pairs"] == there[1]["pairs"] >= 20 and there[1] == there[2]
    os.remove(tmp_path / "part/ids.txt")
    assert pwrfgs.repeatability(pwrfgs.Dataset.load(tmp_path / "part"))["far"] != there[1]


@pytest.mark.parametrize("text, problem", [("1\n2\n", "has 2 lines, but the data have 30 positions; write one ID per position"), ("3\n3\n", ":2:1: `3` is not above the number before; write one ID per line"), ("x\n", ":1:1: `x` is not a number")])
def test_invalid_ids_are_reported(text, problem, tmp_path):
    made("spectrum").save(tmp_path / "data")
    (tmp_path / "data/ids.txt").write_text(text)
    with pytest.raises(pwrfgs.InputError, match=re.escape(problem)):
        pwrfgs.Dataset.load(tmp_path / "data")


@pytest.mark.skipif("PWRFGS_SHARED" not in os.environ, reason="needs the measured data s23 in PWRFGS_SHARED")
def test_measured_subset_keeps_its_noise_ceiling(tmp_path):
    data = pwrfgs.Dataset.load(pathlib.Path(os.environ["PWRFGS_SHARED"]) / "data/s23")
    part = data.subset(np.sort(np.random.default_rng(0).choice(len(data), 500, replace=False)))
    part.save(tmp_path / "part")
    ceilings = [pwrfgs.repeatability(one)["near"]["ssim"]["mean"] for one in (part, pwrfgs.Dataset.load(tmp_path / "part"))]
    assert ceilings[0] == ceilings[1] == pytest.approx(0.962, abs=0.001)


def test_moved_run_folder_finds_its_data(small, tmp_path):
    pwrfgs.run(small, out=tmp_path / "runs/first", progress=False)
    (tmp_path / "runs/first").rename(tmp_path / "moved")
    run = pwrfgs.Run(tmp_path / "moved")
    assert np.array_equal(run.pipeline.load_data().positions, TX)
    assert len(run.model.locate(SPECTRA[:1]).positions) == 1
    assert pwrfgs.run(tmp_path / "moved", progress=False).scores == run.scores


def test_simulated_data_say_so_after_they_are_saved(tmp_path):
    data = pwrfgs.Dataset.from_arrays(TX, SPECTRA, title="toy", simulated=True)
    data.save(tmp_path / "toy")
    assert data.title == pwrfgs.Dataset.load(tmp_path / "toy").title == "toy (simulated)"
    assert str(pwrfgs.inspect(data)).startswith("toy (simulated)\n")
