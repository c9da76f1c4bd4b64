"""Command line and Python give equal numbers for each task and kind of data, or refuse with the same message."""

from __future__ import annotations

import csv
import re
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest

import pwrfgs

POSITIONS = np.random.default_rng(0).uniform((0, 0, 1), (4, 3, 1.5), (60, 3))
GATEWAYS = np.array([[0.0, 0.0, 2.5], [4.0, 3.0, 2.5]])
KINDS = ("quickstart", "powers", "channels", "moving")
pytestmark = pytest.mark.filterwarnings("ignore:orientation")  # of the moving receiver; `test_findings` has it
# Kinds of data for which a task is not available.
REFUSED = {
    "locate": ["moving"], "place": ["quickstart", "channels", "moving"], "interval": ["channels"], "update": ["moving"],
}  # fmt: skip


def made(kind):
    """Data of a kind: those of the quickstart, or a toy in which received power falls with distance."""
    if kind == "quickstart":
        return pwrfgs.Pipeline("quickstart").set({"data.samples": 60}).load_data()
    noise = np.random.default_rng(1)
    distance = np.linalg.norm(POSITIONS[:, None] - GATEWAYS, axis=2)
    if kind == "powers":
        rssi = -40 - 20 * np.log10(distance) + noise.normal(size=distance.shape)
        return pwrfgs.Dataset.from_arrays(POSITIONS, rssi=rssi, receivers=GATEWAYS)
    if kind == "channels":
        hz, antennas = np.array([9e7, 1e8]), np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
        lengths = np.linalg.norm(POSITIONS[:, None] - GATEWAYS[0] - antennas, axis=2)
        csi = np.exp(-2j * np.pi * lengths[:, :, None] * hz / 3e8) / lengths[:, :, None]
        receiver = pwrfgs.Receiver(position=tuple(GATEWAYS[0]), antennas=[tuple(at) for at in antennas])
        return pwrfgs.Dataset.from_arrays(POSITIONS, csi=csi, frequencies_hz=hz, receivers=receiver)
    azimuth = np.arctan2(*(POSITIONS - GATEWAYS[0])[:, 1::-1].T)
    columns = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    spectra = np.exp(np.cos(columns - azimuth[:, None]) - 1)[:, None] * np.linspace(0.9, 0.3, 6)[:, None]
    spectra = (spectra * noise.uniform(0.95, 1.0, spectra.shape)).astype(np.float32)
    poses = np.concatenate([POSITIONS, np.tile([0.0, 0.0, 0.0, 1.0], (60, 1))], axis=1)
    return pwrfgs.Dataset.from_arrays(spectra=spectra, rx_pose=poses, transmitter=(0.0, 0.0, 2.5))


@pytest.fixture(scope="module", params=KINDS)
def case(request, tmp_path_factory):
    """Data in a folder, and a short run on them."""
    folder = tmp_path_factory.mktemp(request.param)
    data = made(request.param)
    data.save(folder / "data")
    pipeline = pwrfgs.Pipeline("quickstart") if request.param == "quickstart" else pwrfgs.Pipeline.for_data(data, name="case")
    pipeline.data = data
    pipeline.split, pipeline.baselines = pwrfgs.Random(test=0.2, validation=0.2), [pwrfgs.NearestNeighbours(k=3)]
    pipeline.training.batch = 8
    if request.param != "moving":
        pipeline.residuals = {}
    if request.param == "channels":
        pipeline.initializer = pwrfgs.MatchingPursuit(most=2, reach=1.0, step=1.0, patience=1, rounds=0)
    run = pwrfgs.run(pipeline, set={"training.scale": 0.005}, out=folder / "run", progress=False)
    return SimpleNamespace(kind=request.param, data=data, folder=folder / "data", run=run, model=run.model)


@pytest.fixture()
def both(case, cli, tmp_path):
    """Calls a task in Python and on the command line: the result and the folder or file of `--out`, or None if both refuse with the
    same message."""

    def plain(text):
        return re.sub(r"[-_`\s]+", " ", text.replace("--", "").replace("=pwrfgs.settings.", ": "))

    def call(task, python, *arguments, file="out"):
        out = tmp_path / file
        words = [cli, *map(str, arguments), "--out", str(out), "-q"]
        done = subprocess.run(words, check=False, capture_output=True, text=True, cwd=tmp_path)
        try:
            result = python()
        except pwrfgs.InputError as error:
            assert case.kind in REFUSED.get(task, ()) and done.returncode == 2, f"{error}\n{done.stderr}"
            assert plain(str(error)) in plain(done.stderr)
            return None
        assert done.returncode == 0 and case.kind not in REFUSED.get(task, ()), done.stderr
        return result, out

    return call


def table(path):
    """Rows of a CSV table."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def without_times(path):
    """Rows of a CSV table whose metric is no time and no memory."""
    return [row for row in table(path) if not row["metric"].startswith(("latency", "training_s", "peak_memory"))]


def positions_file(case, folder):
    """Arguments of `predict` and of `Model.predict` for five positions or poses."""
    rows = POSITIONS[:5] + 0.05
    name, head = "tx", "x,y,z\n"
    if case.kind == "moving":
        rows = np.concatenate([rows, np.tile([0.0, 0.0, 0.6, 0.8], (5, 1))], axis=1)
        name, head = "rx_pose", "x,y,z,qx,qy,qz,qw\n"
    path = folder / "positions.csv"
    path.write_text(head + "".join(",".join(map(repr, row)) + "\n" for row in rows.tolist()))
    return [f"--{name.replace('_', '-')}-csv", path], {name: rows}


def test_map(case, both):
    arguments = ["map", case.run.folder, "--plane", "z=1.2", "--step", "1"]
    result, out = both("map", lambda: case.model.map(plane="z=1.2", step=1.0), *arguments)
    assert set(result.layers) == {path.stem for path in out.glob("*.npy")}
    for name, values in result.layers.items():
        assert np.array_equal(values, np.load(out / f"{name}.npy"), equal_nan=True), name


def test_predict(case, both, tmp_path):
    words, named = positions_file(case, tmp_path)
    stacked = [] if case.kind == "powers" else ["--stacked"]
    result, out = both("predict", lambda: case.model.predict(**named), "predict", case.run.folder, *words, "--no-png", *stacked)
    if case.kind == "powers":
        assert np.array_equal(result.ravel(), np.float32([row["dbm"] for row in table(out / "predictions.csv")]))
    else:
        assert np.array_equal(result, np.load(out / ("channels.npy" if case.kind == "channels" else "spectra.npy")))


def test_predict_with_intervals(case, both, tmp_path):
    words, named = positions_file(case, tmp_path)
    stacked = [] if case.kind == "powers" else ["--stacked"]
    arguments = ["predict", case.run.folder, *words, "--interval", "0.9", "--no-png", *stacked]
    found = both("interval", lambda: case.model.predict(interval=0.9, **named), *arguments)
    if found is None:
        return
    result, out = found
    for name in ("lower", "upper"):
        ours = getattr(result, name)
        if case.kind == "powers":
            assert np.array_equal(ours.ravel(), np.float32([row[f"{name}_dbm"] for row in table(out / "predictions.csv")]))
        else:
            assert np.array_equal(ours, np.load(out / f"{name}.npy"))


def test_locate(case, both):
    found = both("locate", lambda: case.model.locate(), "locate", case.run.folder, "--pictures", "0")
    if found is not None:
        result, rows = found[0], table(found[1] / "locations.csv")
        ours = [[name, *(f"{v:.4f}" for v in position)] for name, position in zip(result.names, result.positions)]
        assert ours == [[row["observation"], row["x"], row["y"], row["z"]] for row in rows]
        assert [f"{error:.4f}" for error in result.error_m] == [row["error_m"] for row in rows]
        assert [f"{misfit:.4f}" for misfit in result.misfit] == [row["misfit"] for row in rows]


def test_plan(case, both):
    result, out = both("plan", lambda: pwrfgs.plan(case.data, count=4), "plan", case.folder, "--count", "4")
    rows = table(out / "plan.csv")
    assert [int(row["candidate"]) for row in rows] == (result.order + 1).tolist()
    assert [f"{variance:.6f}" for variance in result.variances[1:]] == [row["mean_variance"] for row in rows]


def test_place(case, both):
    found = both("place", lambda: pwrfgs.place(case.data, count=1), "place", case.folder, "--count", "1")
    if found is not None:
        rows = table(found[1] / "place.csv")
        assert [(row["choice"], row["receiver"]) for row in rows] == [(name, one[0][0]) for name, one in found[0].choices.items()]
        assert rows[0]["coverage_dbm"] == f"{found[0].coverage_dbm:.3f}"


def test_update(case, both, tmp_path):
    arguments = ["update", case.run.folder, "--data", case.folder, "--accept", "far-from-model"]
    found = both("update", lambda: case.model.update(case.data, accept=["far-from-model"]), *arguments, file="new.safetensors")
    if found is not None:
        found[0].save(tmp_path / "python.safetensors")
        assert (tmp_path / "python.safetensors").read_bytes() == found[1].read_bytes()


def test_compress(case, both, tmp_path):
    model = pwrfgs.Trainer(case.run.pipeline, case.data).model()  # without a residual process
    model.save(tmp_path / "model.safetensors")
    arguments = ["compress", tmp_path / "model.safetensors", "--bits", "16"]
    small, out = both("compress", lambda: model.compress(bits=16), *arguments, file="small.safetensors")
    small.save(tmp_path / "python.safetensors")
    assert (tmp_path / "python.safetensors").read_bytes() == out.read_bytes()


def test_init(case, both):
    pipeline, out = both("init", lambda: pwrfgs.init(case.data, name="data"), "init", case.folder, file="new.ron")
    assert str(pwrfgs.Pipeline(out)) == str(pipeline)


def test_findings(case, cli):
    done = subprocess.run([cli, "data", "check", case.folder], check=True, capture_output=True, text=True)
    assert done.stderr.count("warning: ") == len(case.data.findings())
    assert all(finding.problem in done.stderr for finding in case.data.findings())


def test_evaluate(case, both, tmp_path):
    result, out = both(
        "evaluate", lambda: pwrfgs.evaluate(case.model, case.run.pipeline, out=tmp_path / "python", progress=False),
        "evaluate", case.run.folder,
    )  # fmt: skip
    assert without_times(out / "scores.csv") == without_times(tmp_path / "python" / "scores.csv")
    assert result.scores["model"] != {}


def test_compare(case, both, tmp_path):
    methods = ["virtual transmitters of order 0" if case.kind == "channels" else "P-WRFGS"]
    python, scale = tmp_path / "python", {"training.scale": 0.002}
    arguments = ["compare", case.folder, "--seeds", "1", "--methods", *methods, "--scale", "0.002"]
    result, out = both(
        "compare", lambda: pwrfgs.compare(case.folder, seeds=1, methods=methods, set=scale, out=python), *arguments
    )  # fmt: skip
    assert without_times(out / "report/report.csv") == without_times(python / "report/report.csv")
    assert [row["value"] for row in result.rows] == [float(row["value"]) for row in table(python / "report/report.csv")]
    assert len(result.runs) == 1 and result.split.train.size > result.split.test.size > 0
