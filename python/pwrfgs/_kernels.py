"""Differentiable kernels for custom methods."""

from __future__ import annotations

from typing import Any, Callable, List, Sequence, Tuple

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
    """Project Gaussians to ellipses on the image plane of a receiver.

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
        means, quats, scales, opacities, as_pose(pose), height, width, projector, elevation_deg
    )
    return splats


def as_pose(pose: Any) -> Tuple[Tuple[float, ...], Tuple[float, ...]]:
    """Position and orientation of a pose in any form."""
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
    """Render Gaussians on the image plane of a receiver.

    Complex ``signals`` [N] give a complex image [H, W]; real ``signals`` [N, C] give an image [C, H, W]. Other arguments
    as in ``project``. For gradients use ``rasterize_with_vjp``, or ``pwrfgs.torch.rasterize`` with PyTorch.
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
    """Render, and return the vector-Jacobian product: a function from the gradient of a real loss with respect to the image
    (same shape; ∂/∂Re + i ∂/∂Im for a complex image) to the gradients of (means, quats, scales, opacities, signals).

    The image is discontinuous where Gaussians swap their depth order, or enter or leave a pixel at an opacity of 1/255. The
    gradient does not include these jumps."""
    picture, vjp = rasterize_with_pose_vjp(
        means, quats, scales, opacities, signals, pose,
        height=height, width=width, projector=projector, rasterizer=rasterizer, elevation_deg=elevation_deg,
    )
    return picture, lambda d_picture: tuple(vjp(d_picture)[:5])  # type: ignore[return-value]


def rasterize_with_pose_vjp(
    means: Any, quats: Any, scales: Any, opacities: Any, signals: Any, pose: Any, **view: Any
) -> Tuple[Array, Callable[[Any], List[Array]]]:
    """As ``rasterize_with_vjp``, with two more gradients: those of position [3] and orientation [4] of the receiver.
    ``view`` holds the other arguments."""
    real = np.float64 if _pwrfgs.real_bytes == 8 else np.float32
    signals = np.asarray(signals)
    waves = np.iscomplexobj(signals)
    if waves:
        signals = np.stack([signals.real, signals.imag], axis=-1).astype(real)
    drawing = _pwrfgs.draw(means, quats, scales, opacities, signals, as_pose(pose), **view)
    picture: Array = drawing.image
    if waves:
        picture = picture[0] + 1j * picture[1]  # two channels, also of no Gaussian at all

    def vjp(d_picture: Any) -> List[Array]:
        d_picture = np.asarray(d_picture)
        if waves:
            d_picture = np.stack([d_picture.real, d_picture.imag]).astype(real)
        found: List[Array] = list(drawing.backward(d_picture))
        if waves:
            found[4] = found[4][:, 0] + 1j * found[4][:, 1]
        return found

    return picture, vjp
