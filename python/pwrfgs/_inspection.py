"""`inspect`: properties of data, and the scores of baselines by split, as ``pwrfgs inspect`` prints them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Tuple

import numpy as np

from . import _pwrfgs, plot
from ._pipeline import Pipeline
from ._results import Result
from ._types import Array
from ._values import to_ron


@dataclass(repr=False)
class Inspection(Result):
    """Properties of data, and the scores of baselines by split.

    title : title of the data
    facts : properties and their texts: samples, positions, steps, receivers, point cloud, values
    pose : check of the recorded receiver pose from the strongest directions of spectra: verdict, number of spectra, angles in
        degrees, and the orientation (x, y, z, w) that fits best; None for other data, or with too few spectra
    metric : metric of the scores, such as "ssim"
    baselines : names of the B baselines
    splits : S splits; that of the pipeline ends in " *"
    train : number of training samples [S]
    test : number of test samples [S]
    nearest_m : median distance [S] of test transmitters to the nearest training transmitter, metres; NaN without positions
    scores : mean score [S, B] of each baseline on up to 300 test samples; NaN if the metric does not apply
    ceiling : noise ceiling [S], the best score to expect from a predictor; NaN if it cannot be estimated
    refused : splits that the data do not support, with the reasons
    text : text as on the command line
    """

    title: str
    facts: List[Tuple[str, str]]
    pose: Optional[Dict[str, Any]]
    metric: str
    baselines: List[str]
    splits: List[str]
    train: Array
    test: Array
    nearest_m: Array
    scores: Array
    ceiling: Array
    refused: List[Tuple[str, str]]
    text: str = ""

    def __repr__(self) -> str:
        return f"<Inspection of {self.title}: {len(self.splits)} splits, {len(self.baselines)} baselines>"

    def columns(self) -> Dict[str, Any]:
        columns: Dict[str, Any] = {"split": self.splits, "train": self.train, "test": self.test, "nearest_m": self.nearest_m}
        columns.update({f"{name} {self.metric}": self.scores[:, k] for k, name in enumerate(self.baselines)})
        columns[f"noise ceiling {self.metric}"] = self.ceiling
        return columns

    def plot(self, ax: Any = None) -> Any:
        """Plot the scores of the baselines and the noise ceiling of every split."""
        ax = plot._axes(ax, figsize=(6.4, 3.6))
        rows = np.arange(len(self.splits))
        for k, name in enumerate(self.baselines):
            colour = plot.colours()(k / max(1, len(self.baselines)))
            ax.scatter(self.scores[:, k], rows, s=28, color=colour, label=name)
        ax.scatter(self.ceiling, rows, s=60, marker="|", color="black", label="noise ceiling")
        ax.set(xlabel=f"mean {self.metric} on test samples", yticks=rows, yticklabels=self.splits)
        ax.invert_yaxis()
        ax.legend(fontsize="small", frameon=False, loc="center left", bbox_to_anchor=(1.02, 0.5))
        return ax


def inspect(data: "_pwrfgs.Dataset", pipeline: Any = None) -> Inspection:
    """Inspect data before training: positions, values, receiver pose, and for each split the distance from test to training
    transmitters, the scores of the baselines and the noise ceiling.

    ``pipeline`` is a ``Pipeline``, or anything from which one is made, with split, baselines, metrics and seed; without it, the
    split of ``Pipeline.for_data`` and the defaults for this kind of data."""
    chosen = Pipeline(_pwrfgs.default_pipeline(data, to_ron(data)) if pipeline is None else pipeline)
    return Inspection(**_pwrfgs.inspect(data, chosen._inner))
