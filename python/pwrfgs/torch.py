"""The rasterizer for PyTorch: ``pwrfgs.torch.rasterize`` takes part in autograd. Needs torch; nothing else imports it."""

from __future__ import annotations

from typing import Any, Sequence

import torch

from ._kernels import rasterize_with_vjp


class _Rasterize(torch.autograd.Function):  # type: ignore[misc, unused-ignore]
    @staticmethod
    def forward(ctx: Any, means: Any, quats: Any, scales: Any, opacities: Any, signals: Any, options: Any) -> Any:
        given = [x.detach().cpu().numpy() for x in (means, quats, scales, opacities, signals)]
        pose, settings = options
        picture, ctx.vjp = rasterize_with_vjp(*[*given, pose], **settings)
        ctx.like = means
        return torch.from_numpy(picture).to(device=means.device, dtype=means.dtype)

    @staticmethod
    def backward(ctx: Any, *d_picture: Any) -> Any:
        found = ctx.vjp(d_picture[0].detach().cpu().numpy())
        like = ctx.like
        return (*(torch.from_numpy(d).to(device=like.device, dtype=like.dtype) for d in found), None)


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
    """``pwrfgs.rasterize`` of tensors: signals [N, C] real, picture [C, H, W]. Computes on the processor in single
    precision, wherever the tensors are; gradients flow to all five."""
    settings = dict(
        height=height, width=width, projector=projector, rasterizer=rasterizer, elevation_deg=elevation_deg
    )
    return _Rasterize.apply(means, quats, scales, opacities, signals, (pose, settings))
