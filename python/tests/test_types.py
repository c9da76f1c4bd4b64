"""The types that editors and type checkers see: the package contains its stubs, and pyright finds what it should."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import pwrfgs
from conftest import ROOT
from pwrfgs import _stubs

SETTINGS = str(Path(__file__).resolve().parent.parent / "pyproject.toml")
INSTALLED = Path(pwrfgs.__file__).resolve().parent.parent
needs_mypy = pytest.mark.skipif(importlib.util.find_spec("mypy") is None, reason="mypy is not installed")
# Pyright as a wheel that contains Node.js.
needs_pyright = pytest.mark.skipif(importlib.util.find_spec("basedpyright") is None, reason="basedpyright is not installed")

# Code of a user's. A line with a mistake says so; nothing else may be found.
SAMPLE = """
from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, List

import numpy as np
from numpy.typing import NDArray

import pwrfgs
from pwrfgs import Kriging, settings
from pwrfgs.settings import Rays, Readout, Schedule


@dataclass
class Thin(pwrfgs.Pruner):
    share: float = 0.1

    def columns(self) -> List[pwrfgs.Column]:
        return [pwrfgs.Column("age")]

    def keep(self, cloud: pwrfgs.Cloud, stats: pwrfgs.Stats, context: pwrfgs.StepContext) -> NDArray[np.bool_]:
        return cloud.opacities > self.share * context.round


class Bias(pwrfgs.Metric):
    def evaluate(self, predictions: NDArray[Any], truths: NDArray[Any]) -> float:
        return float(np.mean(predictions - truths))


mask = pwrfgs.LearnableMask(lambda_=0.02, adam=True)
mask.lambda_ = mask.threshold / 2
pwrfgs.LearnableMask(lamda=1)  # error
pwrfgs.LearnableMask(0.02)  # error
pwrfgs.LearnableMask(lambda_="0.02")  # error
pwrfgs.LearnableMask(target=200)  # error
pwrfgs.LernableMask()  # error
pwrfgs.Ssim(window=7)  # error

gpus: List[str] = pwrfgs.devices()
device: str = pwrfgs.use_device(0)
pwrfgs.use_device(gpus)  # error

share: float = pwrfgs.Random(test=0.1).test
count: int = pwrfgs.Random(count=1_000).count
pwrfgs.LeaveReceiverOut(receivers=["g1"])
pwrfgs.LeaveReceiverOut(receivers=[1])  # error
pwrfgs.Nerf2Spectrum(root=Path("data") / "s23", gateway=None, elevation=(0.0, 90.0))
pwrfgs.Nerf2Spectrum(elevation=(0.0, 45.0, 90.0))  # error
pwrfgs.Teacher(width=36.5)  # error
pwrfgs.Teacher(projector=pwrfgs.Mercator(), tx_box=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))

values: List[pwrfgs.Value] = [Readout.Real, Readout.ReceivedPower(sky_deg=10), Rays.Same(400), mask]
names: List[str] = list(settings.Rays)
Schedule.Cosine(first=1e-3, last=1e-5)
Schedule.Cosine(first=1e-3)  # error
Schedule.Cosine(1e-3, 1e-5)  # error
Schedule.Constant(rate=1e-3)  # error
Rays.Some  # error
Rays.Same("400")  # error

pipeline = pwrfgs.Pipeline(name="first", data=pwrfgs.Teacher(), initializer=pwrfgs.Random())
pipeline.training.steps = 20
pipeline.training.stps = 20  # error
pipeline.training.steps = "20"  # error
pipeline.training.optimizer.network = Schedule.Cosine(first=1e-3, last=1e-5)
pipeline.training = dict(steps=20)
pipeline.training = settings.Training(steps=20, optimizer=settings.Optimizer(network=Schedule.Constant(1e-3)))
settings.Training(stps=20)  # error
settings.Near()  # error
decay: float = pipeline.training.optimizer.network_decay
pipeline.trainig  # error
pipeline.pruners = [mask, Thin()]
dataset = pipeline.load_data()
dataset = pwrfgs.Dataset.load(Path("data"))
dataset = pwrfgs.Dataset.load(pwrfgs.Arrays(root="data"))
dataset = pwrfgs.Dataset.load(3)  # error
dataset = pwrfgs.Dataset.from_arrays([[0.0, 0.0, 1.0]], rssi=[[-40.0]], receivers=[pwrfgs.Receiver()])
part: pwrfgs.Partition = dataset.split("voxel", size_m=0.2)
links = dataset.split(pwrfgs.Voxel(), seed=1).train[:4]
dataset.spectra.shape  # error
if dataset.kind == "spectra":  # error
    pass
if dataset.spectra is not None:
    brightest: NDArray[np.float32] = dataset.spectra[links]

run = pwrfgs.run(pipeline, {"training.batch": 2}, pruners=[Thin(0.2)], metrics=[Bias()], baselines=[Kriging()])
pwrfgs.run(pipeline, sets={})  # error
model = run.model
model = pwrfgs.Model.load("runs/a", Path("runs/b"))
print(model.predict([1.2, 0.3, 1.0]).shape, model.predict(dataset.tx, receiver=0), model.gaussians().means)
image: NDArray[np.float32] = pwrfgs.spectrum(np.ones(1, complex), pwrfgs.Receiver(), 2.4e9)
dataset = pwrfgs.convert.from_deepmimo(Path("scenario"), observe="channel", receiver=pwrfgs.Receiver(), pair=(0, 0, 1))
pwrfgs.convert.from_deepmimo("scenario", observe="spectra")  # error
pwrfgs.convert.from_sionna(object(), [0.0])  # error
score = pwrfgs.metrics.ssim(model.predict(dataset.tx), dataset.spectra)
trainer = pwrfgs.Trainer(pipeline, dataset)
while not trainer.finished:
    loss: float = trainer.step()["loss"]
kept: int = trainer.prune(trainer.cloud.opacities > 0.1)
trainer.modle()  # error
trainer.set_cloud(pwrfgs.Gaussians(*model.gaussians()))
trainer.save_checkpoint("c.safetensors")
trainer = pwrfgs.Trainer.load("c.safetensors", pipeline, train=links)
place: NDArray[Any] = dataset[0].tx
part_of_it: pwrfgs.Dataset = dataset[:10]
dataset[0].place  # error
for link in dataset.subset(links):
    print(link.receiver + link.id)
own = pwrfgs.Model.from_arrays(*model.gaussians(), pwrfgs.Pose(), 15, 60, readout=Readout.Power)
own = pwrfgs.Model.from_arrays(*model.gaussians())  # error
run = pwrfgs.evaluate(own, pipeline)
runs: List[pwrfgs.Run] = pwrfgs.sweep(pipeline, axes={"training.steps": [1, 2]}, seeds=range(2))
pwrfgs.sweep("paper-office", executor=ProcessPoolExecutor(2))
model.locate(set={"data.root": "data"}, prior=(0.0, 1.0, 0.0, 1.0))
picture, vjp = pwrfgs.rasterize_with_vjp(*model.gaussians(), pwrfgs.Pose())
d_means = vjp(np.ones_like(picture))[0]
"""


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What mypy found out about NumPy, once for all tests."""
    return tmp_path_factory.mktemp("mypy")


def python(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs a module where ``folder`` is the first place that Python looks in; mypy looks in the installed package."""
    environment = {**os.environ, "MYPYPATH": str(INSTALLED)}
    command = [sys.executable, "-m", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def mypy(cache: Path, *arguments: str) -> str:
    """What mypy says, by the settings of the package."""
    options = ["--config-file", SETTINGS, "--no-pretty", "--no-error-summary", "--cache-dir", str(cache)]
    done = python(cache, "mypy", *options, *arguments)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    return done.stdout


def test_the_installed_package_contains_its_stubs() -> None:
    for name, text in (("_plugins.pyi", _stubs.plugins()), ("settings.pyi", _stubs.settings()), ("_fields.pyi", _stubs.fields())):
        assert (INSTALLED / "pwrfgs" / name).read_text(encoding="utf-8") == text


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ("whole number or None", "Optional[int]"),
        ("list of (number, number)", "Sequence[Tuple[float, float]]"),
        ("((number, number), text)", "Tuple[Tuple[float, float], str]"),
        ("path", "_Path"),
        ("whole number or Auto", "Union[int, Any]"),
        ("list of Pruner", "Sequence[Any]"),
        ("Projector or None", "Optional[Any]"),
    ],
)
def test_words_become_types(words: str, wanted: str) -> None:
    assert _stubs.annotation(words) == wanted


@needs_mypy
def test_the_package_passes(cache: Path) -> None:
    assert mypy(cache, "--package", "pwrfgs") == ""


@needs_pyright
def test_mistakes_of_users_are_found(tmp_path: Path) -> None:
    rules = {"typeCheckingMode": "standard", "reportUnnecessaryComparison": "error", "extraPaths": [str(INSTALLED)]}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(rules), encoding="utf-8")
    (tmp_path / "sample.py").write_text(SAMPLE, encoding="utf-8")
    wanted = [number for number, line in enumerate(SAMPLE.splitlines()) if line.endswith("# error")]
    done = python(tmp_path, "basedpyright", "--outputjson", "--pythonpath", sys.executable)
    found = [fault["range"]["start"]["line"] for fault in json.loads(done.stdout)["generalDiagnostics"]]
    assert found == wanted, done.stdout


# Types of the part of PyTorch that the examples use: its own have gaps, and it need not be installed.
TORCH = {
    "__init__.pyi": """
from typing import Any
from . import nn as nn, optim as optim
class Tensor:
    def abs(self) -> Any: ...
float32: Any
def tensor(data: Any, *, dtype: Any = ...) -> Any: ...
def cat(tensors: Any, dim: int = ...) -> Any: ...
def broadcast_tensors(*tensors: Any) -> Any: ...
def view_as_complex(x: Any) -> Any: ...
def manual_seed(seed: int) -> Any: ...
def sin(x: Any) -> Any: ...
def cos(x: Any) -> Any: ...
def relu(x: Any) -> Any: ...
""",
    "nn.pyi": """
from typing import Any
class Module:
    def __call__(self, *inputs: Any) -> Any: ...
    def parameters(self) -> Any: ...
    def named_parameters(self) -> Any: ...
class Sequential(Module):
    def __init__(self, *modules: Module) -> None: ...
class Linear(Module):
    def __init__(self, inputs: int, outputs: int) -> None: ...
class ReLU(Module): ...
""",
    "optim.pyi": """
from typing import Any
class Adam:
    def __init__(self, parameters: Any, lr: float = ...) -> None: ...
    def step(self) -> None: ...
    def zero_grad(self) -> None: ...
""",
}
TENSORS = """
import torch

import pwrfgs

def check(x: torch.Tensor, model: pwrfgs.Model) -> None:
    image: torch.Tensor = pwrfgs.torch.rasterize(x, x, x, x, x, pwrfgs.Pose())
    image = pwrfgs.torch.rasterize(x, x, x, x, x, (x, x), 12, 48)
    image = pwrfgs.torch.predict(model, x)
    image = pwrfgs.torch.predict(model, rx_pose=x)
    pwrfgs.torch.rasterize([[0.0, 0.0, 1.0]], x, x, x, x, pwrfgs.Pose())  # error
    pwrfgs.torch.predict(model, [1.0, 2.0, 3.0])  # error
    number: float = pwrfgs.torch.predict(model, x)  # error
    pwrfgs.torch.loss(lambda found, truth: found.no_such_name)  # error
"""
# What the snippets of the README take for given.
GIVES = "import numpy as np\nimport pwrfgs\nfrom given import *\n"
GIVEN = """
from typing import Any
import numpy as np
from numpy.typing import NDArray
import pwrfgs
pipeline: pwrfgs.Pipeline
run: pwrfgs.Run
data: pwrfgs.Dataset
tx: NDArray[Any]
spectra: NDArray[Any]
rssi: NDArray[Any]
gateways: NDArray[Any]
csi: NDArray[Any]
hz: NDArray[Any]
antennas: Any
"""


@needs_pyright
def test_examples_are_clean_in_strict_mode_and_the_readme_in_standard_mode(tmp_path: Path) -> None:
    rules = {
        "typeCheckingMode": "standard", "extraPaths": [str(INSTALLED)], "stubPath": "stubs",
        "reportMissingModuleSource": "none",
    }  # fmt: skip
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(rules), encoding="utf-8")
    (tmp_path / "stubs/torch").mkdir(parents=True)
    for name, text in TORCH.items():
        (tmp_path / "stubs/torch" / name).write_text(text, encoding="utf-8")
    (tmp_path / "given.pyi").write_text(GIVEN, encoding="utf-8")
    for path in (ROOT / "python/examples").glob("*.py"):
        (tmp_path / path.name).write_text("# pyright: strict\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    readme = (ROOT / "python/README.md").read_text(encoding="utf-8")
    for place, block in enumerate(re.findall(r"```python\n(.*?)```", readme, flags=re.DOTALL)):
        name, given = ("thin", "") if "class Thin" in block else (f"snippet{place}", GIVES)
        (tmp_path / f"{name}.py").write_text(given + block, encoding="utf-8")
    assert (tmp_path / "own_loop.py").is_file() and (tmp_path / "thin.py").is_file()
    done = python(tmp_path, "basedpyright", "--outputjson", "--pythonpath", sys.executable)
    faults = json.loads(done.stdout)["generalDiagnostics"]
    found = [f"{Path(f['file']).name}:{f['range']['start']['line'] + 1}: {f['message']}" for f in faults]
    assert found == [], "\n".join(found)


@needs_mypy
def test_functions_of_torch_take_and_return_tensors(cache: Path, tmp_path: Path) -> None:
    (tmp_path / "torch").mkdir()
    for name, text in TORCH.items():
        (tmp_path / "torch" / name).write_text(text, encoding="utf-8")
    (tmp_path / "tensors.py").write_text(TENSORS, encoding="utf-8")
    found = re.findall(r"tensors\.py:(\d+): error", mypy(cache, str(tmp_path / "tensors.py")))
    assert [int(line) for line in found] == [
        number for number, line in enumerate(TENSORS.splitlines(), 1) if line.endswith("# error")
    ]


@needs_mypy
def test_the_stub_of_the_compiled_half_names_what_is_there(tmp_path: Path) -> None:
    done = python(tmp_path, "mypy.stubtest", "--concise", "--mypy-config-file", SETTINGS, "pwrfgs._pwrfgs")
    telling = re.compile(r"is not present (in stub|at runtime)|is inconsistent")
    # PyO3 has no names for some defaults, and gives a module `__all__`.
    idle = re.compile(r"default value of Ellipsis|__all__")
    wrong = [line for line in done.stdout.splitlines() if telling.search(line) and not idle.search(line)]
    assert wrong == [], done.stdout
    looked = "error:" not in done.stdout and "failed" not in done.stdout
    assert looked and not done.stderr, done.stdout + done.stderr
