"""One class per plugin, created at import; ``_plugins.pyi`` of a wheel lists them."""

from typing import List

from . import _values

globals().update({name: made for name, made in _values.CLASSES.items() if name})
__all__: List[str] = sorted(name for name in _values.CLASSES if name)
