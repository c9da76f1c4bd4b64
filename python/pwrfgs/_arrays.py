"""Conversion of Gaussians in space to the unconstrained columns of the toolkit, and models from arrays."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Optional, Tuple

import numpy as np

from . import _pwrfgs
from ._errors import InputError
from ._kernels import as_pose
from ._types import Array, Cloud, Gaussians
from ._values import Value, plugin_text, to_ron

# Opacities of the kernels range from 0 to below 1, logits are finite.
_LEAST = 1e-9


def unconstrained(gaussians: Mapping[str, Any]) -> Dict[str, Array]:
    """Columns of Gaussians in space: logarithms of scales, logits of opacities, signals as two real numbers."""
    means = np.asarray(gaussians["means"], float)
    scales = np.asarray(gaussians["scales"], float)
    opacities = np.asarray(gaussians["opacities"], float)
    quats, signals = np.asarray(gaussians["quats"], float), np.asarray(gaussians["signals"])
    n = len(means) if means.ndim == 2 else 0
    for name, array, shape in (
        ("means", means, (n, 3)), ("quats", quats, (n, 4)), ("scales", scales, (n, 3)), ("opacities", opacities, (n,)),
        ("signals", signals, (n, 2) if signals.ndim == 2 else (n,)),
    ):  # fmt: skip
        if array.shape != shape:
            raise InputError(f"{name} has shape {list(array.shape)}, expected {list(shape) if n else '[N, 3]'}")
        if not np.isfinite(array).all():
            raise InputError(f"{name} has a number that is not finite; give finite numbers")
    if not (scales > 0).all():
        raise InputError("scales: give metres above 0")
    if not ((opacities >= 0) & (opacities < 1)).all():
        raise InputError("opacities: give numbers from 0 to below 1")
    if not np.abs(quats).max(axis=1, initial=0).all():
        raise InputError("quats has a row of zeros; give rotations, such as (1, 0, 0, 0)")
    if signals.ndim == 1:
        signals = np.stack([signals.real, signals.imag], axis=1)
    opacities = np.clip(opacities, _LEAST, 1 - _LEAST)
    return {
        "means": means, "log_scales": np.log(scales), "quats": quats,
        "opacity_logits": np.log(opacities / (1 - opacities)), "signals": signals.astype(float),
    }  # fmt: skip


def columns(cloud: Any) -> Tuple[Dict[str, Array], bool]:
    """Unconstrained columns of a cloud, and whether its means are in the world frame, which ``Gaussians`` are."""
    if isinstance(cloud, Cloud):
        return dict(cloud.columns), False
    if isinstance(cloud, tuple) and hasattr(cloud, "_asdict"):
        cloud = cloud._asdict()
    if not isinstance(cloud, Mapping):
        raise InputError(f"cloud is a {type(cloud).__name__}; give a Cloud such as trainer.cloud, Gaussians, or a dict of arrays")
    needed = ("means", "log_scales", "quats", "opacity_logits", "signals")
    if "log_scales" in cloud or "opacity_logits" in cloud:
        missing = [name for name in needed if name not in cloud]
        if missing:
            raise InputError(f"cloud lacks {', '.join(missing)}")
        return {name: np.asarray(values) for name, values in cloud.items()}, False
    missing = [name for name in Gaussians._fields if name not in cloud]
    if missing:
        raise InputError(f"cloud lacks {', '.join(missing)}")
    return unconstrained(cloud), True


def model(gaussians: Any, stages: Any, view: Any, weights: Optional[Mapping[str, Any]], tx: Any) -> "_pwrfgs.Model":
    """`Model.from_arrays`, which describes the arguments."""
    projector, rasterizer, readout, deformation = stages
    pose, size, elevation_deg = view
    texts = [
        plugin_text(kind, default if given is None else given, None)
        for kind, given, default in (
            ("Deformation", deformation, "Fixed()"), ("Projector", projector, "Mercator()"),
            ("Rasterizer", rasterizer, "AlphaBlending()"),
        )
    ]  # fmt: skip
    shown = "Magnitude" if readout is None else to_ron(readout) if isinstance(readout, Value) else str(readout)
    method = "Splatting(deformation: {}, projector: {}, rasterizer: {}, readout: {})".format(*texts, shown)
    position, orientation = as_pose(pose)
    name = getattr(pose, "name", "receiver")
    given = None if weights is None else {name: np.asarray(values) for name, values in weights.items()}
    cloud = unconstrained(dict(zip(Gaussians._fields, gaussians)))
    return _pwrfgs.model_of(
        cloud, method, given, (name, position, orientation), size, elevation_deg, None if tx is None else np.atleast_2d(tx)
    )
