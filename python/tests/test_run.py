"""Runs: the same as the command line's, resumed, stopped, and told of."""

from __future__ import annotations

import importlib
import os
import pathlib
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT, SMALL, files, interrupted

import pwrfgs


def test_a_run_is_that_of_the_command_line(run, cli, tmp_path):
    (tmp_path / "small.ron").write_text(SMALL)
    subprocess.run([cli, "run", str(tmp_path / "small.ron"), "--out", str(tmp_path / "r"), "-q"], check=True, capture_output=True)
    ours, theirs = files(run.folder), files(tmp_path / "r")
    assert [name for name in ours if ours[name] != theirs[name]] == []


def test_names_of_receivers_are_read_as_they_are(tmp_path):
    (tmp_path / "samples.csv").write_text("link,id,receiver,x,split\n0,0,'=n(),-1.5,test\n1,0,''a,,test\n2,1,b,1,train\n")
    (tmp_path / "scores.csv").write_text("predictor,metric,sample,value\nmodel,l1,0,0.5\n'=p,l1,1,0.25\nmodel,gaussians,,3\n")
    rows = pwrfgs.Run.samples(SimpleNamespace(_file=lambda name: str(tmp_path / name)))
    assert rows == [
        {"link": 0, "id": 0, "receiver": "=n()", "x": -1.5, "model l1": 0.5},
        {"link": 1, "id": 0, "receiver": "'a", "x": None, "=p l1": 0.25},
    ]


def test_what_a_run_holds(run):
    assert run.finished and run.facts["steps"] == 60 and run.model.n == run.scores["model"]["gaussians"]
    assert 0 < run.scores["model"]["ssim"]["mean"] <= 1 and set(run.scores) >= {"model", "mean spectrum", "3-NN"}
    assert run.scores["3-NN"]["gaussians"] is None
    assert run.curve["step"].tolist() == list(range(1, 61)) and run.curve["phase"][0] == "densify"
    assert "ssim" in repr(run) and "3-NN" in str(run) and "<pre>" in run._repr_html_() and "html" in open(run.report).read(200)
    rows = run.samples()
    assert len(rows) == run.facts["samples"][2] and set(rows[0]) >= {"id", "x", "nearest_train_m", "3-NN ssim"}
    assert np.isclose(np.mean([row["model ssim"] for row in rows]), run.scores["model"]["ssim"]["mean"])
    assert run.validation["step"].tolist() == [20, 40, 60]
    again = pwrfgs.run(pwrfgs.Pipeline(SMALL), out=run.folder, progress=False)
    assert again.scores == run.scores
    with pytest.raises(pwrfgs.InputError, match="not a run folder"):
        pwrfgs.Run("/nowhere")


def test_scores_as_a_table(run):
    pytest.importorskip("pandas")
    assert run.table().loc["model", "ssim_mean"] == run.scores["model"]["ssim"]["mean"]


def test_values_have_a_repr_of_one_line(run, model, dataset, pipeline):
    trainer = pwrfgs.Trainer(pipeline, dataset)
    parts = dataset.split("random", test=0.2, validation=0.0)
    assert repr(parts) == "<Partition: train [96], validation [0], test [24]>"
    gaussians = model.gaussians()
    splats = pwrfgs.project(*gaussians[:4], pwrfgs.Pose(), 15, 60)
    for value in (run, model, dataset, pipeline, trainer, trainer.cloud, trainer.stats, parts, gaussians, splats, dataset.receivers):
        assert "\n" not in repr(value) and len(repr(value)) < 200, repr(value)


def test_missing_extras_are_named_with_their_command(run, monkeypatch):
    settings = (ROOT / "python/pyproject.toml").read_text()
    for package, extra, use in [
        ("matplotlib", "plot", lambda: pwrfgs.plot.curve(run)),
        ("pandas", "frames", run.table),
        ("torch", "torch", lambda: importlib.import_module("pwrfgs.torch")),
    ]:
        for name in (package, "matplotlib.pyplot"):
            monkeypatch.setitem(sys.modules, name, None)
        monkeypatch.delitem(sys.modules, "pwrfgs.torch", raising=False)
        with pytest.raises(ImportError) as told:
            use()
        cpu = "torch --index-url https://download.pytorch.org/whl/cpu"
        install = cpu if package == "torch" else f"'pwrfgs[{extra}]'"
        assert str(told.value) == f"{package} is missing; install it with: pip install {install}"
        assert f"\n{extra} = [" in settings


def test_stopped_and_resumed_it_ends_in_the_same_files(run, tmp_path):
    def stop_at(step):
        def hear(event):
            if event["what"] == "step" and event["step"] == step:
                raise KeyboardInterrupt

        return hear

    for step in (3, 25, 47):
        with pytest.raises(KeyboardInterrupt):
            pwrfgs.run(pwrfgs.Pipeline(SMALL), out=tmp_path / "r", callback=stop_at(step), progress=False)
        assert (tmp_path / "r/checkpoint.safetensors").is_file() and not pwrfgs.Run(tmp_path / "r").finished
    resumed = pwrfgs.run(tmp_path / "r", progress=False, keep_checkpoint=True)
    assert files(resumed.folder) == files(run.folder)
    ours, theirs = (pathlib.Path(one.folder, "checkpoint.safetensors") for one in (resumed, run))
    assert ours.read_bytes() == theirs.read_bytes()
    once = pwrfgs.run(pwrfgs.Pipeline(SMALL), out=tmp_path / "once", progress=False)
    assert files(once.folder) == files(run.folder) and not (tmp_path / "once/checkpoint.safetensors").exists()


@pytest.mark.parametrize(
    "call",
    [
        "pwrfgs.baselines.kriging(data, np.zeros((10**6, 3)))",
        "pwrfgs.Dataset.load(pwrfgs.Teacher(gaussians=5, samples=10**6, width=60, height=15))",
    ],
)
def test_ctrl_c_ends_a_long_call(call):
    code = (
        "import numpy as np, pwrfgs, time\nfrom conftest import SMALL\n"
        "data = pwrfgs.Pipeline(SMALL).load_data(); print('there', flush=True)\n"
        f"try:\n    pass\n    {call}\n    print('not stopped', flush=True)\n"
        "except KeyboardInterrupt: print('stopped', flush=True)\n"
    )
    begun = time.monotonic()
    assert interrupted(code, after=1.5) == "stopped\n"
    assert time.monotonic() - begun < 15


def test_ctrl_c_ends_the_fit_of_a_baseline():
    """The fit at 40 receivers takes several seconds: the call ends within one."""
    code = (
        "import numpy as np, pwrfgs, time\nrng = np.random.default_rng(0)\n"
        "tx, gateways = rng.uniform(0, 10, (400, 3)), rng.uniform(0, 10, (40, 3))\n"
        "rssi = -20 * np.log10(np.linalg.norm(tx[:, None] - gateways, axis=2)) + rng.normal(size=(400, 40))\n"
        "data = pwrfgs.Dataset.from_arrays(tx, rssi=rssi, receivers=gateways)\n"
        "print('there', flush=True); begun = time.monotonic()\n"
        "try:\n    pass\n    pwrfgs.baselines.kriging(data, tx[:1])\n    print('not stopped', flush=True)\n"
        "except KeyboardInterrupt: print(time.monotonic() - begun, flush=True)\n"
    )
    assert 0.3 < float(interrupted(code, after=0.4)) < 1.4


def test_ctrl_c_in_a_terminal(run, tmp_path):
    """The signal itself, in a process of its own; what goes on then is what would have been."""
    code = (
        "import pwrfgs, sys, time\nfrom conftest import SMALL\n"
        "def hear(event):\n    if event['what'] == 'step' and event['step'] >= 20:\n"
        "        print('there', flush=True); time.sleep(0.05)\n"
        "try: pwrfgs.run(pwrfgs.Pipeline(SMALL), out=sys.argv[1], callback=hear, progress=False)\n"
        "except KeyboardInterrupt as stopped: print('stopped:', stopped, flush=True)\n"
    )
    assert "stopped:" in interrupted(code, tmp_path / "r")
    assert (tmp_path / "r/checkpoint.safetensors").is_file() and not pwrfgs.Run(tmp_path / "r").finished
    assert files(pwrfgs.run(tmp_path / "r", progress=False).folder) == files(run.folder)


def test_an_exception_in_a_callback_comes_out(tmp_path):
    class Mine(Exception):
        pass

    def hear(event):
        if event["what"] == "step":
            raise Mine(event["step"])

    with pytest.raises(Mine):
        pwrfgs.run(pwrfgs.Pipeline(SMALL), out=tmp_path / "r", callback=hear, progress=False)


def test_settings_as_on_the_command_line(tmp_path, capfd):
    events = []
    done = pwrfgs.run(
        pwrfgs.Pipeline(SMALL), set={"training.scale": 0.2, "pruners": [pwrfgs.TopK()], "training.target_count": 20, "split": "Random(test: 0.5)"},
        out=tmp_path / "r", callback=events.append, progress=True,
    )
    assert done.facts["steps"] == 12 and done.model.n <= 20 and done.facts["samples"][2] == 60
    assert {event["what"] for event in events} >= {"start", "step", "stage", "message"}
    assert capfd.readouterr().err == ""  # no bar without a terminal
    with pytest.raises(pwrfgs.InputError, match="did you mean"):
        pwrfgs.run(pwrfgs.Pipeline(SMALL), set={"training.stepz": 1}, out=tmp_path / "x", progress=False)
    with pytest.raises(pwrfgs.Error):
        pwrfgs.run(pwrfgs.Pipeline(SMALL), set={"seed": 5}, out=tmp_path / "r", progress=False)  # another run lies there


def test_the_loop_in_ones_own_hands(pipeline, run):
    trainer = pwrfgs.Trainer(pipeline)
    losses = [trainer.step()["loss"] for _ in range(60)]
    assert trainer.finished and trainer.done == 60
    place = [0.5, 0.2, 1.0]
    assert np.array_equal(trainer.model().predict(place), run.model.predict(place))
    assert np.allclose(losses, run.curve["loss"], rtol=1e-6)
    trainer = pwrfgs.Trainer(pipeline, trainer.dataset)
    trainer.step()
    n = len(trainer.cloud)
    keep = np.arange(n) % 2 == 0
    means = trainer.cloud.means[keep]
    assert trainer.prune(keep) == keep.sum() and np.array_equal(trainer.cloud.means, means)
    assert len(trainer.stats.visible) == keep.sum()
    trainer.step()
    for wrong, said in [(np.ones(3, bool), "3 values"), (np.zeros(int(keep.sum()), bool), "all Gaussians would be removed"), ([1.5], "bool")]:
        with pytest.raises(pwrfgs.InputError) as told:
            trainer.prune(wrong)
        assert said in str(told.value)


def test_sweeps_reports_and_simulations(tmp_path):
    (tmp_path / "small.ron").write_text(SMALL.replace("steps: 60", "steps: 40"))
    (tmp_path / "e.ron").write_text(
        'Experiment(name: "e", base: "small.ron", seeds: [0, 1], set: {"pruners": [TopK()], "training.target_count": 20}, axes: [Axis(name: "n", '
        'variants: [(label: "20", set: {"training.target_count": 20}), (label: "40", set: {"training.target_count": 40})])])'
    )
    runs = pwrfgs.sweep(tmp_path / "e.ron", out=tmp_path / "sweep", jobs=1)
    assert len(runs) == 4 and all(run.finished for run in runs) and (tmp_path / "sweep/report/report.html").is_file()
    (tmp_path / "j.ron").write_text('Experiment(name: "j", join: true, base: "small.ron", seeds: [0, 1])')
    joined = pwrfgs.sweep(tmp_path / "j.ron", out=tmp_path / "both")[-1]
    assert joined.folder.endswith("joined") and [os.path.basename(name) for name in joined.model.members] == ["seed-0", "seed-1"]
    with pytest.raises(pwrfgs.InputError, match="pwrfgs sweep"):
        pwrfgs.run(tmp_path / "j.ron")
    text = pwrfgs.report(runs[:2], out=tmp_path / "compared")
    assert "SSIM" in text and (tmp_path / "compared/report.html").is_file()
    with pytest.raises(pwrfgs.InputError, match="did you mean"):
        pwrfgs.simulate("x.ron", tmp_path / "s", layout="spectrum")
    with pytest.raises(pwrfgs.Error):
        pwrfgs.sweep(tmp_path / "none.ron")


def test_folders_of_others_are_left_alone(pipeline, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scores.csv").write_text("mine")
    for out in ("", ".", tmp_path):
        with pytest.raises(pwrfgs.InputError):
            pwrfgs.run(pipeline, out=out, progress=False)
    assert [path.name for path in tmp_path.iterdir()] == ["scores.csv"]


def test_a_folder_may_have_any_name(pipeline, tmp_path):
    run = pwrfgs.run(pipeline, out=tmp_path / "a (1)", progress=False)
    for name in (tmp_path / "a (1)", str(tmp_path / "a (1)")):
        assert pwrfgs.run(name, progress=False).folder == run.folder


def test_too_many_threads_in_the_environment_are_refused():
    def called(value):
        environment = {**os.environ, "RAYON_NUM_THREADS": value}
        return subprocess.run([sys.executable, "-c", "import pwrfgs"], env=environment, capture_output=True, text=True, check=False)

    told = called("100000")
    assert told.returncode == 1 and "InputError: RAYON_NUM_THREADS is `100000`; give a number from 1 to 1024" in told.stderr
    assert called("2").returncode == 0
