"""Spatial spectra from channels."""

from __future__ import annotations

from typing import Any, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._errors import InputError
from ._types import Array, Receiver

SPEED_OF_LIGHT = 299_792_458.0
# Numbers of the largest intermediate arrays, 64 MB each.
_BLOCK = 1 << 22
# Contrast relative to the largest value below which a spectrum is constant up to rounding.
_NO_CONTRAST = 1e-12


def spectrum(
    csi: ArrayLike,
    antennas: Union[Receiver, ArrayLike],
    frequency_hz: ArrayLike,
    *,
    shape: Tuple[int, int] = (90, 360),
    elevation_deg: Sequence[float] = (0.0, 90.0),
) -> NDArray[np.float32]:
    """Compute spatial spectra [.., H, W] from channels with the formula of the simulator.

    A pixel is the amplitude abs(aᴴh)/A with the steering vector a = exp(+j2π/λ p·u) of its direction u in the receiver
    frame. Each spectrum is stretched from its smallest value (0) to its largest (1), so absolute power is lost. Without a
    signal, or if all directions are equally strong, the spectrum is 0.

    Parameters
    ----------
    csi : channels, complex: [.., A] at one frequency, or [.., A, F]; a path of length d has the phase exp(-jkd)
    antennas : antenna positions [A, 3], metres, receiver frame (boresight is z); or a ``Receiver``
    frequency_hz : one frequency for [.., A]; frequencies [F] for [.., A, F], over which the power of a pixel is averaged
    shape : rows H and columns W; column c has azimuth c · 360/W degrees
    elevation_deg : first and last elevation; row r has elevation first + r · (last - first)/H degrees
    """
    places = _antennas(antennas)
    frequencies = np.asarray(frequency_hz, float)
    if frequencies.ndim > 1 or not frequencies.size or not (np.isfinite(frequencies) & (frequencies > 0)).all():
        raise InputError("frequency_hz must be a positive frequency, or frequencies [F]")
    channels = _channels(csi, len(places), frequencies)
    sizes, ends = np.asarray(shape), np.asarray(elevation_deg, float)
    if sizes.shape != (2,) or sizes.dtype.kind not in "iu" or sizes.min() < 1:
        raise InputError(f"shape is {shape}, expected at least one row and one column")
    if ends.shape != (2,) or not np.isfinite(ends).all():
        raise InputError(f"elevation_deg is {elevation_deg}, expected two angles in degrees, such as (0, 90)")
    height, width = shape
    first, last = ends
    elevations = np.deg2rad(first + np.arange(height) * (last - first) / height)[:, None]
    azimuths = np.deg2rad(np.arange(width) * 360.0 / width)
    up = np.broadcast_to(np.sin(elevations), shape)
    across = np.cos(elevations)
    directions = np.stack([across * np.cos(azimuths), across * np.sin(azimuths), up], axis=-1).reshape(-1, 3)
    flat = channels.reshape(-1, len(places), frequencies.size)
    found = np.empty((len(flat), len(directions)), np.float32)
    rows = max(_BLOCK // max(len(directions), 1), 1)
    for start in range(0, len(flat), rows):
        power = _power(flat[start : start + rows], places, np.atleast_1d(frequencies), directions)
        found[start : start + rows] = _stretched(np.sqrt(power))
    return found.reshape(*channels.shape[:-2], height, width)


def _antennas(antennas: Any) -> Array:
    """Antenna positions [A, 3] in metres, checked."""
    places = np.asarray(antennas.antennas if isinstance(antennas, Receiver) else antennas, float)
    if places.ndim != 2 or places.shape[1] != 3 or not len(places) or not np.isfinite(places).all():
        raise InputError(f"antennas has shape {list(places.shape)}, expected finite positions [A, 3] in metres")
    return places


def _channels(csi: Any, count: int, frequencies: Array) -> Array:
    """Channels [.., A, F], checked against the number of antennas and the frequencies."""
    channels = np.asarray(csi)
    if channels.dtype.kind != "c":
        raise InputError(f"csi has the type {channels.dtype}, expected complex channels")
    wanted, names = ((count, frequencies.size), "[.., A, F]") if frequencies.ndim else ((count,), "[.., A]")
    if channels.shape[-len(wanted) :] != wanted:
        raise InputError(
            f"csi has shape {list(channels.shape)}, expected {names} = [.., {', '.join(map(str, wanted))}]: there are {count} "
            f"antennas and {'one frequency' if not frequencies.ndim else f'{frequencies.size} frequencies'}"
        )
    if not np.isfinite(channels).all():
        place = np.argwhere(~np.isfinite(channels))[0].tolist()
        raise InputError(f"csi{place} is not finite; leave out channels without a measurement")
    return channels if frequencies.ndim else channels[..., None]


def _power(channels: Array, antennas: Array, frequencies: Array, directions: Array) -> Array:
    """Sum of |aᴴh|² over frequencies [N, P], of channels [N, A, F] in directions [P, 3]."""
    power = np.zeros((len(channels), len(directions)))
    step = max(_BLOCK // len(antennas), 1)
    for column, frequency in enumerate(frequencies):
        h = channels[:, :, column].astype(complex)
        for start in range(0, len(directions), step):
            lag = directions[start : start + step] @ antennas.T * (2 * np.pi * frequency / SPEED_OF_LIGHT)
            beams = h @ np.exp(-1j * lag).T
            power[:, start : start + step] += beams.real**2 + beams.imag**2
    return power


def _stretched(amplitude: Array) -> Array:
    """Each row [P] from its smallest value (0) to its largest (1); 0 without contrast."""
    low, high = amplitude.min(axis=1, keepdims=True), amplitude.max(axis=1, keepdims=True)
    contrast = high - low
    flat = contrast <= _NO_CONTRAST * high
    stretched: Array = np.where(flat, 0.0, (amplitude - low) / np.where(flat, 1.0, contrast))
    return stretched
