"""Enums of settings, by type name: ``Schedule.Cosine(first=1e-3)``, ``Rays.Same(400)``, ``Readout.Real``.

Plain settings are dicts: ``pipeline.training = dict(steps=2000, batch=8)``.
"""

from typing import List

from . import _values

globals().update(_values.CHOICES)
__all__: List[str] = sorted(_values.CHOICES)
