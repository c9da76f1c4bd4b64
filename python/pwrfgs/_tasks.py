"""What one does with data or a finished model: the functions behind ``pwrfgs map``, ``locate``, ``plan``, ``place``, ``update``,
``compress`` and ``init``. Their settings are those of the commands, with the same names and texts.
"""

from __future__ import annotations

import inspect
import os
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, TypeVar, Union

import numpy as np

from . import _pwrfgs
from ._classes import Field, defaults_of, listing
from ._errors import InputError
from ._log import log
from ._pipeline import Pipeline
from ._results import Finding, Located, Placement, Plan, RadioMap
from ._values import arguments, to_ron, unknown

_FIELDS: Dict[str, List[Field]] = _pwrfgs.task_settings()
#: Settings that are text on the command line, numbers separated by commas.
_BOXES = ("bounds", "prior", "region")
_Function = TypeVar("_Function", bound=Callable[..., Any])


def settings_text(task: str, given: Mapping[str, Any]) -> str:
    """RON text of the settings of a task."""
    known = {name: words for name, words, _, _ in _FIELDS[task]}
    texts = []
    for name, value in given.items():
        if name not in known:
            raise InputError(unknown(task, name, known))
        if value is None:
            continue
        if name in _BOXES and not isinstance(value, str):
            value = ",".join(repr(number) for number in np.ravel(np.asarray(value, float)).tolist())
        if known[name].startswith("list of"):
            value = list(value) if isinstance(value, (list, tuple)) else [value]
        if known[name] == "list of MapQuantity":  # names without quotes
            texts.append(f"{name}: [{', '.join(map(str, value))}]")
        else:
            if known[name] == "text" and not isinstance(value, str):
                raise InputError(f"{name} is {value!r}, expected a str")
            texts.append(f"{name}: {to_ron(value)}")
    return f"({', '.join(texts)})"


def documented(task: str) -> Callable[[_Function], _Function]:
    """Decorator that adds the settings of a task, which are those of its command, to signature and docstring."""

    def add(function: _Function) -> _Function:
        fields = _FIELDS[task]
        own = list(inspect.signature(function).parameters.values())[:-1]  # the last takes the settings
        fixed = {name: default for name, default in defaults_of(fields).items() if default != []}  # None omits a setting too
        names = [name for name, _, _, _ in fields]
        defaults = [inspect.Parameter.empty if default is None else fixed.get(name) for name, _, _, default in fields]
        parameters = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default)
            for name, default in zip(names, defaults)
        ]
        setattr(function, "__signature__", inspect.Signature([*own, *parameters]))
        function.__doc__ = inspect.cleandoc(function.__doc__ or "") + listing(names, fields, defaults)
        return function

    return add


@documented("map")
def radio_map(self: "_pwrfgs.Model", **settings: Any) -> RadioMap:
    """Map the predictions of a model over a plane: ``model.map(plane="z=1.2", step=0.25)``."""
    if isinstance(settings.get("receiver"), int):
        settings["receiver"] = self.receivers[settings["receiver"]]
    values = _pwrfgs.radio_map(self, settings_text("map", settings))
    layers = values["layers"]
    return RadioMap(
        layers={name: array for name, _, _, array in layers},
        units={name: unit for name, _, unit, _ in layers},
        words={name: words for name, words, _, _ in layers},
        axes=tuple(values["axes"]), x=values["columns"], y=values["rows"], plane=values["plane"],
        extrapolated=values.get("extrapolated"),
    )  # fmt: skip


@documented("locate")
def locate(
    self: "_pwrfgs.Model",
    observations: Any = None,
    *,
    set: Optional[Mapping[str, Any]] = None,
    accept: Sequence[str] = (),
    **settings: Any,
) -> Located:
    """Locate transmitters from their observations: powers [B, R] in dBm (NaN: not known), spectra [B, H, W] or channels [B, A, F].
    Without observations, locate the test samples of the data of the model and compare the errors with those of baselines.

    The known positions are those of the data of a model from a run folder. ``set`` changes settings of its pipeline, as in
    ``run``: ``{"data.root": "data/ble"}``. Other models, such as ``pwrfgs.load("s23")``, compare with their predictions at their
    training positions, without regions. ``accept`` are names of findings on data or observations that are accepted."""
    return Located(**_pwrfgs.locate(self, observations, arguments(set), list(accept), settings_text("locate", settings)))


def update(self: "_pwrfgs.Model", data: "_pwrfgs.Dataset", *, accept: Sequence[str] = ()) -> "_pwrfgs.Model":
    """Add new measurements to the Kriged residuals of a model, without training, and return the new model.

    ``accept`` are names of findings that are accepted, such as ``"far-from-model"``: most links lie outside the 99 % intervals of
    the model, as after a change of the room."""
    updated, added, agreement = _pwrfgs.update(self, data, list(accept))
    log.info("%d links added; new data against the model: %s", added, agreement)
    return updated


def compress(self: "_pwrfgs.Model", bits: int = 8) -> "_pwrfgs.Model":
    """Return the model with network weights in 8 or 16 bits, and everything else in 16 bits, except Kriged residuals
    and constants."""
    small, notes = _pwrfgs.compress(self, bits)
    for note in notes:
        log.info("%s", note)
    return small


def findings(self: "_pwrfgs.Dataset") -> List[Finding]:
    """Implausible properties of the data: the warnings of the command line, each with what mends it."""
    return [Finding(*entry) for entry in _pwrfgs.findings(self)]


def init(
    data: "_pwrfgs.Dataset", name: str = "pipeline", *, effort: str = "normal", accept: Sequence[str] = ()
) -> Pipeline:
    """Pipeline for data, as ``pwrfgs init`` writes it; the same as ``Pipeline.for_data``."""
    return Pipeline.for_data(data, name, effort=effort, accept=accept)


@documented("plan")
def plan(
    source: Union["_pwrfgs.Dataset", "_pwrfgs.Model", None] = None,
    *,
    candidates: Any = None,
    floor: Union[str, "os.PathLike[str]", None] = None,
    step: float = 0.25,
    height: float = 1.2,
    **settings: Any,
) -> Plan:
    """Select positions to measure next: ``pwrfgs.plan(data, candidates=positions, count=20)``.

    Data alone are candidates, none of them measured yet. With ``candidates`` [C, 3], or a grid of ``step`` metres at ``height``
    over the ``floor`` of a scene, the positions of the data or the training positions of a model are measured."""
    scene = None if floor is None else (os.fspath(floor), float(step), float(height))
    return Plan(**_pwrfgs.plan(source, candidates, scene, settings_text("plan", settings)))


@documented("place")
def place(source: Any, **settings: Any) -> Placement:
    """Select positions of receivers with the largest coverage: ``pwrfgs.place("office", count=1)``. ``source`` is a scene, or data
    with received powers: then the best of their receivers, scored on held-out transmitters."""
    values = _pwrfgs.place(source, settings_text("place", settings))
    choices = {name: (names, positions, coverage) for name, names, positions, coverage in values["choices"]}
    return Placement(choices=choices, text=values["text"])


def _attach() -> None:
    """Make methods of the functions of models and data."""
    for name, function in (("map", radio_map), ("locate", locate), ("update", update), ("compress", compress)):
        function.__name__ = name
        setattr(_pwrfgs.Model, name, function)
    setattr(_pwrfgs.Dataset, "findings", findings)


_attach()
