"""Records of arrays for results and strategy arguments."""

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
    """Set the docstrings of named tuple fields from the class docstring, for `help`."""
    for name, doc in re.findall(r"^ *(\w+) : (.*)$", cls.__doc__ or "", flags=re.MULTILINE):
        getattr(cls, name).__doc__ = doc
    return cls


def _brief(cls: Type[Record]) -> Type[Record]:
    """Set a ``repr`` of one line: shapes in place of numbers."""

    def shown(value: Any) -> str:
        return repr(list(value.shape if isinstance(value, np.ndarray) else value))

    def short(self: Any) -> str:
        return f"<{cls.__name__}: {', '.join(f'{name} {shown(value)}' for name, value in zip(self._fields, self))}>"

    setattr(cls, "__repr__", short)
    return cls


@_told
class Pose(NamedTuple):
    """Position and orientation of a receiver.

    position : Metres, world frame.
    orientation : Unit quaternion x, y, z, w (the order of the data sets) from receiver axes to world axes.
    """

    position: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: Tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)


@dataclass
class Receiver:
    """Receiver of a data set.

    name : name in tables
    position : metres, world frame
    orientation : unit quaternion x, y, z, w from receiver axes to world axes; boresight is z
    antennas : antenna positions [A, 3], metres, receiver frame; default: one at the origin
    carrier_hz : carrier of its links, Hz; None if it is not stated
    """

    name: str = "receiver"
    position: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: Tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    antennas: List[Tuple[float, float, float]] = field(default_factory=lambda: [(0.0, 0.0, 0.0)])
    carrier_hz: Optional[float] = None

    def __post_init__(self) -> None:
        self.antennas = [tuple(map(float, place)) for place in self.antennas]  # type: ignore[misc]
        if any(len(place) != 3 for place in self.antennas):
            raise InputError(f"antennas is {self.antennas}, expected positions [A, 3] in metres")


@_brief
@_told
class Partition(NamedTuple):
    """Link indices of a split, sorted and disjoint.

    train : indices of training links
    validation : indices of validation links; may be empty
    test : indices of test links
    """

    train: Array
    validation: Array
    test: Array


@_told
class Sample(NamedTuple):
    """Link of a data set with its observation.

    tx : Transmitter position [3], metres.
    observation : Spectrum [H, W], power in dBm, or channel [A, F].
    receiver : Index of the receiver.
    id : Id of the transmitter position in the data set.
    """

    tx: Array
    observation: Any
    receiver: int
    id: int


@_told
class ReceiverSample(NamedTuple):
    """Link of a data set whose receiver moves, with its observation.

    rx_pose : Pose of the receiver [7]: x, y, z in metres, quaternion qx, qy, qz, qw.
    observation : Spectrum [H, W], power in dBm, or channel [A, F].
    receiver : Index of the receiver.
    id : Id of the pose in the data set.
    """

    rx_pose: Array
    observation: Any
    receiver: int
    id: int


def as_indices(links: Any, count: int) -> Array:
    """Indices of a slice, a mask or a list of links; negative indices count from the end."""
    if isinstance(links, slice):
        return np.arange(count)[links]
    found = np.asarray(links)
    if found.dtype == bool and found.shape == (count,):
        return np.flatnonzero(found)
    if found.ndim != 1 or (found.size and found.dtype.kind not in "iu"):
        raise InputError(f"links: give indices, a slice, or a mask of {count} values")
    found = found.astype(np.int64)
    return np.where(found < 0, found + count, found)


@_brief
class Gaussians(NamedTuple):
    """Gaussians in space, with the field names of gsplat.

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


@_brief
@_told
class Splats(NamedTuple):
    """Gaussians projected to the image plane.

    means2d : [N, 2]: column and row, px.
    conics : [N, 3]: A, B, C of A dx² + 2 B dx dy + C dy², px⁻².
    depths : [N], metres.
    radii : [N], px; 0 outside the image.
    opacities : [N].
    """

    means2d: Array
    conics: Array
    depths: Array
    radii: Array
    opacities: Array


class Cloud:
    """Gaussians in training: unconstrained columns of N rows, by name in ``columns``.

    ``means`` [N, 3] (metres), ``log_scales`` [N, 3], ``quats`` [N, 4] (w, x, y, z), ``opacity_logits`` [N],
    ``signals`` [N, 2] (real and imaginary part), and the columns of strategies.
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


@_brief
@_told
class Stats(NamedTuple):
    """Statistics of each Gaussian since the last densification, [N] each.

    visible : Number of rendered images in which it was visible.
    gradient : Sum over these of the norm of the image-plane position gradient.
    radius : Largest radius, px.
    weight : Sum of its blending weights.
    requested : Statistics requested by ``needs``, computed at this prune step; empty at other steps.
    """

    visible: Array
    gradient: Array
    radius: Array
    weight: Array
    requested: Dict[str, Array]


@_told
class StepContext(NamedTuple):
    """Training step at which a strategy is called.

    step : Training step, from 1.
    phase : "densify", "prune" or "finetune".
    seed : Random seed of the pipeline.
    round : Number of the prune step, from 1; 0 at other steps.
    rounds : Total number of prune steps.
    target : `training.target_count`, for the pruner that must reach it; None for others.
    """

    step: int
    phase: str
    seed: int
    round: int
    rounds: int
    target: Optional[int]


@_brief
@_told
class Room(NamedTuple):
    """Input of an initialiser, metres in the world frame.

    points : Surface points [P, 3]; P is 0 without a point cloud.
    bounds : [2, 3]: smallest and largest corner of the scene.
    receivers : [R, 3].
    """

    points: Array
    bounds: Array
    receivers: Array


@_brief
@_told
class Links(NamedTuple):
    """Links without observations.

    tx : [L, 3], metres.
    ids : [L]: transmitter ids in the data set.
    receiver : [L]: receiver index.
    """

    tx: Array
    ids: Array
    receiver: Array


@dataclass
class Column:
    """Column of the Gaussians for a strategy.

    name : name in ``cloud`` and derivatives
    width : number of values per Gaussian
    init : initial value
    learning_rate : learning rate for the derivatives of ``gate`` and ``penalty``; None for a column that only ``update``
        changes
    adam : whether to use Adam; otherwise plain gradient descent
    """

    name: str
    width: int = 1
    init: float = 0.0
    learning_rate: Optional[float] = None
    adam: bool = True
