"""`check`: validates a pipeline and estimates memory and time of its run."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional

from . import _pwrfgs, _strategies
from ._log import log
from ._pipeline import Pipeline
from ._results import Result
from ._unsaved import storing
from ._values import arguments


@dataclass(repr=False)
class Check(Result):
    """Size and cost of a run.

    samples : numbers of training, validation and test samples
    gaussians : number of initial Gaussians
    weights : number of network weights
    memory_bytes : memory of the training with the initial Gaussians, bytes
    search_s : shortest and longest expected time of the initial search, seconds
    training_s : shortest, expected and longest time of the training, seconds
    warnings : settings without effect, and implausible properties of the data
    text : table as on the command line
    """

    samples: List[int]
    gaussians: int
    weights: int
    memory_bytes: int
    search_s: List[float]
    training_s: List[float]
    warnings: List[str]
    text: str = ""

    def __repr__(self) -> str:
        return f"<Check: {self.training_s[1]:.3g} s of training, {self.memory_bytes / 1e9:.2f} GB>"

    def columns(self) -> Dict[str, Any]:
        names, values = zip(*(line.split("  ", 1) for line in self.text.splitlines() if "  " in line))
        return {"property": [name.strip() for name in names], "value": [value.strip() for value in values]}


def check(pipeline: Any, set: Optional[Mapping[str, Any]] = None) -> Check:
    """Validate a pipeline and estimate memory and time of its run: ``check("quickstart")``.

    Loads the data, makes the split and the initial Gaussians and times a few steps; writes no files. Raises the errors that
    ``run`` would raise, and logs its warnings. Densification increases memory and time.
    """
    chosen = Pipeline(pipeline)
    if set:
        chosen._set_arguments(arguments(set))
    _strategies.check(chosen)
    with tempfile.TemporaryDirectory(prefix="pwrfgs-check-") as folder, storing(folder) as store:
        found = Check(**_pwrfgs.check(chosen._settled(store)._inner))
    for warning in found.warnings:
        log.warning("%s", warning)
    return found
