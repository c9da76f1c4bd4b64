"""Strategies in Python: objects of a pipeline, and their exceptions in runs and sweeps."""

from __future__ import annotations

import copy
import pickle
import traceback
from dataclasses import dataclass

import networks
import numpy as np
import pytest
from conftest import SMALL

import pwrfgs


@dataclass
class Thin(pwrfgs.Pruner):
    share: float = 0.2

    def keep(self, cloud, stats, context):
        return cloud.opacities >= np.quantile(cloud.opacities, self.share)


class Thick(Thin): ...


@dataclass
class Box(pwrfgs.Initializer):
    n: int = 50

    def initialize(self, room, rng):
        return dict(means=rng.uniform(*room.bounds, size=(self.n, 3)), scales=0.5)


class Raises:
    """Raises an exception in every method of a strategy."""

    def __getattribute__(self, name):
        found = object.__getattribute__(self, name)
        return fail if name in WORK else found


WORK = ("keep", "update", "gate", "initialize", "split", "fit", "predict", "evaluate", "forward")


def fail(*arguments):
    raise ZeroDivisionError("mine")


class FailsToKeep(Raises, pwrfgs.Pruner):
    def keep(self, cloud, stats, context): ...


class FailsToUpdate(FailsToKeep):
    def update(self, cloud, stats, context): ...


class FailsToInitialize(Raises, pwrfgs.Initializer):
    def initialize(self, room, rng): ...


class FailsToSplit(Raises, pwrfgs.Split):
    def split(self, links, rng): ...


class FailsToFit(Raises, pwrfgs.Baseline):
    def fit(self, links, observed): ...


class FailsToPredict(Raises, pwrfgs.Baseline):
    def predict(self, tx, receiver): ...


class FailsToEvaluate(Raises, pwrfgs.Metric):
    def evaluate(self, predictions, truths): ...


class FailsForward(Raises, pwrfgs.Deformation):
    def forward(self, weights, means, tx): ...


FAILING = {
    "pruners": [FailsToKeep(), FailsToUpdate()], "initializer": [FailsToInitialize()], "split": [FailsToSplit()],
    "baselines": [FailsToFit(), FailsToPredict()], "metrics": [FailsToEvaluate()], "deformation": [FailsForward()],
}  # fmt: skip
QUICK = {"training.steps": 4, "training.densify_until": 1, "training.prune_until": 3, "training.prune_every": 1}
EACH = [(field, value) for field, values in FAILING.items() for value in values]


def frames(error):
    """Functions of the traceback of an exception."""
    return [frame.name for frame in traceback.extract_tb(error.__traceback__)]


def pipeline_with(field, value):
    return pwrfgs.Pipeline(SMALL).set({**QUICK, field: [value] if field.endswith("s") else value})


@pytest.mark.parametrize(("field", "value"), EACH)
def test_an_exception_of_a_strategy_leaves_a_run_as_it_is(tmp_path, field, value):
    with pytest.raises(ZeroDivisionError, match="^mine$") as told:
        pwrfgs.run(pipeline_with(field, value), out=tmp_path / "r", progress=False)
    assert frames(told.value)[-1] == "fail"


def test_an_exception_of_a_callback_leaves_a_run_as_it_is(tmp_path):
    with pytest.raises(ZeroDivisionError, match="^mine$") as told:
        pwrfgs.run(pwrfgs.Pipeline(SMALL).set(QUICK), out=tmp_path / "r", callback=fail, progress=False)
    assert frames(told.value)[-1] == "fail"


@pytest.mark.parametrize(("field", "value"), EACH)
def test_an_exception_of_a_strategy_in_a_sweep_keeps_its_traceback(tmp_path, field, value):
    axes = {field: {"mine": [value] if field.endswith("s") else value}}
    with pytest.raises(pwrfgs.InputError, match="mine=?.*mine|ZeroDivisionError: mine") as told:
        pwrfgs.sweep(pwrfgs.Pipeline(SMALL).set(QUICK), axes=axes, out=tmp_path / "s", name="s")
    cause = told.value.__cause__
    assert type(cause) is ZeroDivisionError and frames(cause)[-1] == "fail"
    if isinstance(told.value, pwrfgs.SweepError):
        (folder, reason), = told.value.reasons.items()
        assert reason == "ZeroDivisionError: mine" and told.value.exceptions == {folder: cause} and reason in str(told.value)
    else:  # before the first run
        assert f"axis `{field}`, variant `mine`: {field}=mine,seed=0: ZeroDivisionError: mine" in str(told.value) or field == "deformation"


def test_strategies_of_a_pipeline_are_objects(pipeline):
    pipeline.pruners = [Thin(0.25), pwrfgs.LearnableMask(), Thick(0.5)]
    pipeline.deformation = networks.Plane()
    thin, _, thick = pipeline.pruners
    assert (thin, thick) == (Thin(0.25), Thick(0.5)) and pipeline.get("pruners.2") == thick
    assert type(pipeline.deformation) is networks.Plane
    assert repr(pipeline.pruners[:1]) == "[Thin(share=0.25)]" and repr(pipeline).startswith("<Pipeline small: Teacher, Random,")
    thin.share = 0.5  # changes the pipeline, as for values
    assert pipeline.pruners[0] == Thin(0.5) == thin
    copied = copy.deepcopy(thin)
    copied.share = 0.1
    assert pipeline.pruners[0].share == 0.5
    pipeline.pruners.append(FailsToKeep())
    del pipeline.pruners[1]
    assert [type(pruner) for pruner in pipeline.pruners] == [Thin, Thick, FailsToKeep]
    with pytest.raises(pwrfgs.InputError, match="`pruners.2` of the pipeline has changed since this value was read"):
        thick.share = 0.1
    assert pickle.loads(pickle.dumps(pipeline)).pruners[0] == Thin(0.5)
    with pytest.raises(pwrfgs.InputError, match="the pipeline has Thin already"):
        pwrfgs.run(pipeline, pruners=[Thin(0.1)])


def test_strategies_that_cannot_be_imported_remain_values(tmp_path, monkeypatch):
    text = str(pwrfgs.Pipeline(SMALL).set({"pruners": [Thin(0.25)], "initializer": Box()}))
    for module, said in [("there_is_none", "cannot be imported"), (__name__, "has changed")]:
        changed = pwrfgs.Pipeline(text.replace(f'module: "{__name__}"', f'module: "{module}"').replace('source: "', 'source: "0'))
        (pruner,) = changed.pruners
        assert pruner.module == module and repr(pruner) == f'<Thin of the module {module}, settings {{"share": 0.25}}>'
        assert repr(changed).startswith("<Pipeline small: Teacher, Box,")
        pruner.settings = '{"share": 0.5}'
        assert changed.pruners[0].settings == '{"share": 0.5}'
        with pytest.raises(pwrfgs.InputError, match=said):
            pwrfgs.run(changed, out=tmp_path / "r")
