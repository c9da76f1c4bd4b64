"""What calls give and strategies get: plain records of arrays."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Tuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class Pose(NamedTuple):
    """Where a receiver is and how it is turned."""

    position: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Metres, world frame."""
    orientation: Tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Unit quaternion x, y, z, w (the order of the data sets) that turns receiver axes into world axes."""


@dataclass
class Receiver:
    """One receiver of a data set."""

    name: str = "receiver"
    position: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Metres, world frame."""
    orientation: Tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Unit quaternion x, y, z, w that turns receiver axes into world axes; boresight is z."""
    antennas: List[Tuple[float, float, float]] = field(default_factory=lambda: [(0.0, 0.0, 0.0)])
    """Places of the antennas in the receiver's frame, metres."""

    def __post_init__(self) -> None:
        self.antennas = [tuple(map(float, place)) for place in self.antennas]  # type: ignore[misc]


class Partition(NamedTuple):
    """Places of links, sorted and disjoint."""

    train: Array
    validation: Array
    test: Array


class Gaussians(NamedTuple):
    """Gaussians in space, named as gsplat names them."""

    means: Array
    """[N, 3], metres, world frame."""
    quats: Array
    """[N, 4] as w, x, y, z."""
    scales: Array
    """[N, 3], metres."""
    opacities: Array
    """[N], from 0 to 1."""
    signals: Array
    """[N], complex64."""


class Splats(NamedTuple):
    """Gaussians on a picture."""

    means2d: Array
    """[N, 2]: column and row, px."""
    conics: Array
    """[N, 3]: A, B, C of A dx² + 2 B dx dy + C dy², px⁻²."""
    depths: Array
    """[N], metres."""
    radii: Array
    """[N], px; 0 where it does not reach the picture."""
    opacities: Array
    """[N]."""


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


class Stats(NamedTuple):
    """What was seen of each Gaussian since the last densification, [N] each."""

    visible: Array
    """Drawings that it was in."""
    gradient: Array
    """Sum over these of the norm of the derivative in its place on the picture."""
    radius: Array
    """Largest radius, px."""
    weight: Array
    """Sum of its blending weights."""
    asked: Dict[str, Array]
    """What ``needs`` named, fresh at this prune step; empty at any other."""
    state: Array
    """The numbers that the strategy remembers of the whole training."""


class Moment(NamedTuple):
    """When a strategy is asked."""

    step: int
    """Training step, from 1."""
    phase: str
    """"densify", "prune" or "finetune"."""
    seed: int
    """The pipeline's."""
    round: int
    """Which prune step it is, from 1; 0 at any other step."""
    rounds: int
    """How many there are."""


class Room(NamedTuple):
    """What an initialiser knows, metres in the world frame."""

    points: Array
    """Surface points [P, 3]; P is 0 where none are known."""
    bounds: Array
    """[2, 3]: smallest and largest corner of everything known."""
    receivers: Array
    """[R, 3]."""


class Links(NamedTuple):
    """Links without what was observed of them."""

    tx: Array
    """[L, 3], metres."""
    ids: Array
    """[L]: the numbers that the data give the transmitters."""
    receiver: Array
    """[L]: who heard it."""


@dataclass
class Column:
    """A column of the Gaussians that a strategy asks for."""

    name: str
    width: int = 1
    """Numbers a Gaussian."""
    init: float = 0.0
    learning_rate: Optional[float] = None
    """None for one that only ``update`` changes."""
    adam: bool = True
    """Whether Adam moves it; where not, plain descent does."""
