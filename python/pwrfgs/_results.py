"""Results of tasks: arrays with names and units, a table, and a figure."""

from __future__ import annotations

import html
from dataclasses import dataclass, field
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from . import plot
from ._errors import InputError, missing
from ._types import Array, _told


@_told
class Interval(NamedTuple):
    """Predictions with their intervals, arrays of one shape.

    prediction : Predicted observations.
    lower : Lower ends.
    upper : Upper ends.
    """

    prediction: Array
    lower: Array
    upper: Array


def _frame(columns: Dict[str, Any]) -> Any:
    try:
        import pandas
    except ModuleNotFoundError:
        raise missing("pandas", "frames") from None
    return pandas.DataFrame(columns)


class Result:
    """Result with a table: ``print`` shows its text, ``to_pandas()`` its rows."""

    text: str

    def columns(self) -> Dict[str, Any]:
        """Columns of the table by name."""
        raise NotImplementedError

    def to_pandas(self) -> Any:
        """Table as a ``pandas.DataFrame``."""
        return _frame(self.columns())

    def __str__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.text)}</pre>"


@dataclass(repr=False)
class RadioMap(Result):
    """Maps of a model over a plane.

    layers : arrays [rows, columns] by name, lowest row first
    units : unit of each layer
    words : quantity of each layer in words
    axes : names of the coordinates of columns and rows
    x : coordinate of each column, metres
    y : coordinate of each row, metres
    plane : the plane in words
    extrapolated : whether each position is an extrapolation, [rows, columns]; None without training positions
    """

    layers: Dict[str, Array]
    units: Dict[str, str]
    words: Dict[str, str]
    axes: Tuple[str, str]
    x: Array
    y: Array
    plane: str
    extrapolated: Optional[Array] = None

    @property
    def text(self) -> str:  # type: ignore[override]
        rows, columns = len(self.y), len(self.x)
        lines = [f"{rows} x {columns} positions, {self.plane}"]
        for name, values in self.layers.items():
            finite = values[np.isfinite(values)]
            ends = f"{finite.min():.4g} to {finite.max():.4g} {self.units[name]}" if finite.size else "no finite value"
            lines.append(f"{name}: {self.words[name]}, {ends.rstrip()}")
        return "\n".join(lines) + "\n"

    def __repr__(self) -> str:
        return f"<RadioMap {len(self.y)} x {len(self.x)}, {self.plane}: {', '.join(self.layers)}>"

    def __getitem__(self, name: str) -> Array:
        try:
            return self.layers[name]
        except KeyError:
            raise InputError(f"the map has no layer {name!r} (layers: {', '.join(self.layers)})") from None

    def columns(self) -> Dict[str, Any]:
        x, y = np.meshgrid(self.x, self.y)
        columns = {self.axes[0]: x.ravel(), self.axes[1]: y.ravel()}
        columns.update({name: values.ravel() for name, values in self.layers.items()})
        if self.extrapolated is not None:
            columns["extrapolated"] = self.extrapolated.ravel()
        return columns

    def plot(self, layer: Optional[str] = None, ax: Any = None) -> Any:
        """Plot a layer, by default the first."""
        name = next(iter(self.layers)) if layer is None else layer
        return plot.radio_map(self, name, ax)


@dataclass(repr=False)
class Located(Result):
    """Positions of transmitters from their observations.

    positions : estimates [B, 3], metres
    misfit : misfit [B] of the best fingerprint, relative to that of a typical sample; far above 1: like no known position
    region_m2 : area [B] of the region that holds the transmitter with a probability of 90 %; NaN without regions
    outlines : outlines of each region, lists of points in metres; a region may have several parts
    names : number of each observation, or ID of each test sample
    truth : true positions [B, 3] of test samples, metres; None for observations
    text : table as on the command line
    """

    positions: Array
    misfit: Array
    region_m2: Array
    outlines: List[List[Array]]
    names: List[str]
    truth: Optional[Array] = None
    text: str = ""

    def __repr__(self) -> str:
        return f"<Located: {len(self.names)} positions>"

    @property
    def error_m(self) -> Optional[Array]:
        """Distance of each estimate from the true position, metres; None for observations."""
        return None if self.truth is None else np.linalg.norm(self.positions - self.truth, axis=1)

    def columns(self) -> Dict[str, Any]:
        columns: Dict[str, Any] = {"observation": self.names}
        columns.update({axis: self.positions[:, k] for k, axis in enumerate("xyz")})
        columns.update(misfit=self.misfit, region_m2=self.region_m2)
        if self.truth is not None:
            columns.update({f"true_{axis}": self.truth[:, k] for k, axis in enumerate("xyz")})
            columns["error_m"] = self.error_m
        return columns

    def plot(self, ax: Any = None) -> Any:
        """Plot the estimates from above, with true positions or regions."""
        return plot.located(self, ax)


@dataclass(repr=False)
class Plan(Result):
    """Positions to measure next, in order.

    positions : positions [K, 3], metres
    order : index [K] of each position among the candidates
    variances : mean variance over the region [K + 1], before and after each position
    text : table of the plan beside other choices, as on the command line
    """

    positions: Array
    order: Array
    variances: Array
    text: str = ""

    def __repr__(self) -> str:
        return f"<Plan: {len(self.order)} positions>"

    def columns(self) -> Dict[str, Any]:
        columns: Dict[str, Any] = {"order": np.arange(1, len(self.order) + 1), "candidate": self.order}
        columns.update({axis: self.positions[:, k] for k, axis in enumerate("xyz")})
        columns["mean_variance"] = self.variances[1:]
        return columns

    def plot(self, ax: Any = None) -> Any:
        """Plot the positions from above, with their order."""
        return plot.plan(self, ax)


@dataclass(repr=False)
class Placement(Result):
    """Positions of receivers with the largest coverage.

    choices : receivers of each choice: names, positions [K, 3] in metres, and coverage in dBm; the best search first
    text : table as on the command line
    """

    choices: Dict[str, Tuple[List[str], Array, float]] = field(default_factory=dict)
    text: str = ""

    def __repr__(self) -> str:
        return f"<Placement: {', '.join(f'{name} {choice[2]:.2f} dBm' for name, choice in self.choices.items())}>"

    @property
    def positions(self) -> Array:
        """Positions [K, 3] of the best choice, metres."""
        return next(iter(self.choices.values()))[1]

    @property
    def names(self) -> List[str]:
        """Names of the receivers of the best choice; empty texts for receivers of a scene."""
        return next(iter(self.choices.values()))[0]

    @property
    def coverage_dbm(self) -> float:
        """Coverage of the best choice, dBm."""
        return next(iter(self.choices.values()))[2]

    def columns(self) -> Dict[str, Any]:
        rows = [
            (choice, k + 1, name, *position, coverage)
            for choice, (names, positions, coverage) in self.choices.items()
            for k, (name, position) in enumerate(zip(names, positions))
        ]
        heads = ("choice", "order", "receiver", "x", "y", "z", "coverage_dbm")
        return {head: [row[k] for row in rows] for k, head in enumerate(heads)}

    def plot(self, ax: Any = None) -> Any:
        """Plot the receivers of all choices from above."""
        return plot.placement(self, ax)


@dataclass
class Finding:
    """Implausible property of data.

    name : name, such as "orientation": equal for all data with this fault
    problem : problem, with its numbers
    mend : option, setting or conversion that mends it
    """

    name: str
    problem: str
    mend: str
