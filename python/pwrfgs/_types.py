"""What calls give and strategies get: plain records of arrays."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Tuple, Type, TypeVar

import numpy as np
from numpy.typing import NDArray

from ._errors import InputError

Array = NDArray[Any]
Record = TypeVar("Record")


def _told(cls: Type[Record]) -> Type[Record]:
    """Gives the fields of a named tuple the lines of its docstring, which `help` shows beside them."""
    for name, doc in re.findall(r"^ *(\w+) : (.*)$", cls.__doc__ or "", flags=re.MULTILINE):
        getattr(cls, name).__doc__ = doc
    return cls


@_told
class Pose(NamedTuple):
    """Where a receiver is and how it is turned.

    position : Metres, world frame.
    orientation : Unit quaternion x, y, z, w (the order of the data sets) that turns receiver axes into world axes.
    """

    position: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: Tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)


@dataclass
class Receiver:
    """One receiver of a data set.

    name : what tables call it
    position : metres, world frame
    orientation : unit quaternion x, y, z, w that turns receiver axes into world axes; boresight is z
    antennas : places [A, 3] of its antennas, metres in its own frame, before it is turned; one at the middle where left out
    """

    name: str = "receiver"
    position: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: Tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    antennas: List[Tuple[float, float, float]] = field(default_factory=lambda: [(0.0, 0.0, 0.0)])

    def __post_init__(self) -> None:
        self.antennas = [tuple(map(float, place)) for place in self.antennas]  # type: ignore[misc]
        if any(len(place) != 3 for place in self.antennas):
            raise InputError(f"antennas is {self.antennas}; give places [A, 3], metres")


@_told
class Partition(NamedTuple):
    """Places of links, sorted and disjoint.

    train : places of links to learn from
    validation : places of links to watch a training by; may be none
    test : places of links to score with
    """

    train: Array
    validation: Array
    test: Array


class Gaussians(NamedTuple):
    """Gaussians in space, named as gsplat names them.

    means : [N, 3], metres, world frame.
    quats : [N, 4] as w, x, y, z.
    scales : [N, 3], metres.
    opacities : [N], from 0 to 1.
    signals : [N], complex64.
    """

    means: Array
    quats: Array
    scales: Array
    opacities: Array
    signals: Array


@_told
class Splats(NamedTuple):
    """Gaussians on a picture.

    means2d : [N, 2]: column and row, px.
    conics : [N, 3]: A, B, C of A dx² + 2 B dx dy + C dy², px⁻².
    depths : [N], metres.
    radii : [N], px; 0 where it does not reach the picture.
    opacities : [N].
    """

    means2d: Array
    conics: Array
    depths: Array
    radii: Array
    opacities: Array


class Cloud:
    """Gaussians as they are learned: unconstrained columns of N rows, by name in ``columns``.

    ``means`` [N, 3] (metres), ``log_scales`` [N, 3], ``quats`` [N, 4] (w, x, y, z), ``opacity_logits`` [N],
    ``signals`` [N, 2] (real and imaginary part), and the columns that strategies asked for.
    """

    __slots__ = ("columns",)

    def __init__(self, columns: Dict[str, Array]) -> None:
        self.columns = columns

    def __len__(self) -> int:
        return len(self.columns["opacity_logits"])

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __repr__(self) -> str:
        return f"<Cloud of {len(self)} Gaussians: {', '.join(self.columns)}>"

    @property
    def means(self) -> Array:
        """[N, 3], metres."""
        return self.columns["means"]

    @property
    def quats(self) -> Array:
        """[N, 4] as w, x, y, z; normalised on use."""
        return self.columns["quats"]

    @property
    def scales(self) -> Array:
        """[N, 3], metres."""
        scales: Array = np.exp(self.columns["log_scales"])
        return scales

    @property
    def opacities(self) -> Array:
        """[N], from 0 to 1."""
        opacities: Array = 1.0 / (1.0 + np.exp(-self.columns["opacity_logits"]))
        return opacities

    @property
    def signals(self) -> Array:
        """[N, 2]: real and imaginary part."""
        return self.columns["signals"]


@_told
class Stats(NamedTuple):
    """What was seen of each Gaussian since the last densification, [N] each.

    visible : Drawings that it was in.
    gradient : Sum over these of the norm of the derivative in its place on the picture.
    radius : Largest radius, px.
    weight : Sum of its blending weights.
    asked : What ``needs`` named, fresh at this prune step; empty at any other.
    """

    visible: Array
    gradient: Array
    radius: Array
    weight: Array
    asked: Dict[str, Array]


@_told
class Moment(NamedTuple):
    """When a strategy is asked.

    step : Training step, from 1.
    phase : "densify", "prune" or "finetune".
    seed : The pipeline's.
    round : Which prune step it is, from 1; 0 at any other step.
    rounds : How many there are.
    target : `training.target`, for the pruner that has to reach it; None for others.
    """

    step: int
    phase: str
    seed: int
    round: int
    rounds: int
    target: Optional[int]


@_told
class Room(NamedTuple):
    """What an initialiser knows, metres in the world frame.

    points : Surface points [P, 3]; P is 0 where none are known.
    bounds : [2, 3]: smallest and largest corner of everything known.
    receivers : [R, 3].
    """

    points: Array
    bounds: Array
    receivers: Array


@_told
class Links(NamedTuple):
    """Links without what was observed of them.

    tx : [L, 3], metres.
    ids : [L]: the numbers that the data give the transmitters.
    receiver : [L]: who heard it.
    """

    tx: Array
    ids: Array
    receiver: Array


@dataclass
class Column:
    """A column of the Gaussians that a strategy asks for.

    name : what ``cloud`` and derivatives call it
    width : numbers a Gaussian
    init : what they begin with
    learning_rate : how fast it is learned by the derivatives of ``gate`` and ``penalty``; None, for a column that only
        ``update`` changes, learns nothing
    adam : whether Adam moves it; where not, plain descent does
    """

    name: str
    width: int = 1
    init: float = 0.0
    learning_rate: Optional[float] = None
    adam: bool = True
