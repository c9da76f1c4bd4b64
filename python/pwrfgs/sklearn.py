"""scikit-learn: ``SpectrumRegressor``, ``PowerRegressor`` and ``ChannelRegressor`` train on positions and observations.
Requires scikit-learn, which is imported only here."""

from __future__ import annotations

from typing import Any, Dict, Optional, Sequence, Tuple

import numpy as np

from . import _pwrfgs, metrics
from ._errors import InputError, missing
from ._pipeline import Pipeline
from ._plugins import Random
from ._trainer import Trainer
from ._types import Array

try:
    from sklearn.base import BaseEstimator, RegressorMixin
    from sklearn.metrics import r2_score
    from sklearn.utils.validation import check_is_fitted
except ModuleNotFoundError:
    raise missing("scikit-learn", "sklearn") from None
try:
    from sklearn.utils.validation import validate_data
except ImportError:  # scikit-learn below 1.6

    def validate_data(estimator: Any, X: Any, **rules: Any) -> Any:
        return estimator._validate_data(X, **rules)


# First names of the paths of settings.
_SETTINGS = {name for entry in _pwrfgs.types() if entry["name"] == "Pipeline" for name, *_ in entry["fields"]}
# Probability of an interval of one standard deviation on either side.
_ONE_SIGMA = 0.6827


def _check_metres(X: Array) -> None:
    """Raise an error for positions that a scaler has changed."""
    spread = X.std(axis=0)
    varied = spread[spread > 0]
    if len(X) > 2 and varied.size and np.abs(X.mean(axis=0)).max() < 1e-6 and np.abs(varied - 1).max() < 1e-6:
        how = "mean 0 and standard deviation 1"
    elif np.abs(X.min(axis=0)).max() < 1e-9 and np.abs(X.max(axis=0) - 1).max() < 1e-9:
        how = "minimum 0 and maximum 1"
    else:
        return
    reason = "positions must be in metres, as receivers and wavelengths are"
    raise InputError(f"every column of X has {how}, as after a scaler, but {reason}; remove the scaler")


class _Regressor(RegressorMixin, BaseEstimator):  # type: ignore[misc, unused-ignore]
    """Base of the estimators. The parameters below are in all of them."""

    pipeline: Any
    set: Optional[Dict[str, Any]]
    points: Any
    seed: Optional[int]
    # Share of the positions that `fit` holds out to calibrate intervals.
    validation_fraction: float = 0.0

    def _observations(self, y: Array) -> Dict[str, Any]:
        """Arguments of ``Dataset.from_arrays`` that describe the observations."""
        raise NotImplementedError

    def _unflattened(self, y: Array, shape: Optional[Sequence[int]], numbers: int = 1) -> Array:
        """Observations [M, rows, columns] of rows with ``numbers`` real numbers per value."""
        if shape is None and y.ndim > 2:
            return y
        if shape is None:
            raise InputError(f"y has shape {list(y.shape)}; set shape to (rows, columns) of an observation")
        rows, columns = shape
        if y.size != len(y) * rows * columns * numbers:
            raise InputError(
                f"y has shape {list(y.shape)}, expected [M, {rows * columns * numbers}] since shape is ({rows}, {columns})"
            )
        return y.reshape(len(y), rows, -1)

    def _positions(self, X: Any, **rules: Any) -> Array:
        try:
            found: Array = validate_data(self, X, dtype=np.float64, **rules)
        except ValueError as error:
            raise InputError(str(error)) from None
        if found.shape[1] != 3:
            raise InputError(f"X has shape {list(found.shape)}, expected positions [M, 3] in metres")
        return found

    def fit(self, X: Any, y: Any) -> Any:
        """Train on positions ``X`` [M, 3] in metres and observations ``y``. Sets ``model_``, a ``Model``."""
        X = self._positions(X, y=None if y is None else "no_validation")
        _check_metres(X)
        y = np.asarray(y)
        if y.shape[:1] != (len(X),):
            raise InputError(f"y has shape {list(y.shape)}, expected {len(X)} rows as X has")
        if not 0 <= self.validation_fraction < 1:
            raise InputError(f"validation_fraction is {self.validation_fraction}, expected 0 to below 1")
        data = _pwrfgs.Dataset.from_arrays(X, points=self.points, **self._observations(y))
        self.n_held_out_ = round(self.validation_fraction * len(X))
        order = np.random.default_rng(self.seed or 0).permutation(np.unique(data.ids))
        is_held_out = np.isin(data.ids, order[: self.n_held_out_])
        train, validation = np.flatnonzero(~is_held_out), np.flatnonzero(is_held_out)
        pipeline = Pipeline.for_data(data.subset(train), effort="fast") if self.pipeline is None else Pipeline(self.pipeline)
        seed = {} if self.seed is None else {"seed": self.seed}
        pipeline.set({**(self.set or {}), **seed, "split": Random()})
        trainer = Trainer(pipeline, data, train=train)
        while not trainer.finished:
            trainer.step()
        self.model_ = trainer.model()
        if self.n_held_out_:
            self.model_ = _pwrfgs.calibrate(self.model_, pipeline._inner, data, train, validation)
        self.shape_ = y.shape[1:]
        return self

    def predict(self, X: Any) -> Array:
        """Observations at positions [B, 3] in metres, in the form of those of ``fit``."""
        check_is_fitted(self)
        found: Array = self.model_.predict(self._positions(X, reset=False))
        return found.reshape(len(found), *self.shape_)

    def get_params(self, deep: bool = True) -> Dict[str, Any]:
        """Parameters by name; with ``deep``, also the settings of ``set``, such as ``training__steps``."""
        params: Dict[str, Any] = super().get_params(deep=deep)
        if deep and isinstance(self.set, dict):
            params.update({path.replace(".", "__"): value for path, value in self.set.items()})
        return params

    def set_params(self, **params: Any) -> Any:
        """Set parameters by name, and settings of the pipeline by path: ``set_params(training__steps=200)`` adds
        ``"training.steps"`` to ``set``."""
        own = self._get_param_names()
        paths = [name for name in params if name not in own and name.split("__")[0] in _SETTINGS]
        super().set_params(**{name: value for name, value in params.items() if name not in paths})
        if paths:
            self.set = {**(self.set or {}), **{name.replace("__", "."): params[name] for name in paths}}
        return self

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        tags.target_tags.single_output = isinstance(self, PowerRegressor)
        tags.regressor_tags.poor_score = True  # positions of a radio field, not any features
        return tags


class SpectrumRegressor(_Regressor):
    """Spectra of one receiver as an estimator: ``SpectrumRegressor().fit(tx, spectra).predict(tx)``.

    ``X`` are positions [M, 3] in metres. ``y`` are spectra [M, H, W] from 0 to 1, or rows [M, H * W] if ``shape`` is set;
    scorers such as ``scoring="r2"`` need rows. ``score`` is the mean SSIM.
    All samples of ``fit`` are training samples; searches and cross-validation of scikit-learn hold out others.
    Settings are parameters too: ``GridSearchCV(SpectrumRegressor(), {"training__scale": [0.1, 0.5]})``.

    Parameters
    ----------
    pipeline
        A ``Pipeline``, or anything from which one is made; its data and split have no effect. Default: ``Pipeline.for_data``.
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
    shape
        Rows and columns (H, W) of a spectrum; ``y`` and predictions are then rows of H * W numbers.
    """

    def __init__(
        self,
        pipeline: Any = None,
        *,
        set: Optional[Dict[str, Any]] = None,
        receiver: Any = None,
        points: Any = None,
        elevation_deg: Optional[Sequence[float]] = None,
        seed: Optional[int] = None,
        shape: Optional[Tuple[int, int]] = None,
    ) -> None:
        self.pipeline = pipeline
        self.set = set
        self.receiver = receiver
        self.points = points
        self.elevation_deg = elevation_deg
        self.seed = seed
        self.shape = shape

    def _observations(self, y: Array) -> Dict[str, Any]:
        spectra = self._unflattened(y, self.shape)
        return {"spectra": spectra, "receivers": self.receiver, "elevation_deg": self.elevation_deg}

    def score(self, X: Any, y: Any, sample_weight: Any = None) -> float:
        """Mean SSIM of the predictions at ``X`` against spectra ``y``."""
        found, truth = (self._unflattened(np.asarray(rows), self.shape) for rows in (self.predict(X), y))
        return float(np.average(metrics.ssim(found, truth), weights=sample_weight))


class PowerRegressor(_Regressor):
    """Received powers as an estimator: ``PowerRegressor(receivers=gateways).fit(tx, rssi).predict(tx)``.

    ``X`` are positions [M, 3] in metres. ``y`` are powers [M, R] in dBm, or [M] of one receiver; NaN means not received.
    ``score`` is R², the mean over the receivers, without powers that are NaN.
    Settings are parameters too: ``GridSearchCV(PowerRegressor(receivers=gateways), {"training__scale": [0.1, 0.5]})``.

    Parameters
    ----------
    pipeline
        A ``Pipeline``, or anything from which one is made; its data and split have no effect. Default: ``Pipeline.for_data``.
        With ``residuals``, standard deviations depend on the position.
    set
        Settings by path, such as ``{"training.steps": 2000}``.
    receivers
        Positions [R, 3] of the receivers in metres, or a list of ``Receiver``. ``fit`` needs it.
    points
        Surface points of the room [P, 3] in metres, for initialisers that need them.
    seed
        Random seed; default: that of the pipeline.
    validation_fraction
        Share of the positions that ``fit`` does not train on: their errors calibrate the standard deviations. With 0, all
        positions are training samples; ``residuals`` has no effect, and ``predict`` has no ``return_std``.
    """

    def __init__(
        self,
        pipeline: Any = None,
        *,
        set: Optional[Dict[str, Any]] = None,
        receivers: Any = None,
        points: Any = None,
        seed: Optional[int] = None,
        validation_fraction: float = 0.1,
    ) -> None:
        self.pipeline = pipeline
        self.set = set
        self.receivers = receivers
        self.points = points
        self.seed = seed
        self.validation_fraction = validation_fraction

    def _observations(self, y: Array) -> Dict[str, Any]:
        return {"rssi": y, "receivers": self.receivers}

    def predict(self, X: Any, return_std: bool = False) -> Any:
        """Powers [B, R] or [B] in dBm at positions [B, 3] in metres; with ``return_std``, also their standard deviations in
        dB, half the width of the 68.27 % intervals, as a second array of this shape."""
        if not return_std:
            return super().predict(X)
        check_is_fitted(self)
        if self.n_held_out_ < 3:
            what = f"return_std needs 3 held-out positions, and fit held out {self.n_held_out_}"
            raise InputError(f"{what}; raise validation_fraction, or give fit more positions")
        found = self.model_.predict(self._positions(X, reset=False), interval=_ONE_SIGMA)
        powers, deviations = found.prediction, (found.upper - found.lower) / 2
        return tuple(array.reshape(len(array), *self.shape_) for array in (powers, deviations))

    def score(self, X: Any, y: Any, sample_weight: Any = None) -> float:
        """R² of the predictions at ``X`` against powers ``y``, the mean over the receivers; without powers that are NaN."""
        y = np.asarray(y, float).reshape(len(y), -1)
        found, weight = self.predict(X).reshape(y.shape), np.ones(len(y)) if sample_weight is None else sample_weight
        scores = [
            r2_score(y[known, r], found[known, r], sample_weight=np.asarray(weight)[known])
            for r, known in enumerate(~np.isnan(y).T)
            if known.sum() > 1
        ]
        return float(np.mean(scores))


class ChannelRegressor(_Regressor):
    """Channels of one receiver as an estimator: ``ChannelRegressor(frequencies_hz=hz, receiver=array).fit(tx, csi)``.

    ``X`` are positions [M, 3] in metres. ``y`` are channels [M, A, F], complex, or real rows [M, A * F * 2] if ``shape`` is
    set: ``csi.view(csi.real.dtype).reshape(len(csi), -1)``. Scorers such as ``scoring="r2"`` need real rows.
    ``score`` is the mean signal-to-noise ratio in dB.
    All samples of ``fit`` are training samples; searches and cross-validation of scikit-learn hold out others.
    Settings are parameters too, as for ``SpectrumRegressor``.

    Parameters
    ----------
    pipeline
        A ``Pipeline``, or anything from which one is made; its data and split have no effect. Default: ``Pipeline.for_data``.
    set
        Settings by path, such as ``{"training.steps": 2000}``.
    receiver
        A ``Receiver`` with its antennas; default: at the origin.
    frequencies_hz
        Subcarrier frequencies [F] in Hz. ``fit`` needs it.
    points
        Surface points of the room [P, 3] in metres, for initialisers that need them.
    seed
        Random seed; default: that of the pipeline.
    shape
        Numbers of antennas and subcarriers (A, F); ``y`` and predictions are then rows of A * F * 2 real numbers.
    """

    def __init__(
        self,
        pipeline: Any = None,
        *,
        set: Optional[Dict[str, Any]] = None,
        receiver: Any = None,
        frequencies_hz: Any = None,
        points: Any = None,
        seed: Optional[int] = None,
        shape: Optional[Tuple[int, int]] = None,
    ) -> None:
        self.pipeline = pipeline
        self.set = set
        self.receiver = receiver
        self.frequencies_hz = frequencies_hz
        self.points = points
        self.seed = seed
        self.shape = shape

    def _channels(self, y: Array) -> Array:
        if self.shape is None:
            return self._unflattened(y, None)
        if np.iscomplexobj(y):
            raise InputError("y is complex, but shape is set: give rows of real numbers, or leave out shape")
        rows = self._unflattened(np.ascontiguousarray(y, dtype=np.float64), self.shape, numbers=2)
        return rows.view(np.complex128)

    def _observations(self, y: Array) -> Dict[str, Any]:
        return {"csi": self._channels(y), "receivers": self.receiver, "frequencies_hz": self.frequencies_hz}

    def predict(self, X: Any) -> Array:
        """Channels [B, A, F], complex, or real rows [B, A * F * 2] if ``shape`` is set, at positions [B, 3] in metres."""
        check_is_fitted(self)
        found: Array = self.model_.predict(self._positions(X, reset=False))
        return found if self.shape is None else found.view(found.real.dtype).reshape(len(found), -1)

    def score(self, X: Any, y: Any, sample_weight: Any = None) -> float:
        """Mean signal-to-noise ratio of the predictions at ``X`` against channels ``y``, dB."""
        found, truth = (self._channels(np.asarray(rows)) for rows in (self.predict(X), y))
        return float(np.average(metrics.channel_snr(found, truth), weights=sample_weight))
