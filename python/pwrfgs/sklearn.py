"""scikit-learn: ``SpectrumRegressor`` trains on positions and spectra. Requires scikit-learn, which is imported only here."""

from __future__ import annotations

from typing import Any, Dict, Optional, Sequence

import numpy as np

from . import _pwrfgs, metrics
from ._errors import InputError, missing
from ._pipeline import Pipeline
from ._trainer import Trainer
from ._types import Array

try:
    from sklearn.base import BaseEstimator, RegressorMixin
    from sklearn.exceptions import NotFittedError
except ModuleNotFoundError:
    raise missing("scikit-learn", "sklearn") from None


class SpectrumRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc, unused-ignore]
    """Gaussian splatting as an estimator: ``SpectrumRegressor().fit(tx, spectra).predict(tx)``.

    ``tx`` are positions [M, 3] in metres, ``spectra`` arrays [M, H, W] from 0 to 1 at one receiver. ``score`` is the mean SSIM.
    All samples of ``fit`` are training samples; searches and cross-validation of scikit-learn hold out others.

    Parameters
    ----------
    pipeline
        A ``Pipeline``, or anything from which one is made; its data and split have no effect.
    set
        Settings by path, such as ``{"training.steps": 2000}``.
    receiver
        A ``Receiver``; default: at the origin.
    points
        Surface points of the room [P, 3] in metres, for initialisers that need them.
    elevation_deg
        Elevations of the upper and lower edge of a spectrum, degrees.
    seed
        Random seed; default: that of the pipeline.
    """

    def __init__(
        self,
        pipeline: Any = "s23-laptop",
        *,
        set: Optional[Dict[str, Any]] = None,
        receiver: Any = None,
        points: Any = None,
        elevation_deg: Optional[Sequence[float]] = None,
        seed: Optional[int] = None,
    ) -> None:
        self.pipeline = pipeline
        self.set = set
        self.receiver = receiver
        self.points = points
        self.elevation_deg = elevation_deg
        self.seed = seed

    def fit(self, X: Any, y: Any) -> "SpectrumRegressor":
        """Train on positions [M, 3] and spectra [M, H, W]. Sets ``model_`` and ``n_features_in_``."""
        data = _pwrfgs.Dataset.from_arrays(
            X, y, receivers=self.receiver, points=self.points, elevation_deg=self.elevation_deg
        )
        pipeline = Pipeline(self.pipeline)
        pipeline.set({**(self.set or {}), **({} if self.seed is None else {"seed": self.seed})})
        trainer = Trainer(pipeline, data, train=np.arange(len(data)))
        while not trainer.finished:
            trainer.step()
        self.model_ = trainer.model()
        self.n_features_in_ = 3
        return self

    def predict(self, X: Any) -> Array:
        """Spectra [B, H, W] for positions [B, 3]."""
        model = getattr(self, "model_", None)
        if model is None:
            raise NotFittedError("this SpectrumRegressor has no model; call fit first")
        if np.ndim(X) != 2:
            raise InputError(f"X has shape {list(np.shape(X))}, expected [B, 3]")
        found: Array = model.predict(X)
        return found

    def score(self, X: Any, y: Any, sample_weight: Any = None) -> float:
        """Mean SSIM of the predictions at ``X`` against spectra ``y``."""
        return float(np.average(metrics.ssim(self.predict(X), y), weights=sample_weight))
