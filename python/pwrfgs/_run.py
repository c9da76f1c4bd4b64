"""`run` and what it gives; `Trainer`, `simulate`, `sweep` and `report`."""

from __future__ import annotations

import csv
import html
import json
import os
from collections.abc import Mapping as Mappings
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Union

import numpy as np

from . import _pwrfgs, _strategies
from ._errors import InputError
from ._pipeline import Pipeline, is_text
from ._types import Array, Cloud, Stats
from ._values import KINDS, from_ron, plugin_text, to_ron

PathLike = Union[str, "os.PathLike[str]"]
Event = Dict[str, Any]


class Run:
    """A run folder: ``Run("runs/x")`` opens one that is there."""

    def __init__(self, folder: PathLike) -> None:
        self.folder = os.fspath(folder)
        if not os.path.isfile(os.path.join(self.folder, "run.json")):
            raise InputError(f"{self.folder} is no run folder: there is no run.json in it")

    def _file(self, name: str) -> str:
        return os.path.join(self.folder, name)

    @property
    def facts(self) -> Dict[str, Any]:
        """With what, on what and how long: ``run.json``."""
        facts: Dict[str, Any] = json.loads(_pwrfgs.facts(self.folder)[0])
        return facts

    @property
    def finished(self) -> bool:
        """Whether model, scores and report are written."""
        return self.facts.get("finished") is not None

    @property
    def scores(self) -> Dict[str, Dict[str, Any]]:
        """``scores["model"]["ssim"]["mean"]``, and so for every baseline: mean, median and bad_tail of numbers a sample, a
        number of others, None where a metric does not apply. Empty before the run has finished."""
        return dict(_pwrfgs.facts(self.folder)[1] or {})

    def table(self) -> Any:
        """The scores as a data frame of pandas (rows: predictor; columns: metric and statistic), or, without pandas, as a
        list of dicts."""
        rows: List[Dict[str, Any]] = []
        for predictor, metrics in self.scores.items():
            row: Dict[str, Any] = {"predictor": predictor}
            for metric, value in metrics.items():
                if isinstance(value, dict):
                    row.update({f"{metric}_{statistic}": number for statistic, number in value.items()})
                else:
                    row[metric] = value
            rows.append(row)
        try:
            import pandas
        except ImportError:
            return rows
        return pandas.DataFrame(rows).set_index("predictor") if rows else pandas.DataFrame()

    def samples(self) -> List[Dict[str, str]]:
        """Every number of ``samples.csv``: a row a test sample."""
        # Names that spreadsheets would compute have one more apostrophe in the file.
        rows = _rows(self._file("samples.csv"))
        return [{key: text[1:] if text.startswith("'") else text for key, text in row.items()} for row in rows]

    @property
    def curve(self) -> Dict[str, Array]:
        """Loss, penalty, Gaussians and seconds by step."""
        return _columns(self._file("curve.csv"))

    @property
    def validation(self) -> Dict[str, Array]:
        """What the validation part scored while it was trained."""
        return _columns(self._file("validation.csv"))

    @property
    def model(self) -> "_pwrfgs.Model":
        """The trained model; there is none before the run has finished."""
        if not os.path.isfile(self._file("model.safetensors")):
            raise InputError(f"{self.folder} has no model yet: the run has not finished; pwrfgs.run({self.folder!r}) goes on with it")
        return _pwrfgs.Model.load(self._file("model.safetensors"))

    @property
    def pipeline(self) -> Pipeline:
        """What was run. Of a joined model, what it is scored by: its runs have their own."""
        return Pipeline(self._file("pipeline.ron"))

    @property
    def report(self) -> str:
        """The page of the run, a file for any browser."""
        return self._file("report.html")

    def __repr__(self) -> str:
        text = _pwrfgs.facts(self.folder)[2]
        return f"<Run {self.folder}{'' if text else ', not finished'}>" + (f"\n{text}" if text else "")

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(repr(self))}</pre>"


def _rows(path: str) -> List[Dict[str, str]]:
    try:
        with open(path, newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error}") from None


def _columns(path: str) -> Dict[str, Array]:
    rows = _rows(path)
    names = list(rows[0]) if rows else []

    def column(name: str) -> Array:
        values = [row[name] for row in rows]
        try:
            return np.array([float(value) for value in values])
        except ValueError:
            return np.array(values)

    return {name: column(name) for name in names}


class _Progress:
    """A bar in a terminal or a notebook."""

    def __init__(self, shown: bool) -> None:
        self.shown = shown
        self.bar: Any = None
        self.name = ""
        self.note = ""

    def begin(self, name: str, total: Optional[int], done: int = 0) -> None:
        self.close()
        if self.shown:
            from tqdm.auto import tqdm

            self.name = name
            self.bar = tqdm(total=total or None, initial=done, desc=name, leave=name == "training", mininterval=0.2)

    def to(self, done: int) -> None:
        if self.bar is not None and done > self.bar.n:
            self.bar.update(done - self.bar.n)

    def close(self) -> None:
        if self.bar is not None:
            self.bar.close()
            self.bar = None

    def hear(self, event: Event) -> None:
        what = event["what"]
        if what == "stage":
            if event["done"] == 0 or self.bar is None or self.name != event["name"]:
                self.begin(event["name"], event["total"])
            elif self.bar.total is None and event["total"]:
                self.bar.total = event["total"]
            self.to(event["done"])
        elif what == "start":
            self.begin("training", event["steps"], event["done"])
        elif what == "step" and self.bar is not None:
            if self.name != "training":
                return
            if event["step"] % 10 == 0 or event["step"] == self.bar.total:
                self.bar.set_postfix_str(f"N {event['gaussians']}, loss {event['loss']:.4f}{self.note}", refresh=False)
            self.to(event["step"])
        elif what == "validation":
            self.note = f", validation {event['mean']:.3f}"


def _arguments(values: Optional[Mapping[str, Any]]) -> List[str]:
    """Settings as ``--set`` has them: texts as they are on the command line, everything else as RON."""
    if values is not None and not isinstance(values, Mappings):
        raise InputError(f'set is {values!r}; give a dict, such as {{"training.steps": 2000}}')
    return [f"{path}={value if isinstance(value, str) else to_ron(value)}" for path, value in (values or {}).items()]


def run(
    pipeline: Any,
    set: Optional[Mapping[str, Any]] = None,
    out: Optional[PathLike] = None,
    callback: Optional[Callable[[Event], Any]] = None,
    *,
    pruners: Sequence[Any] = (),
    initializer: Any = None,
    split: Any = None,
    baselines: Sequence[Any] = (),
    metrics: Sequence[Any] = (),
    progress: bool = True,
) -> Run:
    """Trains, prunes, scores and reports: ``run("pipelines/quickstart.ron")``.

    Parameters
    ----------
    pipeline
        A ``Pipeline``, the path of a pipeline file, or a run folder, whose run goes on.
    set
        Settings by path, as ``--set`` has them: ``{"training.steps": 2000, "split": "Voxel()"}``.
    out
        The run folder; ``runs/NAME`` where it is left out. A run that was stopped goes on there, a finished one is opened,
        anything else is not touched.
    callback
        Called with every event, a dict with ``what``: "step" (step, phase, loss, penalty, gaussians), "validation", "stage",
        "start" or "message". An exception in it stops the run at the next step, with a checkpoint.
    pruners, baselines, metrics
        Strategies of one's own, or plugins, **beside** those that the pipeline names: a Gaussian stays where all pruners agree.
        ``set={"pruners": []}`` takes the pipeline's away first.
    initializer, split
        A strategy of one's own, or a plugin, in the place of the pipeline's.
    progress
        Whether a bar is drawn.

    Ctrl-C stops at the next step and writes a checkpoint; the same call goes on and ends in the same files.
    """
    for name, many in (("pruners", pruners), ("baselines", baselines), ("metrics", metrics)):
        if not isinstance(many, (list, tuple)):
            raise InputError(f"{name} is {many!r}; give a list, such as {name}=[..]")
    if isinstance(pipeline, (str, os.PathLike)) and not is_text(pipeline):
        path = os.fspath(pipeline)
        if os.path.isdir(path):
            out = path if out is None else out
            path = os.path.join(path, "pipeline.ron")
        chosen = Pipeline(path)
    else:
        chosen = Pipeline(pipeline)
    if set:
        chosen._inner.set_arguments(_arguments(set))
    for field, more in (("pruners", pruners), ("baselines", baselines), ("metrics", metrics)):
        if more:
            there, named = chosen.get(field), [_named(field, item) for item in more]
            if field == "pruners":
                _refuse_twice(there, named)
            chosen.set({field: [*there, *named]})
    for field, one in (("initializer", initializer), ("split", split)):
        if one is not None:
            chosen.set({field: _named(field, one)})
    _strategies.check(chosen)
    folder = os.fspath(out) if out is not None else os.path.join("runs", chosen.name)
    bar = _Progress(progress)
    try:
        _pwrfgs.run(chosen._inner, folder, _listener(bar, callback))
    finally:
        bar.close()
    return Run(folder)


def _named(field: str, strategy: Any) -> Any:
    """What a user gives for a field: a name alone becomes a value; a plugin must be of the kind that stands there."""
    kind = _strategies.FIELDS[field]
    value = from_ron(plugin_text(kind, strategy, None))
    kinds = KINDS.get(getattr(value, "_name", None) or "", [kind])
    if kind not in kinds:
        raise InputError(f"{field}: {value._name} is a {' and a '.join(kinds)}, and a {kind} is wanted")
    return value


def _refuse_twice(there: List[Any], more: List[Any]) -> None:
    """Refuses a pruner that is there already, which nobody means."""

    def of_class(value: Any) -> Any:
        return value._name, value._fields.get("module"), value._fields.get("class")

    for place, value in enumerate(more):
        if of_class(value) in map(of_class, [*there, *more[:place]]):
            name = value._fields["class"] if value._name == "Python" else value._name
            raise InputError(
                f"the pipeline has {name} already, and this would be another beside it; change its settings by `set`, or take the "
                'pruners that are there away with set={"pruners": []}'
            )


def _listener(bar: _Progress, callback: Optional[Callable[[Event], Any]]) -> Callable[[Event], None]:
    def hear(event: Event) -> None:
        bar.hear(event)
        if callback is not None:
            callback(event)

    return hear


class Trainer:
    """The training loop in one's own hands: ``step()`` until ``finished``.

    ``dataset`` is what the pipeline's ``data`` names where it is left out. Nothing is written.
    """

    def __init__(self, pipeline: Any, dataset: Optional["_pwrfgs.Dataset"] = None) -> None:
        self.pipeline = Pipeline(pipeline)
        _strategies.check(self.pipeline)
        self.dataset = self.pipeline.load_data() if dataset is None else dataset
        self._inner = _pwrfgs.Trainer(self.pipeline._inner, self.dataset)

    def step(self) -> Event:
        """One step: batch, gradients, Adam, then densification or pruning where due. Gives step, phase, loss, penalty and
        gaussians (N after it). After an exception in it the trainer takes no further step: half of one may be done."""
        return dict(self._inner.step())

    @property
    def done(self) -> int:
        """Steps taken."""
        return int(self._inner.done)

    @property
    def finished(self) -> bool:
        """Whether all steps are taken."""
        return bool(self._inner.finished)

    @property
    def cloud(self) -> Cloud:
        """The Gaussians as they stand; a copy."""
        cloud: Cloud = self._inner.cloud
        return cloud

    @property
    def stats(self) -> Stats:
        """What was seen of them since the last densification; a copy."""
        stats: Stats = self._inner.stats
        return stats

    def prune(self, keep: Any) -> int:
        """Takes away the Gaussians where ``keep`` [N] is false, with their moments and statistics; gives how many are left."""
        return int(self._inner.prune(keep))

    def model(self) -> "_pwrfgs.Model":
        """The model as it stands."""
        return self._inner.model()

    def __repr__(self) -> str:
        return f"<Trainer of {self.pipeline.name}: step {self.done} of {self.pipeline.training.steps}, N {len(self.cloud)}>"


def simulate(
    scene: PathLike,
    out: PathLike,
    *,
    layout: str = "spectra",
    samples: int = 200,
    seed: int = 0,
    points: int = 3000,
    noise_db: Optional[float] = None,
    snr_db: Optional[float] = None,
    paths: bool = False,
    progress: bool = True,
) -> "_pwrfgs.Dataset":
    """Simulates a scene file into the new folder ``out`` and loads it: ``simulate("scenes/office.ron", "data/office")``.

    ``layout`` is "spectra", "arrays", "rssi" (``noise_db`` is its scatter), "channels" or "csi" (``snr_db`` is their noise).
    Ctrl-C stops it; nothing is left behind then. A scene of several receivers makes a folder for each inside ``out`` (but for
    "rssi"); the first is loaded.
    """
    bar = _Progress(progress)
    bar.begin("simulating", samples)
    try:
        _pwrfgs.simulate(
            scene, out, layout, samples, seed, points, noise_db, snr_db, paths, lambda done, total: bar.to(done)
        )
    finally:
        bar.close()
    folder = os.fspath(out)
    inner = sorted(entry.path for entry in os.scandir(folder) if entry.is_dir() and entry.name != "spectrum")
    alone = any(os.path.isfile(os.path.join(folder, name)) for name in ("tx_pos.csv", "tx.npy"))
    return _pwrfgs.Dataset.load(folder if alone or not inner else inner[0])


class SweepError(InputError):
    """Runs of a sweep that failed; ``reasons`` has why, by folder."""

    reasons: Dict[str, str] = {}


def sweep(
    experiment: PathLike, set: Optional[Mapping[str, Any]] = None, out: Optional[PathLike] = None, jobs: int = 1
) -> List[Run]:
    """Does every run of an experiment file that is left to do, and its report; gives the runs in their order, and after them,
    if the file says ``join: true``, the joined model.

    The same call goes on after Ctrl-C. Raises ``SweepError`` when runs failed, after all others are done.
    """
    folder, ends = _pwrfgs.sweep(experiment, _arguments(set), out, jobs)
    failed = {os.fspath(run): reason for run, reason in ends if reason}
    if failed:
        first = next(iter(failed.items()))
        error = SweepError(f"{len(failed)} of {len(ends)} runs failed, {first[0]}: {first[1]}")
        error.reasons = failed
        raise error
    return [Run(run) for run, _ in ends]


def report(runs: Any, out: Optional[PathLike] = None, reference: Optional[str] = None) -> str:
    """Compares finished runs, or whole sweeps: tables and figures in ``out`` (``report`` in the first of the folders), with
    report.html to open; gives the tables as text."""
    given = [runs] if isinstance(runs, (str, os.PathLike, Run)) else list(runs)
    folders = [one.folder if isinstance(one, Run) else os.fspath(one) for one in given]
    if not folders:
        raise InputError("give a run at least")
    where = os.path.join(folders[0], "report") if out is None else os.fspath(out)
    return str(_pwrfgs.report(folders, where, reference))
