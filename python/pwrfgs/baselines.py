"""Baselines: predictors without Gaussians, on any data set.

Each is fitted to the links ``train`` of a data set and predicts for transmitters at ``tx`` [B, 3] and one receiver:
spectra [B, H, W], powers [B] or channels [B, A, F]. ``receiver`` is an index into ``dataset.receivers``, or a name.
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
    """Predict with any baseline, such as ``pwrfgs.Kriging()``. Without ``train`` it is fitted to all links."""
    if isinstance(train, tuple):
        raise InputError("train is a whole split; pass one of its sets, such as split.train")
    links = np.arange(len(dataset)) if train is None else train
    if isinstance(receiver, str):
        names = [one.name for one in dataset.receivers]
        if receiver not in names:
            raise InputError(f"unknown receiver {receiver!r} (expected one of {', '.join(names)})")
        receiver = names.index(receiver)
    found: Array = _pwrfgs.predict_baseline(baseline, dataset, links, np.atleast_2d(tx), receiver)
    return found


def mean(dataset: "_pwrfgs.Dataset", tx: Any, train: Optional[Any] = None, receiver: Union[int, str] = 0) -> Array:
    """Mean of the observations, independent of the position."""
    return predict("MeanSpectrum()", dataset, tx, train, receiver)


def knn(dataset: "_pwrfgs.Dataset", tx: Any, train: Optional[Any] = None, receiver: Union[int, str] = 0, k: int = 5) -> Array:
    """Mean of the k nearest samples, weighted by inverse distance."""
    return predict(f"NearestNeighbours(k: {int(k)})", dataset, tx, train, receiver)


def log_distance(
    dataset: "_pwrfgs.Dataset",
    tx: Any,
    train: Optional[Any] = None,
    receiver: Union[int, str] = 0,
    *,
    per_receiver: bool = True,
) -> Array:
    """Path-loss model for received powers, per receiver or common to all receivers (the default of ``LogDistance()`` in a
    pipeline)."""
    return predict(f"LogDistance(per_receiver: {str(bool(per_receiver)).lower()})", dataset, tx, train, receiver)


def kriging(dataset: "_pwrfgs.Dataset", tx: Any, train: Optional[Any] = None, receiver: Union[int, str] = 0) -> Array:
    """Gaussian process over the transmitter position."""
    return predict("Kriging()", dataset, tx, train, receiver)
