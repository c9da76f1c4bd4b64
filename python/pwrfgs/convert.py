"""Data sets from Sionna RT and DeepMIMO, and scenarios for DeepMIMO.

Antennas of Sionna RT and DeepMIMO are in the y-z plane and face x. A receiver of pwrfgs has its antennas in the x-y plane
and faces z. The orientation of a converted receiver contains this rotation.
"""

from __future__ import annotations

import functools
import json
import math
import os
import re
import zipfile
from typing import Any, Dict, List, Literal, Mapping, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike

from . import _pwrfgs
from ._errors import InputError
from ._log import warn
from ._mat import read_matrix
from ._run import Progress
from ._spectrum import SPEED_OF_LIGHT, spectrum
from ._types import Array, Receiver

__all__ = ["from_deepmimo", "from_sionna", "to_deepmimo", "to_sionna"]

PathLike = Union[str, "os.PathLike[str]"]
Observed = Literal["spectrum", "channel", "power"]

# Receiver axes x, y, z (boresight) are the axes y, z, x of an array in the y-z plane. Quaternion x, y, z, w.
_FACING_X = (0.5, 0.5, 0.5, 0.5)
# Spectra per block; numbers of the largest intermediate arrays.
_SPECTRA, _BLOCK = 256, 1 << 22
# Matrices of a DeepMIMO pair that a channel needs: of the paths [U, P], and positions [U, 3] and [1, 3].
_PATHS = ("power", "phase", "delay", "aod_az", "aod_el")
# Whether phases of a ray tracer lack the phase of the delay.
_LACKS_DELAY = {"sionna ray tracing": True, "remcom wireless insite": False, "pwrfgs": False}
# Direct paths that decide about the phases; fewer may agree by chance.
_LEAST_DIRECT = 10
# Largest number of values of a matrix: 1.3 million users with 25 paths. Largest parameter file, bytes.
_MOST_VALUES, _MOST_BYTES = 1 << 25, 1 << 24
# Ranges of values: decibels and seconds.
_RANGES = {"power": (-1e4, 300.0), "delay": (0.0, 1.0)}


def from_sionna(
    paths: Any,
    frequencies: ArrayLike,
    scene: Any,
    *,
    observe: Observed = "spectrum",
    receiver: Optional[str] = None,
    power_dbm: float = 0.0,
) -> "_pwrfgs.Dataset":
    """Convert the paths of Sionna RT to a data set: ``from_sionna(solver(scene), [0.0], scene)``.

    Every transmitter of the scene is a sample and has one antenna. Transmitters without a path are left out, with a warning.

    Parameters
    ----------
    paths : ``sionna.rt.Paths``, from ``PathSolver``
    frequencies : [F], Hz relative to the carrier ``scene.frequency``, as for ``Paths.cfr``; ``[0.0]`` is the carrier
    scene : ``sionna.rt.Scene`` of the paths, unchanged since then: orientation, names and array of the receivers
    observe : "spectrum" (90 x 360, from the mean power over frequencies), "channel", or "power" at all receivers
    receiver : name of the receiver; may be omitted for one receiver, and for "power"
    power_dbm : transmit power for "power"
    """
    offsets, carrier = np.atleast_1d(np.asarray(frequencies, float)), float(np.ravel(scene.frequency)[0])
    if offsets.ndim != 1 or not offsets.size or not (np.abs(offsets) < carrier / 2).all():
        raise InputError(
            f"frequencies must be relative to the carrier of {carrier:g} Hz, as for Paths.cfr, such as [0.0]; subtract "
            "scene.frequency from absolute frequencies"
        )
    h = np.asarray(paths.cfr(frequencies=offsets, normalize_delays=False, out_type="numpy"))[..., 0, :]
    antennas = np.array(scene.rx_array.positions(scene.wavelength), float).T
    tx = np.array(paths.sources, float).T
    wanted = (len(scene.receivers), len(antennas), len(tx), 1, offsets.size)
    if h.shape != wanted:
        raise InputError(
            f"channels of the paths have shape {list(h.shape)} (receivers, antennas, transmitters, antennas, frequencies), "
            f"expected {list(wanted)}; trace the paths of this scene, with one antenna per transmitter and one polarisation "
            "per antenna"
        )
    names = list(scene.receivers)
    if receiver is not None and receiver not in names:
        raise InputError(f"unknown receiver {receiver!r} (expected one of {', '.join(names)})")
    chosen = names if receiver is None else [receiver]
    receivers = [_sionna_receiver(name, scene.receivers[name], antennas) for name in chosen]
    h = np.moveaxis(h[[names.index(name) for name in chosen], :, :, 0], 2, 1)
    return _dataset(tx, h, receivers, carrier + offsets, observe, power_dbm, "Sionna RT")


def _sionna_receiver(name: str, device: Any, antennas: Array) -> Receiver:
    """Receiver of Sionna RT, whose orientation is given by rotations around z, y and x; ``antennas`` [A, 3] in its frame."""
    halves = np.ravel(device.orientation).astype(float) / 2
    turns = [(*(np.sin(half) * np.eye(3)[axis]), np.cos(half)) for half, axis in zip(halves, (2, 1, 0))]
    orientation = functools.reduce(_product, map(np.array, [*turns, _FACING_X]))
    return _receiver(name, np.ravel(device.position), orientation, antennas[:, [1, 2, 0]])


def from_deepmimo(
    source: Any,
    frequencies_hz: Optional[ArrayLike] = None,
    *,
    receiver: Optional[Receiver] = None,
    pair: Optional[Sequence[int]] = None,
    every: int = 1,
    observe: Observed = "spectrum",
    power_dbm: float = 0.0,
) -> "_pwrfgs.Dataset":
    """Convert a scenario of DeepMIMO v4 to a data set: ``from_deepmimo("deepmimo_scenarios/asu_campus_3p5")``.

    The base station is the receiver and each user is a transmitter; channels are reciprocal. The array receives plane waves.
    Paths with a NaN are ignored. Users without a path are left out, with a warning. Meshes are not read.

    Phases of paths contain the phase of their delay, or not: those of Sionna RT do not, and it is added. The scenario names its
    ray tracer. The direct paths decide if it is unknown, or if they contradict it, which a warning reports.

    Parameters
    ----------
    source : folder of a scenario, or a ``deepmimo`` data set of one base station and one set of users
    frequencies_hz : [F], absolute; default: the carrier of the scenario
    receiver : antennas and orientation of the base station, whose position is that of the scenario; default: 4 x 4 antennas at
        a spacing of 0.49 wavelengths that face the x axis of the world
    pair : set of the base station, its index in this set, and set of users, for a folder with several: (0, 0, 1)
    every : use every k-th user; a spectrum takes 32 kB
    observe : "spectrum" (90 x 360, from the mean power over frequencies), "channel" or "power"
    power_dbm : transmit power for "power"
    """
    is_folder = isinstance(source, (str, os.PathLike))
    found = _read_deepmimo(os.fspath(source), pair) if is_folder else _deepmimo_dataset(source)
    carrier: float = found["frequency"]
    frequencies = np.atleast_1d(np.asarray(carrier if frequencies_hz is None else frequencies_hz, float))
    if frequencies.ndim != 1 or not frequencies.size or not (np.abs(frequencies - carrier) < carrier / 2).all():
        raise InputError(f"frequencies_hz must be near the carrier of the scenario, {carrier:g} Hz")
    if found["power"].ndim != 2 or found["tx_pos"].size != 3:
        raise InputError("power must have the axes users and paths, and tx_pos three coordinates; pass one base station")
    found["tx_pos"], paths = found["tx_pos"].reshape(1, 3), found["power"].shape
    wanted_shapes = {**dict.fromkeys((*_PATHS, "inter"), paths), "rx_pos": (paths[0], 3), "tx_pos": (1, 3)}
    for name, wanted in wanted_shapes.items():
        if np.shape(found[name]) != wanted and not (name == "inter" and found[name] is None):
            raise InputError(f"{name} has shape {list(np.shape(found[name]))}, expected {list(wanted)}")
    if every < 1:
        raise InputError(f"every is {every}, expected 1 or more")
    for name, (low, high) in _RANGES.items():
        values = found[name][np.isfinite(found[name])]
        if values.size and not low <= values.min() <= values.max() <= high:
            raise InputError(f"{name} is in {values.min():g} to {values.max():g}, expected {low:g} to {high:g}; correct the matrix")
    if _lacks_delay(found, carrier):
        found["phase"] = found["phase"] - np.rad2deg(2 * np.pi * carrier * np.asarray(found["delay"], float))
    found.update({name: found[name][::every] for name in (*_PATHS, "rx_pos", "inter") if found[name] is not None})
    if receiver is None:
        steps = 0.49 * SPEED_OF_LIGHT / carrier * (np.arange(4) - 1.5)
        receiver = Receiver("base-station", orientation=_FACING_X, antennas=[(x, y, 0.0) for y in steps for x in steps])
    base = _receiver(receiver.name, found["tx_pos"][0], receiver.orientation, np.array(receiver.antennas))
    h = _channels(found, carrier, frequencies, _rotated(np.array(base.antennas), base.orientation))
    return _dataset(np.asarray(found["rx_pos"], float), h[None], [base], frequencies, observe, power_dbm, found["title"])


def _channels(found: Mapping[str, Any], carrier: float, frequencies: Array, antennas: Array) -> Array:
    """Channels [U, A, F] of paths at antennas [A, 3] relative to the base station, world axes."""
    power, phase, delay, azimuth, zenith = (np.asarray(found[name], float) for name in _PATHS)
    usable = np.isfinite(power + phase + delay + azimuth + zenith)
    power, phase, delay, azimuth, zenith = (np.where(usable, x, 0.0) for x in (power, phase, delay, azimuth, zenith))
    phase, azimuth, zenith = np.deg2rad(phase), np.deg2rad(azimuth), np.deg2rad(zenith)
    gain = np.where(usable, 10 ** (power / 20), 0.0) * np.exp(1j * phase)
    across = np.sin(zenith)
    directions = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(zenith)], axis=-1)
    h = np.empty((len(gain), len(antennas), len(frequencies)), np.complex64)
    rows = max(_BLOCK // max(len(antennas) * gain.shape[1], 1), 1)
    for start in range(0, len(gain), rows):
        block = slice(start, start + rows)
        early = directions[block] @ antennas.T / SPEED_OF_LIGHT
        for column, frequency in enumerate(frequencies):
            wave = gain[block] * np.exp(-2j * np.pi * (frequency - carrier) * delay[block])
            h[block, :, column] = np.einsum("up,upa->ua", wave, np.exp(2j * np.pi * frequency * early))
    return h


def _lacks_delay(found: Mapping[str, Any], carrier: float) -> bool:
    """Whether phases do not contain the phase of the delay, by the ray tracer and the direct paths."""
    tracer = str(found["ray_tracer"])
    stated = _LACKS_DELAY.get(tracer.lower())
    phase, delay = np.deg2rad(np.asarray(found["phase"], float)), np.asarray(found["delay"], float)
    direct = np.isfinite(phase + delay) & (np.array(found["inter"], float) == 0)
    phase, lag, count = phase[direct], 2 * np.pi * carrier * delay[direct], int(direct.sum())
    # Direct paths agree if their phases lack the delay, or after it is removed.
    lacks, contains = (bool(count) and _agreement(phases) > 0.9 for phases in (phase, phase + lag))
    is_shown = lacks != contains and (stated is None or count >= _LEAST_DIRECT)
    words = None
    if stated is None and not is_shown:
        words = (
            f"the ray tracer {tracer!r} is unknown, and {count} direct paths do not show whether phases contain the delay; "
            "they are used as they are; compare with compute_channels, or correct raytracer_name in params.json"
        )
    elif stated is None and count < _LEAST_DIRECT:
        words = f"only {count} direct paths decide whether phases contain the delay; compare with compute_channels"
    elif stated is not None and is_shown and lacks != stated:
        words = (
            f"phases of {tracer} {'lack' if stated else 'contain'} the delay, but those of {count} direct paths "
            f"{'lack' if lacks else 'contain'} it; the direct paths decide; correct raytracer_name in params.json"
        )
    if words:
        warn(words)
    return lacks if is_shown else bool(stated)


def _agreement(phases: Array) -> float:
    """Length of the mean phasor of doubled phases: 1 if all phases are equal up to the sign of the amplitude."""
    return float(abs(np.exp(2j * phases).mean()))


def _deepmimo_dataset(source: Any) -> Dict[str, Any]:
    """Matrices of a data set of the package ``deepmimo``."""
    if "datasets" in getattr(source, "__dict__", {}):  # `hasattr` raises a KeyError
        raise InputError("the data set has several base stations or sets of users; pass one of them, such as dataset[0]")
    try:
        found: Dict[str, Any] = {name: np.array(source[name], float) for name in (*_PATHS, "rx_pos", "tx_pos")}
        found["inter"] = source["inter"]
        return {**found, **_ray_tracer(source["rt_params"]), "title": "DeepMIMO"}
    except (KeyError, AttributeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"no DeepMIMO data set: {error}; pass a folder, or the result of deepmimo.load(..)") from None


def _ray_tracer(params: Any) -> Dict[str, Any]:
    """Carrier and name of the ray tracer."""
    frequency = float(params["frequency"])
    if not 0 < frequency < 1e15:
        raise ValueError(f"a frequency of {frequency:g} Hz")
    name = params["raytracer_name"] if "raytracer_name" in params else ""
    return {"frequency": frequency, "ray_tracer": name}


def _read_deepmimo(folder: str, pair: Optional[Sequence[int]]) -> Dict[str, Any]:
    """Matrices of one pair in the folder of a scenario."""
    places = [os.path.join(where, "params.json") for where in (folder, os.path.dirname(os.path.abspath(folder)))]
    place = next(filter(os.path.isfile, places), None)
    pattern = re.compile(r"power_t(\d+)_tx(\d+)_r(\d+)\.(?:npz|mat)")
    names = [pattern.fullmatch(name) for name in sorted(os.listdir(folder))] if os.path.isdir(folder) else []
    pairs = [tuple(int(part) for part in name.groups()) for name in names if name]
    if place is None or not pairs:
        raise InputError(
            f"{folder}: no params.json and power_t000_tx000_r000.npz of DeepMIMO v4; give the folder of a scenario, such as "
            "deepmimo_scenarios/asu_campus_3p5"
        )
    try:
        if os.path.getsize(place) > _MOST_BYTES:
            raise ValueError(f"more than {_MOST_BYTES >> 20} MB")
        with open(place, encoding="utf-8") as file:
            params = json.load(file)
        ray_tracer = _ray_tracer(params["rt_params"])
        senders = {s["id"] for s in params["txrx_sets"].values() if isinstance(s, dict) and s["is_tx"]}
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise _at(place, f"not the parameters of a DeepMIMO v4 scenario ({error!r})") from None
    candidates = [p for p in pairs if (p[2] not in senders if pair is None else p == tuple(pair))]
    if len(candidates) != 1:
        raise InputError(f"{folder}: pass pair=.., one of {', '.join(map(str, pairs))}")
    ending = "_t{:03}_tx{:03}_r{:03}".format(*candidates[0])
    found = {name: _matrix(os.path.join(folder, name + ending), name) for name in (*_PATHS, "rx_pos", "tx_pos", "inter")}
    return {**found, **ray_tracer, "title": os.path.basename(os.path.abspath(folder))}


def _at(path: str, problem: str) -> InputError:
    """Error in a file."""
    error = InputError(f"{path}: {problem}")
    error.path = path
    return error


def _matrix(stem: str, name: str) -> Any:
    """Matrix in an ``.npz`` or ``.mat`` file; None if interactions are missing."""
    path = next((stem + ending for ending in (".npz", ".mat") if os.path.isfile(stem + ending)), None)
    if path is None and name == "inter":
        return None
    if path is None:
        raise _at(f"{stem}.npz", "no such file; download the scenario again")
    try:
        return _npz_matrix(path, name) if path.endswith(".npz") else read_matrix(path, name, _check_size)
    except Exception as error:  # of many kinds, by the kind of damage
        raise _at(path, f"no readable matrix `{name}` ({str(error) or type(error).__name__}); download the scenario again") from None


def _npz_matrix(path: str, name: str) -> Array:
    """Matrix of an archive of NumPy. Its size is checked before it is read, its checksum after."""
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    with zipfile.ZipFile(path) as archive, archive.open(f"{name}.npy") as file:
        shape, _, number = headers[np.lib.format.read_magic(file)](file)
        _check_size(shape, number.kind in "fiu")
        file.seek(0)
        values: Array = np.lib.format.read_array(file, allow_pickle=False)
        if file.read(1):  # at the end, the checksum is compared
            raise ValueError("the file goes on after the matrix")
        return values


def _check_size(shape: Sequence[int], is_real: bool) -> None:
    """Refuses matrices of other types, and those that would need gigabytes."""
    if not is_real:
        raise ValueError("its values are not real numbers")
    if math.prod(shape) > _MOST_VALUES:
        raise ValueError(f"it has {math.prod(shape):,} values, and at most {_MOST_VALUES:,} are read")


def to_deepmimo(
    scene: PathLike,
    out: PathLike,
    *,
    samples: int = 200,
    seed: int = 0,
    tx: Union[PathLike, ArrayLike, None] = None,
    progress: bool = True,
) -> None:
    """Simulate a scene into the new folder ``out`` as a scenario of DeepMIMO v4, like ``pwrfgs simulate --layout deepmimo``.

    Receivers become base stations, and transmitters become users. Each user keeps its 25 strongest paths. The scenario has no
    objects. ``tx`` states the positions of the users instead of ``samples``, as for `simulate`. ``deepmimo.load("NAME")`` reads ``deepmimo_scenarios/NAME``; NAME must be in lower case.
    """
    bar = Progress(progress)
    bar.begin("simulating", samples)
    try:
        _pwrfgs.simulate(
            scene, out, "DeepMIMO", samples, seed, 0, None, None, True, tx, None, lambda done, total: bar.to(done)
        )
    finally:
        bar.close()


def to_sionna(scene: PathLike, out: PathLike) -> int:
    """Write a scene as Mitsuba XML with a PLY mesh per object into the new folder ``out``, for ``sionna.rt.load_scene``, as
    ``pwrfgs export-scene`` does; returns the number of meshes. ``scene`` is a file or the name of a scene in the package.

    Sheets keep material and thickness; solids become sheets with a thickness of 10 m. Antennas are not written: set them in
    Sionna RT."""
    return _pwrfgs.export_scene(scene, out)


def _dataset(
    tx: Array, h: Array, receivers: List[Receiver], frequencies: Array, observe: str, power_dbm: float, title: str
) -> "_pwrfgs.Dataset":
    """Data set of observations of channels [R, T, A, F]; transmitters that no receiver receives are left out."""
    if observe not in ("spectrum", "channel", "power"):
        raise InputError(f"observe is {observe!r}, expected 'spectrum', 'channel' or 'power'")
    if observe != "power" and len(receivers) > 1:
        names = ", ".join(receiver.name for receiver in receivers)
        raise InputError(f"there are {len(receivers)} receivers; pass receiver=.., one of {names}")
    received = (h != 0).any(axis=(0, 2, 3))
    if not received.any():
        raise InputError("no transmitter has a path to the receiver; check the scene and the positions")
    if not received.all():
        words = f"{(~received).sum()} of {len(tx)} transmitters have no path and are left out"
        warn(words)
    tx, h = tx[received], h[:, received]
    common: Dict[str, Any] = {"title": title, "simulated": True}
    if observe == "power":
        with np.errstate(divide="ignore"):
            rssi = 10 * np.log10((np.abs(h) ** 2).mean(axis=(2, 3))).T + power_dbm
        alone = [Receiver(r.name, r.position, r.orientation) for r in receivers]
        rssi = np.where(np.isfinite(rssi), rssi, np.nan)
        return _pwrfgs.Dataset.from_arrays(tx, rssi=rssi, receivers=alone, **common)
    if observe == "channel":
        return _pwrfgs.Dataset.from_arrays(tx, csi=h[0], receivers=receivers, frequencies_hz=frequencies, **common)
    blocks = (h[0, start : start + _SPECTRA] for start in range(0, len(tx), _SPECTRA))
    spectra = np.concatenate([(255 * spectrum(block, receivers[0], frequencies)).astype(np.uint8) for block in blocks])
    return _pwrfgs.Dataset.from_arrays(tx, spectra, receivers=receivers, **common)


def _receiver(name: str, position: Any, orientation: Any, antennas: Array) -> Receiver:
    """Receiver of arrays."""
    x, y, z = (float(value) for value in position)
    qx, qy, qz, qw = (float(value) for value in orientation)
    return Receiver(name, (x, y, z), (qx, qy, qz, qw), [(p[0], p[1], p[2]) for p in antennas.tolist()])


def _product(p: Array, q: Array) -> Array:
    """Product of two quaternions x, y, z, w: rotation by q, then by p."""
    return np.append(p[3] * q[:3] + q[3] * p[:3] + np.cross(p[:3], q[:3]), p[3] * q[3] - p[:3] @ q[:3])


def _rotated(vectors: Array, quaternion: Any) -> Array:
    """Vectors [N, 3] rotated by a quaternion x, y, z, w."""
    axis = np.asarray(quaternion[:3], float)
    twice = 2 * np.cross(axis, vectors)
    rotated: Array = vectors + quaternion[3] * twice + np.cross(axis, twice)
    return rotated
