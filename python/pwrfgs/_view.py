"""Interactive page of a model, as with ``pwrfgs view``."""

from __future__ import annotations

import os
import sys
from typing import Any, Optional

from . import _pwrfgs
from ._errors import InputError
from ._values import plugin_text


def in_notebook() -> bool:
    """Whether the program is a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")


def show(path: Optional[str], model: Optional["_pwrfgs.Model"], beside: Any) -> "_pwrfgs.View":
    """Start the page of a run folder or a model; outside a notebook, print its address."""
    if isinstance(beside, _pwrfgs.Model):
        raise InputError("beside is a Model; give the path of its file or run folder")
    if beside is not None:
        named = getattr(beside, "folder", beside)  # of a run
        beside = os.fspath(named) if isinstance(named, (str, os.PathLike)) else plugin_text("Baseline", beside, None)
    view = _pwrfgs.view(path, model, beside)
    if not in_notebook():
        print(f"{view.address}\nopen this address in a browser on this machine; the page ends with this program, or with its result")
    return view


def view(self: "_pwrfgs.Model", beside: Any = None) -> "_pwrfgs.View":
    """Show an interactive page of the model: in a notebook as output, elsewhere at the printed address.

    On the page you move a transmitter and see the prediction. The model of a run folder has the samples of its data there.
    ``beside`` is a run, a model file or a baseline such as ``pwrfgs.NearestNeighbours(k=5)``; both sides share the transmitter.
    ``close()`` stops the page, as does deleting the result; several pages can be open."""
    return show(None, self, beside)


setattr(_pwrfgs.Model, "view", view)
