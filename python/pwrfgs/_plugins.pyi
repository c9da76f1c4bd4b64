# Written by `python -m pwrfgs._stubs` from what the program says of itself; changes belong there.

import os
from typing import Any, List, Optional, Sequence, Tuple, Union

from typing_extensions import TypeAlias

from ._values import Value

_Path: TypeAlias = Union[str, os.PathLike[str]]

__all__: List[str] = [
    "AlphaBlending", "ArrayResponse", "Arrays", "Chamfer", "ChannelSnr", "Channels", "ControlGs", "DirectionError",
    "Eagles", "Factored", "FastGs", "Fixed", "GaussianCount", "GaussianSpa", "GreedyElimination", "Grid", "Kriging",
    "L1", "Latency", "LearnableMask", "LeaveReceiverOut", "LightGaussian", "LogDistance", "Lp3dgs", "MaskGaussian",
    "MatchingPursuit", "Mcmc", "MeanSpectrum", "Mercator", "MergeByMoments", "MiniSplatting", "Mlp", "ModelSize",
    "NaturalSelection", "NearestNeighbours", "Nerf2", "Nerf2Csi", "Nerf2Rssi", "Nerf2Spectrum", "NoGaussians",
    "Official", "OpacityThreshold", "PointCloud", "PowerError", "Psnr", "Pup3dgs", "RadSplat", "Random", "RandomLinks",
    "RandomReference", "RateRatio", "RayTracing", "Reduced3dgs", "Ridge", "SafeguardGs", "SignalContribution",
    "Simulated", "Site", "Sparse", "SpeedySplat", "Splatting", "Ssim", "Taming3dgs", "Teacher", "TimeBlock", "TopK",
    "Trained", "TrimmingTheFat", "VirtualTransmitters", "Voxel", "Wrfgs", "WrfgsCompat", "Zero",
]

class AlphaBlending(Value):
    """Rasterizer: front-to-back alpha blending in depth order, as in the paper; exact backward.

    Front-to-back alpha blending in order of depth, tile by tile, with an exact backward pass.

    `Exact`: those where its γ is at least 1/255; tiles are bookkeeping that no picture shows. `TileSquares`: those of
    the 16 × 16 tiles that meet the square of three standard deviations, as released; the picture then shows tile edges,
    and azimuth does not come round. It exists to compare with published code.

    *Differentiable* in means, conics, opacities and signals. *Discontinuous* where γ crosses 1/255, where a pixel fills
    up (T < 10⁻⁴) and where two Gaussians swap depth; the 0.99 ceiling of γ passes the gradient, as in 3DGS.

    Parameters
    ----------
    support : Support
        Which pixels a Gaussian can reach.
    """

    support: Any
    def __init__(self, *, support: Any = ...) -> None: ...

class ArrayResponse(Value):
    """Rasterizer: waves that add up on an antenna array, with phase: what the measured spectra are; exact backward.

    The field of all Gaussians on a planar array, and what the array hears from every direction.

    Each splat is a wave from its direction u with the complex signal s of its two channels and the opacity o as
    amplitude. The waves add up at the antennas, h = Σ o·s·a(u) with aₖ(u) = exp(+j2π pₖ·u), pₖ in wavelengths (eq. 1),
    and pixel by pixel the array is steered back: aᴴh/K (eq. 2 before the square). No tiles, no order, nothing hides
    anything: the cost is O(N·K + H·W·K). The measured spectra are such pictures, with K = 16 antennas and to the
    rounding of their 8 bits; sixteen Gaussians in different directions therefore suffice for any of them.

    *Widened*: waves from all over the Gaussian, in equal phase, average to aₖ·exp(-(2π)² pₖᵀ Σᵤ pₖ / 2), with Σᵤ the
    covariance of u (along x and y) to first order; wide Gaussians are heard by the middle of the array only. It stays
    finite at the zenith, where the picture's azimuth does not. The projector's blur (a fraction of a degree) counts as
    width.

    *Spherical*: the phase follows from the way between the Gaussian and each antenna; amplitude and width are those of
    a plane wave. Distances then matter, and are differentiated.

    *Needs* a projector whose pixels are directions (`Mercator`), signals with two channels (`readout: MinMax`,
    `Magnitude` or `Power`) and `calibration: Physical`. *Differentiable* in means, conics, depths, opacities and
    signals. *Discontinuous* where a Gaussian leaves the projector's view. A flat array cannot tell u from its mirror
    image below the horizon. For densification, the gradient that counts is that along the direction, in pixels as
    always; there is no depth order to resolve and rarely a reason to densify.

    Source: eq. (1) and (2) of the paper. Neither the paper nor its ancestors draw like this: they blend.

    Parameters
    ----------
    rows : whole number
        Antennas along y of the receiver.
    columns : whole number
        Antennas along x of the receiver.
    spacing_wavelengths : number
        Distance of neighbours, wavelengths; 0.491 as measured (0.16 m at 920 MHz).
    widened : true or false
        Whether a Gaussian is as wide as its covariance, or a point.
    wavefront : Wavefront
        How phases at the antennas follow.
    """

    rows: int
    columns: int
    spacing_wavelengths: float
    widened: bool
    wavefront: Any
    def __init__(
        self,
        *,
        rows: int = 4,
        columns: int = 4,
        spacing_wavelengths: float = 0.491,
        widened: bool = True,
        wavefront: Any = ...,
    ) -> None: ...

class Arrays(Value):
    """DataSource: spectra and transmitters as arrays of NumPy, of any number.

    Spectra and transmitters as arrays of NumPy. `pwrfgs import` writes such a folder from what you have.

    ```text
    root/gateway_info.yml    gateway1: {position: [x, y, z], orientation: [x, y, z, w]}; metres, unit quaternion
    root/tx.npy              [M, 3], float64 or float32, metres; or tx_pos.csv with columns x, y, z
    root/spectra.npy         [M, H, W]: a row is an elevation, a column an azimuth; uint8 (255 is 1), uint16 (65535 is 1),
                             or float32 and float64 from 0 to 1
    root/train_index.txt     ids, one a line, counted from 1; this file and
    root/test_index.txt      this one come together or not at all
    ```

    Spectra of up to 512 MB are read into memory. Larger ones stay in their file, which must stay as it is while it is
    used, and a picture is read when it is wanted: a hundred thousand need no more memory than a hundred. Floats are
    looked at once, when they are loaded.

    Parameters
    ----------
    root : path
        The folder, relative to the pipeline file.
    points : path or None
        Point cloud of the room (PLY, XYZ or CSV, metres, world frame), relative to the pipeline file.
    elevation : two numbers or None
        Elevations where the top row of the spectra begins and the bottom row ends, degrees; what `gateway_info.yml`
        says where it is left out, else 0 and 90.
    """

    root: _Path
    points: Optional[_Path]
    elevation: Optional[Tuple[float, float]]
    def __init__(
        self,
        *,
        root: _Path = "data/mine",
        points: Optional[_Path] = None,
        elevation: Optional[Tuple[float, float]] = None,
    ) -> None: ...

class Chamfer(Value):
    """Metric: distance between Gaussians and point cloud in m².

    Whether the Gaussians lie on the surfaces of the scene: the sum of the two mean squared distances, in m².

    Key `chamfer`, eq. (16): from each point to its nearest centre, and from each centre to its nearest point. The paper
    finds 0.22 started from the point cloud and 7.51 started at random. Pruning alone raises the first term. `n/a` for
    baselines and where the scene has no point cloud.
    """

    def __init__(self) -> None: ...

class ChannelSnr(Value):
    """Metric: signal-to-noise ratio of channels, a snapshot and over all, dB.

    Signal-to-noise ratio of predicted channels, dB: −10 log₁₀(Σ|h′ − h|² / Σ|h|²).

    Keys: `snr_db`, a snapshot (all links of a transmitter together, as NeRF2 sums over antennas and subcarriers; its
    median is what NeRF2 prints), and `snr_all_db`, one ratio over the whole test part, as `NeWRF` has it. A predictor
    of zeros has 0 dB by both; strong snapshots count more in the second.
    """

    def __init__(self) -> None: ...

class Channels(Value):
    """DataSource: channels at one receiver as an array of NumPy, with a table of places.

    Channels (CSI) at one receiver as an array of NumPy, with a table of the transmitter's places.

    ```text
    root/file         [M, A, F], complex64 or complex128: M places of the transmitter, A antennas of the receiver, F
                      subcarriers
    root/positions    header naming x, y, z among others; row k is place k of the array; metres
    ```

    The id of a transmitter is its row, counted from 0 as NumPy does. Numbers are taken as they are. Subcarriers are
    evenly spaced about `carrier_hz`. By reciprocity it is all the same which end sends: where the fixed node is the
    transmitter, call it the receiver.

    The `frequencies_hz` of `root/receiver.yml` count if neither carrier nor spacing is given, and need not be evenly
    spaced. Carrier, spacing and receiver that are left out are read from `root/receiver.yml`, which `pwrfgs simulate
    --layout channels` writes; and `train_index.txt` with `test_index.txt`, where they are there, hold ids for `split:
    Official()`.

    Parameters
    ----------
    root : path
        The folder, relative to the pipeline file.
    file : path
        The array, relative to `root`.
    positions : path
        The table of places, relative to `root`.
    points : path or None
        Point cloud of the room (PLY, XYZ or CSV, metres, world frame), relative to the pipeline file.
    carrier_hz : number or None
        Frequency in the middle of the subcarriers, Hz.
    spacing_hz : number or None
        From one subcarrier to the next, Hz; nothing depends on it where there is one subcarrier.
    receiver : ReceiverPlace or None
        Where the receiver is.
    simulated : true or false
        Whether the numbers come from a simulation whose files do not say so: nothing made of them is then called
        measured.
    """

    root: _Path
    file: _Path
    positions: _Path
    points: Optional[_Path]
    carrier_hz: Optional[float]
    spacing_hz: Optional[float]
    receiver: Optional[Any]
    simulated: bool
    def __init__(
        self,
        *,
        root: _Path = "data/channels",
        file: _Path = "channel.npy",
        positions: _Path = "tx_pos.csv",
        points: Optional[_Path] = None,
        carrier_hz: Optional[float] = None,
        spacing_hz: Optional[float] = None,
        receiver: Optional[Any] = None,
        simulated: bool = False,
    ) -> None: ...

class ControlGs(Value):
    """Pruner: a pull on all opacities, until a prune step takes next to nothing (ControlGS).

    Pulls all opacities down a little and drops what has faded, until a prune step takes next to nothing.

    The loss gains lambda · Σ o; what is below `epsilon` goes, at each prune step, as long as the one before took at
    least the share `settle` of all (ControlGS, Zhang et al., 2025: 3e-7, and 2,000 of some million a round). Then the
    pull and the pruning stop: the number of Gaussians follows from lambda alone and not from how long one waits. That
    it has stopped is a number which the pipeline remembers, checkpoints included.

    Parameters
    ----------
    lambda_ : number
        Weight λ of the sum of opacities, 0 or more.
    epsilon : number
        Opacity ε below which a Gaussian goes, from 0 to below 1.
    settle : number
        A prune step that takes less than this share of all is the last, from 0 to 1.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `epsilon`.
    """

    lambda_: float
    epsilon: float
    settle: float
    target: Optional[int]
    def __init__(
        self, *, lambda_: float = 1e-05, epsilon: float = 0.005, settle: float = 0.01, target: Optional[int] = None
    ) -> None: ...

class DirectionError(Value):
    """Metric: great-circle degrees between strongest directions.

    Great-circle angle in degrees between the strongest directions of prediction and measurement.

    Key `direction_error`. A distance in pixels would misjudge both the seam in azimuth and the zenith, where many
    columns are one direction; this does not. The strongest pixel is taken before clamping, the first in row-major order
    where several are equal. Two equally strong paths make it jump, so look at the median. `n/a` with the released
    projection, whose pixels mean no angle.
    """

    def __init__(self) -> None: ...

class Eagles(Value):
    """Pruner: least influence on the pictures goes, a quantile at a time (EAGLES).

    Drops what has the least influence on the pictures, a small part at every prune step.

    Influence is Σ w, the blending weights γ·T over all pixels and training transmitters; what lies at or below a
    quantile of it goes (EAGLES, Girish et al., ECCV 2024, section 3.3: 5 % every 3,000 steps). Gaussians that nobody
    sees share the value 0 and go together. Slow and safe: many prune steps with training between them.

    Parameters
    ----------
    quantile : number
        What lies at or below this quantile goes, from 0 to 1.
    transmitters : whole number
        Training transmitters that a pass looks at; 0: all.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `quantile`.
    """

    quantile: float
    transmitters: int
    target: Optional[int]
    def __init__(self, *, quantile: float = 0.05, transmitters: int = 0, target: Optional[int] = None) -> None: ...

class Factored(Value):
    """Deformation: signals as products of features of the transmitter and of the Gaussian: one small network, whatever
    N is.

    A network that runs once a transmitter and not once a Gaussian: `Δsᵢ(p) = G(μᵢ)·T(p) + G₀(μᵢ)`.

    A stack of ReLU layers makes `width` features T of the transmitter's encoded position γ(p); one linear layer on the
    waves φ(μ) of the encoded centre makes each Gaussian's factors G, two rows (real and imaginary part) of `width` + 1
    numbers. A signal is then a scalar product. Waves short against the distances of Gaussians make their factors
    independent, long ones let neighbours agree. The cost of a prediction is that of one pass through the stack,
    whatever N is, and sixteen Gaussians on a 4 x 4 array can follow all that the network knows of the transmitter: the
    shape for `ArrayResponse`. Geometry does not depend on the transmitter. Known elsewhere as branch and trunk
    (`DeepONet`).

    Centres are differentiated through the network.

    Parameters
    ----------
    depth : whole number
        ReLU layers of the transmitter's stack, 1 or more.
    width : whole number
        Numbers a layer, and features.
    tx_encoding : Encoding
        How the transmitter's position is encoded.
    position_encoding : Encoding
        How the centre is encoded; without the coordinates, which would drown the waves.
    """

    depth: int
    width: int
    tx_encoding: Any
    position_encoding: Any
    def __init__(
        self, *, depth: int = 4, width: int = 256, tx_encoding: Any = ..., position_encoding: Any = ...
    ) -> None: ...

class FastGs(Value):
    """Pruner: what covers pixels of high error in many pictures goes (FastGS).

    Drops what stands, again and again, where the pictures are wrong.

    For each training transmitter the Gaussian's pixels of high error are counted and multiplied by the picture's mean
    absolute error; the sums, stretched from 0 to 1, are its blame, and what has more than `blame` goes (FastGS, Ren et
    al., 2025, view-consistent pruning). An error of a pixel is high above `high` of the way from the picture's smallest
    to its largest. It takes the large, misplaced ones, and is no measure of use: as a way down to a small number it is
    the wrong tool.

    Parameters
    ----------
    blame : number
        Blame above which a Gaussian goes, from 0 to 1.
    high : number
        Share of the way from a picture's smallest error to its largest from which an error is high, from 0 to 1.
    transmitters : whole number
        Training transmitters that a pass looks at; 0: all.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `blame`.
    """

    blame: float
    high: float
    transmitters: int
    target: Optional[int]
    def __init__(
        self, *, blame: float = 0.9, high: float = 0.1, transmitters: int = 64, target: Optional[int] = None
    ) -> None: ...

class Fixed(Value):
    """Deformation: no deformation: the same Gaussians for every transmitter.

    No deformation: every transmitter sees the same Gaussians and the same signals. No weights, no settings.

    Of use to fit a single spectrum, to test everything else, and as the floor below which no network may fall.
    """

    def __init__(self) -> None: ...

class GaussianCount(Value):
    """Metric: number of Gaussians.

    Number of Gaussians of the model: the horizontal axis of the paper's trade-off (fig. 2b).

    Key `gaussians`. `n/a` for baselines, and for a method without Gaussians.
    """

    def __init__(self) -> None: ...

class GaussianSpa(Value):
    """Pruner: opacities are drawn to a sparse vector, then cut to an exact number (GaussianSpa).

    Opacities are drawn, a little at every step, towards a vector in which only the best few are not 0.

    The alternating direction method of multipliers on the opacities o: every `every` steps of the pruning phase z
    becomes o + u with all but the largest k set to 0, and u gains o − z; in between the loss has rho/2 · Σ (o − z +
    u)², which the optimiser works off. What shall go fades while training makes up for it, so that the cut at the last
    prune step, to the k largest o + u, changes little (GaussianSpa, Zhang et al., CVPR 2025, algorithm 1: rho 5e-4, 80
    % pruned after a first half). Nothing goes before the last prune step.

    Parameters
    ----------
    rho : number
        Weight ρ of the distance, above 0.
    every : whole number
        Steps between two projections, 1 or more.
    share : number
        The share that goes, where no target is set, from 0 to below 1.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning.
    """

    rho: float
    every: int
    share: float
    target: Optional[int]
    def __init__(
        self, *, rho: float = 0.0005, every: int = 50, share: float = 0.8, target: Optional[int] = None
    ) -> None: ...

class GreedyElimination(Value):
    """Pruner: one at a time by the true loss: the reference for small numbers.

    Takes one Gaussian at a time: always that one without which the training loss is smallest.

    The reference from above for small numbers, for any method and any observation: nothing is estimated, the loss of
    `transmitters` is worked out without each Gaussian in turn, N(N+1)/2 times in all. Above `most` Gaussians that is
    too much, and it goes by what the pictures are sensitive to, as `SpeedySplat` does (by opacity, where nothing is
    blended), until `most` are left. It is greedy and looks no step ahead, so that it can be beaten by training with
    fewer from the start.

    Parameters
    ----------
    most : whole number
        Gaussians from which on the true loss decides, from 2 to 1,000.
    shares : list of number
        The share that goes at each prune step, from the first on; after the last of them nothing goes.
    transmitters : whole number
        Training transmitters whose loss it is, from 1 to 1,000: they are held in memory.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `shares`.
    """

    most: int
    shares: Sequence[float]
    transmitters: int
    target: Optional[int]
    def __init__(
        self, *, most: int = 100, shares: Sequence[float] = [0.5], transmitters: int = 64, target: Optional[int] = None
    ) -> None: ...

class Grid(Value):
    """Initializer: evenly spread directions at one distance from the receiver.

    A regular grid of directions on a sphere about the receiver.

    Rings of equal elevation, each with as many azimuths as its share of the solid angle, so that directions are nearly
    uniform. Every Gaussian covers about the same part of the picture, and none is hidden or wasted: the best start for
    few Gaussians without a point cloud. Not of the paper. Where pixels are angles of the true pose, the grid is the
    hemisphere in front of the receiver, or the sphere where the picture shows what is behind; with the released
    projection it is the whole sphere about that projection's real centre, −R·r with R and r the receiver's orientation
    and position.

    Parameters
    ----------
    count : whole number
        Number of Gaussians.
    distance_m : number
        Distance from the receiver, metres.
    overlap : number
        Scale (one standard deviation) over the spacing of the grid: 1 leaves no gap, 0.5 little overlap.
    opacity : number
        Opacity of every Gaussian, above 0 and below 1.
    signal_scale : number
        Width of the interval about 0 in which each channel of a signal is drawn uniformly. The released colours have
        1/0.28209479 = 3.5449.
    """

    count: int
    distance_m: float
    overlap: float
    opacity: float
    signal_scale: float
    def __init__(
        self,
        *,
        count: int = 500,
        distance_m: float = 5.0,
        overlap: float = 1.0,
        opacity: float = 0.1,
        signal_scale: float = 1.0,
    ) -> None: ...

class Kriging(Value):
    """Baseline: a Gaussian process over position, of the nearest spectra; length scales and noise by likelihood.

    Ordinary kriging: the best linear unbiased prediction of a Gaussian process over the transmitter's position, as maps
    of radio coverage are made.

    The spectra are taken as one Gaussian process whose correlation between two places is exponential (Matern 1/2),
    Matern 3/2 or squared exponential, with a length scale for each axis, plus noise of each spectrum by itself. All
    pixels, and so all principal components of the spectra, share that correlation. Then the prediction is a weighted
    sum of spectra (weights add up to 1 and may be negative), no component has to be cut off, and nothing is kept but
    positions.

    Correlation, length scales and noise are those under which the spectra of at most 160 validation samples are most
    likely, given the 24 training spectra nearest to each (the strength follows in closed form). Where there is no
    validation part, every tenth training sample is left out for this. The prediction then uses the nearest of all, in
    units of the length scales. A note under the tables tells what was found.

    Each receiver has a process of its own; one without training links is predicted from those of all. Of received
    powers it is the residual of a law of distance, RSSI = T - 10 gamma log10(d) by least squares, that is taken for the
    process; the law is added again, and is the prediction where no measurement is near. Its correlation is Matern 3/2
    with one length scale for all axes, and those numbers are taken under which at most 320 training powers are most
    likely, each given the 16 nearest before it in random order. Data whose links have features in the place of
    positions are refused.

    Parameters
    ----------
    neighbours : whole number
        Spectra that a prediction is made of, 2 to 512: its time grows with the third power.
    """

    neighbours: int
    def __init__(self, *, neighbours: int = 48) -> None: ...

class L1(Value):
    """Metric: mean absolute error of a pixel.

    Mean absolute difference of predicted and measured pixels; the L₁ of eq. (9) with the prediction clamped to [0, 1].

    Key `l1`. Use it beside SSIM: it sees a wrong overall level that SSIM forgives.
    """

    def __init__(self) -> None: ...

class Latency(Value):
    """Metric: median milliseconds of a prediction, stage by stage.

    Median milliseconds of one prediction: network, projection, sorting, blending, and all of it.

    Keys `latency_prepare_ms`, `latency_network_ms`, `latency_projection_ms`, `latency_sort_ms`, `latency_blending_ms`,
    `latency_total_ms`. Each median is taken by itself, so the stages need not add up to the total. Times are those of
    this machine under its present load and differ from run to run. A baseline has the total alone, without the time it
    takes to learn; it is timed for two seconds at most, but once at least.

    What no transmitter changes is prepared once and is in no other stage: the network's share of it and, if geometry
    does not depend on the transmitter, projection and sorting. `latency_prepare_ms` is the time of that one
    preparation. Table I of the paper counts all of it in every prediction: add it to the total to compare.

    Parameters
    ----------
    repeats : whole number
        Predictions timed, 1 to 10,000.
    warm_up : whole number
        Predictions made before, not timed: they fill caches and start threads. At most 10,000.
    """

    repeats: int
    warm_up: int
    def __init__(self, *, repeats: int = 20, warm_up: int = 3) -> None: ...

class LearnableMask(Value):
    """Pruner: one learned mask a Gaussian, with a penalty on the mean mask (P-WRFGS).

    One learned mask a Gaussian, under pressure from a penalty: the pruning of P-WRFGS.

    While training, opacity and scale are multiplied by M = sg(1[σ(m) ≥ threshold] − σ(m)) + σ(m), eq. (11): forward 0
    or 1, derivative σ′(m). The loss gains lambda · mean σ(m), eqs. (12) and (13). At a prune step what has M = 0 is
    discarded, eq. (10). A mask that crosses the threshold cannot come back: a Gaussian with M = 0 is not drawn, has no
    derivative from the picture, and only the penalty is left to move it. The pressure on one Gaussian is lambda/N ·
    σ(1−σ), and Adam divides it by its running size. Masks of Gaussians that the spectra do not need therefore reach the
    threshold about 1,410 steps after the start at a rate of 0.01, for any lambda above 0 (730 steps at 0.02).

    Use it to let training find how many Gaussians a quality is worth; a larger lambda leaves fewer (the paper: 2,613 at
    0.01, 157 at 0.02, 8 at 0.04). For a number given beforehand say `target`; `LightGaussian` and others come to one
    with less loss. Threshold and initial logit are those of Compact-3DGS, where the paper is silent.

    With tens of thousands of Gaussians lambda/N is small against the noise of the picture's derivative, and Adam
    divides by that noise: the rate of 0.01 then wants the paper's 20,000 steps of one transmitter. What makes it
    affordable: train first and press then, from a trained model (`Trained` as the initializer), with 16 transmitters a
    step at 0.03 for 4,000 steps; or leave Adam's division out, `LearnableMask(adam: false, learning_rate: 5)`, whose
    end is the same within a tenth of N and 0.002 of SSIM. N goes on falling as long as it is pressed, slowly, so the
    length of the pressure belongs to lambda. A rate of 0.1 is faster still, and chance then closes masks, which do not
    come back: fewer are left, and SSIM at equal N is worse. `docs/reproduce.md` has the figures, under "Masks in a
    hurry".

    Parameters
    ----------
    lambda_ : number
        Weight λ of the penalty, 0 or more.
    threshold : number
        A Gaussian stays where σ(m) is at least this; between 0 and 1.
    initial_logit : number
        m at the start; σ(1) is 0.73.
    learning_rate : number
        Rate of m; without Adam some 3 to 10.
    adam : true or false
        Whether Adam moves m; without it m −= rate · N · derivative.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning: at the last prune step those of the largest m stay,
        closed or not. Left out, the penalty decides.
    """

    lambda_: float
    threshold: float
    initial_logit: float
    learning_rate: float
    adam: bool
    target: Optional[int]
    def __init__(
        self,
        *,
        lambda_: float = 0.01,
        threshold: float = 0.01,
        initial_logit: float = 1.0,
        learning_rate: float = 0.01,
        adam: bool = True,
        target: Optional[int] = None,
    ) -> None: ...

class LeaveReceiverOut(Value):
    """Split: what some receivers heard is the test set.

    All links of the receivers named are the test set; the links of the others are learned from.

    Asks what somebody would hear where no receiver stood. Validation is a share of the transmitters that the other
    receivers heard, with all their links there. Receivers at the same place say much of each other: leave them out
    together, such as `g08` and `g09` of the NeRF2 powers.

    A receiver that was never heard has a gain that nobody knows. `calibration` leaves some links of each receiver
    named, drawn at random, in the training part, so that its offset can be learned.

    Parameters
    ----------
    receivers : list of text
        Names of the receivers that are left out.
    calibration : whole number
        Links of each of them that stay in the training part; 0 for none.
    validation : number
        Share of the transmitters held out of the training part, in [0, 1); 0 for none.
    """

    receivers: Sequence[str]
    calibration: int
    validation: float
    def __init__(self, *, receivers: Sequence[str] = [], calibration: int = 0, validation: float = 0.1) -> None: ...

class LightGaussian(Value):
    """Pruner: least weight in the pictures goes, times a power of volume (LightGaussian).

    Drops a share of the Gaussians that show least, weighed a little by their volume.

    The score is Σ w · min(V/V₉₀, 1)^`volume_power`, w = γ·T the blending weights over all pixels and training
    transmitters, V the product of the scales and V₉₀ the volume that nine tenths do not reach (LightGaussian, Fan et
    al., NeurIPS 2024, eq. (4)). It prunes two thirds at once there, then a decaying share, and fine-tunes. What hardly
    shows goes, however opaque it is; what shows a little to every transmitter stays before what one transmitter alone
    needs: for that see `SignalContribution`.

    Parameters
    ----------
    shares : list of number
        The share that goes at each prune step, from the first on; after the last of them nothing goes.
    volume_power : number
        Power of the volume, 0 or more; 0 leaves it out.
    transmitters : whole number
        Training transmitters that a pass looks at; 0: all.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `shares`.
    """

    shares: Sequence[float]
    volume_power: float
    transmitters: int
    target: Optional[int]
    def __init__(
        self,
        *,
        shares: Sequence[float] = [0.66, 0.4, 0.24],
        volume_power: float = 0.1,
        transmitters: int = 0,
        target: Optional[int] = None,
    ) -> None: ...

class LogDistance(Value):
    """Baseline: a law of distance for received powers, by least squares.

    A law of distance by least squares: RSSI = T - 10 gamma log10(d), with d in metres from transmitter to receiver.

    One T and one gamma for all receivers is what NeRF2 calls MRI. With `offset` each receiver has a T of its own, its
    gain, and gamma is shared; with `per_receiver` each has T and gamma of its own. A receiver with fewer than three
    training links has the shared gamma and an offset from the links it has; one without any has the T of all training
    links together. A note under the table names such receivers. It is for received powers alone.

    Parameters
    ----------
    per_receiver : true or false
        Whether T and gamma are fitted for each receiver.
    offset : true or false
        Whether T alone is fitted for each receiver; `per_receiver` does that too.
    """

    per_receiver: bool
    offset: bool
    def __init__(self, *, per_receiver: bool = False, offset: bool = False) -> None: ...

class Lp3dgs(Value):
    """Pruner: a learned Gumbel mask whose odds are an importance score (LP-3DGS).

    A mask is learned whose odds are those of an importance score, so that learning starts from what the pictures say.

    The chance to stay is σ(m + ln(S/S̃)): the importance S of a Gaussian, its largest blending weight in any pixel of
    any transmitter as RadSplat has it, over the median S̃, multiplies the odds of a learned logit m. While training,
    the light that it takes is multiplied by the relaxed throw σ((m + ln(S/S̃) + g)/temperature) with logistic noise g
    (LP-3DGS, Zhang et al., NeurIPS 2024, section 3.2: a Gumbel-sigmoid mask on an importance score, which finds the
    share to prune by itself), and the loss gains lambda times the mean chance. At a prune step what stays has a chance
    of one half or more. S is measured at the first prune step and again at each; before the first it counts as 1.

    Parameters
    ----------
    lambda_ : number
        Weight λ of the penalty, 0 or more.
    temperature : number
        How far throws are from 0 and 1: from 0.2 to 5.
    initial_logit : number
        m at the start.
    learning_rate : number
        Adam's rate for m.
    transmitters : whole number
        Training transmitters that a pass looks at; 0: all.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning. Left out, the penalty decides.
    """

    lambda_: float
    temperature: float
    initial_logit: float
    learning_rate: float
    transmitters: int
    target: Optional[int]
    def __init__(
        self,
        *,
        lambda_: float = 0.01,
        temperature: float = 0.5,
        initial_logit: float = 3.0,
        learning_rate: float = 0.01,
        transmitters: int = 256,
        target: Optional[int] = None,
    ) -> None: ...

class MaskGaussian(Value):
    """Pruner: a coin a Gaussian with a learned probability; who is not there still learns (MaskGaussian).

    A Gaussian is there with a probability that is learned, and one that is not there still learns whether it should be.

    At every step M = 1[m + g > 0] with logistic noise g, so that M = 1 with probability σ(m); its derivative is that of
    the relaxed throw σ(m + g). M multiplies the light that a Gaussian takes and nothing else, `Gate::Presence`: where M
    = 0 the picture is drawn without it, and the derivative still says what it would have changed, so that it can come
    back. The loss gains lambda · (mean M)², whose pressure fades as fewer are there. At a prune step goes what `draws`
    throws never find open (MaskGaussian, Liu et al., CVPR 2025, section 3.2, where the two logits of each Gaussian are
    one here). The fair upgrade of `LearnableMask`, whose closed masks cannot come back; it costs more, as nothing is
    left out of a step.

    In fine-tuning all that are left are there. Under a `target` the largest m stay at the last prune step.

    Parameters
    ----------
    lambda_ : number
        Weight λ of the penalty, 0 or more.
    initial_logit : number
        m at the start; σ(1) is 0.73.
    learning_rate : number
        Adam's rate for m.
    draws : whole number
        Throws at a prune step, 1 or more.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning. Left out, the penalty decides.
    """

    lambda_: float
    initial_logit: float
    learning_rate: float
    draws: int
    target: Optional[int]
    def __init__(
        self,
        *,
        lambda_: float = 0.1,
        initial_logit: float = 1.0,
        learning_rate: float = 0.01,
        draws: int = 10,
        target: Optional[int] = None,
    ) -> None: ...

class MatchingPursuit(Value):
    """Initializer: virtual transmitters found in the training channels by orthogonal matching pursuit.

    Finds the virtual transmitters of the training channels greedily: the one that explains most, all gains anew by
    least squares, all places refined, and the next one, as many as a held-out part of the training links wants.

    For `method: VirtualTransmitters()`, with gains of its `order`. Candidates are the receiver itself, places of a grid
    about the transmitters, coarser the farther they are, and mirror images of what was found. It reads the training
    part alone; the part held out for the count is learned from at the end. Where the scene alone is asked (`pwrfgs
    check`), it puts `most` of them anywhere.

    Parameters
    ----------
    most : whole number
        Virtual transmitters at most, of each search.
    reach : number
        How far beyond the positions of the transmitters the grid reaches in every direction, in the longest side of
        their box.
    step : number
        Distance of the places of the grid near those positions, in the shortest wavelength; a quarter or less finds
        every hill.
    patience : whole number
        Additions without a better score on the held-out part after which the search stops.
    hold_out : whole number
        One of so many training links is held out while the number is chosen; 0 or 1: none, all `most` are kept.
    rounds : whole number
        Times that the least needed are taken away again and others searched in their place.
    ridge : number
        Weight of the ridge on gains, in the share of noise to signal that the fit itself shows.
    images : true or false
        Whether mirror images of what was found are tried too.
    searches : whole number
        Searches, each with another part held out: the start is the mean of what they find, as many Gaussians as all of
        them found. What is found by accident differs from search to search, and fades in the mean.
    """

    most: int
    reach: float
    step: float
    patience: int
    hold_out: int
    rounds: int
    ridge: float
    images: bool
    searches: int
    def __init__(
        self,
        *,
        most: int = 64,
        reach: float = 2.0,
        step: float = 0.25,
        patience: int = 8,
        hold_out: int = 5,
        rounds: int = 2,
        ridge: float = 1.0,
        images: bool = True,
        searches: int = 1,
    ) -> None: ...

class Mcmc(Value):
    """Pruner: moves the faint onto the opaque, under a cap on N (3DGS-MCMC).

    Moves what has faded onto others, drawn by their opacity, so that the picture stays the same and the work is shared.

    At a prune step each Gaussian of opacity `dead` or less moves onto one drawn in proportion to opacity. Of a place
    that k now share, each takes the opacity 1 − (1 − o)^(1/k), so that together they let through what one did, and
    scales that keep the blended amplitude: s · o / Σᵢ Σⱼ (i−1 over j) (−1)^j o′^(j+1) / √(j+1), i from 1 to k, j below
    i (3D Gaussian splatting as Markov chain Monte Carlo, Kheradmand et al., NeurIPS 2024, eq. (9)). The loss gains
    `opacity_weight` times the mean opacity and `scale_weight` times the mean scale, and centres are stirred, the faint
    ones more: noise · σ(100 (0.005 − o)) · Σ · N(0, 1).

    A `target` is the cap on N: with more, the least opaque go by rounds; with fewer, at most `grow` of N are added at a
    prune step, in the same way as the dead are moved. Without one N stays as it is.

    Parameters
    ----------
    dead : number
        Opacity up to which a Gaussian is dead, from 0 to below 1.
    grow : number
        Share of N that may be added at a prune step, from 0 to 1.
    opacity_weight : number
        Weight of the mean opacity in the loss, 0 or more.
    scale_weight : number
        Weight of the mean scale in the loss, 1/m, 0 or more.
    noise : number
        How much faint centres are stirred at each step, 1/m, 0 or more. The paper lets it fall with the rate of the
        means, from 80 to 0.8; here it stays, as the pruning phase is short.
    target : whole number or None
        The cap on N, and the number of Gaussians at the end of pruning.
    """

    dead: float
    grow: float
    opacity_weight: float
    scale_weight: float
    noise: float
    target: Optional[int]
    def __init__(
        self,
        *,
        dead: float = 0.005,
        grow: float = 0.05,
        opacity_weight: float = 0.01,
        scale_weight: float = 0.01,
        noise: float = 1.0,
        target: Optional[int] = None,
    ) -> None: ...

class MeanSpectrum(Value):
    """Baseline: the mean of all training spectra, or of what each receiver observed.

    The mean of all training spectra, whatever the transmitter: the floor of every score. Of powers and channels it is
    the mean of what the receiver observed, called "mean of the receiver"; a receiver without training links has the
    mean of all.
    """

    def __init__(self) -> None: ...

class Mercator(Value):
    """Projector: the paper's projection: azimuth and elevation linear in the pixel, hemisphere, true pose, azimuth
    comes round.

    Equirectangular picture of the hemisphere in front of the receiver, the paper's «Mercator» projection; or of other
    elevations, behind it too, where the data say so.

    Column c is azimuth c·360/W degrees, row r is elevation r·90/H degrees above the array plane: with the measured 360
    × 90 spectra one degree a pixel, row 0 the horizon of the array, row 89 almost its boresight. The receiver's true
    pose is used and azimuth comes round: a splat at the seam is drawn on both sides of it, once.

    *Differentiable* in means, scales, rotations and opacities. *Discontinuous* where a Gaussian crosses `near_m`, the
    margin, or the axis of the array.

    Near the zenith:

    The measured line of sight lies at 70 to 81 degrees of elevation, so this matters. A linear map of a sphere onto a
    plane stretches azimuth by 1/cos(elevation). That factor is floored at cos 89.5°, and its derivative is that of what
    is computed; a splat wider than the circle covers every column once. What the first-order picture loses is shown by
    a round Gaussian of 5° (opacity 0.99, a single splat) against the exact one, exp(-angle²/(2·5²)), on the sphere;
    error is the mean of |difference| over the picture divided by the mean of the exact picture, both weighted by
    cos(elevation):

    | elevation of the centre | relative error | largest error |
    |---|---|---|
    | 45° | 0.041 | 0.022 |
    | 75° | 0.134 | 0.090 |
    | 88° | 0.292 | 0.384 |

    (The test `what_is_lost_near_the_zenith` prints these figures and holds them.)

    Parameters
    ----------
    blur : number
        Added to both diagonal entries of the 2-D covariance, px² of the whole spectrum, whatever `training.stride` is.
        `readout: Received` has a filter of its own.
    near_m : number
        Gaussians nearer to the receiver than this are not drawn, metres.
    margin_deg : number
        Gaussians centred further below the horizon than this are not drawn, degrees.
    """

    blur: float
    near_m: float
    margin_deg: float
    def __init__(self, *, blur: float = 0.3, near_m: float = 0.2, margin_deg: float = 15.0) -> None: ...

class MergeByMoments(Value):
    """Pruner: the nearest pairs become one of their joint mean and covariance.

    Replaces the nearest pairs by one Gaussian each, of their joint mean and covariance.

    The mass of a Gaussian is its opacity times the product of its scales. Pairs are taken in the order of Ward's
    criterion, m₁m₂/(m₁+m₂) · ‖μ₁ − μ₂‖², each Gaussian with its nearest other and once a pass, until enough are gone.
    The one that takes their place has the mean and the covariance of both as a mixture, their mean signal, and an
    opacity that keeps the mass, at most 0.99. Nothing is lost from a place where something was, as with any other
    strategy; detail is. Its network's signals are those of the new centre.

    Parameters
    ----------
    shares : list of number
        The share of Gaussians that are merged away at each prune step, from the first on.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `shares`.
    """

    shares: Sequence[float]
    target: Optional[int]
    def __init__(self, *, shares: Sequence[float] = [0.5, 0.5, 0.5], target: Optional[int] = None) -> None: ...

class MiniSplatting(Value):
    """Pruner: a lottery by weight in the pictures, or a share of all weight (Mini-Splatting).

    Keeps Gaussians by chance, in proportion to their weight, or those that together have nearly all of it.

    Weight is Σ w, or per pixel that the Gaussian touches, over the training transmitters. `Sampled` draws without
    replacement with that probability, so that a thin cover of the scene remains where the best alone would crowd
    together; `Cumulated` keeps the best until they have that share of all weight (Mini-Splatting, Fang and Wang, ECCV
    2024, section 3.3: half drawn at step 15,000, 0.99 of the weight kept at 20,000). Draws come from the pipeline's
    seed.

    Parameters
    ----------
    rule : Rule
        Who stays.
    per_area : true or false
        Whether the weight is that of a pixel in the mean of those it touches, and not their sum.
    transmitters : whole number
        Training transmitters that a pass looks at; 0: all.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `rule`.
    """

    rule: Any
    per_area: bool
    transmitters: int
    target: Optional[int]
    def __init__(
        self, *, rule: Any = ..., per_area: bool = False, transmitters: int = 0, target: Optional[int] = None
    ) -> None: ...

class Mlp(Value):
    """Deformation: the network of P-WRFGS: changes signals, rotations and scales with the transmitter.

    The network of P-WRFGS: for each Gaussian and transmitter a change of signal, rotation and scale, to be added.

    The transmitter's encoding γ(p) passes two small layers of its own and joins the encoding γ(μ) of the Gaussian's
    centre; a stack of ReLU layers follows, in which both enter once more after layer `skip`; linear heads end it. The
    defaults are those of the released WRF-GS+, on which the paper builds (574,819 weights; its two heads that never
    reach the picture are left out).

    With `outputs: Signals` only signals depend on the transmitter: a whole batch then shares one projection and one
    sorting, which is several times faster. Smaller networks are faster too; the cost grows with `depth · width²`.

    Centres are not differentiated through the network (the released code detaches them): `d_means` stays as it is.

    Parameters
    ----------
    depth : whole number
        Number of ReLU layers, 1 or more.
    width : whole number
        Numbers a layer.
    position_frequencies : whole number
        Frequencies 2⁰…2^(L-1) rad/m in the encoding of the centre; 0 gives the bare coordinates.
    tx_frequencies : whole number
        Frequencies in the encoding of the transmitter, likewise.
    tx_hidden : whole number
        Numbers in the hidden layer of the transmitter's branch.
    tx_features : whole number
        Numbers that the transmitter's branch hands to the stack.
    skip : whole number or None
        Both inputs enter again after this layer (counted from 0); `None` for a plain stack.
    outputs : Outputs
        What depends on the transmitter.
    head_init : number
        Factor on the initial weights and biases of the heads. 1 is PyTorch's start; with small values training starts
        near the undeformed Gaussians.
    """

    depth: int
    width: int
    position_frequencies: int
    tx_frequencies: int
    tx_hidden: int
    tx_features: int
    skip: Optional[int]
    outputs: Any
    head_init: float
    def __init__(
        self,
        *,
        depth: int = 8,
        width: int = 256,
        position_frequencies: int = 10,
        tx_frequencies: int = 6,
        tx_hidden: int = 256,
        tx_features: int = 90,
        skip: Optional[int] = 4,
        outputs: Any = ...,
        head_init: float = 1.0,
    ) -> None: ...

class ModelSize(Value):
    """Metric: bytes of the Gaussians, and with the network.

    Bytes of the Gaussians alone, and of Gaussians and network together.

    Keys `gaussian_bytes` and `model_bytes`. Both, because the paper's 100-fold storage reduction counts the Gaussians
    alone: the deformation network does not shrink with N and soon outweighs them. `n/a` for baselines, which keep the
    measured spectra instead.
    """

    def __init__(self) -> None: ...

class NaturalSelection(Value):
    """Pruner: all opacities decay alike, and die below a threshold (Natural Selection).

    All opacities decay alike, and the derivative of the picture holds up those that are needed.

    The loss gains `pressure` times the mean opacity logit, so that every logit is pulled by the same amount however
    opaque its Gaussian is; what the loss does not hold falls without end. Life is a moving average of opacity, so that
    a Gaussian is not lost to one bad batch; it dies where life is below `epsilon` (Gaussian Natural Selection, 2025,
    whose field of decay is this pull, and whose count is set by a final cut to a budget: `target`).

    Parameters
    ----------
    pressure : number
        Weight of the mean logit, 0 or more.
    epsilon : number
        Life below which a Gaussian dies, from 0 to below 1.
    memory : number
        What is left of life after a step, from 0 to below 1; the rest is the opacity of that step.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, those of the longest life. Left out, the pressure
        decides.
    """

    pressure: float
    epsilon: float
    memory: float
    target: Optional[int]
    def __init__(
        self, *, pressure: float = 0.05, epsilon: float = 0.005, memory: float = 0.9, target: Optional[int] = None
    ) -> None: ...

class NearestNeighbours(Value):
    """Baseline: the spectra of the k nearest training transmitters, weighted by inverse distance.

    The mean of the spectra of the k nearest training transmitters, weighted by inverse distance.

    Where the transmitter stands on training transmitters, it is the mean of the spectra measured there. Powers and
    channels are averaged alike, each receiver by itself; a receiver without training links is given those of all. Where
    links have features, such as an uplink channel, distance is that between features.

    `k: Auto` takes the k out of 1, 2, 3, 5, 8, 12, 20, 30, 40, 60, 80, 120 and 160 that predicts the validation part
    best from the training part, by the mean SSIM of at most 240 samples (powers: the absolute error, channels: the
    squared error), and then learns from both. Where there is no validation part, every tenth training sample is left
    out for the choice; on a split that holds out whole stretches give it a validation part, or k comes out too small. A
    note under the table says which.

    Parameters
    ----------
    k : whole number or Auto
        Neighbours that are averaged, at least 1, or `Auto`; more than there are training samples means all of them.
    """

    k: Union[int, Any]
    def __init__(self, *, k: Union[int, Any] = 3) -> None: ...

class Nerf2(Value):
    """Method: rays through a network, without Gaussians (NeRF2): the baseline that everybody compares with.

    Rays from the receiver through a network that says of every place how it weakens a wave and what it emits (NeRF2,
    Zhao et al., MobiCom 2023): the baseline that everybody compares with. It has no Gaussians, so nothing is pruned,
    and N and Chamfer are n/a.

    A trunk of `depth` layers reads a sample's place and gives its attenuation; with the direction of the ray and the
    transmitter (or its `features`) a smaller net says what the sample emits. A pixel of a spectrum is the modulus of
    the sum along its ray; a received power the modulus of the sum over a coarse sky, as 100 |R| − 100 dBm; a channel
    the sum itself, with a weight of its own for each subcarrier. The rate of `optimizer.network` counts, `rays` says
    which pixels a step looks at, and projector, rasterizer, deformation, calibration and readout do not count.

    As released, but for this: the sky of powers and channels is that of `azimuths` and `elevations`, of which the
    released code draws only the first ring for powers (`first_ring` has it so); directions of pixels are those of the
    data, which are one degree from the released ones; behind a trillionth of the amplitude, and at the endless last
    sample of powers and channels, nothing counts; losses are those of this program, in dB² of powers (10⁴ times the
    released one) and relative of channels. The rate that falls and rises again is `Cosine` with its `steps` below those
    of the training; normalisation by test data is `by_test_data` of `Nerf2Csi`.

    The trunk does not know the transmitter: it is worked out once for all that are asked for together, and kept between
    predictions where all of it fits in `cache_mb`. Training at full size wants some 10¹² multiply-adds a step;
    `nerf2-laptop.ron` is a size for two cores.

    Parameters
    ----------
    depth : whole number
        Layers of the trunk; from 6 on the place comes in once more at the sixth.
    width : whole number
        Units of each, an even number.
    samples : whole number
        Samples of a ray, from the receiver to the far end, both included.
    far_m : number
        Where rays end, metres.
    unit_m : number
        Metres of the network's unit of length; the released settings have 60 for BLE.
    azimuths : whole number
        Directions around, of powers and channels.
    elevations : whole number
        Rings above the horizon, up to the zenith.
    first_ring : true or false
        Whether powers see the lowest ring alone, as the released renderer does by a slip in its number of chunks.
    carrier_hz : number
        Frequency whose phase turns along a ray of powers and channels, Hz; the distance counts in the network's unit,
        as released.
    features : whole number
        Numbers that describe a transmitter in place of its position: 52 for the uplinks of NeRF2's channels; 0: the
        position.
    cache_mb : whole number
        What predictions may keep of the trunk, MiB a model; where all of it is more, nothing is kept.
    """

    depth: int
    width: int
    samples: int
    far_m: float
    unit_m: float
    azimuths: int
    elevations: int
    first_ring: bool
    carrier_hz: float
    features: int
    cache_mb: int
    def __init__(
        self,
        *,
        depth: int = 8,
        width: int = 256,
        samples: int = 64,
        far_m: float = 5.0,
        unit_m: float = 1.0,
        azimuths: int = 36,
        elevations: int = 9,
        first_ring: bool = False,
        carrier_hz: float = 2400000000.0,
        features: int = 0,
        cache_mb: int = 2500,
    ) -> None: ...

class Nerf2Csi(Value):
    """DataSource: uplink and downlink channels of a base station in the NeRF2 folder layout.

    Channels (CSI) of a base station in the layout of NeRF2 (Zhao et al., 2023): what the uplink says of the downlink.

    ```text
    root/csidata.npy         [N, A, 2F], complex64 or complex128: N snapshots at A antennas of the base station, the first
                             half of the subcarriers is the uplink, the second the downlink (NeRF2: 8 antennas, 26 and 26)
    root/base-station.yml    base_station: [[x, y, z], ..], a place for each antenna; metres
    root/tx_pos.csv          columns x, y, z, a row a snapshot; metres; may be absent
    root/train_index.txt     snapshots counted from 0, one a line; this file and
    root/test_index.txt      this one come together or not at all
    ```

    Every antenna is a receiver, called `antenna 1` and so on. A link is a snapshot and an antenna. Its features, which
    stand where the transmitter's position stands elsewhere, are its uplink: F real parts, then F imaginary parts. What
    was observed of it is its downlink, a channel of 1 antenna and F subcarriers. The id of a transmitter is its
    snapshot, counted from 0 as the index files do. Without `tx_pos.csv` nobody knows where the transmitters are, and
    what needs places, such as the split `Voxel`, is refused.

    The whole array is divided by its largest modulus, which is looked for in the training part of the index files, and
    in all snapshots where there are none. NeRF2 looks for it in training and test data alike: `by_test_data: true` does
    so.

    Parameters
    ----------
    root : path
        The folder, relative to the pipeline file.
    carrier_hz : number
        Frequency in the middle of all subcarriers, between uplink and downlink, Hz.
    spacing_hz : number
        From one subcarrier to the next, Hz.
    normalise : true or false
        Whether all channels are divided by one number, the largest modulus of the training part.
    by_test_data : true or false
        Whether the largest modulus may be one of the test part, as NeRF2 has it; a factor that no score sees.
    together : true or false
        Whether the antennas are one receiver's: a link is then a snapshot, its features are the uplinks of all antennas
        one after the other, and what was observed of it is the downlink at all of them.
    """

    root: _Path
    carrier_hz: float
    spacing_hz: float
    normalise: bool
    by_test_data: bool
    together: bool
    def __init__(
        self,
        *,
        root: _Path = "data/mimo",
        carrier_hz: float = 2400000000.0,
        spacing_hz: float = 312500.0,
        normalise: bool = True,
        by_test_data: bool = False,
        together: bool = False,
    ) -> None: ...

class Nerf2Rssi(Value):
    """DataSource: received powers at many gateways in the NeRF2 folder layout.

    Received powers (RSSI) at many gateways in the layout of NeRF2 (Zhao et al., 2023).

    ```text
    root/gateway_position.yml    g01: [x, y, z], one line a gateway; metres; of one that is turned
                                 g01: {position: [x, y, z], orientation: [x, y, z, w]}, a unit quaternion
    root/gateway_rssi.csv        header with the names of the gateways; row k is what each received, dBm; -100: not heard
    root/tx_pos.csv              header naming x, y, z among others; row k is the transmitter; metres
    root/train_index.txt         rows counted from 0, one a line; this file and
    root/test_index.txt          this one come together or not at all
    ```

    A link is a transmitter and a gateway that heard it; -100 dBm says that it did not, and is no link. The id of a
    transmitter is its row, counted from 0 as the index files do (ids of spectra count from 1). The split of the index
    files takes all links of a transmitter. Gateways are receivers of that name, in the order of `gateway_position.yml`.

    Of the data that NeRF2 released: whether rows are in the order of time is not known, so that `TimeBlock` may hold
    out something else than a stretch of time; the gateways `g08` and `g09` have the same coordinates, so that to leave
    out one of them means to leave out both; its gateways are in three separate areas, of which a transmitter is heard
    in one.

    A name that holds the word «simulated», or a `manifest.json` that says so, makes the data count as simulated.

    Parameters
    ----------
    root : path
        The folder, relative to the pipeline file.
    points : path or None
        Point cloud of the rooms (PLY, XYZ or CSV, metres, world frame), relative to the pipeline file.
    """

    root: _Path
    points: Optional[_Path]
    def __init__(self, *, root: _Path = "data/ble", points: Optional[_Path] = None) -> None: ...

class Nerf2Spectrum(Value):
    """DataSource: measured spectra in the NeRF2 folder layout.

    Measured spatial spectra in the layout of NeRF2 (Zhao et al., 2023).

    ```text
    root/gateway_info.yml    gateway1: {position: [x, y, z], orientation: [x, y, z, w]}; metres, unit quaternion
    root/tx_pos.csv          header naming x, y, z among others; row k, counted from 1, is the transmitter of id k
    root/spectrum/00001.png  8-bit grey, one channel, all of one size; a row is an elevation, a column an azimuth
    root/train_index.txt     ids, one a line; this file and
    root/test_index.txt      this one come together or not at all
    ```

    The samples are the ids that have a row and a picture; others must not be named by an index file. Lines may end in
    LF or CRLF, ids may be zero-padded. Pictures stay 8-bit in memory and decide the size of the image plane.

    The pictures go once around in azimuth. Their rows are elevations 0 to 90 degrees, row 0 in the plane of the array,
    unless `elevation` here, or a key `elevation: [first, last]` of `gateway_info.yml`, says otherwise: a full sphere
    has `elevation: (-90, 90)`. Without a word a picture is refused whose pixels are further from square than 1 to 1.75,
    such as 360 x 180; with one, further than 1 to 4.

    A folder that `pwrfgs simulate` wrote says so in its `manifest.json`, with the scene; so does a data set whose name
    holds the word «simulated». Any other counts as measured.

    Parameters
    ----------
    root : path
        The folder, relative to the pipeline file.
    points : path or None
        Point cloud of the room (PLY, XYZ or CSV, metres, world frame), relative to the pipeline file.
    gateway : text or None
        Which receiver, where `gateway_info.yml` has more than `gateway1`; a file with several is refused unless one is
        named. Keys that hold no `position` and are not called gateway are left alone.
    elevation : two numbers or None
        Elevations where the top row of the pictures begins and the bottom row ends, degrees; where it is left out, what
        `gateway_info.yml` says, else 0 and 90.
    """

    root: _Path
    points: Optional[_Path]
    gateway: Optional[str]
    elevation: Optional[Tuple[float, float]]
    def __init__(
        self,
        *,
        root: _Path = "data/s23",
        points: Optional[_Path] = None,
        gateway: Optional[str] = None,
        elevation: Optional[Tuple[float, float]] = None,
    ) -> None: ...

class NoGaussians(Value):
    """Initializer: no Gaussians, for a method that has none.

    No Gaussians, for a method that has none, such as `Nerf2`; it is what such a pipeline takes that leaves
    `initializer` out.
    """

    def __init__(self) -> None: ...

class Official(Value):
    """Split: the split that comes with the data.

    The split that comes with the data: `train_index.txt` and `test_index.txt` of the NeRF2 layout.

    Validation is drawn over transmitters, with all links of each. Use it to compare with published figures. Samples
    that neither list names are left out. The index files of the NeRF2 spectra are random, so their test samples lie 8
    mm from a training sample: read every score beside `NearestNeighbours`.

    Parameters
    ----------
    validation : number
        Share of the training list held out at random, in [0, 1); 0 for none.
    """

    validation: float
    def __init__(self, *, validation: float = 0.1) -> None: ...

class OpacityThreshold(Value):
    """Pruner: discards Gaussians below an opacity (WRF-GS).

    A Gaussian stays where its opacity o = σ(logit) is at least epsilon.

    With the paper's 0.005 it takes dead weight away and goes beside `LearnableMask` (section IV; a Gaussian must
    satisfy both to stay). Alone, with 0.005 to 0.5, it is the WRF-GS baseline of fig. 2b: simple, but opacity is not
    importance, and quality falls fast. It is asked at the prune steps only; densification has its own floor,
    `opacity_floor`, because every Gaussian starts at 0.1 and each opacity reset sets it to 0.01 at most.

    Parameters
    ----------
    epsilon : number
        Smallest opacity ε that stays, from 0 (keeps all) to below 1.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, the most opaque ones; in place of epsilon.
    """

    epsilon: float
    target: Optional[int]
    def __init__(self, *, epsilon: float = 0.005, target: Optional[int] = None) -> None: ...

class PointCloud(Value):
    """Initializer: one Gaussian on each point of the scene (the paper's start).

    One Gaussian on each point of the scene's point cloud.

    Mean = point, covariance = d²·I with d the distance to the nearest neighbour (section III-C and eq. (14) of the
    paper), floored at sqrt(1e-7) m, so that duplicates are safe; a single point gets 1 m. Reflection and scattering
    happen on surfaces, so this is the better start wherever a scan of the scene is at hand. It makes as many Gaussians
    as there are points: `max_points` takes a random part of them, without repetition, and measures distances within
    that part.

    Parameters
    ----------
    max_points : whole number or None
        Most Gaussians to start with; `None` takes every point.
    nearest : whole number
        Neighbours whose root mean squared distance is the scale: 1 as in the paper, 3 as in the released WRF-GS.
    opacity : number
        Opacity of every Gaussian, above 0 and below 1.
    signal_scale : number
        Width of the interval about 0 in which each channel of a signal is drawn uniformly. The released colours have
        1/0.28209479 = 3.5449.
    """

    max_points: Optional[int]
    nearest: int
    opacity: float
    signal_scale: float
    def __init__(
        self, *, max_points: Optional[int] = None, nearest: int = 1, opacity: float = 0.1, signal_scale: float = 1.0
    ) -> None: ...

class PowerError(Value):
    """Metric: absolute error of a received power, dB.

    |predicted − measured| of a received power, dB.

    Key `power_error_db`. Tables give mean, median and 90th percentile over links; papers print one of the first two,
    often without saying which. What readings at one place differ by is no model's to predict: see the ceiling.
    """

    def __init__(self) -> None: ...

class Psnr(Value):
    """Metric: peak signal-to-noise ratio in dB.

    Peak signal-to-noise ratio −10·log₁₀(mean squared error) in dB, for a peak of 1.

    Key `psnr`. The prediction is clamped to [0, 1]. An exact prediction counts as 100 dB rather than infinity, so that
    means stay finite. Use it to compare with image-like results of other fields.
    """

    def __init__(self) -> None: ...

class Pup3dgs(Value):
    """Pruner: what the pictures say least about, by place and size, goes (PUP-3DGS).

    Drops the Gaussians whose place and size the pictures say least about.

    The score is log det of the 6 × 6 Fisher matrix Σ J Jᵀ, J = ∂P̂/∂(mean, log scale) with signals held, over pixels
    and training transmitters (PUP-3DGS, Hanson et al., CVPR 2025, eq. (11), with the scale where we have its
    logarithm). 80 % go at once, then half of the rest, each followed by fine-tuning. Where a direction is not seen at
    all, such as the distance from a single receiver, the determinant would be 0 for every Gaussian: `ridge` times the
    matrix' own mean diagonal is added.

    Parameters
    ----------
    shares : list of number
        The share that goes at each prune step, from the first on; after the last of them nothing goes.
    ridge : number
        What is added to the diagonal, over its own mean; above 0.
    transmitters : whole number
        Training transmitters that a pass looks at; 0: all.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `shares`.
    """

    shares: Sequence[float]
    ridge: float
    transmitters: int
    target: Optional[int]
    def __init__(
        self,
        *,
        shares: Sequence[float] = [0.8, 0.5],
        ridge: float = 1e-06,
        transmitters: int = 256,
        target: Optional[int] = None,
    ) -> None: ...

class RadSplat(Value):
    """Pruner: what has no pixel to itself goes: largest weight below a threshold (RadSplat).

    A Gaussian stays where it has at least `threshold` of some pixel for some transmitter.

    The score is max w, the largest blending weight γ·T over all pixels and training transmitters (RadSplat, Niemeyer et
    al., 3DV 2025, eq. (12); 0.01 there, 0.25 for a light model). A maximum keeps what a single pixel needs, where a sum
    keeps what is seen often: of two like Gaussians behind each other the front one stays.

    Parameters
    ----------
    threshold : number
        Smallest weight that counts, from 0 to 1.
    transmitters : whole number
        Training transmitters that a pass looks at; 0: all.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `threshold`.
    """

    threshold: float
    transmitters: int
    target: Optional[int]
    def __init__(self, *, threshold: float = 0.01, transmitters: int = 0, target: Optional[int] = None) -> None: ...

class Random(Value):
    """Initializer: normally distributed about the receiver and in front of it (the released start).

    Gaussians drawn from a normal distribution about the receiver.

    Where pixels are angles of the true pose (`Mercator`), centres are normal about the receiver, and (unless the
    picture shows what is behind) those behind it are mirrored to its front (local z > 0), so that none starts out of
    sight. With the released projection (`WrfgsCompat`) they are normal about the origin of the world, as released:
    count 20,000 and 10 m for WRF-GS, 200,000 and 20 m for WRF-GS+. The scale is the root mean squared distance to the
    three nearest neighbours, as released. Use it where there is no point cloud; the paper finds it slightly inferior to
    `PointCloud`.

    Split: a random share of the samples is the test set.

    A random share of the transmitters is the test set, with all links of each.

    The usual split of this field, and the easiest: with a dense trajectory each test sample has a training sample
    beside it. Use `TimeBlock` or `Voxel` to ask for more than interpolation.

    Parameters
    ----------
    count : whole number
        Number of Gaussians.
    std : number
        Standard deviation along each axis, metres.
    nearest : whole number
        Neighbours whose root mean squared distance is the scale: 3 as released, 1 as the paper does with points.
    opacity : number
        Opacity of every Gaussian, above 0 and below 1.
    signal_scale : number
        Width of the interval about 0 in which each channel of a signal is drawn uniformly. The released colours have
        1/0.28209479 = 3.5449.
    test : number
        Share of all samples in the test set, in (0, 1).
    validation : number
        Share of the others held out at random, in [0, 1); 0 for none.
    """

    count: int
    std: float
    nearest: int
    opacity: float
    signal_scale: float
    test: float
    validation: float
    def __init__(
        self,
        *,
        count: int = 20000,
        std: float = 10.0,
        nearest: int = 3,
        opacity: float = 0.1,
        signal_scale: float = 1.0,
        test: float = 0.2,
        validation: float = 0.1,
    ) -> None: ...

class RandomLinks(Value):
    """Split: a random share of the links is the test set.

    A random share of the links is the test set: most transmitters are then in training and test, at different
    receivers.

    Asks what a receiver hears of a transmitter that others heard. With one receiver it is `Random`.

    Parameters
    ----------
    test : number
        Share of all links in the test set, in (0, 1).
    validation : number
        Share of the others held out at random, in [0, 1); 0 for none.
    """

    test: float
    validation: float
    def __init__(self, *, test: float = 0.2, validation: float = 0.1) -> None: ...

class RandomReference(Value):
    """Pruner: Gaussians go by chance: the reference that any strategy has to beat.

    Drops Gaussians by chance: the reference from below that every strategy has to beat.

    Each prune step draws anew from the pipeline's seed. What a strategy gains over it at equal N and equal training is
    what its score knows; the reference from above is `GreedyElimination`.

    Parameters
    ----------
    shares : list of number
        The share that goes at each prune step, from the first on; after the last of them nothing goes.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `shares`.
    """

    shares: Sequence[float]
    target: Optional[int]
    def __init__(self, *, shares: Sequence[float] = [0.5, 0.5, 0.5], target: Optional[int] = None) -> None: ...

class RateRatio(Value):
    """Metric: achievable-rate ratio of the predicted beam direction.

    Rate reached by steering to the strongest predicted direction, over the rate of the truly strongest one.

    η(ρ) = log₂(1 + ρ·P(predicted direction)) / log₂(1 + ρ·max P), eq. (15), in [0, 1]; ρ is the transmit
    signal-to-noise ratio. Key `eta_0db` for 0 dB, and so on. The direction is the strongest pixel of the prediction
    before clamping (clamping would make ties), the first in row-major order where several are equal. Where the measured
    spectrum is 0 everywhere no direction is better than another: 1. It is a forgiving number: even the mean training
    spectrum reaches 0.8 to 0.9, so read it beside the baselines.

    Parameters
    ----------
    snr_db : number
        Transmit signal-to-noise ratio ρ in dB, −100 to 100; the paper reports 0.
    """

    snr_db: float
    def __init__(self, *, snr_db: float = 0.0) -> None: ...

class RayTracing(Value):
    """Baseline: ray tracing in a known room: the generator of simulated data, or a scene with errors.

    Ray tracing in a known room, as a predictor beside the model.

    It learns nothing from the training part. With the scene that the data were simulated from it *is* their generator,
    an upper bound for every model, and tables say so; what the errors of the receiver take from it nobody can win back.
    `material_error` and `position_error_m` spoil the scene by a stated amount: what one would have in practice.

    Parameters
    ----------
    scene : path or None
        A scene file, relative to the pipeline file; `None` for the scene of the data, which must be `Simulated` or a
        folder that `pwrfgs simulate` wrote. A scene with meshes has to be named for such a folder, which does not hold
        them.
    noise : true or false
        Whether the scene's receiver errors are drawn, anew.
    material_error : number
        Standard deviation of the logarithm of every permittivity, conductivity and thickness; 0.2 is about 20 %.
    position_error_m : number
        Standard deviation of the place of every wall and object along each horizontal axis, metres.
    seed : whole number
        Which errors.
    """

    scene: Optional[_Path]
    noise: bool
    material_error: float
    position_error_m: float
    seed: int
    def __init__(
        self,
        *,
        scene: Optional[_Path] = None,
        noise: bool = False,
        material_error: float = 0.0,
        position_error_m: float = 0.0,
        seed: int = 0,
    ) -> None: ...

class Reduced3dgs(Value):
    """Pruner: the fainter half of the crowded goes (Reduced-3DGS).

    Thins out where Gaussians crowd: of those with many overlaps, the less opaque half goes.

    Two Gaussians overlap where their centres are nearer than the sum of their largest scales; of each the `neighbours`
    nearest are looked at. Whose count lies more than `deviations` standard deviations above the mean is crowded, and of
    the crowded the `share` that is least opaque goes (Reducing the memory footprint of 3DGS, Papantonakis et al., I3D
    2024, with spheres for its ray test). It looks at the cloud alone, so that it works for any method. Under a `target`
    the most crowded go first, then the least opaque.

    Parameters
    ----------
    neighbours : whole number
        Neighbours that are looked at, 1 or more.
    deviations : number
        How far above the mean a count is crowded, in standard deviations.
    share : number
        Share of the crowded that goes, from 0 to 1.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of the share.
    """

    neighbours: int
    deviations: float
    share: float
    target: Optional[int]
    def __init__(
        self, *, neighbours: int = 30, deviations: float = 1.0, share: float = 0.5, target: Optional[int] = None
    ) -> None: ...

class Ridge(Value):
    """Baseline: linear regression from features, such as an uplink, to observations.

    Linear regression from what describes a transmitter, such as its uplink, to what was observed, for each receiver.

    y = ȳ + B (x − x̄) with B the minimum of Σ|y − ŷ|² + λ|B|² over the training links; λ is `weight` times the mean of
    Σ(x − x̄)² over the features. Downlink follows from uplink nearly linearly where few paths make both, so this is the
    honest floor of that task.

    Parameters
    ----------
    weight : number
        Weight of the ridge, in the mean square of the features.
    """

    weight: float
    def __init__(self, *, weight: float = 0.001) -> None: ...

class SafeguardGs(Value):
    """Pruner: what no pixel needs goes: not among the first of any (SafeguardGS).

    Keeps whatever is among the first few of some pixel of some transmitter.

    In each pixel splats are ranked by exp(−|‖s‖ − P|) · w, with the splat's own strength ‖s‖, what was measured there
    P, and the blending weight w = γ·T: those that show, and show what is there. The first `of_pixel` are safe
    (SafeguardGS, Lee et al., 2024, with amplitudes in place of colours). No pixel is left empty, which matters most
    when few are left. Under a `target` those that are safe come first, by weight.

    Parameters
    ----------
    of_pixel : whole number
        How many of each pixel are safe, from 1 to 64.
    transmitters : whole number
        Training transmitters that a pass looks at; 0: all.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `of_pixel`.
    """

    of_pixel: int
    transmitters: int
    target: Optional[int]
    def __init__(self, *, of_pixel: int = 1, transmitters: int = 256, target: Optional[int] = None) -> None: ...

class SignalContribution(Value):
    """Pruner: least signal times weight goes, mean or max over transmitters.

    Drops what sends least into the pictures: signal times weight, in the mean over transmitters or for the one that
    needs it most.

    The score is Σ ‖s(tx)‖ · w over the pixels, with the Gaussian's signal s for a transmitter and its blending weights
    w = γ·T. In radiance fields of radio a Gaussian's signal depends on the transmitter, so opacity alone, the score of
    the baseline in the paper's fig. 2b, says little: an opaque Gaussian may be silent. `Mean` asks for what helps in
    general, `Max` keeps what a single transmitter cannot do without, as RadSplat does with pixels.

    Parameters
    ----------
    over : Over
        How transmitters are put together.
    shares : list of number
        The share that goes at each prune step, from the first on; after the last of them nothing goes.
    transmitters : whole number
        Training transmitters that a pass looks at; 0: all.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `shares`.
    """

    over: Any
    shares: Sequence[float]
    transmitters: int
    target: Optional[int]
    def __init__(
        self,
        *,
        over: Any = ...,
        shares: Sequence[float] = [0.5, 0.5, 0.5],
        transmitters: int = 0,
        target: Optional[int] = None,
    ) -> None: ...

class Simulated(Value):
    """DataSource: simulated spectra, powers or channels of a room known exactly, by ray tracing.

    *Simulated* spectra, powers or channels of a room that is known exactly: ray tracing in a scene file.

    Paths are found by image sources, diffraction at edges and diffuse patches; their sum on the antennas of the
    receiver gives the spectrum, as the measured files hold it (`docs/math.md`), or what `observe` says. A scene with
    several receivers gives a link each; one at which nothing is heard is left out. The point cloud of the scene is
    exact, so that `PointCloud` initialisation and `Chamfer` mean something here. Every fifth sample belongs to the test
    list of `Official`.

    The data set is simulated once and kept in the user's cache folder (`$PWRFGS_CACHE` names another) under a key of
    the scene, its meshes and all fields; it can be removed at any time. More than 512 MB of spectra stay there, and a
    picture is read when it is wanted. `pwrfgs simulate` writes the same data set where you want it, with every path.

    Parameters
    ----------
    scene : path
        The scene file, relative to the pipeline file.
    samples : whole number
        Transmitters; with one receiver, spectra.
    seed : whole number
        Which transmitter positions and receiver errors; the pipeline's seed does not change them.
    points : whole number
        Points of the cloud, spread over all surfaces; the paper has 190,000.
    observe : Observe
        What is observed: `Spectrum`, `Power(noise_db: 3)` or `Channel(snr_db: 30)`.
    cache : true or false
        Whether the data set is kept on disk.
    """

    scene: _Path
    samples: int
    seed: int
    points: int
    observe: Any
    cache: bool
    def __init__(
        self,
        *,
        scene: _Path = "scenes/office.ron",
        samples: int = 1000,
        seed: int = 0,
        points: int = 190000,
        observe: Any = ...,
        cache: bool = True,
    ) -> None: ...

class Site(Value):
    """Initializer: about every receiver, and all over the site: one cloud for many receivers.

    Some Gaussians about each receiver, the others all over the box that holds receivers, transmitters and points.

    For one cloud that many receivers look at, where no point cloud is known: what happens near a receiver decides most
    of what it hears, so each has its share. Of one receiver and spectra, `Random` is the released start.

    Parameters
    ----------
    count : whole number
        Number of Gaussians.
    near : number
        Share of them that stand about the receivers, 0 to 1.
    spread_m : number
        Standard deviation about a receiver along each axis, metres.
    scale_m : number
        Scale of every Gaussian, metres.
    opacity : number
        Opacity of every Gaussian, above 0 and below 1.
    signal_scale : number
        Width of the interval about 0 in which each channel of a signal is drawn uniformly.
    """

    count: int
    near: float
    spread_m: float
    scale_m: float
    opacity: float
    signal_scale: float
    def __init__(
        self,
        *,
        count: int = 900,
        near: float = 0.5,
        spread_m: float = 2.5,
        scale_m: float = 0.8,
        opacity: float = 0.3,
        signal_scale: float = 1.0,
    ) -> None: ...

class Sparse(Value):
    """Split: a few random training samples, all others are the test set.

    A given number of random training samples (transmitters with all their links); all others are the test set.

    Asks how far few measurements go: with 220 of the NeRF2 spectra the nearest training sample is 6 cm away.

    Parameters
    ----------
    train : whole number
        Training samples, those held out included.
    validation : number
        Share of `train` held out at random, in [0, 1); 0 for none.
    """

    train: int
    validation: float
    def __init__(self, *, train: int = 220, validation: float = 0.1) -> None: ...

class SpeedySplat(Value):
    """Pruner: what the pictures are least sensitive to goes (Speedy-Splat).

    Drops what the pictures are least sensitive to.

    The score is Σ (∂P̂/∂a)² over pixels and training transmitters, with a factor a on the Gaussian's γ, at 1: one
    number a Gaussian, of second order, as it is the diagonal of the Gauss-Newton Hessian along its own strength
    (Speedy-Splat, Hanson et al., CVPR 2025, eq. (10), whose derivative is by the Gaussian's value). 80 % may go at once
    ("soft", while training goes on), then 30 % at a time ("hard"). It sees hiding: a Gaussian before another of the
    same signal hardly counts.

    Parameters
    ----------
    shares : list of number
        The share that goes at each prune step, from the first on; after the last of them nothing goes.
    transmitters : whole number
        Training transmitters that a pass looks at; 0: all.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `shares`.
    """

    shares: Sequence[float]
    transmitters: int
    target: Optional[int]
    def __init__(
        self, *, shares: Sequence[float] = [0.8, 0.3, 0.3, 0.3], transmitters: int = 256, target: Optional[int] = None
    ) -> None: ...

class Splatting(Value):
    """Method: Gaussians drawn as splats: what a pipeline does that leaves `method` out.

    Gaussians drawn as splats: what the fields `projector`, `rasterizer`, `deformation`, `calibration` and `readout` of
    a pipeline say, and what a pipeline does that leaves `method` out.

    Parameters
    ----------
    deformation : Deformation
        What the transmitter changes.
    projector : Projector
        From space to the picture.
    rasterizer : Rasterizer
        From splats to pixels.
    calibration : Calibration
        How calibration terms meet the base parameters.
    readout : Readout
        From blended signals to grey values.
    """

    deformation: Any
    projector: Any
    rasterizer: Any
    calibration: Any
    readout: Any
    def __init__(
        self,
        *,
        deformation: Any = ...,
        projector: Any = ...,
        rasterizer: Any = ...,
        calibration: Any = ...,
        readout: Any = ...,
    ) -> None: ...

class Ssim(Value):
    """Metric: structural similarity, equal to scikit-image's.

    Structural similarity of predicted and measured spectrum, 1 where they are equal.

    Key `ssim`. Uniform 7x7 windows, data range 1, sample covariance, mean over the picture without its border of 3 px:
    scikit-image's `structural_similarity(a, b, data_range=1)`, which is what the released test prints. The prediction
    is clamped to [0, 1]. It is not the SSIM of the training loss, whose Gaussian window gives other values. Papers
    often print the median without saying so; the report gives both. Read it beside the baselines: neighbouring
    transmitters have nearly equal spectra.
    """

    def __init__(self) -> None: ...

class Taming3dgs(Value):
    """Pruner: least by a sum of median-normalised terms goes (Taming 3DGS).

    Drops the least by a weighted sum of what may matter, each number over its own median.

    Gradient 25, opacity 100, radius 10, scale 25, loss 10 (weights times errors), count 0.1 (pictures that it is seen
    in), blend 50 (blending weights): the score of Taming 3DGS (Mallick et al., SIGGRAPH Asia 2024, section 4.2), which
    uses it to choose what to densify under an exact budget. Its terms for depth and for distance are left out: they
    tell cameras apart that go round a scene, and a receiver stands still.

    Parameters
    ----------
    shares : list of number
        The share that goes at each prune step, from the first on; after the last of them nothing goes.
    transmitters : whole number
        Training transmitters that a pass looks at; 0: all.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of `shares`.
    """

    shares: Sequence[float]
    transmitters: int
    target: Optional[int]
    def __init__(
        self, *, shares: Sequence[float] = [0.5], transmitters: int = 256, target: Optional[int] = None
    ) -> None: ...

class Teacher(Value):
    """DataSource: simulated spectra of a few random Gaussians, with a known answer.

    *Simulated* spectra of a few random Gaussians: a known answer, for tests and for a run without any download.

    The Gaussians lie 2 to 6 m from the receiver at elevations of 10° to 75°, nearly round, with standard deviations of
    5° to 12° as seen from it and opacities of 0.5 to 0.9. Geometry does not depend on the transmitter; each signal
    does, as a plane wave with a random direction and wavelength λ: sᵢ(p) = aᵢ·(0.55 + 0.45·cos(2π nᵢ·p/λᵢ + φᵢ)) on the
    channels (cos θᵢ, sin θᵢ) with θᵢ in the first quadrant. The spectrum is the magnitude of the blended signal; all
    are divided by one common maximum and rounded to 8 bits.

    Transmitters are uniform in a box. `scene.points` are the centres of the Gaussians. Every fifth sample belongs to
    the test list of `Official`. `Teacher::cloud` and `Teacher::signals` tell the answer.

    To read scores by: with the defaults the mean spectrum has a mean SSIM of 0.847 on the official test list, 3-NN of
    0.980.

    Parameters
    ----------
    gaussians : whole number
        Gaussians of the answer.
    samples : whole number
        Spectra.
    seed : whole number
        Which scene; the pipeline's seed does not change it.
    width : whole number
        Columns of a spectrum.
    height : whole number
        Rows of a spectrum.
    tx_box : ((number, number, number), (number, number, number))
        Smallest and largest corner of the transmitters' box, metres, world frame.
    wavelength_m : (number, number)
        Shortest and longest wavelength of the signals, metres; shorter is harder to learn.
    receiver : Pose
        Where the receiver stands and how it looks.
    projector : Projector or None
        What projects; `None` for `Mercator()`.
    rasterizer : Rasterizer or None
        What draws; `None` for `AlphaBlending()`.
    """

    gaussians: int
    samples: int
    seed: int
    width: int
    height: int
    tx_box: Tuple[Tuple[float, float, float], Tuple[float, float, float]]
    wavelength_m: Tuple[float, float]
    receiver: Any
    projector: Optional[Any]
    rasterizer: Optional[Any]
    def __init__(
        self,
        *,
        gaussians: int = 12,
        samples: int = 200,
        seed: int = 0,
        width: int = 360,
        height: int = 90,
        tx_box: Tuple[Tuple[float, float, float], Tuple[float, float, float]] = ((-0.8, -0.65, 0.5), (0.8, 0.65, 1.4)),
        wavelength_m: Tuple[float, float] = (1.0, 2.0),
        receiver: Any = ...,
        projector: Optional[Any] = None,
        rasterizer: Optional[Any] = None,
    ) -> None: ...

class TimeBlock(Value):
    """Split: a contiguous block of the sorted ids is the test set.

    A contiguous block of the sorted ids of transmitters is the test set, with all links of each.

    Ids follow the trajectory, so this holds out a stretch of it: most test samples are centimetres from training
    samples, not millimetres. Validation is a block too: the ids right behind the test block, and where these do not
    suffice, the ids right before it.

    At the ends of the block consecutive ids are neighbours again. `gap` leaves out the samples on both sides of it:
    they serve neither part. `docs/data.md` says what a gap changes on measured spectra; `samples.csv` lists every
    distance.

    Parameters
    ----------
    start : number
        Where the test block begins, a fraction of the sorted ids in [0, 1).
    length : number
        Length of the test block, a fraction of the sorted ids in (0, 1).
    gap : whole number
        Samples left out on either side of the test block.
    validation : number
        Share of the others held out next to the test block, in [0, 1); 0 for none.
    """

    start: float
    length: float
    gap: int
    validation: float
    def __init__(self, *, start: float = 0.4, length: float = 0.2, gap: int = 0, validation: float = 0.1) -> None: ...

class TopK(Value):
    """Pruner: keeps an exact number of Gaussians, the best-scored.

    Keeps the best-scored Gaussians, exactly as many as asked for.

    Use it where memory or time is given and quality is to be found; `densify.max_gaussians` is its companion, which
    keeps densification from growing far beyond. Equal scores are taken in the order of the Gaussians. At the default of
    2,613 it can be compared with the paper's model at lambda 0.01. `Weight`, the part in the picture that
    importance-based pruning of visual splatting uses, is the best guide; `Opacity` and `OpacityVolume` need no picture.

    Parameters
    ----------
    keep : whole number
        Number of Gaussians that stay, 1 or more.
    score : Score
        What makes one Gaussian better than another.
    """

    keep: int
    score: Any
    def __init__(self, *, keep: int = 2613, score: Any = ...) -> None: ...

class Trained(Value):
    """Initializer: the Gaussians and weights of a trained model.

    Gaussians and weights of a trained model.

    To prune, or to go on training, where another run ended: the same dense model can then be thinned out in many ways,
    all trained equally long (`experiments/pareto.ron`). Method and receivers must be those of the model; the optimiser
    begins anew. A checkpoint, with which a run that was stopped goes on, is another thing.

    Parameters
    ----------
    model : path
        The `model.safetensors` of a finished run, relative to the pipeline.
    """

    model: _Path
    def __init__(self, *, model: _Path = "model.safetensors") -> None: ...

class TrimmingTheFat(Value):
    """Pruner: faint ones with small gradients go, in rounds (Trimming the Fat).

    Drops what is faint and has a small gradient, in rounds with training between them.

    A Gaussian goes where its opacity is below a quantile of all opacities and its mean positional gradient since the
    last densification below a quantile of all gradients: what is still being moved gets its chance (Trimming the Fat,
    Salman et al., BMVC 2024). Under a `target` the score is the larger of its two ranks. Needs no pass.

    Parameters
    ----------
    opacity_quantile : number
        Opacities below this quantile, from 0 to 1, are faint.
    gradient_quantile : number
        Gradients below this quantile, from 0 to 1, are small.
    target : whole number or None
        How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place
        of the quantiles.
    """

    opacity_quantile: float
    gradient_quantile: float
    target: Optional[int]
    def __init__(
        self, *, opacity_quantile: float = 0.1, gradient_quantile: float = 0.5, target: Optional[int] = None
    ) -> None: ...

class VirtualTransmitters(Value):
    """Method: channels as sums of spherical waves from the receiver, its mirror images and scatterers, coherent over
    the room.

    Channels as sums of spherical waves from virtual transmitters: `h(p) = Σ s·exp(−j k d)/d`, eq. (1) of the paper in
    space, coherent over the whole room.

    By reciprocity the fixed node and the moving one change roles: each Gaussian is the fixed node (the receiver of the
    data), a mirror image of it, or something that scatters. Its mean is its position, its signal a complex gain, and
    its quaternion turns the array about it (a mirrored planar array is a turned one). Every subcarrier has its own
    wavenumber, so delays come for free. Scales and opacities are not looked at, and there is no network: projector,
    rasterizer, deformation, calibration and readout do not count. The basin of a position is a quarter of a wavelength
    wide, so start from `MatchingPursuit`; a rate of `means` beyond a hundredth of the wavelength loses it again.

    One receiver with any number of antennas. Exact for flat walls as long as nothing hides an image, and what reflects
    does so in all directions alike. Real walls, antennas and things in the way do not: with an `order` the gain is a
    sum of spherical harmonics of the direction from the virtual transmitter, at the price of (order + 1)² complex
    numbers each, which want data: some ten measured numbers for each unknown.

    Parameters
    ----------
    order : whole number
        Order of the harmonics of a gain over direction, at most 3; 0: the same in all directions.
    """

    order: int
    def __init__(self, *, order: int = 0) -> None: ...

class Voxel(Value):
    """Split: whole cells of space are the test set.

    Whole cubic cells of space are held out, drawn at random until the test share is reached; all links of a transmitter
    are in one part. Data that do not say where the transmitters are are refused.

    No test sample has a training sample in its own cell, so the model must say what the field is where it was not
    measured. Cells lie on a grid through the world's origin; a sample on a wall belongs to the cell above. That is
    decided by the decimals that coordinates and `size_m` are written in, since 1.4/0.2 is less than 7 in floating
    point: who checks a split has to do the same. The last cell drawn may overshoot the share; one cell is always left
    to train on. Validation is drawn in the same way from the cells that remain.

    Parameters
    ----------
    size_m : number
        Edge of a cell, metres, above 0.
    test : number
        Share of all samples in the test set, in (0, 1).
    validation : number
        Share of the others held out as whole cells, in [0, 1); 0 for none.
    """

    size_m: float
    test: float
    validation: float
    def __init__(self, *, size_m: float = 0.2, test: float = 0.2, validation: float = 0.1) -> None: ...

class Wrfgs(Value):
    """Deformation: the network of WRF-GS: gives the signals of each transmitter, geometry stays.

    The network of WRF-GS, the released ancestor: it replaces the signals and leaves geometry alone.

    A stack of ReLU layers sees γ(X) of the Gaussian's centre and gives an attenuation A and a feature; the feature,
    γ(p) of the transmitter and γ(X - p) pass two more layers that give an amplitude S. The signal is g·S·A ≥ 0 in the
    first channel and 0 in the second. As released, g = 40·F with F = √Σᵢ|Xᵢ - r|², one number for the whole cloud with
    r the receiver's position: it grows with √N and makes most starts saturate. A fixed `gain` gives a model that can be
    used.

    The defaults are the released network, 189,636 weights; its two phases per Gaussian are computed and not used (their
    weights are kept, so that the layout is the released one).

    Parameters
    ----------
    depth : whole number
        Number of ReLU layers before attenuation and feature, 1 or more.
    width : whole number
        Numbers a layer, 2 or more; the last hidden layer has half of them.
    frequencies : whole number
        Frequencies 2⁰…2^(L-1) rad/m of all three encodings; 0 gives the bare coordinates.
    skip : whole number or None
        γ(X) enters again after this layer (counted from 0); `None` for a plain stack.
    gain : number or None
        The factor g on every signal; `None` for 40·F as released.
    """

    depth: int
    width: int
    frequencies: int
    skip: Optional[int]
    gain: Optional[float]
    def __init__(
        self,
        *,
        depth: int = 8,
        width: int = 128,
        frequencies: int = 10,
        skip: Optional[int] = 4,
        gain: Optional[float] = None,
    ) -> None: ...

class WrfgsCompat(Value):
    """Projector: the projection of the released WRF-GS code: full sphere, wrong centre and axis, no seam; for
    comparison.

    The released WRF-GS projection, for comparison with published code only.

    It differs from `Mercator` in all that matters for geometry: the receiver's position is used as the camera's
    translation (`v = Rᵀx + r_o`, so the centre is at `-R r_o`), the polar axis is the receiver's y axis, the *full*
    sphere is squeezed onto the rows (2° a row with 90 of them), and azimuth does not come round. A pixel therefore has
    no angle in the receiver frame, and whatever needs one refuses this plane. Pair it with `AlphaBlending(support:
    TileSquares)` and `calibration: AsReleased`.
    """

    def __init__(self) -> None: ...

class Zero(Value):
    """Baseline: a channel of zeros.

    A channel of zeros: an SNR of 0 dB, which a prediction with wrong phases does not reach.
    """

    def __init__(self) -> None: ...
