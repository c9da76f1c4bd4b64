"""What notebooks show of data sets, models and runs: a table, and an image of spectra."""

from __future__ import annotations

import base64
import html
import struct
import zlib
from typing import Any, Dict, List, Optional

import numpy as np

from . import _pwrfgs
from ._types import Array

# Colours of the reports from dark to bright (viridis at five points), R, G, B.
_COLOURS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
_SHOWN = 4


def png(image: Array) -> bytes:
    """PNG of values from 0 to 1, [H, W]."""
    height, width = image.shape
    at = np.clip(np.nan_to_num(image), 0, 1) * (len(_COLOURS) - 1)
    colours = np.stack([np.interp(at, range(len(_COLOURS)), channel) for channel in _COLOURS.T], axis=-1)
    rows = np.concatenate([np.zeros((height, 1), np.uint8), colours.round().astype(np.uint8).reshape(height, -1)], axis=1)

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows.tobytes())) + chunk(b"IEND", b"")


def figure(image: Array, caption: str) -> str:
    """Image with a caption."""
    data = base64.b64encode(png(image)).decode()
    style = "width: 260px; image-rendering: pixelated"
    text = html.escape(caption)
    return (
        f'<figure style="display: inline-block; margin: 4px"><img alt="{text}" style="{style}" '
        f'src="data:image/png;base64,{data}"><figcaption>{text}</figcaption></figure>'
    )


def scatter(places: Array, values: Optional[Array], caption: str) -> str:
    """Map of positions from above as SVG, coloured by ``values`` from 0 to 1."""
    xy = np.asarray(places, float)[:, :2]
    low, side = xy.min(axis=0), max(float(np.ptp(xy, axis=0).max()), 1e-9)
    at = 6 + 188 * (xy - low) / side
    shades = np.zeros(len(xy)) + 0.5 if values is None else values
    colours = [np.interp(shades, np.linspace(0, 1, len(_COLOURS)), channel).astype(int) for channel in _COLOURS.T]
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{200 - y:.1f}" r="3" fill="rgb({r},{g},{b})"/>' for (x, y), r, g, b in zip(at, *colours)
    )
    text = html.escape(caption)
    return f'<figure style="margin: 4px"><svg width="200" height="200">{dots}</svg><figcaption>{text}</figcaption></figure>'


def _place(moving: str, position: Array) -> str:
    return f"{moving} at " + ", ".join(f"{v:.2f}" for v in position) + " m"


def _thinned(count: int, most: int) -> Array:
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def page(title: str, *parts: str) -> str:
    return f"<div><code>{html.escape(title)}</code><br>{''.join(parts)}</div>"


def dataset(data: "_pwrfgs.Dataset") -> str:
    """Some spectra, or a map of the transmitters, coloured by the strongest received power."""
    moving = "transmitter" if data.rx_pose is None else "receiver"
    if data.kind == "spectrum":
        shown = [int(i) for i in _thinned(len(data), _SHOWN)]
        positions = data.positions
        return page(repr(data), *(figure(data[i].observation, _place(moving, positions[i])) for i in shown))
    links = _thinned(len(data), 2000)
    strength = np.abs(np.asarray(data.observations(links))).reshape(len(links), -1).mean(axis=1)
    if data.kind == "power":
        strength = np.asarray(data.observations(links), float)
    caption = f"{moving}s from above, bright: strong"
    return page(repr(data), scatter(data.positions[links], _unit(strength), caption))


def _unit(values: Array) -> Array:
    low, high = float(values.min()), float(values.max())
    unit: Array = (values - low) / max(high - low, 1e-12)
    return unit


def model(own: "_pwrfgs.Model") -> str:
    """A predicted spectrum at a training position, and the centres of the Gaussians from above."""
    parts: List[str] = []
    places = own.training_positions
    if own.kind == "spectrum" and places is not None:
        first = places[0]
        ends: Dict[str, Any] = {"tx": first} if own.moving == "transmitter" else {"rx_pose": [*first, 0.0, 0.0, 0.0, 1.0]}
        parts.append(figure(np.asarray(own.predict(**ends)), "prediction, " + _place(own.moving, first)))
    means, _, _, opacities, _ = own.gaussians()
    if len(means):
        rows = _thinned(len(means), 2000)
        parts.append(scatter(means[rows], opacities[rows], "Gaussians from above, bright: opaque"))
    return page(repr(own), *parts)


def run(text: str, model_of: Any, finished: bool) -> str:
    """Scores, and the model of a finished run."""
    table = f"<pre>{html.escape(text)}</pre>"
    return f"<div>{table}{model(model_of()) if finished else ''}</div>"
