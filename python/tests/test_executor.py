"""Sweeps whose runs an executor performs, in processes of its own."""

from __future__ import annotations

import multiprocessing
import os
import pathlib
import signal
import subprocess
import sys
import time
import traceback
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest
from conftest import files

import pwrfgs

QUICK = {"data.samples": 40, "training.steps": 4, "training.densify_until": 1, "training.prune_until": 3, "training.validate_every": 0}


@dataclass
class Thin(pwrfgs.Pruner):
    """Raises an exception while a file exists."""

    share: float
    unless: str = ""

    def keep(self, cloud, stats, context):
        return cloud.opacities >= np.quantile(cloud.opacities, self.share)

    def update(self, cloud, stats, context):
        if self.unless and pathlib.Path(self.unless).exists():
            raise ZeroDivisionError(f"not at step {context.step}")


@pytest.fixture(params=["processes", "dask"])
def executor(request):
    if request.param == "processes":
        with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
            yield pool
        return
    distributed = pytest.importorskip("distributed", reason="Dask (distributed) is not installed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        with distributed.Client(cluster) as client:
            yield client.get_executor()


def test_runs_of_an_executor_are_those_of_one_process(executor, pipeline, tmp_path):
    there = tmp_path / "there"
    there.touch()
    axes = {"pruners": {"thin": [Thin(0.1)], "wrong": [Thin(0.2, str(there))]}}
    call = dict(set=QUICK, axes=axes, seeds=[1], name="s", keep_checkpoint=True)
    with pytest.raises(pwrfgs.SweepError, match="1 of 2 runs failed, .*wrong,seed=1: ZeroDivisionError: not at step 1") as told:
        pwrfgs.sweep(pipeline, out=tmp_path / "s", executor=executor, **call)
    folder = str(tmp_path / "s/pruners=wrong,seed=1")
    assert told.value.reasons == {folder: "ZeroDivisionError: not at step 1"}
    assert type(told.value.__cause__) is ZeroDivisionError and told.value.exceptions == {folder: told.value.__cause__}
    assert "in update" in "".join(traceback.format_exception(told.type, told.value, told.tb))
    assert (tmp_path / "s/failures/pruners=wrong,seed=1.txt").read_text() == "ZeroDivisionError: not at step 1\n"
    assert not (tmp_path / "s/report").exists()
    done = pwrfgs.Run(tmp_path / "s/pruners=thin,seed=1").facts["started"]

    there.unlink()
    runs = pwrfgs.sweep(pipeline, out=tmp_path / "s", executor=executor, **call)
    assert runs[0].facts["started"] == done and (tmp_path / "s/pruners=thin,seed=1/checkpoint.safetensors").is_file()
    assert (tmp_path / "s/report/report.html").is_file() and not (tmp_path / "s/failures").exists()
    alone = pwrfgs.sweep(pipeline, out=tmp_path / "alone", **call)
    assert [files(run.folder) for run in runs] == [files(run.folder) for run in alone]


def test_an_experiment_says_how_many_threads_a_run_has(pipeline, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pipeline.set(QUICK).save("base.ron")
    text = 'Experiment(name: "e", base: "base.ron", seeds: [1, 2], join: true, slurm: (cpus: 1), axes: [])'
    (tmp_path / "e.ron").write_text(text)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        *runs, joined = pwrfgs.sweep("e.ron", executor=pool)
        again = pwrfgs.sweep("e.ron", executor=pool)
    assert [run.facts["machine"]["threads"] for run in runs] == [1, 1]
    assert joined.folder.endswith("joined") and joined.finished and joined.facts["started"] == again[-1].facts["started"]
    assert (tmp_path / "runs/e/report/report.html").is_file()


INTERRUPTED = """
import multiprocessing, signal, sys
from concurrent.futures import ProcessPoolExecutor
import pwrfgs
from conftest import SMALL

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        pwrfgs.sweep(pwrfgs.Pipeline(SMALL), {"training.steps": 10**6}, sys.argv[1], axes={"training.batch": [1, 2]}, executor=pool)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_interrupt_ends_all_runs_of_an_executor(tmp_path):
    (tmp_path / "interrupted.py").write_text(INTERRUPTED)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path])}
    child = subprocess.Popen(
        [sys.executable, "interrupted.py", "s"], cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    curve = tmp_path / "s/batch=1,seed=0/curve.csv"
    try:
        while child.poll() is None and not curve.exists():
            time.sleep(0.1)
        os.killpg(child.pid, signal.SIGINT)
        assert "KeyboardInterrupt" in child.communicate(timeout=60)[1]
    finally:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
    assert (tmp_path / "s/batch=1,seed=0/checkpoint.safetensors").is_file() and not (tmp_path / "s/batch=2,seed=0").exists()


def test_other_executors_are_refused(pipeline, tmp_path):
    for executor, jobs, said in [(map, 1, "give a concurrent.futures.Executor"), (ProcessPoolExecutor(1), 2, "jobs has no effect")]:
        with pytest.raises(pwrfgs.InputError, match=said):
            pwrfgs.sweep(pipeline, axes={"seed": [1]}, out=tmp_path / "s", executor=executor, jobs=jobs)
