"""Metrics of the reports, for any arrays.

Each takes a prediction and the observation, for one sample or with leading axes for many, and returns a number, or an array
of the shape of the leading axes.
"""

from __future__ import annotations

from typing import Any, Dict, Sequence, Union

import numpy as np

from . import _pwrfgs
from ._errors import InputError
from ._types import Array
from ._values import to_ron

Score = Union[float, Array]


def _measure(metric: str, kind: str, prediction: Any, truth: Any, axes: int, **more: Any) -> Score:
    shape, other = np.shape(truth), np.shape(prediction)
    if shape != other:
        raise InputError(f"prediction and truth differ in shape: {list(other)} and {list(shape)}")
    lead = shape[: max(len(shape) - axes, 0)]
    if len(lead) > 1:  # one axis of samples is what the toolkit knows
        prediction, truth = (np.reshape(x, (-1, *shape[len(lead) :])) for x in (prediction, truth))
    found = _pwrfgs.measure(metric, kind, prediction, truth, more.get("elevation_deg", (0.0, 90.0)))
    values: Any = found[0][2]
    if np.ndim(values) == 0:
        return float(values)
    return values.reshape(lead) if lead else float(values[0])


def ssim(prediction: Any, truth: Any) -> Score:
    """Structural similarity of spectra [.., H, W] from 0 to 1, as in scikit-image; predictions are clamped."""
    return _measure("Ssim()", "spectrum", prediction, truth, 2)


def psnr(prediction: Any, truth: Any) -> Score:
    """Peak signal-to-noise ratio of spectra [.., H, W], dB."""
    return _measure("Psnr()", "spectrum", prediction, truth, 2)


def l1(prediction: Any, truth: Any) -> Score:
    """Mean absolute error of spectra [.., H, W]."""
    return _measure("L1()", "spectrum", prediction, truth, 2)


def eta(prediction: Any, truth: Any, snr_db: float = 0.0) -> Score:
    """Achievable-rate ratio of spectra [.., H, W], from 0 to 1: rate loss of beam steering by the prediction, eq. (15)."""
    return _measure(f"RateRatio(snr_db: {float(snr_db)!r})", "spectrum", prediction, truth, 2)


def direction_error(prediction: Any, truth: Any, elevation_deg: Sequence[float] = (0.0, 90.0)) -> Score:
    """Angle between the strongest directions of spectra [.., H, W], degrees."""
    return _measure("DirectionError()", "spectrum", prediction, truth, 2, elevation_deg=elevation_deg)


def power_error(prediction: Any, truth: Any) -> Score:
    """Absolute error of received powers [..], dB."""
    return _measure("PowerError()", "power", prediction, truth, 0)


def channel_snr(prediction: Any, truth: Any) -> Score:
    """Signal-to-noise ratio of channels [.., A, F], dB: the power of the truth over that of the error."""
    return _measure("ChannelSnr()", "channel", prediction, truth, 2)


def chamfer(first: Any, second: Any) -> float:
    """Chamfer distance of two sets of points [N, 3] and [P, 3], m²: mean squared distance to the nearest point of the other
    set, summed over both directions."""
    return float(_pwrfgs.chamfer(first, second))


def repeatability(dataset: "_pwrfgs.Dataset", metrics: Sequence[Any] = ("Ssim()",)) -> Dict[str, Dict[str, Any]]:
    """Agreement of two observations at one position: the noise ceiling of any function of the position.

    Pairs of samples at small distances are extrapolated to distance zero: ``["near"]`` holds pairs near in time, ``["far"]``
    pairs far apart in time. Each has ``pairs``, ``reach_m`` and, per metric, ``mean``, ``median`` and ``interval`` (95 %) at
    distance zero, or ``why_not``.
    """
    texts = [metric if isinstance(metric, str) else to_ron(metric) for metric in metrics]
    return dict(_pwrfgs.repeatability(dataset, texts))
