"""Data sets in the package, for first experiments without a download."""

from __future__ import annotations

import os

from . import _pwrfgs
from ._errors import InputError
from ._run import simulate

_SAMPLE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "samples", "office-simulated")


def sample() -> "_pwrfgs.Dataset":
    """Load 60 *simulated* spectra of the office of ``quickstart``, with 2,000 surface points."""
    if not os.path.isdir(_SAMPLE):
        raise InputError(f"{_SAMPLE}: no such folder; install pwrfgs from a wheel, whose build simulates the data")
    return _pwrfgs.Dataset.load(_SAMPLE)


def _make_sample() -> None:
    """Simulate the data of ``sample``; the build of a wheel calls it."""
    simulate("office", _SAMPLE, samples=60, points=2000, progress=False)
