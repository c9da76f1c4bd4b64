# Written by `python -m pwrfgs._stubs` from what the program says of itself; changes belong there.

from typing import ClassVar, List, Optional

from ._values import Choice, Value

__all__: List[str] = [
    "Calibration", "Encoding", "Errors", "Observe", "Outputs", "Over", "Rays", "Readout", "Rule", "Schedule", "Score",
    "Support", "Wavefront",
]

class Calibration(metaclass=Choice):
    """How calibration terms meet the base parameters."""

    Physical: ClassVar[Value]
    """Scales exp(log s) + Δ, not below 0.1 mm; rotations normalise(q/|q| + Δ); signals s + Δ, signed."""

    AsReleased: ClassVar[Value]
    """As the released code has it: scales may go negative, rotations are not normalised again, signals become colours
    max(0, 0.2821·s + 0.5), and the blended picture is clamped to [0, 1] before the loss.
    """

class Encoding(metaclass=Choice):
    """The encoding γ(p) of a position: the coordinates, and waves over the room."""

    @staticmethod
    def Octaves(value: int, /) -> Value:
        """Sine and cosine of 2⁰…2^(L-1) rad/m along each axis (`NeRF`). 5 ends at 16 rad/m, near 2π/λ at 920 MHz,
        beyond which no wave from a transmitter varies.
        """

    @staticmethod
    def Waves(*, count: int, reach: float, seed: int = ...) -> Value:
        """Sine and cosine of kᵢ·p for `count` wave vectors k of any direction, their lengths evenly from 0 to `reach`
        (random Fourier features, shaped for a band-limited field). Drawn from `seed`: networks of one ensemble had
        better each have their own. They are not learned.

        Parameters
        ----------
        count : whole number
            Number of wave vectors.
        reach : number
            Longest of them, rad/m; a little above 2π/λ.
        seed : whole number
            Decides the directions.
        """

    @staticmethod
    def Wavelengths(*, count: int, longest_m: float, shortest_m: float) -> Value:
        """Sine and cosine of 2π/λ along each axis for `count` wavelengths in equal ratios, and the coordinates times 2π
        over the longest: for fields that vary slowly over tens of metres, such as received powers.

        Parameters
        ----------
        count : whole number
            Number of wavelengths.
        longest_m : number
            Metres; about the size of the site.
        shortest_m : number
            Metres; what varies faster cannot be followed, which keeps a network from learning noise.
        """

    @staticmethod
    def Features(*, width: int, gain: float = ...) -> Value:
        """No position, but the vector that the data have in its place, as it is; of the transmitter only. The network's
        features then hold it too, so that signals may be linear in it.

        Parameters
        ----------
        width : whole number
            Numbers of the vector.
        gain : number
            What they are multiplied by, so that they are about 1.
        """

    @staticmethod
    def PseudoPosition(*, width: int, gain: float = ..., octaves: int) -> Value:
        """No position, but the vector that the data have in its place, made a pseudo-position: 2 tanh of three learned
        linear maps of it, then sine and cosine of `octaves` frequencies, as `GSRF` has it. Of the transmitter only.

        Parameters
        ----------
        width : whole number
            Numbers of the vector.
        gain : number
            What they are multiplied by, so that they are about 1.
        octaves : whole number
            Frequencies 2⁰…2^(L-1) of the encoding.
        """

class Errors(metaclass=Choice):
    """How errors count."""

    Absolute: ClassVar[Value]
    """|Δ|: deaf to outliers."""

    Squared: ClassVar[Value]
    """Δ²."""

class Observe(metaclass=Choice):
    """What is observed of every pair of a transmitter and a receiver."""

    Spectrum: ClassVar[Value]
    """The spatial spectrum, a picture of 360 x 90 pixels, at the carrier."""

    @staticmethod
    def Power(*, noise_db: float = ...) -> Value:
        """The received power in dBm: `power_dbm` of the scene's transmitter and the mean of |h|² over antennas and
        subcarriers. What is weaker than -100 dBm is not heard.

        Parameters
        ----------
        noise_db : number
            Standard deviation of a reading in dB: normal, drawn anew for each; 0 for none. Measured BLE readings have
            about 3.6.
        """

    @staticmethod
    def Channel(*, snr_db: Optional[float] = ...) -> Value:
        """The channel h, complex, of every antenna at every subcarrier of the scene.

        Parameters
        ----------
        snr_db : number or None
            Signal-to-noise ratio in dB, in place of that of the scene's `noise`: the mean of |h|² over the antennas and
            subcarriers of this one snapshot against the variance of complex Gaussian noise, drawn anew for each of
            them. Left out: that of the scene.
        """

class Outputs(metaclass=Choice):
    """What an `Mlp` changes."""

    All: ClassVar[Value]
    """Rotations (4), scales (3) and signals (2)."""

    Signals: ClassVar[Value]
    """Signals (2) alone."""

class Over(metaclass=Choice):
    """How the numbers of all transmitters become one."""

    Mean: ClassVar[Value]
    """Their mean."""

    Max: ClassVar[Value]
    """The largest."""

class Rays(metaclass=Choice):
    """Which pixels of the spectra a step looks at, for a method that can draw some alone."""

    All: ClassVar[Value]
    """All that `stride` leaves."""

    @staticmethod
    def Same(value: int, /) -> Value:
        """So many, drawn anew at each step, the same of all spectra of the batch: what does not depend on the
        transmitter is then worked out once.
        """

    @staticmethod
    def Each(value: int, /) -> Value:
        """In place of a batch so many pairs of a spectrum and a pixel, as NeRF2 draws them."""

class Readout(metaclass=Choice):
    """How the two real channels of a blended signal become one grey value."""

    Real: ClassVar[Value]
    """The first channel alone: WRF-GS."""

    Magnitude: ClassVar[Value]
    """√(c₀² + c₁²): P-WRFGS, since the files hold amplitudes. Its derivative at (0, 0) is 0: most pixels of a sparse
    picture are empty and must not give NaN.
    """

    Power: ClassVar[Value]
    """c₀² + c₁², as eq. (2) of the paper has it."""

    MinMax: ClassVar[Value]
    """The magnitude m of each picture stretched from its smallest value to its largest, (m - min)/(max - min): what the
    measured files hold, so that absolute power is neither needed nor learned. Every picture then has a 0 and a 1. All
    zero, without derivative, where all directions are equally strong. Differentiable wherever the smallest and the
    largest pixel are the only ones; of several, the first counts.
    """

    @staticmethod
    def Received(*, sky_deg: int = ..., filter_deg2: float = ...) -> Value:
        """A received power in dBm: 10 log₁₀ of c₀² + c₁² summed over a whole sky, times solid angle, and for each
        receiver an offset and an exponent of distance that are learned too. The sky is drawn in pixels of so many
        degrees.

        Parameters
        ----------
        sky_deg : whole number
            Sides of a pixel, degrees: a divisor of 180.
        filter_deg2 : number
            Added to both diagonal entries of the 2-D covariance of a Gaussian on this sky, in place of the projector's
            filter, degrees².
        """

    Channel: ClassVar[Value]
    """A channel: c₀ + j·c₁ of each Gaussian as a spherical wave, summed on the antennas of the receiver for every
    subcarrier, times a level that is learned for each receiver. Nothing is projected: scales, rotations and opacities
    do not count, the projector and the rasterizer neither.
    """

class Rule(metaclass=Choice):
    """Who stays, by weight."""

    @staticmethod
    def Sampled(value: float, /) -> Value:
        """This share of all Gaussians, drawn with probabilities in proportion to weight."""

    @staticmethod
    def Cumulated(value: float, /) -> Value:
        """The best, until they have this share of the weight of all."""

class Schedule(metaclass=Choice):
    """A learning rate as a function of the step."""

    @staticmethod
    def Constant(value: float, /) -> Value:
        """The same at every step."""

    @staticmethod
    def LogLinear(*, first: float, last: float, steps: int = ...) -> Value:
        """Falls geometrically from `first` to `last` over `steps` steps, then stays; 0 steps means the whole training.

        Parameters
        ----------
        first : number
            Rate at step 1.
        last : number
            Rate from step `steps` on.
        steps : whole number
            Steps the fall takes; 0 for `training.steps`.
        """

    @staticmethod
    def Cosine(*, first: float, last: float, steps: int = ...) -> Value:
        """Falls along half a cosine from `first` to `last` over `steps` steps, and periodically on, as released.

        Parameters
        ----------
        first : number
            Rate at step 1.
        last : number
            Rate at step `steps`.
        steps : whole number
            Half a period; 0 for `training.steps`.
        """

class Score(metaclass=Choice):
    """How much a Gaussian matters."""

    Weight: ClassVar[Value]
    """Its part in the pictures: the sum of its blending weights γ·T over pixels and renders since the last
    densification. Opacity where no picture has been drawn since.
    """

    Opacity: ClassVar[Value]
    """Its opacity."""

    OpacityVolume: ClassVar[Value]
    """Its opacity times the product of its scales."""

class Support(metaclass=Choice):
    """Which pixels a Gaussian can reach."""

    Exact: ClassVar[Value]
    """Those where γ ≥ 1/255."""

    TileSquares: ClassVar[Value]
    """Those of whole tiles around the square of radius 3σ, as released."""

class Wavefront(metaclass=Choice):
    """How the phase at an antenna follows from a Gaussian."""

    Plane: ClassVar[Value]
    """From its direction, as if it were infinitely far away."""

    @staticmethod
    def Spherical(*, wavelength_m: float) -> Value:
        """From its position.

        Parameters
        ----------
        wavelength_m : number
            Wavelength of the carrier, metres.
        """
