"""Tasks with data and finished models: map, locate, update, compress, findings, init, plan, place, intervals, and warnings."""

from __future__ import annotations

import csv
import inspect
import logging
import pickle
import re
import subprocess

import numpy as np
import pytest
from conftest import SMALL

import pwrfgs

TX = np.random.default_rng(0).uniform((0, 0, 1), (4, 3, 1.5), (80, 3))
GATEWAYS = np.array([[0.0, 0.0, 2.5], [4.0, 3.0, 2.5], [0.0, 3.0, 2.5]])


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """A run with enough validation samples for intervals of 90 %."""
    pipeline = pwrfgs.Pipeline(SMALL.replace("Random(test: 0.2)", "Random(test: 0.2, validation: 0.2)"))
    return pwrfgs.run(pipeline, out=tmp_path_factory.mktemp("runs") / "calibrated", progress=False)


@pytest.fixture(scope="module")
def powers(tmp_path_factory):
    """Received powers at three receivers, in a folder."""
    distance = np.linalg.norm(TX[:, None] - GATEWAYS, axis=2)
    rssi = -40 - 20 * np.log10(distance) + np.random.default_rng(1).normal(size=distance.shape)
    data = pwrfgs.Dataset.from_arrays(TX, rssi=rssi, receivers=GATEWAYS)
    data.save(tmp_path_factory.mktemp("data") / "powers")
    return data


@pytest.fixture()
def command(cli, tmp_path):
    """Calls a command with `--out`; gives the folder or file that it wrote."""

    def call(*arguments, file="out"):
        out = tmp_path / file
        subprocess.run([cli, *map(str, arguments), "--out", str(out), "-q"], check=True, capture_output=True)
        return out

    return call


def table(path):
    """Rows of a CSV table."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def folder_of(data):
    """Folder of saved data."""
    return re.search(r'root: "(.*?)"', data._source).group(1)


def warnings_of(caplog):
    """Texts of all warnings that the package logged."""
    return [record.getMessage() for record in caplog.records if record.name == "pwrfgs" and record.levelname == "WARNING"]


def check_result(result, columns, rows):
    """The text, the table and the figure of a result."""
    assert str(result) and "\n" not in repr(result) and len(repr(result)) < 200
    assert result._repr_html_().startswith("<pre>")
    pandas, plt = pytest.importorskip("pandas"), pytest.importorskip("matplotlib.pyplot")
    frame = result.to_pandas()
    assert isinstance(frame, pandas.DataFrame) and frame.shape[0] == rows and set(columns) <= set(frame.columns)
    ax = plt.subplots()[1]
    assert result.plot(ax=ax) is ax and ax.has_data()
    assert result.plot().get_xlabel()
    plt.close("all")


def test_map_equals_the_arrays_of_the_program(model, run, command):
    result = model.map(plane="z=1.2", step=0.5)
    out = command("map", run.folder, "--plane", "z=1.2", "--step", "0.5")
    assert set(result.layers) == {path.stem for path in out.glob("*.npy")} >= {"azimuth", "elevation", "level"}
    for name, values in result.layers.items():
        assert np.array_equal(values, np.load(out / f"{name}.npy"), equal_nan=True), name
    first = table(out / "map.csv")[0]
    assert (result.x[0], len(result.x)) == (float(first["first_column_m"]), int(first["columns"]))
    assert np.allclose(np.diff(result.y), 0.5) and result["level"].shape == (len(result.y), len(result.x))
    assert (result.plane, result.axes, result.units["azimuth"]) == ("z = 1.2 m", ("x", "y"), "degrees")
    assert result.extrapolated.sum() == int(first["extrapolated"])
    check_result(result, ["x", "y", "level", "azimuth", "extrapolated"], result["level"].size)
    assert result.plot("azimuth").get_title(loc="left").endswith(", z = 1.2 m")
    with pytest.raises(pwrfgs.InputError, match="no layer 'levle'"):
        result["levle"]


def test_map_takes_the_settings_of_the_command(model):
    result = model.map(plane="x=0", step=1, bounds=(-1, 1, 0, 2), of="level", receiver=[])
    assert result.axes == ("y", "z") and list(result.layers) == ["level", "training_distance"]
    assert result.x.tolist() == [-1, 0, 1] and result.y.tolist() == [0, 1, 2]
    assert np.array_equal(result["level"], model.map(plane="x=0", step=1, bounds="-1,1,0,2", of=["level"])["level"])
    for settings, problem in [
        (dict(plane="z=1", stpe=0.5), "map has no field `stpe`; did you mean `step`?"),
        (dict(), "plane"),
        (dict(plane="up"), "plane up: expected a fixed coordinate"),
        (dict(plane="z=1", of="levle"), "levle"),
        (dict(plane="z=1", receiver="gx"), "no such receiver"),
        (dict(plane="z=1", step=0), "step 0: expected a grid spacing"),
    ]:
        with pytest.raises(pwrfgs.InputError) as error:
            model.map(**settings)
        assert problem in str(error.value) and "--" not in str(error.value)


def test_settings_are_in_signatures_and_docstrings():
    parameters = inspect.signature(pwrfgs.Model.map).parameters
    assert list(parameters) == ["self", "plane", "step", "bounds", "receiver", "of"]
    assert parameters["step"].default is None and parameters["plane"].default is inspect.Parameter.empty
    assert "step : number or None, default None\n    Grid spacing" in pwrfgs.Model.map.__doc__
    for function, setting in [(pwrfgs.Model.map, "step"), (pwrfgs.Model.locate, "prior"), (pwrfgs.plan, "region"), (pwrfgs.place, "mount")]:
        assert f"\n{setting} : " in function.__doc__


def test_intervals_equal_those_of_the_program(calibrated, model, dataset, command, tmp_path):
    tx = np.random.default_rng(1).normal(size=(5, 3))
    (tmp_path / "tx.csv").write_text("x,y,z\n" + "".join(f"{x!r},{y!r},{z!r}\n" for x, y, z in tx.tolist()))
    out = command(
        "predict", calibrated.folder, "--tx-csv", tmp_path / "tx.csv", "--interval", "0.9", "--stacked", "--no-png"
    )  # fmt: skip
    result = calibrated.model.predict(tx, interval=0.9)
    assert result.prediction.shape == (5, 15, 60) and np.array_equal(result.prediction, calibrated.model.predict(tx))
    assert np.array_equal(result.prediction, np.load(out / "spectra.npy"))
    assert np.array_equal(result.lower, np.load(out / "lower.npy")) and np.array_equal(result.upper, np.load(out / "upper.npy"))
    one = calibrated.model.predict(tx[0], interval=0.9)
    assert one.lower.shape == (15, 60) and np.array_equal(one.upper, result.upper[0])
    narrow = calibrated.model.predict(tx, interval=0.5)
    assert (narrow.upper <= result.upper).all() and (narrow.lower >= result.lower).all()
    with pytest.raises(pwrfgs.InputError, match="give one of vjp and interval"):
        calibrated.model.predict(tx, interval=0.9, vjp=np.zeros((5, 15, 60)))
    with pytest.raises(pwrfgs.InputError, match="lower the level"):
        calibrated.model.predict(tx, interval=0.999)
    uncalibrated = pwrfgs.Trainer(pwrfgs.Pipeline(SMALL), dataset).model()
    with pytest.raises(pwrfgs.InputError, match="^interval: the model has no calibration; use the model of a single run"):
        uncalibrated.predict(tx, interval=0.9)


def test_extrapolations_are_logged_as_warnings(model, caplog):
    near = model.training_positions[:3]
    model.predict(near)
    assert warnings_of(caplog) == []
    model.predict([*near, (60.0, 0.0, 1.0)])
    (warning,) = warnings_of(caplog)
    assert warning.startswith("1 of 4 predictions are extrapolations: farther than ")


def test_locate_equals_the_program(calibrated, command):
    result = calibrated.model.locate()
    rows = table(command("locate", calibrated.folder, "--pictures", "0") / "locations.csv")
    assert result.names == [row["observation"] for row in rows]
    assert [f"{error:.4f}" for error in result.error_m] == [row["error_m"] for row in rows]
    for k, axis in enumerate("xyz"):
        assert [f"{value:.4f}" for value in result.positions[:, k]] == [row[axis] for row in rows]
        assert result.truth[:, k].tolist() == [float(row[f"true_{axis}"]) for row in rows]
    assert [f"{area:.6f}" for area in result.region_m2] == [row["region_m2"] for row in rows]
    check_result(result, ["observation", "x", "y", "z", "misfit", "region_m2", "true_x", "error_m"], len(rows))
    without = calibrated.model.locate(no_kriging=True)
    assert "Kriging" in result.text and "Kriging" not in without.text
    assert without.positions.tolist() == result.positions.tolist()


def test_locate_changes_settings_of_the_pipeline(calibrated, command):
    change = pwrfgs.Random(test=0.1, validation=0.2)
    names = calibrated.model.locate(set={"split": change}).names
    rows = table(command("locate", calibrated.folder, "--set", f"split={change}", "--pictures", "0") / "locations.csv")
    assert names == [row["observation"] for row in rows] and len(names) == 12
    with pytest.raises(pwrfgs.InputError, match="^splt=1: .*did you mean `split`"):
        calibrated.model.locate(set={"splt": 1})


def test_locate_observations(calibrated, dataset, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # the model remembers where its run is
    model, spectra = calibrated.model, dataset.spectra[:4]
    result = model.locate(spectra)
    assert result.positions.shape == (4, 3) and np.isfinite(result.positions).all()
    assert result.truth is None and result.error_m is None and len(result.outlines) == 4
    check_result(result, ["x", "region_m2"], 4)
    bounds = (dataset.tx[:, 0].min(), dataset.tx[:, 0].max(), dataset.tx[:, 1].min(), dataset.tx[:, 1].max())
    inside = model.locate(spectra, prior=bounds).positions
    assert ((inside[:, 0] >= bounds[0]) & (inside[:, 1] <= bounds[3])).all()
    for observations, problem in [
        (spectra[:0], "observations is empty"),
        (spectra[0], "observations has shape [15, 60], expected [any, 15, 60]"),
        (np.full((2, 15, 60), np.nan), "observation 1 has a value that is not finite"),
    ]:
        with pytest.raises(pwrfgs.InputError) as error:
            model.locate(observations)
        assert problem in str(error.value)
    with pytest.raises(pwrfgs.InputError, match="prior"):
        model.locate(spectra, prior="1,0")


def test_locate_without_the_run_folder_compares_with_predictions(model, pipeline, dataset, tmp_path):
    model.save(tmp_path / "alone.safetensors")
    for alone in (pwrfgs.Trainer(pipeline, dataset).model(), pwrfgs.load(tmp_path / "alone.safetensors")):
        with pytest.raises(pwrfgs.InputError, match="use the model of a run folder"):
            alone.locate()
        known = alone.training_positions[3]
        result = alone.locate(alone.predict(known)[None].clip(0, 1))
        assert np.abs(result.positions[0] - known).max() < 0.5 and np.isnan(result.region_m2).all()
        with pytest.raises(pwrfgs.InputError, match="use the model of a run folder"):
            alone.locate(dataset.spectra[:1], set={"data.root": "elsewhere"})


def test_compressed_models_predict_alike(model, run, caplog, command, tmp_path):
    with caplog.at_level(logging.INFO, "pwrfgs"):
        small = model.compress(bits=8)
    assert "whole file" in caplog.text
    small.save(tmp_path / "small.safetensors")
    written = command("compress", run.folder, "--bits", "8", file="program.safetensors")
    assert (tmp_path / "small.safetensors").read_bytes() == written.read_bytes()
    pickle.loads(pickle.dumps(small)).save(tmp_path / "again.safetensors")
    assert (tmp_path / "again.safetensors").read_bytes() == written.read_bytes()
    near = model.training_positions[:3]
    assert np.abs(small.predict(near) - model.predict(near)).mean() < 0.02
    with pytest.raises(pwrfgs.InputError, match="bits is 9, expected 8 or 16"):
        model.compress(bits=9)


def test_update_needs_a_residual_process(model, dataset):
    with pytest.raises(pwrfgs.InputError, match="the model has no residual process"):
        model.update(dataset)


def test_update_adds_links(powers, tmp_path, caplog):
    pipeline = pwrfgs.init(powers)
    pipeline.residuals = {}  # the default settings
    pipeline.baselines, pipeline.split = [], pwrfgs.Random(test=0.2, validation=0.2)
    settings = {"training.scale": 0.01, "training.batch": 16}
    model = pwrfgs.run(pipeline, set=settings, out=tmp_path / "run", progress=False).model
    new = powers[:30]
    with caplog.at_level(logging.INFO, "pwrfgs"):
        updated = model.update(new, accept=["far-from-model"])
    assert "30 links added; " in caplog.text
    assert not np.array_equal(updated.predict(TX), model.predict(TX))
    moved = pwrfgs.Dataset.from_arrays(TX, rssi=np.full((80, 3), -40.0), receivers=GATEWAYS + 1)
    with pytest.raises(pwrfgs.InputError, match="another pose than in the model"):
        model.update(moved)


def test_findings(dataset):
    with pytest.warns(UserWarning, match="^equal-observations: "):
        equal = pwrfgs.Dataset.from_arrays(TX, np.full((80, 15, 60), 0.5, np.float32))
    (finding,) = equal.findings()
    assert finding.name == "equal-observations" and finding.problem.startswith("all 80 spectra are equal") and finding.mend
    assert dataset.findings() == []


def test_init_gives_a_pipeline_that_trains(powers, tmp_path):
    pipeline = pwrfgs.init(powers, name="first")
    train = powers.split(pipeline.split, seed=pipeline.seed).train
    assert pipeline.name == "first" and pipeline.training.batch <= len(np.unique(powers.positions[train], axis=0))
    run = pwrfgs.run(pipeline, set={"training.scale": 0.01}, out=tmp_path / "run", progress=False)
    assert run.finished and run.model.predict(TX).shape == (80, 3)
    assert pwrfgs.init(powers[:40]).load_data().ids.tolist() == powers[:40].ids.tolist()


def test_plan_equals_the_program(powers, command):
    result = pwrfgs.plan(powers, count=5)
    rows = table(command("plan", folder_of(powers), "--count", "5") / "plan.csv")
    assert len(np.unique(result.positions, axis=0)) == len(rows) == 5
    assert result.positions.tolist() == [[float(row[axis]) for axis in "xyz"] for row in rows]
    assert [int(row["candidate"]) for row in rows] == (result.order + 1).tolist()
    assert [f"{variance:.6f}" for variance in result.variances[1:]] == [row["mean_variance"] for row in rows]
    check_result(result, ["order", "candidate", "x", "y", "z", "mean_variance"], 5)


def test_plan_takes_candidates_and_scenes(model, powers):
    candidates = np.random.default_rng(2).uniform((0, 0, 1), (4, 3, 1.5), (30, 3))
    result = pwrfgs.plan(powers, candidates=candidates, count=3, length_scale=1.0)
    assert np.array_equal(result.positions, candidates[result.order]) and (np.diff(result.variances) <= 0).all()
    assert len(pwrfgs.plan(model, candidates=model.training_positions[:20] + 0.1, count=2).order) == 2
    for call, problem in [
        (lambda: pwrfgs.plan(model, count=3), "set `candidates` or `floor`, or give data"),
        (lambda: pwrfgs.plan(powers, count=81), "lower count"),
        (lambda: pwrfgs.plan(powers, cuont=3), "plan has no field `cuont`; did you mean `count`?"),
        (lambda: pwrfgs.plan(3, count=3), "source: expected a Dataset or a Model"),
        (lambda: pwrfgs.plan(powers, candidates=candidates[:, :2], count=3), "candidates has shape [30, 2]"),
    ]:
        with pytest.raises(pwrfgs.InputError) as error:
            call()
        assert problem in str(error.value)


def test_place_equals_the_program(powers, command):
    result = pwrfgs.place(powers, count=2)
    rows = table(command("place", folder_of(powers), "--count", "2") / "place.csv")
    ours = [
        (choice, str(k + 1), name, *position, f"{coverage:.3f}")
        for choice, (names, positions, coverage) in result.choices.items()
        for k, (name, position) in enumerate(zip(names, positions.tolist()))
    ]
    theirs = [
        (row["choice"], row["order"], row["receiver"], *(float(row[axis]) for axis in "xyz"), row["coverage_dbm"]) for row in rows
    ]
    assert ours == theirs
    assert result.positions.shape == (2, 3) and len(result.names) == 2 and result.coverage_dbm < 0
    check_result(result, ["choice", "order", "receiver", "x", "y", "z", "coverage_dbm"], len(rows))
    with pytest.raises(pwrfgs.InputError, match="count 4: the data have 3 receivers; lower count"):
        pwrfgs.place(powers, count=4)


def test_place_in_a_scene():
    result = pwrfgs.place("office", count=1, step=2.0, no_grid=True)
    assert result.positions.shape == (1, 3) and np.isfinite(result.coverage_dbm)


def test_warnings_of_a_run_have_their_level(pipeline, tmp_path, caplog):
    pipeline.pruners = [pwrfgs.OpacityThreshold(epsilon=1e-6)]
    pipeline.baselines = []
    pipeline.training = dict(steps=4, batch=2, densify_until=0, prune_until=2, prune_every=1, validate_every=0, checkpoint_every=4)
    with caplog.at_level(logging.INFO, "pwrfgs"):
        pwrfgs.run(pipeline, out=tmp_path / "run", progress=False)
    (warning,) = warnings_of(caplog)
    assert warning.endswith("nothing was pruned: 60 Gaussians remain, and no pruner has removed any")


def test_settings_take_nested_boxes_and_refuse_other_types(model):
    nested = model.map(plane="z=1", step=1.0, bounds=((0, 2), (0, 1)))
    assert list(nested.x) == list(model.map(plane="z=1", step=1.0, bounds="0,2,0,1").x)
    assert nested.layers.keys() == model.map(plane="z=1", step=1.0, bounds=[0, 2, 0, 1], receiver=0).layers.keys()
    with pytest.raises(pwrfgs.InputError, match="plane is 1, expected a str"):
        model.map(plane=1)
    with pytest.raises(pwrfgs.InputError, match=r"no layer 'pwr' \(layers: "):
        nested.plot("pwr")
