"""Groups of settings and enums, by type name: ``Training(steps=2000)``, ``Schedule.Cosine(first=1e-3, last=1e-6)``,
``Rays.Same(400)``, ``Readout.Real``.

A dict also sets a group: ``pipeline.training = dict(steps=2000, batch=8)``.
"""

from typing import List

from . import _classes

globals().update(_classes.SETTINGS)
__all__: List[str] = sorted(_classes.SETTINGS)
