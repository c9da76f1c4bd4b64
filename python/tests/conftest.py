"""What the tests share: a small data set, and a run on it."""

from __future__ import annotations

import os
import pathlib
import shutil
import signal
import subprocess
import sys
import time
from typing import Any, Dict

import pytest

import pwrfgs

ROOT = pathlib.Path(__file__).resolve().parents[2]
SMALL = """Pipeline(
    name: "small", data: Teacher(gaussians: 5, samples: 120, width: 60, height: 15), split: Random(test: 0.2),
    initializer: Random(count: 60, std: 3.0), deformation: Factored(width: 16, depth: 1), pruners: [OpacityThreshold(epsilon: 0.02)],
    training: (steps: 60, batch: 4, densify_until: 20, prune_until: 40, prune_every: 10, validate_every: 20, checkpoint_every: 10),
    baselines: [MeanSpectrum(), NearestNeighbours(k: 3)], metrics: [Ssim(), RateRatio(), GaussianCount()],
)"""


@pytest.fixture()
def pipeline() -> pwrfgs.Pipeline:
    return pwrfgs.Pipeline(SMALL)


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> pwrfgs.Run:
    return pwrfgs.run(pwrfgs.Pipeline(SMALL), out=tmp_path_factory.mktemp("runs") / "small", progress=False, keep_checkpoint=True)


@pytest.fixture(scope="session")
def model(run: pwrfgs.Run) -> pwrfgs.Model:
    return run.model


@pytest.fixture(scope="session")
def dataset(run: pwrfgs.Run) -> pwrfgs.Dataset:
    return run.pipeline.load_data()


@pytest.fixture(scope="session")
def cli() -> str:
    """The program of the command line, built as the package is."""
    found = os.environ.get("PWRFGS_CLI") or shutil.which("pwrfgs") or str(ROOT / "target/release/pwrfgs")
    if not os.path.isfile(found):
        pytest.skip("there is no program `pwrfgs`; name it in PWRFGS_CLI")
    return found


def files(folder: Any) -> Dict[str, bytes]:
    """What a resumed run has to have in common with one never stopped: everything but times."""
    folder = pathlib.Path(folder)
    found = {}
    for name in ("pipeline.ron", "model.safetensors", "start.safetensors", "validation.csv"):
        found[name] = (folder / name).read_bytes()
    for name in ("curve.csv", "scores.csv", "samples.csv"):
        lines = (folder / name).read_text().splitlines()
        if name == "curve.csv":
            lines = [line.rsplit(",", 1)[0] for line in lines]
        found[name] = "\n".join(line for line in lines if "latency" not in line).encode()
    return found


def interrupted(code: str, *arguments: Any, after: float = 0.0) -> str:
    """Runs `code` in a process of its own, sends Ctrl-C `after` seconds from its line "there" on; what it printed then."""
    # What runs in the background may ignore the signal.
    begin = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    child = subprocess.Popen(
        [sys.executable, "-c", begin + code, *map(str, arguments)],
        stdout=subprocess.PIPE, text=True, cwd=os.path.dirname(__file__),
    )  # fmt: skip
    try:
        assert child.stdout is not None and child.stdout.readline() == "there\n"
        time.sleep(after)
        child.send_signal(signal.SIGINT)
        return child.communicate(timeout=60)[0]
    finally:
        child.kill()
