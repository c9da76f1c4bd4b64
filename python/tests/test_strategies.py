"""Strategies that are written in Python."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
import textwrap
import traceback
from dataclasses import dataclass

import numpy as np
import pytest
from conftest import SMALL, files

import pwrfgs
from pwrfgs._values import from_ron


@dataclass
class Thin(pwrfgs.Pruner):
    share: float = 0.2

    def keep(self, cloud, stats, context):
        return cloud.opacities >= np.quantile(cloud.opacities, self.share)


@dataclass
class Gated(pwrfgs.Pruner):
    """The paper's mask by hand: gate, penalty and their derivatives. The gate decides which Gaussians are kept."""

    lam: float = 0.3
    rate: float = 0.3
    existence: bool = False

    def columns(self):
        return [pwrfgs.Column("logit", init=1.0, learning_rate=self.rate), pwrfgs.Column("age", width=2)]

    def gate(self, cloud, context):
        mask = 1 / (1 + np.exp(-cloud["logit"]))
        found = (mask >= 0.01).astype(mask.dtype), {"logit": mask * (1 - mask)}
        return (*found, "existence") if self.existence else found

    def penalty(self, cloud, context):
        mask = 1 / (1 + np.exp(-cloud["logit"]))
        return self.lam * float(mask.mean()), {"logit": self.lam * mask * (1 - mask) / len(mask)}

    def update(self, cloud, stats, context):
        cloud.columns["age"] += 1

    def score(self, cloud, stats, context):
        return cloud["logit"]


@dataclass
class Mask(Gated):
    """The same with a decision of its own."""

    def needs(self, cloud, context):
        return ["weight", "largest_weight"]

    def keep(self, cloud, stats, context):
        assert stats.requested["weight"].shape == (len(cloud),) and "elimination" not in stats.requested
        assert (cloud["age"] == context.step).all() and cloud["age"].shape == (len(cloud), 2)
        assert not cloud.means.flags.writeable
        return cloud["logit"] >= np.log(0.01 / 0.99)


class Wrong(pwrfgs.Pruner):
    def keep(self, cloud, stats, context):
        raise RuntimeError(f"nothing can be kept at step {context.step}")


class Short(pwrfgs.Pruner):
    def keep(self, cloud, stats, context):
        return [True]


@dataclass
class Box(pwrfgs.Initializer):
    n: int = 50

    def initialize(self, room, rng):
        return dict(means=rng.uniform(*room.bounds, size=(self.n, 3)), scales=0.5, opacities=np.full(self.n, 0.3))


class Odd(pwrfgs.Split):
    def split(self, links, rng):
        return links.ids % 2 == 1, np.flatnonzero(links.ids % 2 == 0)


class Nearest(pwrfgs.Baseline):
    name = "nearest of mine"

    def fit(self, links, observed):
        self.links, self.observed = links, observed

    def predict(self, tx, receiver):
        return self.observed[np.argmin(((self.links.tx - tx) ** 2).sum(1))]


class Squares(pwrfgs.Metric):
    name, higher_is_better = "squares", False

    def evaluate(self, predictions, truths):
        return ((predictions - truths) ** 2).mean((1, 2))


def test_all_kinds_take_part(tmp_path):
    run = pwrfgs.run(
        pwrfgs.Pipeline(SMALL), out=tmp_path / "r", progress=False, pruners=[Thin(0.25), Mask(rate=0.05)], initializer=Box(40),
        split=Odd(), baselines=[Nearest(), pwrfgs.NearestNeighbours(k=1)], metrics=[Squares()],
    )
    scores = run.scores
    assert run.facts["samples"] == [60, 0, 60] and run.curve["gaussians"][0] == 40 and run.model.n < 40
    assert scores["nearest of mine"]["ssim"] == scores["1-NN"]["ssim"]
    assert 0 < scores["model"]["squares"]["mean"] < 1
    recorded = from_ron(str(run.pipeline))._named["pruners"][1]
    assert recorded.module == __name__ and getattr(recorded, "class_") == "Thin" and json.loads(recorded.settings) == {"share": 0.25}
    assert len(recorded.source) == 64
    again = run.pipeline
    assert again.pruners[1:] == [Thin(0.25), Mask(rate=0.05)] and again.initializer == Box(40)
    assert [type(value) for value in (again.split, again.baselines[2], again.metrics[-1])] == [Odd, Nearest, Squares]
    assert "squares ↓" in str(run) and "squares_mean" in run.table().columns
    printed = pwrfgs.report(run, tmp_path / "report")
    assert printed.count("squares ↓") == 2, printed  # scores and differences
    for name in ("report.html", "tables/1-scores.tex", "tables/1-differences.tex", "report.csv"):
        assert "squares" in (tmp_path / "report" / name).read_text(), name


def test_a_mask_by_hand_is_the_papers(tmp_path):
    settings = {"training.prune_until": 60}
    builtin = pwrfgs.Pipeline(SMALL).set(settings)
    builtin.pruners = [pwrfgs.LearnableMask(lambda_=0.3, learning_rate=0.3)]
    ours = pwrfgs.Pipeline(SMALL).set(settings)
    ours.pruners = [Mask()]
    theirs, mine = pwrfgs.Trainer(builtin), pwrfgs.Trainer(ours)
    for _ in range(59):  # the prune step after them leaves one Gaussian, at which training stops
        a, b = theirs.step(), mine.step()
        assert a["gaussians"] == b["gaussians"] and np.isclose(a["loss"], b["loss"], rtol=1e-3)
        assert np.isclose(a["penalty"], b["penalty"], rtol=1e-4)
    existence = pwrfgs.Pipeline(SMALL)
    existence.pruners = [Mask(existence=True)]
    trainer = pwrfgs.Trainer(existence)
    assert all(np.isfinite(trainer.step()["loss"]) for _ in range(5))


def test_a_gate_without_keep_decides_as_the_mask(tmp_path):
    pipeline = pwrfgs.Pipeline(SMALL).set({"pruners": []})
    one, other = (pwrfgs.run(pipeline, pruners=[mask], out=tmp_path / type(mask).__name__, progress=False) for mask in (Mask(rate=0.2), Gated(rate=0.2)))
    assert 1 < one.model.n < one.curve["gaussians"][0]
    assert np.array_equal(one.curve["gaussians"], other.curve["gaussians"]) and np.array_equal(one.model.gaussians().means, other.model.gaussians().means)


def test_stopped_and_resumed_it_ends_in_the_same_files(tmp_path):
    whole = pwrfgs.run(pwrfgs.Pipeline(SMALL), out=tmp_path / "whole", pruners=[Mask(), Thin(0.1)], progress=False)

    def hear(event):
        if event["what"] == "step" and event["step"] == 31:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pwrfgs.run(pwrfgs.Pipeline(SMALL), out=tmp_path / "r", pruners=[Mask(), Thin(0.1)], callback=hear, progress=False)
    assert files(pwrfgs.run(tmp_path / "r", progress=False).folder) == files(whole.folder)


@pytest.mark.parametrize(("pruner", "error", "said"), [(Wrong(), RuntimeError, "at step 30"), (Short(), pwrfgs.InputError, "[1]")])
def test_an_exception_stops_the_run_and_keeps_the_checkpoint(tmp_path, pruner, error, said):
    with pytest.raises(error) as told:
        pwrfgs.run(pwrfgs.Pipeline(SMALL), out=tmp_path / "r", pruners=[pruner], progress=False)
    assert said in str(told.value)
    if error is RuntimeError:
        assert any("in keep" in line for line in traceback.format_exception(told.type, told.value, told.tb))
    assert (tmp_path / "r/checkpoint.safetensors").is_file()
    assert pwrfgs.Run(tmp_path / "r").facts["finished"] is None


def test_a_changed_source_does_not_go_on(tmp_path, monkeypatch):
    text = """
    import pwrfgs
    class Mine(pwrfgs.Pruner):
        def keep(self, cloud, stats, context):
            return cloud.opacities > {}
    """
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "strategy_of_mine.py").write_text(textwrap.dedent(text.format(0.0)))
    module = importlib.import_module("strategy_of_mine")

    def hear(event):
        if event["what"] == "step" and event["step"] == 25:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pwrfgs.run(pwrfgs.Pipeline(SMALL), out=tmp_path / "r", pruners=[module.Mine()], callback=hear, progress=False)
    code = "import pwrfgs, sys; sys.path.insert(0, {!r}); pwrfgs.run({!r}, progress=False)".format(str(tmp_path), str(tmp_path / "r"))
    (tmp_path / "strategy_of_mine.py").write_text(textwrap.dedent(text.format(0.5)))
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert told.returncode != 0 and "has changed since this run began" in told.stderr
    (tmp_path / "strategy_of_mine.py").write_text(textwrap.dedent(text.format(0.0)))
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    assert pwrfgs.Run(tmp_path / "r").finished


def test_the_command_line_reports_and_predicts_and_does_not_train(tmp_path, cli):
    run = pwrfgs.run(pwrfgs.Pipeline(SMALL), out=tmp_path / "r", pruners=[Thin()], progress=False)

    def call(*arguments):
        return subprocess.run([cli, *map(str, arguments)], capture_output=True, text=True, check=False)

    assert call("report", run.folder, "--out", tmp_path / "report").returncode == 0
    assert call("predict", f"{run.folder}/model.safetensors", "--tx", "0,0,1", "--out", tmp_path / "p").returncode == 0
    told = call("run", run.folder, "--out", tmp_path / "again")
    assert told.returncode == 2 and "`Thin`" in told.stderr and "written in Python" in told.stderr


def test_what_cannot_be_recorded_is_refused(pipeline):
    class Inside(pwrfgs.Pruner):
        def keep(self, cloud, stats, context):
            return np.ones(len(cloud), bool)

    class_without = type("Hidden", (pwrfgs.Pruner,), {"__init__": lambda self, share: None, "keep": Inside.keep, "__module__": __name__})
    for value, said in [(Inside(), "defined inside a function"), (class_without(1), "`share` is not an attribute"), (Thin(share=object()), "settings must be")]:
        with pytest.raises(pwrfgs.InputError) as told:
            pipeline.pruners = [value]
        assert said in str(told.value)
    pipeline.pruners = [Odd()]
    with pytest.raises(pwrfgs.InputError, match="does not implement `keep`"):
        pwrfgs.Trainer(pipeline)


def test_the_digest_is_of_the_source_and_of_what_it_derives_from():
    from pwrfgs._strategies import code, digest

    def of(text, name="B"):
        space = {"pwrfgs": pwrfgs, "np": np, "__name__": "prompt"}
        exec(textwrap.dedent(text), space)
        return digest(space[name])

    text = """
    class A(pwrfgs.Pruner):
        share = {}
        def keep(self, cloud, stats, context):
            return np.array([o > {} for o in cloud.opacities])
    class B(A):
        pass
    """
    assert of(text.format(1, 0)) == of(text.format(1, 0))
    assert len({of(text.format(*values)) for values in [(1, 0), (2, 0), (1, 1)]}) == 3
    assert " at 0x" not in repr(code(Mask)) and digest(Mask) != digest(Thin)


class Counting(pwrfgs.Pruner):
    def __init__(self):
        self.count = 0

    def keep(self, cloud, stats, context):
        self.count += 1
        return np.arange(len(cloud)) >= self.count


class Settings(pwrfgs.Pruner):
    def __init__(self, **settings):
        self.share = settings.get("share", 0.1)

    def keep(self, cloud, stats, context):
        return cloud.opacities > self.share


class Percent(Thin):
    def __init__(self, share=50):
        self.share = share / 100


def test_what_an_object_remembers_ends_with_its_run(pipeline, tmp_path):
    left = [pwrfgs.run(pipeline, pruners=[Counting()], out=tmp_path / f"{i}", progress=False).model.n for i in range(2)]
    assert left[0] == left[1]


def test_strategies_that_a_folder_could_not_make_again_are_refused(pipeline, tmp_path):
    for strategy, said in [(Settings(share=0.5), "cannot be given by name"), (Percent(50), "an object recreated from its settings"), (Odd(), "does not implement `keep`")]:
        with pytest.raises(pwrfgs.InputError, match=said):
            pwrfgs.run(pipeline, pruners=[strategy], out=tmp_path / "r", progress=False)
    with pytest.raises(pwrfgs.InputError, match="give a list"):
        pwrfgs.run(pipeline, pruners=Thin(), out=tmp_path / "r")
    with pytest.raises(pwrfgs.InputError, match="does not implement `evaluate`"):
        pwrfgs.run(pipeline, metrics=[Thin()], out=tmp_path / "r")
    assert not (tmp_path / "r").exists()
    assert pwrfgs.run(pipeline, metrics=["L1"], out=tmp_path / "r", progress=False).scores["model"]["l1"]


TRAINER = []


class Asks(pwrfgs.Pruner):
    def keep(self, cloud, stats, context):
        return np.ones(len(cloud), bool)

    def update(self, cloud, stats, context):
        if context.step == 3:
            TRAINER[0].step()


def test_a_file_that_names_another_program_does_not_start_it(tmp_path):
    settings = json.dumps({"args": ["touch", str(tmp_path / "touched")]})
    named = f'Python(module: "subprocess", class: "Popen", settings: {json.dumps(settings)})'
    text = SMALL.replace("OpacityThreshold(epsilon: 0.02)", named)
    with pytest.raises(pwrfgs.InputError, match="`Popen` does not implement `keep`, `gate` or `score`, so it is not a Pruner"):
        pwrfgs.run(pwrfgs.Pipeline(text), out=tmp_path / "r", progress=False)
    assert not (tmp_path / "touched").exists() and not (tmp_path / "r").exists()


def test_a_trainer_is_not_used_by_the_strategy_that_it_asks(pipeline):
    pipeline.pruners = [Asks()]
    trainer = pwrfgs.Trainer(pipeline)
    TRAINER[:] = [trainer]
    trainer.step(), trainer.step()
    with pytest.raises(pwrfgs.InputError, match="middle of a step"):
        trainer.step()
    with pytest.raises(pwrfgs.InputError, match="a step of this trainer has failed"):
        trainer.step()
    assert trainer.done == 2 and len(trainer.cloud) == 60


COLUMN = []


class Columns(Asks):
    def columns(self):
        return COLUMN


def test_columns_have_names_and_numbers_of_their_own(pipeline):
    column = pwrfgs.Column
    for wrong in ([column("means")], [column("")], [column("a b")], [column("a"), column("a")], [column("a", width=0)], [column("a", width=10**13)],
                  [column("a", init=float("nan"))], [column("a", learning_rate=-1.0)]):  # fmt: skip
        COLUMN[:] = wrong
        with pytest.raises(pwrfgs.InputError, match="columns: "):
            pwrfgs.Trainer(pwrfgs.Pipeline(SMALL).set({"pruners": [Columns()]}))


class Says(Asks):
    """Whatever the test wants of it."""

    what = {}

    def columns(self):
        return [pwrfgs.Column("own", learning_rate=0.1), pwrfgs.Column("wide", width=2, learning_rate=0.1), pwrfgs.Column("fixed")]

    def gate(self, cloud, context):
        return self.what.get("gate", lambda n: None)(len(cloud))

    def penalty(self, cloud, context):
        return self.what.get("penalty", lambda n: None)(len(cloud))

    def needs(self, cloud, context):
        return self.what.get("needs", [])

    def update(self, cloud, stats, context):
        self.what.get("update", lambda cloud: None)(cloud)


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ({"gate": np.ones}, r"gate returned a value of ndarray, expected \(factor \[N\], \{column: derivative\}\), or None"),
        ({"gate": lambda n: (np.ones(n), np.ones(n))}, "a value of ndarray as its derivatives"),
        ({"gate": lambda n: (-np.ones(n), {"own": np.ones(n)})}, "a factor is -1; give numbers from 0 to 1"),
        ({"gate": lambda n: (np.ones(n), {"own": np.full(n, np.nan)})}, "the derivative in `own` holds NaN"),
        ({"gate": lambda n: (np.ones(n), {"own": np.ones(n + 1)})}, r"has shape \[61\], expected \[60\]"),
        ({"gate": lambda n: (np.ones(n), {"own": np.ones((n, 1))})}, r"derivative in `own` has shape \[60, 1\], expected \[60\]"),
        ({"gate": lambda n: (np.ones(n), {"wide": np.ones((2, n))})}, r"`wide` has shape \[2, 60\], expected \[60, 2\]"),
        ({"gate": lambda n: (np.ones((6, n // 6)), {"own": np.ones(n)})}, r"the factor has shape \[6, 10\], expected \[60\]"),
        ({"penalty": lambda n: (np.ones(1), {"own": np.ones(n)})}, r"penalty: the value has shape \[1\], expected \[\]"),
        ({"penalty": lambda n: (1.0, {"wide": np.ones(2 * n)})}, r"`wide` has shape \[120\], expected \[60, 2\]"),
        ({"update": lambda cloud: cloud.columns.update(wide=cloud["wide"].T)}, r"update: `wide` has shape \[2, 60\], expected \[60, 2\]"),
        ({"gate": lambda n: (np.ones(n), {"owm": np.ones(n)})}, "unknown column `owm`; did you mean `own`"),
        ({"gate": lambda n: (np.ones(n), {"fixed": np.ones(n)})}, "`fixed` has no learning_rate"),
        ({"gate": lambda n: (np.ones(n), {"own": np.ones(n)}, "existences")}, "unknown third entry"),
        ({"penalty": lambda n: 0.5}, r"penalty returned a value of float, expected \(number, \{column: derivative\}\)"),
        ({"penalty": lambda n: (np.inf, {"own": np.ones(n)})}, "penalty: the value holds inf"),
    ],
)
def test_what_a_strategy_gives_is_named_where_it_is_wrong(monkeypatch, what, said):
    monkeypatch.setattr(Says, "what", what)
    trainer = pwrfgs.Trainer(pwrfgs.Pipeline(SMALL).set({"pruners": [Says()]}))
    with pytest.raises(pwrfgs.InputError, match=said):
        trainer.step()


def test_a_statistic_that_is_not_there_is_told_when_it_is_set(pipeline, monkeypatch):
    monkeypatch.setattr(Says, "what", {"needs": ["wieght"]})
    with pytest.raises(pwrfgs.InputError, match="unknown statistic `wieght`; did you mean `weight`"):
        pipeline.pruners = [Says()]
    with pytest.raises(pwrfgs.InputError, match="unknown statistic"):
        pwrfgs.run(SMALL, pruners=[Says()])


@dataclass
class Gives(pwrfgs.Initializer):
    """Four Gaussians with whatever the test wants."""

    what = {}

    def initialize(self, room, rng):
        return self.what if isinstance(self.what, list) else {"means": np.zeros((4, 3)), "scales": 0.5, **self.what}


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ({"opacity": np.full(4, 0.3)}, "initialize: unknown entry `opacity`; did you mean `opacities`"),
        ({"scale": 0.1}, "unknown entry `scale`; did you mean `scales`"),
        ({"scales": np.ones((3, 4))}, r"scales has shape \[3, 4\], expected \[4, 3\]"),
        ({"opacities": np.full((4, 1), 0.3)}, r"opacities has shape \[4, 1\], expected \[4\]"),
        ({"quats": np.zeros((4, 4))}, r"quats\[0\] is zero"),
        ({"quats": np.full((4, 4), np.nan)}, "quats holds NaN"),
        ({"signals": np.zeros((4, 2))}, r"signals has shape \[4, 2\], expected \[4\]"),
        ([1], "initialize returned no dict"),
    ],
)
def test_entries_of_an_initialiser_are_checked(pipeline, monkeypatch, what, said):
    monkeypatch.setattr(Gives, "what", what)
    pipeline.initializer = Gives()
    with pytest.raises(pwrfgs.InputError, match=said):
        pwrfgs.Trainer(pipeline)


@dataclass
class OfPowers(pwrfgs.Baseline):
    """Predicts a number for every link, in one form."""

    shape: str = "number"

    def predict(self, tx, receiver):
        return {"number": -60.0, "scalar": np.float32(-60), "array": np.array(-60.0), "vector": np.array([-60.0])}[self.shape]


def test_prediction_of_a_power_is_a_number():
    tx, rssi = np.random.default_rng(0).uniform(1, 5, (6, 3)), np.full((6, 1), -60.0) - np.arange(6)[:, None]
    data = pwrfgs.Dataset.from_arrays(tx, rssi=rssi, receivers=[[0, 0, 0]])
    for shape in ("number", "scalar", "array"):
        assert (pwrfgs.baselines.predict(OfPowers(shape), data, tx) == -60).all()
    with pytest.raises(pwrfgs.InputError, match=r"has shape \[1\], expected \[\]"):
        pwrfgs.baselines.predict(OfPowers("vector"), data, tx)


class Nothing(pwrfgs.Pruner):
    def keep(self, cloud, stats, context):
        return np.zeros(len(cloud), bool)


class NoKeep(pwrfgs.Pruner):
    pass


def test_pruners_stand_beside_those_of_the_pipeline(pipeline, tmp_path, caplog):
    out = dict(out=tmp_path / "r", progress=False)
    with pytest.raises(pwrfgs.InputError, match="has OpacityThreshold already"):
        pwrfgs.run(pipeline, pruners=[pwrfgs.OpacityThreshold()], **out)
    with pytest.raises(pwrfgs.InputError, match="has Thin already"):
        pwrfgs.run(pipeline, pruners=[Thin(), Thin(0.1)], **out)
    with pytest.raises(pwrfgs.InputError, match="Thin is a class; give an object of it"):
        pwrfgs.run(pipeline, pruners=[Thin], **out)
    with pytest.raises(pwrfgs.InputError, match="TopK is a Pruner, expected a Metric"):
        pwrfgs.run(pipeline, metrics=[pwrfgs.TopK()], **out)
    with pytest.raises(pwrfgs.InputError, match="does not implement `keep`"):
        pwrfgs.run(pipeline, pruners=[NoKeep()], **out)
    with pytest.raises(pwrfgs.Error, match="one Gaussian is left at step 30"):
        pwrfgs.run(pipeline, set={"pruners": []}, pruners=[Nothing()], **out)
    assert "would remove all Gaussians" in caplog.text


class Brightest(pwrfgs.Pruner):
    def score(self, cloud, stats, context):
        return cloud.opacities


def test_score_alone_reaches_the_target_as_built_in_pruners_do(pipeline, tmp_path, cli):
    with pytest.raises(pwrfgs.InputError, match="`Brightest` needs training.target_count"):
        pwrfgs.run(pipeline, set={"pruners": [Brightest()]}, out=tmp_path / "r", progress=False)
    axes = {"pruner": {
        "mine": {"pruners": [Brightest()], "training.target_count": 20},
        "top": {"pruners": [pwrfgs.TopK()], "training.target_count": 10},
    }}  # fmt: skip
    runs = pwrfgs.sweep(pipeline, axes=axes, out=tmp_path / "s", name="s", seeds=[0, 1])
    assert [len(run.model.gaussians().means) for run in runs] == [20, 20, 10, 10]
    printed = pwrfgs.report(tmp_path / "s", reference="mine")
    assert "differences from mine" in printed and printed.endswith(f"report: {tmp_path / 's/report/report.html'}\n")
    alone = {"pruners": [], "training.target_count": 20}
    run = pwrfgs.run(pipeline, set=alone, pruners=[Brightest()], out=tmp_path / "alone", progress=False)
    assert run.model.n == 20
    subprocess.run([cli, "report", run.folder, "--out", tmp_path / "report"], check=True)


def test_messages_name_the_class_of_a_pruner(pipeline, tmp_path, caplog):
    caplog.set_level("INFO", "pwrfgs")
    pwrfgs.run(pipeline, pruners=[Thin(0.7)], set={"pruners": []}, out=tmp_path / "run", progress=False)
    assert "`Thin`" in caplog.text and "`Python`" not in caplog.text
