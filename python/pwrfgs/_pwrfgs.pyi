"""The compiled half, written in Rust.

Arrays are of single precision, as in every release; a build where ``real_bytes`` is 8 has double precision instead.
"""

import os
from pathlib import Path
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    Literal,
    Optional,
    Protocol,
    Sequence,
    SupportsIndex,
    Tuple,
    Type,
    Union,
    final,
    overload,
)

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import TypeAlias

from ._results import Finding, Interval, Located, RadioMap
from ._strategies import Baseline, Deformation, Metric, Split
from ._types import Cloud, Gaussians, Partition, Receiver, Sample, Splats, Stats
from ._values import Value

_Path: TypeAlias = Union[str, os.PathLike[str]]
_Event: TypeAlias = Dict[str, Any]
_Kind: TypeAlias = Literal["spectrum", "power", "channel"]
_Degrees: TypeAlias = Tuple[NDArray[np.float64], NDArray[np.float64]]
# A plugin, its class, its name or its RON text.
_Plugin: TypeAlias = Union[Value, Type[Value], str]
# Position and orientation x, y, z, w: `Pose`, or two sequences.
_Pose: TypeAlias = Tuple[Sequence[float], Sequence[float]]
class _Frame(Protocol):
    to_csv: Any

# Path of a table, or a `pandas.DataFrame`.
_Table: TypeAlias = Union[_Path, _Frame]
# Name of a column.
_Column: TypeAlias = Union[str, int]
# Metres as x0, x1, y0, y1.
_Box: TypeAlias = Union[str, Sequence[float]]
# Name, type, doc and default as JSON text per setting of a task; no default of a required one.
_Settings: TypeAlias = List[Tuple[str, str, str, Optional[str]]]
# Real numbers of spectra and powers, complex ones of channels.
_Observed: TypeAlias = NDArray[Any]

__version__: str
real_bytes: int

@final
class Dataset:
    @staticmethod
    def load(source: Union[_Path, Value, Type[Value]]) -> Dataset: ...
    @staticmethod
    def from_arrays(
        tx: Optional[ArrayLike] = None,
        spectra: Optional[ArrayLike] = None,
        rssi: Optional[ArrayLike] = None,
        csi: Optional[ArrayLike] = None,
        *,
        rx_pose: Optional[ArrayLike] = None,
        transmitter: Optional[Sequence[float]] = None,
        receivers: Optional[Union[Receiver, Iterable[Union[Receiver, ArrayLike]]]] = None,
        carriers_hz: Optional[ArrayLike] = None,
        frequencies_hz: Optional[ArrayLike] = None,
        points: Optional[ArrayLike] = None,
        elevation_deg: Optional[Sequence[float]] = None,
        title: str = "arrays",
        simulated: bool = False,
    ) -> Dataset: ...
    @staticmethod
    def from_table(
        table: Union[_Table, Sequence[_Table]],
        *,
        x: Optional[_Column] = None,
        y: Optional[_Column] = None,
        z: Optional[_Column] = None,
        lat: Optional[_Column] = None,
        lon: Optional[_Column] = None,
        floor: Optional[_Column] = None,
        receiver: Optional[_Column] = None,
        power: Optional[_Column] = None,
        time: Optional[_Column] = None,
        tx_id: Optional[_Column] = None,
        columns: Union[None, _Column, Sequence[_Column]] = None,
        tx: Optional[_Table] = None,
        places: Optional[_Table] = None,
        receivers: Optional[_Table] = None,
        test: Union[None, _Table, Sequence[_Table]] = None,
        missing: Union[None, float, Sequence[float]] = None,
        unit: str = "dBm",
        lat_lon: bool = False,
        height: Optional[float] = None,
        floor_height: Optional[float] = None,
        title: str = "table",
        simulated: bool = False,
        accept: Union[str, Sequence[str]] = (),
    ) -> Dataset: ...
    def save(self, path: _Path) -> None: ...
    def observations(self, links: ArrayLike) -> _Observed: ...
    def split(self, how: Optional[Union[_Plugin, Split]] = None, *, seed: int = 0, **settings: Any) -> Partition: ...
    @property
    def title(self) -> str: ...
    @property
    def kind(self) -> _Kind: ...
    @property
    def simulated(self) -> bool: ...
    @property
    def tx(self) -> NDArray[np.float64]: ...
    @property
    def positions(self) -> NDArray[np.float64]: ...
    @property
    def rx_pose(self) -> Optional[NDArray[np.float64]]: ...
    @property
    def transmitter(self) -> Optional[NDArray[np.float64]]: ...
    @property
    def ids(self) -> NDArray[np.uint32]: ...
    @property
    def receiver(self) -> NDArray[np.int64]: ...
    @property
    def receivers(self) -> List[Receiver]: ...
    @property
    def spectra(self) -> Optional[NDArray[np.float32]]: ...
    @property
    def rssi(self) -> Optional[NDArray[np.float32]]: ...
    @property
    def csi(self) -> Optional[NDArray[np.complex64]]: ...
    @property
    def frequencies_hz(self) -> Optional[NDArray[np.float64]]: ...
    @property
    def features(self) -> Optional[NDArray[np.float32]]: ...
    @property
    def points(self) -> NDArray[np.float64]: ...
    @property
    def angles_deg(self) -> Optional[_Degrees]: ...
    @property
    def _source(self) -> Optional[str]: ...
    @property
    def _digest(self) -> str: ...
    def _store(self, path: _Path) -> str: ...
    def __len__(self) -> int: ...
    @overload
    def __getitem__(self, index: Union[int, np.integer[Any]], /) -> Union[Sample, Any]: ...
    @overload
    def __getitem__(self, index: Union[slice, Sequence[int], NDArray[Any]], /) -> Dataset: ...
    def __iter__(self) -> Iterator[Union[Sample, Any]]: ...
    def subset(self, links: Union[slice, ArrayLike]) -> Dataset: ...
    def findings(self) -> List[Finding]: ...
    @staticmethod
    def _restore(state: Dict[str, Any]) -> Dataset: ...
    def __reduce__(self) -> Tuple[Any, ...]: ...
    def _repr_html_(self) -> str: ...

@final
class Model:
    @staticmethod
    def load(*paths: _Path) -> Model: ...
    @staticmethod
    def from_arrays(
        means: ArrayLike,
        quats: ArrayLike,
        scales: ArrayLike,
        opacities: ArrayLike,
        signals: ArrayLike,
        pose: Union[_Pose, Receiver],
        height: int = 90,
        width: int = 360,
        *,
        projector: Optional[_Plugin] = None,
        rasterizer: Optional[_Plugin] = None,
        readout: Optional[Union[Value, str]] = None,
        deformation: Optional[Union[_Plugin, Deformation]] = None,
        weights: Optional[Mapping[str, ArrayLike]] = None,
        elevation_deg: Sequence[float] = (0.0, 90.0),
        tx: Optional[ArrayLike] = None,
    ) -> Model: ...
    @staticmethod
    def _from_bytes(bytes: bytes, is_compressed: bool = False) -> Model: ...
    def __reduce__(self) -> Tuple[Any, ...]: ...
    def _repr_html_(self) -> str: ...
    # `Any` in what these two give: one power of one receiver is a float, and with `vjp` there are two arrays.
    @overload
    def predict(
        self,
        tx: Optional[ArrayLike] = None,
        receiver: Optional[Union[str, SupportsIndex]] = None,
        *,
        rx_pose: Optional[ArrayLike] = None,
        features: Optional[ArrayLike] = None,
        vjp: Optional[ArrayLike] = None,
        interval: None = None,
        batch_size: None = None,
    ) -> Union[_Observed, Any]: ...
    @overload
    def predict(
        self,
        tx: Optional[ArrayLike] = None,
        receiver: Optional[Union[str, SupportsIndex]] = None,
        *,
        rx_pose: Optional[ArrayLike] = None,
        features: Optional[ArrayLike] = None,
        vjp: None = None,
        interval: float,
        batch_size: None = None,
    ) -> Interval: ...
    @overload
    def predict(
        self,
        tx: Optional[ArrayLike] = None,
        receiver: Optional[Union[str, SupportsIndex]] = None,
        *,
        rx_pose: Optional[ArrayLike] = None,
        features: Optional[ArrayLike] = None,
        vjp: None = None,
        interval: Optional[float] = None,
        batch_size: int,
    ) -> Iterator[Any]: ...
    def spread(
        self,
        tx: Optional[ArrayLike] = None,
        receiver: Optional[Union[str, SupportsIndex]] = None,
        *,
        rx_pose: Optional[ArrayLike] = None,
        features: Optional[ArrayLike] = None,
    ) -> Union[_Observed, Any]: ...
    def map(
        self,
        *,
        plane: str,
        step: Optional[float] = None,
        bounds: Optional[_Box] = None,
        receiver: Optional[Union[str, Sequence[str]]] = None,
        of: Optional[Union[str, Sequence[str]]] = None,
    ) -> RadioMap: ...
    def locate(
        self,
        observations: Optional[ArrayLike] = None,
        *,
        set: Optional[Mapping[str, Any]] = None,
        accept: Sequence[str] = (),
        prior: Optional[_Box] = None,
        no_kriging: bool = False,
    ) -> Located: ...
    def update(self, data: Dataset, *, accept: Sequence[str] = ()) -> Model: ...
    def compress(self, bits: int = 8) -> Model: ...
    def view(self, beside: Any = None) -> View: ...
    def gaussians(self, tx: Optional[ArrayLike] = None, member: int = 0) -> Gaussians: ...
    def save(self, path: _Path, *, half: bool = False) -> None: ...
    def to_ply(self, path: _Path, tx: Optional[ArrayLike] = None) -> None: ...
    @property
    def kind(self) -> _Kind: ...
    @property
    def moving(self) -> str: ...
    @property
    def n(self) -> int: ...
    @property
    def bytes(self) -> int: ...
    @property
    def training_positions(self) -> Optional[NDArray[np.float64]]: ...
    @property
    def members(self) -> List[str]: ...
    @property
    def receivers(self) -> List[str]: ...
    @property
    def frequencies_hz(self) -> NDArray[np.float64]: ...
    @property
    def angles_deg(self) -> Optional[_Degrees]: ...

@final
class View:
    def close(self) -> None: ...
    def __enter__(self) -> View: ...
    def __exit__(self, *exception: Any) -> None: ...
    @property
    def address(self) -> str: ...
    @property
    def closed(self) -> bool: ...

@final
class Pipeline:
    @staticmethod
    def parse(text: str, path: _Path, folder: _Path) -> Pipeline: ...
    def text(self) -> str: ...
    def set(self, values: Sequence[Tuple[str, str]]) -> None: ...
    def set_arguments(self, arguments: Sequence[str]) -> None: ...
    def save(self, path: str) -> None: ...
    def copied(self) -> Pipeline: ...
    def data(self) -> Dataset: ...
    @property
    def folder(self) -> Path: ...

@final
class Trainer:
    def __new__(
        cls,
        pipeline: Pipeline,
        dataset: Dataset,
        train: Optional[ArrayLike] = None,
        loss: Optional[Callable[[Any, Any], Any]] = None,
        checkpoint: Optional[_Path] = None,
    ) -> Trainer: ...
    def set_cloud(self, columns: Dict[str, NDArray[Any]], is_world: bool) -> None: ...
    def step(self) -> _Event: ...
    def prune(self, keep: ArrayLike) -> int: ...
    def model(self) -> Model: ...
    def save_checkpoint(self, path: _Path) -> None: ...
    @property
    def done(self) -> int: ...
    @property
    def finished(self) -> bool: ...
    @property
    def cloud(self) -> Cloud: ...
    @property
    def stats(self) -> Stats: ...

@final
class Drawing:
    def backward(self, d_image: ArrayLike) -> List[NDArray[np.float32]]: ...
    @property
    def image(self) -> NDArray[np.float32]: ...
    @property
    def transmittance(self) -> Optional[NDArray[np.float32]]: ...

def model_of(
    cloud: Dict[str, NDArray[Any]],
    method: str,
    weights: Optional[Dict[str, NDArray[Any]]],
    receiver: Tuple[str, Sequence[float], Sequence[float]],
    size: Tuple[int, int],
    elevation_deg: Sequence[float],
    tx: Optional[NDArray[Any]],
) -> Model: ...
def project(
    means: ArrayLike,
    quats: ArrayLike,
    scales: ArrayLike,
    opacities: ArrayLike,
    pose: _Pose,
    height: int,
    width: int,
    projector: _Plugin,
    elevation_deg: Sequence[float],
) -> Splats: ...
def draw(
    means: ArrayLike,
    quats: ArrayLike,
    scales: ArrayLike,
    opacities: ArrayLike,
    signals: ArrayLike,
    pose: _Pose,
    height: int,
    width: int,
    projector: _Plugin,
    rasterizer: _Plugin,
    elevation_deg: Sequence[float],
) -> Drawing: ...
def pipeline_text(path: _Path) -> str: ...
def program(arguments: Sequence[str]) -> int: ...
def run(
    pipeline: Pipeline,
    out: _Path,
    send_event: Callable[[_Event], Any],
    keep_checkpoint: bool,
    threads: Optional[int] = None,
) -> bool: ...
def score(model: Model, pipeline: Pipeline, out: _Path, send_event: Callable[[_Event], Any]) -> None: ...
def facts(folder: _Path) -> Tuple[str, Optional[Tuple[Dict[str, Dict[str, Any]], str]]]: ...
def measure(
    metric: Union[_Plugin, Metric],
    kind: str,
    predictions: ArrayLike,
    truths: ArrayLike,
    elevation_deg: Sequence[float],
) -> List[Tuple[str, str, Union[float, NDArray[np.float64]]]]: ...
def chamfer(first: ArrayLike, second: ArrayLike) -> float: ...
def predict_baseline(
    baseline: Union[_Plugin, Baseline], dataset: Dataset, train: ArrayLike, tx: ArrayLike, receiver: int
) -> _Observed: ...
def repeatability(dataset: Dataset, metrics: Sequence[str]) -> Dict[str, Dict[str, Any]]: ...
def simulate(
    scene: _Path,
    out: _Path,
    layout: str,
    samples: int,
    seed: int,
    points: int,
    noise_db: Optional[float],
    snr_db: Optional[float],
    paths: bool,
    tx: Union[_Path, ArrayLike, None],
    rx_pose: Union[_Path, ArrayLike, None],
    send_event: Callable[[int, int], Any],
) -> None: ...
def sweep(
    experiment: _Path,
    arguments: Sequence[str],
    out: Optional[_Path],
    jobs: int,
    send_event: Callable[[Dict[str, Any]], Any],
    keep_checkpoint: bool,
    failures: Optional[Sequence[Tuple[int, str]]] = None,
) -> List[Tuple[Path, Optional[BaseException]]]: ...
def prepare_sweep(
    experiment: _Path, arguments: Sequence[str], out: Optional[_Path]
) -> Tuple[List[Tuple[int, Path, str]], int]: ...
def compare(
    data: Union[Dataset, _Path],
    source: Optional[str],
    text: str,
    changes: Sequence[str],
    accept: Sequence[str],
    out: Optional[_Path],
    dry_run: bool,
    keep_checkpoint: bool,
) -> Dict[str, Any]: ...
def view(path: Optional[_Path], model: Optional[Model], beside: Optional[str]) -> View: ...
def check(pipeline: Pipeline) -> Dict[str, Any]: ...
def devices() -> List[str]: ...
def use_device(device: Union[str, int]) -> str: ...
def export_scene(scene: _Path, out: _Path) -> int: ...
def task_settings() -> Dict[str, _Settings]: ...
def radio_map(model: Model, text: str) -> Dict[str, Any]: ...
def locate(
    model: Model, observations: Optional[ArrayLike], set: Sequence[str], accept: Sequence[str], text: str
) -> Dict[str, Any]: ...
def update(model: Model, data: Dataset, accept: Sequence[str]) -> Tuple[Model, int, str]: ...
def calibrate(
    model: Model, pipeline: Pipeline, data: Dataset, train: ArrayLike, validation: ArrayLike
) -> Model: ...
def compress(model: Model, bits: int) -> Tuple[Model, List[str]]: ...
def findings(data: Dataset) -> List[Tuple[str, str, str]]: ...
def suggest_pipeline(
    data: Dataset, source: str, root: Optional[str], name: str, effort: str, accept: Sequence[str]
) -> str: ...
def plan(
    source: Union[Dataset, Model, None],
    candidates: Optional[ArrayLike],
    floor: Optional[Tuple[_Path, float, float]],
    text: str,
) -> Dict[str, Any]: ...
def place(source: Union[Dataset, _Path], text: str) -> Dict[str, Any]: ...
def default_pipeline(data: Dataset, source: str) -> str: ...
def inspect(data: Dataset, pipeline: Pipeline) -> Dict[str, Any]: ...
def report(
    runs: Sequence[_Path], out: _Path, reference: Optional[str], columns: Sequence[str], variants: Sequence[str]
) -> str: ...
def complete(kind: str, text: str) -> str: ...
def parse_ron(text: str) -> Tuple[Any, ...]: ...
def registry() -> List[Dict[str, Any]]: ...
def types() -> List[Dict[str, Any]]: ...
