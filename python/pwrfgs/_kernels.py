"""The differentiable kernels, for methods of one's own."""

from __future__ import annotations

from typing import Any, Callable, Sequence, Tuple

import numpy as np

from . import _pwrfgs
from ._errors import InputError
from ._types import Array, Receiver, Splats

Vjp = Callable[[Any], Tuple[Array, Array, Array, Array, Array]]


def project(
    means: Any,
    quats: Any,
    scales: Any,
    opacities: Any,
    pose: Any,
    height: int = 90,
    width: int = 360,
    *,
    projector: Any = "Mercator",
    elevation_deg: Sequence[float] = (0.0, 90.0),
) -> Splats:
    """Gaussians in space as ellipses on a picture of the receiver's sky.

    Parameters
    ----------
    means : [N, 3], metres
    quats : [N, 4] as w, x, y, z, of any length but 0
    scales : [N, 3], metres above 0
    opacities : [N], from 0 to below 1
    pose : a ``Pose``, a ``Receiver``, or (position [3], orientation x, y, z, w) of the receiver
    projector : a projector such as ``pwrfgs.Mercator()``, or its name
    """
    splats: Splats = _pwrfgs.project(
        means, quats, scales, opacities, _pose(pose), height, width, projector, elevation_deg
    )
    return splats


def _pose(pose: Any) -> Any:
    if isinstance(pose, Receiver):
        pose = (pose.position, pose.orientation)
    try:
        position, orientation = ([float(v) for v in part] for part in pose)
    except (TypeError, ValueError):
        position, orientation = [], []
    if len(position) != 3 or len(orientation) != 4:
        raise InputError(
            f"pose is {pose!r}; give a Pose(position=(x, y, z), orientation=(x, y, z, w)), or a Receiver such as "
            "dataset.receivers[0]"
        )
    return tuple(position), tuple(orientation)


def rasterize(
    means: Any,
    quats: Any,
    scales: Any,
    opacities: Any,
    signals: Any,
    pose: Any,
    height: int = 90,
    width: int = 360,
    *,
    projector: Any = "Mercator",
    rasterizer: Any = "AlphaBlending",
    elevation_deg: Sequence[float] = (0.0, 90.0),
) -> Array:
    """Draws Gaussians on the receiver's sky.

    ``signals`` [N] complex give a complex picture [H, W]; [N, C] real ones a picture [C, H, W]. Other arguments as in
    ``project``. The derivative is ``rasterize_with_vjp``, and ``pwrfgs.torch.rasterize`` for PyTorch.
    """
    return rasterize_with_vjp(
        means, quats, scales, opacities, signals, pose, height, width,
        projector=projector, rasterizer=rasterizer, elevation_deg=elevation_deg,
    )[0]


def rasterize_with_vjp(
    means: Any,
    quats: Any,
    scales: Any,
    opacities: Any,
    signals: Any,
    pose: Any,
    height: int = 90,
    width: int = 360,
    *,
    projector: Any = "Mercator",
    rasterizer: Any = "AlphaBlending",
    elevation_deg: Sequence[float] = (0.0, 90.0),
) -> Tuple[Array, Vjp]:
    """``rasterize``, and the way back: a function from the derivative of a real number in the picture (of its shape; of a
    complex picture ∂/∂Re + i ∂/∂Im) to those in (means, quats, scales, opacities, signals).

    The derivative is that of the picture as it is drawn: where Gaussians change places in depth, or enter or leave a pixel at
    1/255, the picture jumps, and no derivative says so."""
    real = np.float64 if _pwrfgs.real_bytes == 8 else np.float32
    signals = np.asarray(signals)
    waves = np.iscomplexobj(signals)
    if waves:
        signals = np.stack([signals.real, signals.imag], axis=-1).astype(real)
    drawing = _pwrfgs.draw(
        means, quats, scales, opacities, signals, _pose(pose), height, width, projector, rasterizer, elevation_deg
    )
    picture: Array = drawing.image
    if waves:
        picture = picture[0] + 1j * picture[1]  # two channels, also of no Gaussian at all

    def vjp(d_picture: Any) -> Tuple[Array, Array, Array, Array, Array]:
        d_picture = np.asarray(d_picture)
        if waves:
            d_picture = np.stack([d_picture.real, d_picture.imag]).astype(real)
        means_, quats_, scales_, opacities_, signals_ = drawing.backward(d_picture)
        if waves:
            signals_ = signals_[:, 0] + 1j * signals_[:, 1]
        return means_, quats_, scales_, opacities_, signals_

    return picture, vjp
