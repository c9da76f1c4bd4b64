"""`run` and its result `Run`; `evaluate`, `simulate` and `report`."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import sys
import warnings
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Union

import numpy as np
from numpy.typing import ArrayLike

from . import _html, _pwrfgs, _strategies, _view
from ._errors import InputError, missing
from ._log import event as log_event
from ._pipeline import Pipeline, is_text
from ._types import Array
from ._unsaved import storing
from ._values import KINDS, Value, arguments, from_ron, plugin_text, to_ron

PathLike = Union[str, "os.PathLike[str]"]
Event = Dict[str, Any]


class Run:
    """Run folder: ``Run("runs/x")`` opens an existing one."""

    def __init__(self, folder: PathLike) -> None:
        self.folder = os.fspath(folder)
        if not os.path.isfile(os.path.join(self.folder, "run.json")):
            raise InputError(f"{self.folder} is not a run folder: run.json is missing")

    def _file(self, name: str) -> str:
        return os.path.join(self.folder, name)

    @property
    def facts(self) -> Dict[str, Any]:
        """Settings, machine and times of the run (``run.json``)."""
        facts: Dict[str, Any] = json.loads(_pwrfgs.facts(self.folder)[0])
        return facts

    @property
    def finished(self) -> bool:
        """Whether the run is finished, with model, scores and report."""
        return self.facts.get("finished") is not None

    @property
    def scores(self) -> Dict[str, Dict[str, Any]]:
        """Scores of the model and every baseline, such as ``scores["model"]["ssim"]["mean"]``: mean, median and tail10 for
        per-sample metrics, one number for others, None if a metric does not apply. Empty before the run has finished."""
        scored = _pwrfgs.facts(self.folder)[1]
        return scored[0] if scored else {}

    def table(self) -> Any:
        """Scores as a pandas data frame (rows: predictor; columns: metric and statistic)."""
        try:
            import pandas
        except ModuleNotFoundError:
            raise missing("pandas", "frames") from None
        rows: List[Dict[str, Any]] = []
        for predictor, metrics in self.scores.items():
            row: Dict[str, Any] = {"predictor": predictor}
            for metric, value in metrics.items():
                if isinstance(value, dict):
                    row.update({f"{metric}_{statistic}": number for statistic, number in value.items()})
                else:
                    row[metric] = value
            rows.append(row)
        return pandas.DataFrame(rows).set_index("predictor") if rows else pandas.DataFrame()

    def samples(self) -> List[Dict[str, Any]]:
        """Position and scores of every test sample, one dict each: id, x, y, z in metres, nearest_train_m (distance to the
        nearest training transmitter in metres), and a score per predictor and metric, such as ``row["model ssim"]``. Data
        with several receivers also have link and receiver. Unknown values are None."""
        rows = [row for row in _rows(self._file("samples.csv")) if row.pop("split") == "test"]
        samples = {row.get("link", row["id"]): {key: _parsed(key, text) for key, text in row.items()} for row in rows}
        for score in _rows(self._file("scores.csv")):
            if score["sample"]:
                name = f"{_unquoted(score['predictor'])} {score['metric']}"
                samples[score["sample"]][name] = float(score["value"])
        return list(samples.values())

    @property
    def curve(self) -> Dict[str, Array]:
        """Loss, penalty, number of Gaussians and seconds per step."""
        return _columns(self._file("curve.csv"))

    @property
    def validation(self) -> Dict[str, Array]:
        """Scores on the validation set during training."""
        return _columns(self._file("validation.csv"))

    @property
    def model(self) -> "_pwrfgs.Model":
        """Trained model, available after the run has finished."""
        if not os.path.isfile(self._file("model.safetensors")):
            raise InputError(f"{self.folder} has no model: the run has not finished; resume it with pwrfgs.run({self.folder!r})")
        return _pwrfgs.Model.load(self._file("model.safetensors"))

    @property
    def pipeline(self) -> Pipeline:
        """Pipeline of the run; for a joined model, the pipeline of its evaluation."""
        return Pipeline(self._file("pipeline.ron"))

    @property
    def report(self) -> str:
        """Path of the report, an HTML file."""
        return self._file("report.html")

    def view(self, beside: Any = None) -> "_pwrfgs.View":
        """Show an interactive page of the run, see ``Model.view``; a run in progress shows its last checkpoint."""
        return _view.show(self.folder, None, beside)

    def __repr__(self) -> str:
        if not self.finished:
            return f"<Run {self.folder}: not finished>"
        metric, value = next(iter(self.scores["model"].items()))
        mean = value["mean"] if isinstance(value, dict) else value
        return f"<Run {self.folder}: {metric} {mean:.4g}, {self.facts['gaussians']} Gaussians>"

    def __str__(self) -> str:
        scored = _pwrfgs.facts(self.folder)[1]
        return f"{self!r}\n{scored[1]}" if scored else repr(self)

    def _repr_html_(self) -> str:
        return _html.run(str(self), lambda: self.model, self.finished)


def _rows(path: str) -> List[Dict[str, str]]:
    try:
        with open(path, newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error}") from None


def _unquoted(text: str) -> str:
    """Name from a CSV file: a name that spreadsheets would compute has one more apostrophe in the file."""
    return text[1:] if text.startswith("'") else text


def _parsed(key: str, text: str) -> Any:
    """Value of a column of ``samples.csv``; None if it is empty."""
    if key == "receiver":
        return _unquoted(text)
    return None if not text else int(text) if key in ("id", "link") else float(text)


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


def _is_interactive() -> bool:
    """Whether the error stream is a terminal, or the program a notebook."""
    return _view.in_notebook() or (sys.stderr is not None and sys.stderr.isatty())


class Progress:
    """Progress bar in a terminal or a notebook; silent elsewhere."""

    def __init__(self, shown: bool) -> None:
        self.shown = shown and _is_interactive()
        self.bar: Any = None
        self.name = ""
        self.note = ""

    def begin(self, name: str, total: Optional[int], done: int = 0) -> None:
        self.close()
        if self.shown:
            with warnings.catch_warnings():  # without ipywidgets, a notebook has a bar of text
                warnings.simplefilter("ignore")
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
    keep_checkpoint: bool = False,
) -> Run:
    """Train, prune, score and report: ``run("quickstart")``.

    Ctrl-C stops at the next step and writes a checkpoint. Repeat the call to resume; the result is identical to an
    uninterrupted run.

    Parameters
    ----------
    pipeline
        A ``Pipeline``, the path of a pipeline file, the name of a pipeline in the package, or a run folder to resume.
    set
        Settings by path, as in ``--set``: ``{"training.steps": 2000, "split": "Voxel()"}``.
    out
        Run folder, default ``runs/NAME``. An interrupted run is resumed there, a finished one is opened, and a folder with
        other content is an error. Data in memory are written to its folder ``data`` first.
    callback
        Called with every event, a dict with ``what``: "step" (step, phase, loss, penalty, gaussians), "validation", "stage",
        "start", "message" or "warning". An exception in it stops the run at the next step, with a checkpoint.
    pruners, baselines, metrics
        Custom strategies or plugins **in addition to** those of the pipeline: a Gaussian is kept if all pruners keep it.
        ``set={"pruners": []}`` removes those of the pipeline.
    initializer, split
        Custom strategy or plugin that replaces that of the pipeline.
    progress
        Whether to show a progress bar, in a terminal or a notebook.
    keep_checkpoint
        Whether the finished run keeps its training state ``checkpoint.safetensors``, for ``Trainer.load``.
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
    settings = arguments(set)
    added = {}
    for field, more in (("pruners", pruners), ("baselines", baselines), ("metrics", metrics)):
        if more:
            own, named = _field_after(chosen, settings, field), [_named(field, item) for item in more]
            if field == "pruners":
                _refuse_twice(own, named)
            added[field] = [*own, *named]
    # Together: `training.target_count` needs a pruner with `score`. Settings of single plugins follow the lists.
    inner = [one for one in settings if one.split(".")[0] in added]
    chosen._set_arguments([*(one for one in settings if one not in inner), *arguments(added), *inner])
    for field, one in (("initializer", initializer), ("split", split)):
        if one is not None:
            chosen.set({field: _named(field, one)})
    _strategies.check(chosen)
    folder = os.fspath(out) if out is not None else os.path.join("runs", chosen.name)
    bar = Progress(progress)
    with storing(folder) as store, contextlib.closing(bar):
        _pwrfgs.run(chosen._settled(store)._inner, folder, event_listener(bar, callback), keep_checkpoint)
    return Run(folder)


def evaluate(
    model: "_pwrfgs.Model",
    pipeline: Any,
    out: Optional[PathLike] = None,
    callback: Optional[Callable[[Event], Any]] = None,
    *,
    progress: bool = True,
) -> Run:
    """Score a model that you trained or made yourself, such as ``trainer.model()`` or ``Model.from_arrays(..)``.

    The new run folder ``out`` (default ``runs/NAME``) has model, scores and report, like that of ``run``, but no training
    curve. Data, split, baselines and metrics are those of the pipeline; its training settings have no effect, and the
    report says so. The same call with the same model opens the folder again.
    """
    chosen = Pipeline(pipeline)
    _strategies.check(chosen)
    folder = os.fspath(out) if out is not None else os.path.join("runs", chosen.name)
    bar = Progress(progress)
    with storing(folder) as store, contextlib.closing(bar):
        _pwrfgs.score(model, chosen._settled(store)._inner, folder, event_listener(bar, callback))
    return Run(folder)


def _field_after(pipeline: Pipeline, settings: List[str], field: str) -> List[Any]:
    """Plugins of a field of a pipeline after these settings, without settings of single plugins."""
    lists = [value for name, value in (one.split("=", 1) for one in settings) if name == field]
    if not lists:
        return list(pipeline.get(field))
    own = from_ron(lists[-1])
    if not isinstance(own, list) or not all(isinstance(one, Value) for one in own):
        Pipeline(pipeline)._set_arguments(settings)  # raises
    return list(own)


def _named(field: str, strategy: Any) -> Any:
    """Convert a value for a field: names become values; a plugin must be of the kind of the field."""
    kind = _strategies.FIELDS[field]
    value = from_ron(plugin_text(kind, strategy, None))
    kinds = KINDS.get(getattr(value, "_name", None) or "", [kind])
    if kind not in kinds:
        raise InputError(f"{field}: {value._name} is a {' and a '.join(kinds)}, expected a {kind}")
    return value


def _refuse_twice(there: List[Any], more: List[Any]) -> None:
    """Raise an error for a pruner that the pipeline already has."""

    def of_class(value: Any) -> Any:
        read = from_ron(to_ron(value))  # also that of an object
        return read._named.get("class", read._name), read._named.get("module")

    for place, value in enumerate(more):
        if of_class(value) in map(of_class, [*there, *more[:place]]):
            name = of_class(value)[0]
            raise InputError(
                f"the pipeline has {name} already; change its settings with `set`, or remove the pruners of the pipeline with "
                'set={"pruners": []}'
            )


def event_listener(bar: Progress, callback: Optional[Callable[[Event], Any]]) -> Callable[[Event], None]:
    def hear(event: Event) -> None:
        log_event(event)
        bar.hear(event)
        if callback is not None:
            callback(event)

    return hear


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
    tx: Union[PathLike, ArrayLike, None] = None,
    rx_pose: Union[PathLike, ArrayLike, None] = None,
    progress: bool = True,
) -> "_pwrfgs.Dataset":
    """Simulate a scene into the new folder ``out`` and load it: ``simulate("office", "data/office")``. ``scene`` is a file, or
    the name of a scene in the package.

    ``layout`` is "spectra", "arrays", "rssi" (with noise of ``noise_db``), "channels" or "csi" (with an SNR of ``snr_db``).
    ``tx`` states transmitter positions in metres instead of ``samples``: an array [M, 3] or [3], or a CSV file with the columns
    x, y, z. ``rx_pose`` states poses of a moving receiver: an array [M, 7] or [7] of x, y, z, qx, qy, qz, qw, or a CSV file
    with these columns; ``tx`` [3] is then the fixed transmitter. Rows keep their order.
    Ctrl-C stops without leaving files. With several receivers, each has a folder inside ``out`` (except for "rssi"); the
    first is loaded.
    """
    bar = Progress(progress)
    bar.begin("simulating", samples)
    try:
        _pwrfgs.simulate(
            scene,
            out,
            layout,
            samples,
            seed,
            points,
            noise_db,
            snr_db,
            paths,
            tx,
            rx_pose,
            lambda done, total: bar.to(done),
        )
    finally:
        bar.close()
    folder = os.fspath(out)
    inner = sorted(entry.path for entry in os.scandir(folder) if entry.is_dir() and entry.name != "spectrum")
    alone = any(os.path.isfile(os.path.join(folder, name)) for name in ("tx_pos.csv", "rx_pose.csv", "tx.npy"))
    return _pwrfgs.Dataset.load(folder if alone or not inner else inner[0])


def report(
    runs: Any,
    out: Optional[PathLike] = None,
    reference: Optional[str] = None,
    columns: Sequence[str] = (),
    variants: Sequence[str] = (),
) -> str:
    """Compare finished runs or sweeps: write tables, figures and report.html to ``out`` (default: ``report`` in the first
    folder); returns the tables and the path of the page as text. ``columns`` are those of the score table in LaTeX, such as ``["ssim",
    "ssim.median"]``, and ``variants`` the variants or methods in the figures, at most 6. ``reference`` is the variant or
    baseline from which differences are taken, or a value on an axis, such as ``"Mine"``: each variant is then compared with
    the one that differs only on this axis."""
    given = [runs] if isinstance(runs, (str, os.PathLike, Run)) else list(runs)
    folders = [one.folder if isinstance(one, Run) else os.fspath(one) for one in given]
    if not folders:
        raise InputError("runs is empty; pass at least one run")
    where = os.path.join(folders[0], "report") if out is None else os.fspath(out)
    tables = str(_pwrfgs.report(folders, where, reference, list(columns), list(variants)))
    return f"{tables}\nreport: {os.path.join(where, 'report.html')}\n"
