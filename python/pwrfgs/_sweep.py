"""`sweep`: many runs from an experiment file, or from a pipeline and lists of values."""

from __future__ import annotations

import contextlib
import os
import tempfile
import uuid
from concurrent.futures import Executor, as_completed
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Set, Tuple, Union

import numpy as np

from . import _pwrfgs, _strategies
from ._errors import Error, InputError
from ._log import event as log_event
from ._pipeline import Pipeline
from ._run import PathLike, Progress, Run, event_listener
from ._unsaved import Store, storing
from ._values import Value, arguments, from_ron, quoted, ron_name, to_ron

# Values of one path: a list, or a dict that gives each value a label.
Values = Union[Sequence[Any], Mapping[str, Any]]


class SweepError(InputError):
    """Failed runs of a sweep: ``reasons`` maps folders to messages, ``exceptions`` to exceptions with their tracebacks. The first
    of these is the cause of this error, so that its traceback is printed."""

    reasons: Dict[str, str] = {}
    exceptions: Dict[str, BaseException] = {}


def sweep(
    experiment: Any,
    set: Optional[Mapping[str, Any]] = None,
    out: Optional[PathLike] = None,
    jobs: int = 1,
    *,
    axes: Optional[Mapping[str, Values]] = None,
    seeds: Iterable[int] = (0,),
    name: Optional[str] = None,
    join: bool = False,
    executor: Optional[Executor] = None,
    progress: bool = True,
    keep_checkpoint: bool = False,
) -> List[Run]:
    """Perform all unfinished runs of a sweep and write its report. Returns the runs in order, followed by the joined model if
    ``join`` is set.

    ``experiment`` is an experiment file or its name in ``pwrfgs pipelines``, or with ``axes`` the base pipeline::

        sweep("quickstart", axes={"training.scale": [0.1, 0.5], "split": {"voxel": pwrfgs.Voxel()}}, seeds=range(3))

    Each axis is the path of a setting with its values: every combination runs with each of the ``seeds``. A dict gives the
    values labels for folders, tables and figures; the label of a plugin in a list is its name with the settings that differ.
    A value that is a dict changes several settings, and the axis then has any name::

        axes={"pruner": {"mine": {"pruners": [Mine()], "training.target_count": 0}, "top": {"pruners": [pwrfgs.TopK()]}}}

    ``out`` is the sweep folder, default ``runs/NAME``; ``name`` is by default the name of the base and of the axes.

    Repeat the call to resume after Ctrl-C. Raises ``SweepError`` if runs failed, after all others have finished.
    ``keep_checkpoint`` keeps the training states of finished runs, and ``progress`` shows how many runs have ended, in a
    terminal or a notebook.

    ``jobs`` runs share the threads of this process. With an ``executor`` of ``concurrent.futures``, also of Dask
    (``client.get_executor()``) or MPI (``mpi4py.futures.MPIPoolExecutor()``), each unfinished run is a task of it::

        with ProcessPoolExecutor(8, mp_context=multiprocessing.get_context("spawn")) as executor:
            sweep("paper-office", out="runs/office", executor=executor)

    Its processes need this package, the modules of your own classes, and a disk in common. Each run uses ``slurm.cpus``
    threads, a field of the experiment file with the default 2. The calling process validates all runs before the first task,
    and joins the models and writes the report after the last.
    """
    if executor is not None and not isinstance(executor, Executor):
        raise InputError(f"executor is {executor!r}; give a concurrent.futures.Executor, for Dask client.get_executor()")
    if executor is not None and jobs != 1:
        raise InputError("jobs has no effect with an executor, which decides how many runs are performed at a time; leave it out")
    if axes is None:
        if out is None and any(isinstance(value, _pwrfgs.Dataset) and value._source is None for value in (set or {}).values()):
            raise InputError("set: data in memory are written to the sweep folder; give it as `out`")
        with storing(os.fspath(out or "")) as store:
            return _performed(experiment, _settled(set, store), out, jobs, executor, progress, keep_checkpoint)
    base = Pipeline(experiment)
    names = _axis_names(list(axes))
    chosen = name or "-".join([base.name, *names])
    where = os.path.join("runs", chosen) if out is None else os.fspath(out)
    with tempfile.TemporaryDirectory(prefix="pwrfgs-sweep-") as folder, storing(where) as store:
        base._settled(store).save(os.path.join(folder, "base.ron"))
        lines = [_axis(short, path, _settled(axes[path], store)) for short, path in zip(names, axes)]
        text = f"Experiment(name: {quoted(chosen)}, base: \"base.ron\", seeds: {to_ron([int(s) for s in seeds])}, "
        text += f"join: {to_ron(join)}, axes: [{', '.join(lines)}])"
        path = os.path.join(folder, f"{os.path.basename(chosen) or 'sweep'}.ron")
        with open(path, "w", encoding="utf-8") as file:
            file.write(text)
        return _performed(path, _settled(set, store), out, jobs, executor, progress, keep_checkpoint)


def _settled(value: Any, store: Store) -> Any:
    """Value with data in memory replaced by their source in the sweep folder."""
    if isinstance(value, _pwrfgs.Dataset) and value._source is None:
        return from_ron(store(value))
    if isinstance(value, Mapping):
        return {name: _settled(item, store) for name, item in value.items()}
    return type(value)(_settled(item, store) for item in value) if type(value) in (list, tuple) else value


def _performed(
    experiment: PathLike,
    set: Optional[Mapping[str, Any]],
    out: Optional[PathLike],
    jobs: int,
    executor: Optional[Executor],
    progress: bool,
    keep_checkpoint: bool,
) -> List[Run]:
    changes = arguments(set)
    if executor is None:
        with contextlib.closing(Progress(progress)) as bar:
            listener = event_listener(bar, None)
            return finished_runs(_pwrfgs.sweep(experiment, changes, out, jobs, listener, keep_checkpoint))
    failures = _submitted(executor, *_pwrfgs.prepare_sweep(experiment, changes, out), keep_checkpoint)
    reasons = [(place, _reason(why)) for place, why in failures.items()]
    ends = _pwrfgs.sweep(experiment, changes, out, jobs, log_event, keep_checkpoint, reasons)
    return finished_runs([(run, failures.get(place, why)) for place, (run, why) in enumerate(ends)])


def finished_runs(ends: Sequence[Tuple[PathLike, Optional[BaseException]]]) -> List[Run]:
    """Runs of folders; an error if one has an exception."""
    failed = {os.fspath(run): why for run, why in ends if why is not None}
    if failed:
        folder, first = next(iter(failed.items()))
        error = SweepError(f"{len(failed)} of {len(ends)} runs failed, {folder}: {_reason(first)}")
        error.reasons = {run: _reason(why) for run, why in failed.items()}
        error.exceptions = failed
        raise error from first
    return [Run(run) for run, _ in ends]


def _reason(error: BaseException) -> str:
    """Message of an exception; its class too, if it is not of this package."""
    return str(error) if isinstance(error, Error) else f"{type(error).__name__}: {error}"


def _submitted(
    executor: Executor, runs: List[Tuple[int, Any, str]], threads: int, keep_checkpoint: bool
) -> Dict[int, BaseException]:
    """Perform runs by an executor; returns the exceptions of those that failed, by place."""
    # Dask returns the result of an earlier task with the same arguments, and a failed run is repeated.
    call = uuid.uuid4().hex
    tasks = {
        executor.submit(_perform, pipeline, os.path.abspath(folder), threads, keep_checkpoint, call): place
        for place, folder, pipeline in runs
    }
    failures: Dict[int, BaseException] = {}
    try:
        for task in as_completed(tasks):
            error = task.exception()
            if error is not None:
                failures[tasks[task]] = error
    finally:
        for task in tasks:
            task.cancel()  # after Ctrl-C; a task that has ended or runs is not affected
    return dict(sorted(failures.items()))


# Calls of `sweep` that Ctrl-C has ended in this process: an executor may start a waiting task after the one that it ended.
_ENDED: Set[str] = set()


def _perform(pipeline: str, folder: str, threads: int, keep_checkpoint: bool, call: str) -> None:
    """Perform one run of a sweep in a process of an executor."""
    if call in _ENDED:
        raise KeyboardInterrupt
    chosen = Pipeline(pipeline)
    _strategies.check(chosen)
    try:
        _pwrfgs.run(chosen._inner, folder, log_event, keep_checkpoint, threads)
    except KeyboardInterrupt:
        _ENDED.add(call)
        raise


def _axis_names(paths: List[str]) -> List[str]:
    """Last part of each path, or the whole path if two parts are equal."""
    last = [path.rsplit(".", 1)[-1] for path in paths]
    return [short if last.count(short) == 1 else path for short, path in zip(last, paths)]


def _axis(name: str, path: str, values: Values) -> str:
    """RON text of an axis."""
    if isinstance(values, (str, bytes, Value)) or not hasattr(values, "__len__"):
        raise InputError(f"axes: {path} is {values!r}; give a list of values, or a dict of values by label")
    listed: List[Tuple[str, Any]]
    if isinstance(values, Mapping):
        listed = [(str(label), value) for label, value in values.items()]
    else:
        listed = list(zip(_labels(list(values)), values))
    variants = [f"(label: {quoted(label)}, set: {_changes(path, value)})" for label, value in listed]
    return f"Axis(name: {quoted(name)}, variants: [{', '.join(variants)}])"


def _changes(path: str, value: Any) -> str:
    """RON map of the settings of a variant: those of a dict, or that of the axis."""
    settings = value if isinstance(value, Mapping) else {path: value}
    # A path of Python may have the name of a keyword, such as `lambda_`.
    paths = {name: quoted(".".join(map(ron_name, name.split(".")))) for name in settings}
    return f"{{{', '.join(f'{paths[name]}: {to_ron(setting)}' for name, setting in settings.items())}}}"


def _labels(values: List[Any]) -> List[str]:
    """Short and distinct labels of values."""
    for label in (_name, _differing(values), to_ron):
        labels = [label(value) for value in values]
        if len({label.lower() for label in labels}) == len(labels):
            break
    return labels


def _name(value: Any) -> str:
    if isinstance(value, Value):
        return value._name or "values"
    if isinstance(value, _strategies.Strategy):
        return type(value).__name__
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_name, value)) or "none"
    return value if isinstance(value, str) else str(value.item() if isinstance(value, np.generic) else value)


def _differing(values: List[Any]) -> Any:
    """Label with those settings that differ between values of one name; for a list, those of its items."""

    def flat(value: Any) -> List[Any]:
        return list(value) if isinstance(value, (list, tuple)) else [value]

    def fields(value: Any) -> Dict[str, Any]:
        if isinstance(value, Value):
            return dict(value._named)
        return _strategies.settings_of(value) if isinstance(value, _strategies.Strategy) else {}

    others = [fields(item) for value in values for item in flat(value)]

    def one(item: Any) -> str:
        own = fields(item)
        differ = {name: field for name, field in own.items() if any(name in o and o[name] != field for o in others)}
        return " ".join([_name(item), *(f"{name}={_name(field)}" for name, field in differ.items())])

    return lambda value: ", ".join(map(one, flat(value))) or "none"
