"""One class per plugin, created at import; ``_plugins.pyi`` of a wheel lists them."""

from typing import List

from . import _classes

globals().update(_classes.CLASSES)
__all__: List[str] = sorted(_classes.CLASSES)
