"""Values of a pipeline: their text in Python, and their help."""

from __future__ import annotations

import copy
import pickle
import pydoc

import pytest
from conftest import ROOT

import pwrfgs
from pwrfgs._values import from_ron


def again(value):
    """What the text of a value in Python evaluates to."""
    return eval(repr(value), {"pwrfgs": pwrfgs})


def test_the_text_of_a_value_in_python_evaluates_to_it():
    for entry in pwrfgs._pwrfgs.registry():
        value = from_ron(entry["text"])
        assert entry["name"] == "Python" or again(value) == value
    values = [pwrfgs.Random(test=0.3), pwrfgs.Random(), pwrfgs.Teacher(projector=pwrfgs.WrfgsCompat()), pwrfgs.Nerf2Spectrum(root='a"\\')]
    values += [pwrfgs.settings.Rays.Same(400), pwrfgs.settings.Readout.Real, pwrfgs.settings.Schedule.Cosine(first=1e-3, last=0.0, steps=3)]
    assert again(from_ron("[(inf, -inf)]")) == [(float("inf"), float("-inf"))]
    assert [again(value) for value in values] == values
    assert again(pwrfgs.NearestNeighbours(k="Auto")) == pwrfgs.NearestNeighbours(k="Auto") != pwrfgs.NearestNeighbours(k=3)
    assert repr(pwrfgs.Teacher(projector=pwrfgs.WrfgsCompat())) == "pwrfgs.Teacher(projector=pwrfgs.WrfgsCompat())"


def test_all_values_of_the_pipelines_of_the_project_have_a_text_in_python():
    for file in sorted((ROOT / "pipelines").glob("*.ron")):
        pipeline = pwrfgs.Pipeline(file)
        for field in pipeline._field_names():
            value = getattr(pipeline, field)
            assert again(value) == value, (file, field)
        other = pipeline.copy().set({"training": again(pipeline.training)})
        assert str(other) == str(pipeline), file


def test_groups_of_settings_are_classes(pipeline):
    settings = pwrfgs.settings
    assert repr(pipeline.training).startswith("pwrfgs.settings.Training(steps=60, batch=4, ")
    assert repr(settings.Training(optimizer=dict(eps=1e-8))) == "pwrfgs.settings.Training(optimizer=pwrfgs.settings.Optimizer(eps=1e-08))"
    pipeline.training = settings.Training(steps=50, densify_until=0, prune_until=10, loss=settings.Loss(ssim_weight=0.5))
    assert (pipeline.training.steps, pipeline.training.batch, pipeline.training.loss.ssim_weight) == (50, 1, 0.5)
    for value in (pipeline.training, pipeline.training.optimizer.network, settings.Readout.Real):
        for copied in (copy.copy(value), copy.deepcopy(value), pickle.loads(pickle.dumps(value))):
            assert copied == value and type(copied) is type(value)
    assert settings.Schedule.Cosine(first=1.0, last=0.5) == settings.Schedule.Cosine(first=1.0, last=0.5, steps=0)
    assert pipeline.training.replace(steps=7).steps == 7 and settings.Schedule.Cosine(first=1.0, last=0.5).replace(last=0.1).last == 0.1
    with pytest.raises(pwrfgs.InputError, match="Training has no field `stps`; did you mean `steps`"):
        settings.Training(stps=3)
    with pytest.raises(pwrfgs.InputError, match="Near lacks count"):
        settings.Near()


@pytest.mark.parametrize(
    ("value", "lines"),
    [
        ("training", ["class Training(", "steps : whole number, default 200000", "    Number of training steps", "optimizer : Optimizer, default pwrfgs.settings.Optimizer()"]),
        ("training.optimizer", ["network : Schedule, default pwrfgs.settings.Schedule.LogLinear(first=0.0008, last=1.6e-06)", "eps : number, default 1e-15"]),
        ("training.optimizer.network", ["class LogLinear(", "first : number", "    Rate at step 1."]),
        ("readout", ["class Magnitude("]),
        ("pruners.0", ["class OpacityThreshold(", "epsilon : number, default "]),
    ],
)  # fmt: skip
def test_help_of_a_value_lists_its_fields(pipeline, value, lines):
    text = pydoc.render_doc(pipeline.get(value), renderer=pydoc.plaintext)
    assert "_named" not in text and "_defaults" not in text
    for line in lines:
        assert any(shown.lstrip(" |").startswith(line.strip()) for shown in text.splitlines()), (line, text)


def test_help_of_an_enum_lists_its_variants():
    text = pydoc.render_doc(pwrfgs.settings.Schedule, renderer=pydoc.plaintext)
    assert "Constant = " in text and "Cosine = " in text and "Rate after `steps` steps." in text
    assert "steps : whole number, default 200000" in (pwrfgs.settings.Training.__doc__ or "")
    assert "pruners : list of Pruner\n" in (pwrfgs.Pipeline.__doc__ or "") and "training : Training\n" in (pwrfgs.Pipeline.__doc__ or "")
