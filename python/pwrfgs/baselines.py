"""What must be beaten: predictors without Gaussians, on any data set.

Each learns from the links ``train`` of a data set and predicts for transmitters at ``tx`` [B, 3] heard by one receiver:
spectra [B, H, W], powers [B] or channels [B, A, F]. ``receiver`` is a place in
``dataset.receivers``, or a name.
"""

from __future__ import annotations

from typing import Any, Optional, Union

import numpy as np

from . import _pwrfgs
from ._errors import InputError
from ._types import Array


def predict(
    baseline: Any, dataset: "_pwrfgs.Dataset", tx: Any, train: Optional[Any] = None, receiver: Union[int, str] = 0
) -> Array:
    """What any baseline predicts, such as ``pwrfgs.Kriging()``. Learns from all links where ``train`` is left out."""
    if isinstance(train, tuple):
        raise InputError("train is a whole split; give one part of it, such as split.train")
    links = np.arange(len(dataset)) if train is None else train
    if isinstance(receiver, str):
        names = [one.name for one in dataset.receivers]
        if receiver not in names:
            raise InputError(f"there is no receiver {receiver!r}; there are {', '.join(names)}")
        receiver = names.index(receiver)
    found: Array = _pwrfgs.predict_baseline(baseline, dataset, links, np.atleast_2d(tx), receiver)
    return found


def mean(dataset: "_pwrfgs.Dataset", tx: Any, train: Optional[Any] = None, receiver: Union[int, str] = 0) -> Array:
    """The mean of what was observed, whatever the position."""
    return predict("MeanSpectrum()", dataset, tx, train, receiver)


def knn(dataset: "_pwrfgs.Dataset", tx: Any, train: Optional[Any] = None, receiver: Union[int, str] = 0, k: int = 5) -> Array:
    """The mean of the k nearest, weighted by distance."""
    return predict(f"NearestNeighbours(k: {int(k)})", dataset, tx, train, receiver)


def log_distance(
    dataset: "_pwrfgs.Dataset",
    tx: Any,
    train: Optional[Any] = None,
    receiver: Union[int, str] = 0,
    *,
    per_receiver: bool = True,
) -> Array:
    """A law of distance for received powers: of each receiver its own, or one for all of them (which is what
    ``LogDistance()`` in a pipeline is where it says nothing else)."""
    return predict(f"LogDistance(per_receiver: {str(bool(per_receiver)).lower()})", dataset, tx, train, receiver)


def kriging(dataset: "_pwrfgs.Dataset", tx: Any, train: Optional[Any] = None, receiver: Union[int, str] = 0) -> Array:
    """A Gaussian process over position."""
    return predict("Kriging()", dataset, tx, train, receiver)
