"""The rasterizer for PyTorch: ``pwrfgs.torch.rasterize`` supports autograd. Requires torch, which is imported only here."""

from __future__ import annotations

from typing import Any, Sequence

from . import _pwrfgs
from ._errors import InputError, missing
from ._kernels import rasterize_with_vjp

try:
    import torch
    from torch.autograd.function import once_differentiable
except ModuleNotFoundError:
    raise missing("torch", "torch") from None

# What the kernels of this build compute in, and narrower numbers, which lose nothing on the way.
_REAL = (torch.float32, torch.float64)[: _pwrfgs.real_bytes // 4]
_COMPLEX = (torch.complex64, torch.complex128)[: _pwrfgs.real_bytes // 4]


def _array(x: Any) -> Any:
    return x.detach().cpu().resolve_conj().resolve_neg().numpy()


def _like(array: Any, x: Any) -> Any:
    return torch.from_numpy(array).to(device=x.device, dtype=x.dtype)


class _Rasterize(torch.autograd.Function):  # type: ignore[misc, unused-ignore]
    @staticmethod
    def forward(ctx: Any, means: Any, quats: Any, scales: Any, opacities: Any, signals: Any, options: Any) -> Any:
        given = means, quats, scales, opacities, signals
        ctx.like = [x.new_empty(0) for x in given]
        pose, settings = options
        picture, ctx.vjp = rasterize_with_vjp(*[*map(_array, given), pose], **settings)
        return _like(picture, signals)

    @staticmethod
    @once_differentiable  # type: ignore[untyped-decorator, unused-ignore]
    def backward(ctx: Any, d_picture: Any) -> Any:
        return (*map(_like, ctx.vjp(_array(d_picture)), ctx.like), None)


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
) -> Any:
    """Render tensors like ``pwrfgs.rasterize``: complex ``signals`` [N] give a complex image [H, W], real ``signals`` [N, C] an
    image [C, H, W]. All five inputs have first-order gradients.

    Computes on the CPU for tensors on any device, in single precision: tensors must be float32, signals float32 or complex64."""
    given = dict(means=means, quats=quats, scales=scales, opacities=opacities, signals=signals)
    for name, x in given.items():
        takes = _REAL + _COMPLEX if name == "signals" else _REAL
        dtype = getattr(x, "dtype", None)
        if not isinstance(x, torch.Tensor) or dtype not in takes:
            found = dtype if isinstance(x, torch.Tensor) else type(x).__name__
            wanted = " or ".join(str(dtype) for dtype in takes)
            convert = "torch.complex64" if getattr(x, "is_complex", bool)() and name == "signals" else "torch.float32"
            raise InputError(f"{name}: unsupported type {found} (expected a tensor of {wanted}); use {name}.to({convert})")
    settings = dict(
        height=height, width=width, projector=projector, rasterizer=rasterizer, elevation_deg=elevation_deg
    )
    return _Rasterize.apply(*given.values(), (pose, settings))
