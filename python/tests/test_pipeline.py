"""Pipelines and their values."""

from __future__ import annotations

import copy
import pathlib
import pickle

import numpy as np
import pytest

import pwrfgs
from pwrfgs._values import from_ron, to_ron

ROOT = pathlib.Path(__file__).resolve().parents[2]


def test_every_plugin_is_a_class_whose_text_is_its_value():
    assert len(pwrfgs._values.CLASSES) > 70
    for entry in pwrfgs._pwrfgs.registry():
        if entry["name"] == "Python":
            continue
        made = getattr(pwrfgs, entry["name"])
        assert f"{entry['kind']}. " in made.__doc__
        if entry["text"] is not None:
            assert to_ron(from_ron(entry["text"])) == to_ron(from_ron(to_ron(from_ron(entry["text"]))))


def test_values():
    mask = pwrfgs.LearnableMask(lambda_=0.02)
    assert mask.lambda_ == 0.02 and mask.adam is True
    assert repr(mask) == "pwrfgs.LearnableMask(lambda_=0.02)" and str(mask).startswith("LearnableMask(lambda: 0.02, ")
    assert "lambda_" in dir(mask) and mask == pwrfgs.LearnableMask(lambda_=0.02) != mask.replace(lambda_=0.1)
    assert pwrfgs.Random(count=5).count == 5 and pwrfgs.Random(test=0.3).test == 0.3
    assert str(pwrfgs.settings.Rays.Same(400)) == "Same(400)" and str(pwrfgs.settings.Readout.Real) == "Real"
    assert repr(pwrfgs.settings.Schedule.Cosine(first=1e-3, last=1e-6)) == "pwrfgs.settings.Schedule.Cosine(first=0.001, last=1e-06)"
    for wrong, said in [(dict(lamda=1), "did you mean `lambda_`"), (dict(lambda_=-1.0), "lambda"), (dict(lambda_="a"), "LearnableMask")]:
        with pytest.raises(pwrfgs.InputError) as told:
            pwrfgs.LearnableMask(**wrong)
        assert said in str(told.value)
    with pytest.raises(AttributeError, match="did you mean `LearnableMask`"):
        pwrfgs.LernableMask
    with pytest.raises(AttributeError, match="did you mean `lambda_`"):
        mask.lamda = 1


@pytest.mark.parametrize("value", [0, -3, 1.5, 1e-9, True, None, "a \"b\" \\ ü\n", [1, 2], (1.0, 2.0), [[1, 2], []], float("inf")])
def test_python_to_ron_and_back(value):
    assert from_ron(to_ron(value)) == value


def test_fields_are_attributes(pipeline):
    assert pipeline.training.steps == 60 and pipeline.name == "small" and pipeline.pruners[0].epsilon == 0.02
    pipeline.training.steps = 80
    pipeline.pruners[0].epsilon = 0.1
    pipeline.pruners = [*pipeline.pruners, pwrfgs.LearnableMask(lambda_=0.5)]
    pipeline.training.optimizer.network = pwrfgs.settings.Schedule.Constant(1e-3)
    pipeline.set({"training.batch": 2, "seed": 4})
    assert (pipeline.training.steps, pipeline.training.batch, pipeline.seed) == (80, 2, 4)
    assert pipeline.get("pruners.LearnableMask.lambda") == 0.5 and pipeline.pruners[0].epsilon == 0.1
    assert repr(pipeline.training.optimizer.network) == "pwrfgs.settings.Schedule.Constant(0.001)"
    assert pwrfgs.Pipeline(str(pipeline)) == pipeline
    assert repr(pipeline) == "<Pipeline small: Teacher, Random, 80 steps>"
    other = pipeline.copy()
    other.seed = 9
    assert pipeline.seed == 4 and copy.deepcopy is not None
    assert "training" in dir(pipeline) and "steps" in dir(pipeline.training)


def test_made_of_values():
    made = pwrfgs.Pipeline(
        name="made", data=pwrfgs.Teacher(samples=40), initializer=pwrfgs.Random(count=np.int64(7)),
        training=dict(steps=5, batch=2, densify_until=0, prune_until=0),
    )
    assert made.initializer.count == 7 and made.training.steps == 5 and made.data.samples == 40


def test_mistakes_have_a_place(pipeline, tmp_path):
    file = tmp_path / "p.ron"
    file.write_text('Pipeline(\n    name: "a",\n    initialiser: Random(),\n)')
    with pytest.raises(pwrfgs.InputError) as told:
        pwrfgs.Pipeline(file)
    assert (told.value.line, told.value.column) == (3, 16) and "did you mean `initializer`" in str(told.value)
    assert str(told.value.path).endswith("p.ron")
    before = str(pipeline)
    for change in [{"training.stepps": 1}, {"training.steps": "many"}, {"seed": -1}, {"training.batch": 0}]:
        with pytest.raises(pwrfgs.InputError):
            pipeline.set({"training.steps": 7, **change} if "training.steps" not in change else change)
        assert str(pipeline) == before
    for change, said in [
        ({"training.steps": -5}, "^training.steps = -5: .*; it takes a whole number$"),
        ({"seed": [1]}, r"^seed = \[1\]: .*; it takes a whole number$"),
        ({"training.stepps": 1}, "did you mean `steps`"),
        ({"training.batch": 0}, "^training.batch = 0: `batch`"),
    ]:
        with pytest.raises(pwrfgs.InputError, match=said):
            pipeline.set(change)
    with pytest.raises(pwrfgs.InputError, match="^training.steps=-5: .*; it takes a whole number$"):
        pwrfgs.run(pipeline, set={"training.steps": -5})
    with pytest.raises(pwrfgs.InputError, match="^seed = 'x'|^seed = \"x\": .*it takes a whole number$"):
        pipeline.seed = "x"
    with pytest.raises(AttributeError, match="Schedule has no variant `Cosin`; did you mean `Cosine`"):
        pwrfgs.settings.Schedule.Cosin
    with pytest.raises(TypeError, match=r"by name, such as LearnableMask\(lambda_=0.05\)"):
        pwrfgs.LearnableMask(0.05)
    with pytest.raises(pwrfgs.InputError, match="give a dict"):
        pwrfgs.run(pipeline, set="training.steps=5")
    with pytest.raises(AttributeError, match="did you mean `training`"):
        pipeline.trainig = 1
    with pytest.raises(pwrfgs.InputError):
        pipeline.pruners = [object()]
    with pytest.raises(pwrfgs.InputError, match="cannot read"):
        pwrfgs.Pipeline(tmp_path / "none.ron")


def test_every_pipeline_of_the_project_is_read():
    for file in sorted((ROOT / "pipelines").glob("*.ron")):
        read = pwrfgs.Pipeline(file)
        assert pwrfgs.Pipeline(str(read)).name == read.name


def test_lists_of_a_pipeline_change_it(pipeline):
    pipeline.pruners.append(pwrfgs.LearnableMask(lambda_=0.5))
    assert [pruner._name for pruner in pipeline.pruners] == ["OpacityThreshold", "LearnableMask"]
    pruners = pipeline.pruners
    del pruners[0]
    pruners[0].lambda_ = 0.25
    pruners += [pwrfgs.RadSplat(threshold=0.5)]
    assert pipeline.pruners[0].lambda_ == 0.25 and pipeline.pruners[1].threshold == 0.5 and pruners == pipeline.pruners
    with pytest.raises(pwrfgs.InputError):
        pruners.append(pwrfgs.Ssim())
    assert len(pruners) == len(pipeline.pruners) == 2
    held = pipeline.pruners[0]
    pipeline.pruners = [pwrfgs.OpacityThreshold()]
    for change in (lambda: setattr(held, "lambda_", 0.9), lambda: pruners.clear()):
        with pytest.raises(pwrfgs.InputError, match="read it again"):
            change()
    assert len(pipeline.pruners) == 1


def test_values_and_pipelines_are_copied_and_pickled(pipeline):
    mask = pwrfgs.LearnableMask(lambda_=0.3)
    for again in (copy.copy(mask), copy.deepcopy(mask), pickle.loads(pickle.dumps(mask))):
        assert again == mask and type(again) is type(mask)
    for again in (copy.copy(pipeline), copy.deepcopy(pipeline), pickle.loads(pickle.dumps(pipeline))):
        assert again == pipeline and again.folder == pipeline.folder
        again.training.steps = 7
        assert pipeline.training.steps == 60
    with pytest.raises(pwrfgs.InputError):
        mask.lambda_ = "foo"
    assert mask.lambda_ == 0.3
    odd = 'a\x01b\b"\\é\n'
    assert pwrfgs.Nerf2Spectrum(root=odd).root == odd


def test_a_saved_pipeline_means_the_same_data(tmp_path):
    there = pwrfgs.Pipeline(ROOT / "pipelines/quickstart.ron")
    path = tmp_path / "a (1)" / "q (2).ron"
    path.parent.mkdir()
    there.save(path)
    again = pwrfgs.Pipeline(str(path))
    assert again.load_data().title == there.load_data().title
    with pytest.raises(pwrfgs.InputError, match="exists"):
        there.save(path)
    commented = "// mine\n/* (a) */ " + str(there)
    assert pwrfgs.Pipeline(commented).name == there.name


def test_stated_positions_are_simulated_in_their_order(tmp_path):
    def make(out, **settings):
        return pwrfgs.simulate("office", tmp_path / out, points=10, progress=False, **settings)

    tx = np.array([[3, 2, 1.1], [4.1234567, 3, 1.2], [2, 2.5, 1]])
    (tmp_path / "walk.csv").write_text("x,y,z\n" + "".join(f"{x},{y},{z}\n" for x, y, z in tx))
    arrays = make("arrays", tx=tx, layout="arrays")
    assert np.array_equal(arrays.tx, tx)
    for out, layout in [("file", "arrays"), ("powers", "rssi"), ("channels", "channels")]:
        data = make(out, tx=tmp_path / "walk.csv", layout=layout)
        assert np.array_equal(data.tx, tx), layout
    assert np.array_equal(pwrfgs.Dataset.load(tmp_path / "file").spectra, arrays.spectra)
    assert np.array_equal(make("one", tx=tx[0], layout="arrays").spectra[0], arrays.spectra[0])
    poses = np.array([[3, 2, 1.1, 0, 0, 0, 1], [4.5, 3, 1.2, 0, 0, 0.6, 0.8]])
    moved = make("moved", rx_pose=poses, tx=(1, 1, 2), layout="rssi")
    assert np.array_equal(moved.rx_pose, poses) and len(moved) == 2
    pwrfgs.convert.to_deepmimo("office-channel", tmp_path / "users", tx=tx, progress=False)
    assert np.allclose(pwrfgs.convert.from_deepmimo(tmp_path / "users", observe="power").tx, tx, atol=1e-6)
    with pytest.raises(pwrfgs.InputError, match="its transmitter moves; add the position of a fixed one"):
        make("refused", rx_pose=poses)
    with pytest.raises(pwrfgs.InputError, match="transmitter 1 at .* is outside the room"):
        make("refused", tx=[(30, 2, 1)])


def test_pipelines_of_the_package_have_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pipeline = pwrfgs.Pipeline("quickstart")
    assert pipeline.name == "quickstart" and pipeline.data.scene == "office" and pipeline.folder == str(tmp_path)
    pipeline.set({"data.samples": 12, "data.points": 100})
    data = pipeline.load_data()
    assert len(data) == 12 and data.simulated
    assert len(pwrfgs.Dataset.load(pwrfgs.Simulated(scene="office", samples=12, points=100))) == 12
    assert len(pwrfgs.simulate("office", tmp_path / "office", samples=5, points=10, progress=False)) == 5
    with pytest.raises(pwrfgs.InputError, match="did you mean `s23-laptop`"):
        pwrfgs.Pipeline("s23-lptop")
    (tmp_path / "quickstart").write_text(str(pipeline.copy().set({"seed": 7})))
    assert pwrfgs.Pipeline("quickstart").seed == 7


def test_fields_of_plugins_take_names_and_say_what_they_expect(pipeline):
    pipeline.split = "voxel"
    pipeline.metrics = ["Ssim", pwrfgs.Psnr()]
    assert pipeline.split == pwrfgs.Voxel() and pipeline.metrics == [pwrfgs.Ssim(), pwrfgs.Psnr()]
    for field, value, problem in [
        ("pruners", pwrfgs.OpacityThreshold(), r"pruners is pwrfgs.OpacityThreshold\(.*; give a list, such as \["),
        ("split", "voxle", "did you mean `Voxel`"),
        ("training.steps", 100.5, "training.steps = 100.5: invalid value; it takes a whole number"),
    ]:
        with pytest.raises(pwrfgs.InputError, match=problem):
            pipeline.set({field: value})
    with pytest.raises(AttributeError, match="it is pwrfgs.settings.Kriged"):
        pwrfgs.Kriged  # noqa: B018
    for call in (lambda: pwrfgs.Pipeline.for_data(np.zeros((2, 3))), lambda: pwrfgs.run(pipeline.load_data())):
        with pytest.raises(pwrfgs.InputError, match="Dataset"):
            call()
