"""`compare`: all methods, baselines and predictions of other programs on one data set."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, Optional, Sequence, Union

from . import _pwrfgs, plot
from ._errors import InputError
from ._results import Result
from ._run import PathLike, Run, _rows, _unquoted
from ._sweep import finished_runs
from ._tasks import documented, settings_text
from ._types import Array, Partition
from ._unsaved import storing
from ._values import arguments


@dataclass(repr=False)
class Comparison(Result):
    """Scores of all methods, baselines and predictions of other programs on one data set.

    folder : folder of the runs, with their report in ``report``
    runs : finished runs; empty after ``dry_run``
    split : links of each set, equal for all runs
    test_ids : IDs of the links of the test set, or numbers of the links for several receivers: those that another program predicts
    rows : numbers of the report, a dict each: variant, kind, metric, unit, statistic, value, std, n (number of seeds), and for
        paired differences reference, low and high (95 % interval)
    text : tables as on the command line; the planned runs after ``dry_run``
    """

    folder: str
    runs: List[Run]
    split: Partition
    test_ids: Array
    rows: List[Dict[str, Any]] = field(default_factory=list)
    text: str = ""

    def __repr__(self) -> str:
        return f"<Comparison: {len(self.runs)} runs in {self.folder}>"

    def columns(self) -> Dict[str, Any]:
        return {name: [row[name] for row in self.rows] for name in (self.rows[0] if self.rows else ())}

    def plot(self, ax: Any = None) -> Any:
        """Plot the main metric of all methods and baselines."""
        return plot.comparison(self, ax)


def _number(name: str, text: str) -> Any:
    if name in ("value", "std", "low", "high"):
        return float(text) if text else math.nan
    return int(text) if name == "n" else text == "true" if name == "simulated" else _unquoted(text)


@documented("compare")
def compare(
    data: Union["_pwrfgs.Dataset", PathLike],
    *,
    set: Optional[Mapping[str, Any]] = None,
    accept: Sequence[str] = (),
    out: Optional[PathLike] = None,
    dry_run: bool = False,
    keep_checkpoint: bool = False,
    **settings: Any,
) -> Comparison:
    """Compare all methods, all baselines and the predictions of other programs on data, with one split:
    ``pwrfgs.compare("data/s23", seeds=1, set={"training.scale": 0.1})``.

    Every method that can predict the data is trained with each seed. ``data`` is a data folder or a data set; ``set`` are
    changes of all pipelines, ``accept`` are names of accepted findings, ``out`` is the output folder, by default ``runs/compare-NAME``. ``dry_run`` lists the runs with
    estimated times and runs nothing. Repeat the call to resume, or with new predictions: trained models are kept.
    ``keep_checkpoint`` keeps the training states of finished runs.
    ``pwrfgs.report`` compares runs that are finished.

    ``predictions`` is a dict of folders by name. Another program trains on ``split.train`` and ``split.validation``, and predicts
    ``test_ids``: NNNNN.npy per ID, or predictions.csv with the columns id (link for several receivers) and dbm.

    Raises ``SweepError`` if runs failed, after all others have finished."""
    if not isinstance(data, (_pwrfgs.Dataset, str, os.PathLike)):
        raise InputError("data: expected a Dataset or a data folder; pwrfgs.report compares finished runs")
    predictions = settings.get("predictions")
    if isinstance(predictions, Mapping):
        settings["predictions"] = [f"{name}={os.fspath(folder)}" for name, folder in predictions.items()]
    text = settings_text("compare", settings)
    if isinstance(data, _pwrfgs.Dataset):
        if out is None:
            out = os.path.join("runs", "compare-" + (re.sub(r"\W+", "-", data.title).strip("-") or "data"))
        with storing(os.fspath(out)) as store:
            found = _pwrfgs.compare(data, store(data), text, arguments(set), list(accept), out, dry_run, keep_checkpoint)
    else:
        found = _pwrfgs.compare(data, None, text, arguments(set), list(accept), out, dry_run, keep_checkpoint)
    folder, split = os.fspath(found["folder"]), Partition(found["train"], found["validation"], found["test"])
    runs = finished_runs(found["runs"])
    lines = _rows(os.path.join(folder, "report", "report.csv")) if runs else []
    rows = [{name: _number(name, value) for name, value in line.items()} for line in lines]
    return Comparison(folder, runs, split, found["test_ids"], rows, found["text"])
