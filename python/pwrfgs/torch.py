"""PyTorch: ``rasterize`` and ``predict`` support autograd; ``loss`` and ``Deformation`` make a loss and a network of your own for training.
Requires torch, which is imported only here."""

from __future__ import annotations

import threading
from typing import Any, Callable, Dict, Mapping, Optional, Sequence, Tuple

import numpy as np

from . import _pwrfgs, _strategies
from ._errors import InputError, missing
from ._kernels import as_pose, rasterize_with_pose_vjp
from ._types import Array, Receiver
from ._values import plugin_text

try:
    import torch
    from torch.autograd.function import once_differentiable
except ModuleNotFoundError:
    raise missing("torch", "torch") from None

# What the kernels of this build compute in, and narrower numbers, which lose nothing on the way.
_REAL = (torch.float32, torch.float64)[: _pwrfgs.real_bytes // 4]
_COMPLEX = (torch.complex64, torch.complex128)[: _pwrfgs.real_bytes // 4]
_NAMES = ("means", "quats", "scales", "opacities", "signals")


def _array(x: Any) -> Any:
    return x.detach().cpu().resolve_conj().resolve_neg().numpy()


def _like(array: Any, x: Any) -> Any:
    return torch.from_numpy(np.ascontiguousarray(array)).to(device=x.device, dtype=x.dtype)


class _Rasterize(torch.autograd.Function):  # type: ignore[misc, unused-ignore]
    @staticmethod
    def forward(ctx: Any, *given: Any) -> Any:
        *tensors, settings = given
        means, quats, scales, opacities, signals, position, orientation = map(_array, tensors)
        # The kernels normalise nearly normalised quaternions themselves, and reject zero.
        length = float(np.linalg.norm(orientation))
        length = 1.0 if length == 0 or abs(length - 1) < 1e-3 else length
        pose = position, orientation / length
        picture, vjp = rasterize_with_pose_vjp(means, quats, scales, opacities, signals, pose, **settings)
        ctx.like = [x.new_empty(0) for x in tensors]
        ctx.vjp = lambda d: [*(found := vjp(d))[:6], found[6] / length]
        return _like(picture, tensors[4])

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
    image [C, H, W]. All inputs have first-order gradients.

    A batch has one more leading axis B: ``signals`` [B, N, C] or complex [B, N] give images [B, C, H, W] or [B, H, W]. The
    other columns, and the pose, may have this axis too; signals alone are fastest, since all images then share one
    projection.

    ``pose`` is a ``Pose``, a ``Receiver``, a list of B of them, or a pair of tensors: positions [3] or [B, 3], and
    orientations x, y, z, w [4] or [B, 4]. With the projector ``Mercator``, these tensors have gradients; the one of an
    orientation is that of the normalised quaternion.

    Computes on the CPU for tensors on any device, in single precision: tensors must be float32, signals float32 or complex64."""
    given = dict(zip(_NAMES, (means, quats, scales, opacities, signals)))
    for name, x in given.items():
        _check(name, x, _REAL + _COMPLEX if name == "signals" else _REAL)
    given["position"], given["orientation"] = _poses(pose, means)
    if given["position"].requires_grad or given["orientation"].requires_grad:
        name = plugin_text("Projector", projector, None).split("(")[0]
        if name != "Mercator":  # WrfgsCompat takes the position of the receiver for a translation, as in its source
            raise InputError(f"pose: the projector {name} has no gradient in the pose; use Mercator(), or detach the pose")
    axes = dict(zip(given, (2, 2, 2, 1, 1 if signals.is_complex() else 2, 1, 1)))
    sizes = {name: len(x) for name, x in given.items() if x.dim() > axes[name]}
    settings = dict(
        height=height, width=width, projector=projector, rasterizer=rasterizer, elevation_deg=elevation_deg
    )
    if not sizes:
        return _Rasterize.apply(*given.values(), settings)
    if len(set(sizes.values())) > 1 or any(x.dim() > axes[name] + 1 for name, x in given.items()):
        shapes = ", ".join(f"{name} {list(given[name].shape)}" for name in sizes)
        raise InputError(f"different batches: {shapes}; give one leading axis of the same length B")
    if list(sizes) == ["signals"]:
        return _shared(given, settings)

    def one(b: int) -> Any:
        return _Rasterize.apply(*(x[b] if name in sizes else x for name, x in given.items()), settings)

    return torch.stack([one(b) for b in range(next(iter(sizes.values())))])


class _Predict(torch.autograd.Function):  # type: ignore[misc, unused-ignore]
    @staticmethod
    def forward(ctx: Any, ends: Any, model: Any, receiver: Any, name: str) -> Any:
        ctx.given, ctx.like = (model, receiver, {name: _array(ends).copy()}), ends.new_empty(0)
        found = model.predict(receiver=receiver, **ctx.given[2])
        kind: Dict[str, Any] = {} if isinstance(found, np.ndarray) else {"dtype": _REAL[-1]}  # one power is a float
        return torch.as_tensor(found, device=ends.device, **kind)

    @staticmethod
    @once_differentiable  # type: ignore[untyped-decorator, unused-ignore]
    def backward(ctx: Any, d: Any) -> Any:
        model, receiver, ends = ctx.given
        return _like(model.predict(receiver=receiver, vjp=_array(d), **ends)[1], ctx.like), None, None, None


def predict(model: _pwrfgs.Model, tx: Any = None, receiver: Any = None, *, rx_pose: Any = None) -> Any:
    """Observations of a trained model as ``model.predict``, with first-order gradients in ``tx``, positions [3] or [B, 3] of
    transmitters, or in ``rx_pose``, poses x, y, z, qx, qy, qz, qw of a moving receiver, [7] or [B, 7]; metres, float32 or
    float64. The length of an orientation, 1 within 0.001, has no effect.

    The weights of the model have no gradient. A model of link features, or with a network in Python, has no gradient in
    positions, and the calibration ``AsReleased`` has none in orientations; the backward pass reports it. Computes on the CPU for tensors on any device."""
    if (tx is None) == (rx_pose is None):
        raise InputError("give tx, or rx_pose for a moving receiver")
    name, ends, width = ("tx", tx, 3) if rx_pose is None else ("rx_pose", rx_pose, 7)
    _check(name, ends, (torch.float32, torch.float64))
    if ends.dim() not in (1, 2) or ends.shape[-1] != width:
        raise InputError(f"{name} has shape {list(ends.shape)}, expected [{width}] or [B, {width}]")
    return _Predict.apply(ends, model, receiver, name)


def _shared(given: Dict[str, Any], settings: Dict[str, Any]) -> Any:
    """Images of a batch of signals, as channels of one image."""
    signals = given["signals"]
    batch, waves = len(signals), signals.is_complex()
    channels = torch.view_as_real(signals) if waves else signals  # [B, N, C]
    flat = channels.permute(1, 0, 2).reshape(channels.shape[1], -1)
    image = _Rasterize.apply(*{**given, "signals": flat}.values(), settings)
    image = image.reshape(batch, channels.shape[2], *image.shape[1:])
    return torch.view_as_complex(image.permute(0, 2, 3, 1).contiguous()) if waves else image


def _check(name: str, x: Any, takes: Tuple[Any, ...]) -> None:
    dtype = getattr(x, "dtype", None)
    if isinstance(x, torch.Tensor) and dtype in takes:
        return
    found = dtype if isinstance(x, torch.Tensor) else type(x).__name__
    wanted = " or ".join(str(dtype) for dtype in takes)
    convert = "torch.complex64" if getattr(x, "is_complex", bool)() and name == "signals" else "torch.float32"
    raise InputError(f"{name}: unsupported type {found} (expected a tensor of {wanted}); use {name}.to({convert})")


def _poses(pose: Any, like: Any) -> Tuple[Any, Any]:
    """Tensors of positions and orientations."""
    if isinstance(pose, (tuple, list)) and len(pose) == 2 and isinstance(pose[0], torch.Tensor):
        for name, x, width in (("position", pose[0], 3), ("orientation", pose[1], 4)):
            _check(name, x, (torch.float32, torch.float64))
            if x.dim() not in (1, 2) or x.shape[-1] != width:
                raise InputError(f"{name} has shape {list(x.shape)}, expected [{width}] or [B, {width}]")
        return pose[0], pose[1]
    is_list = isinstance(pose, list) and all(isinstance(one, Receiver) or len(one) == 2 for one in pose)
    position, orientation = zip(*map(as_pose, pose)) if is_list else as_pose(pose)

    def tensor(part: Any) -> Any:
        return torch.tensor(part, dtype=torch.float64, device=like.device)

    return tensor(position), tensor(orientation)


def loss(function: Callable[[Any, Any], Any]) -> Callable[[Array, Array], Tuple[float, Array]]:
    """Loss for ``Trainer(loss=..)`` from a PyTorch function of predictions and truths that returns a scalar tensor."""

    def evaluate(predictions: Array, truths: Array) -> Tuple[float, Array]:
        with torch.enable_grad():
            given = torch.from_numpy(predictions).requires_grad_()
            value = function(given, torch.from_numpy(truths))
            (slope,) = torch.autograd.grad(value, given)
        derivative: Array = slope.resolve_conj().numpy()
        return float(value), derivative

    return evaluate


class Deformation(_strategies.Deformation):
    """Base class of networks in PyTorch. Only ``module`` is required: it creates an ``nn.Module`` that maps centres [N, 3] and
    transmitter positions [B, 3] to signals [B, N, 2], or to a dict of the terms of ``pwrfgs.Deformation.forward``.

    The initial weights are those that PyTorch draws with ``seed``.
    """

    seed: int = 0

    def module(self) -> Any:
        """Create the network."""
        raise NotImplementedError

    def weights(self) -> Dict[str, Array]:
        return {name: _array(value).copy() for name, value in self._network()[0].items()}

    def forward(self, weights: Mapping[str, Array], means: Array, tx: Array) -> Dict[str, Array]:
        with torch.no_grad():
            return {name: _array(term) for name, term in self._terms(weights, means, tx)[0].items()}

    def vjp(
        self, weights: Mapping[str, Array], means: Array, tx: Array, cotangents: Mapping[str, Array]
    ) -> Tuple[Dict[str, Array], Optional[Array]]:
        with torch.enable_grad():
            terms, parameters, centres = self._terms(weights, means, tx, learns=True)
            outputs = [terms[name] for name in cotangents]
            given = [torch.from_numpy(cotangents[name]).to(terms[name].dtype) for name in cotangents]
            found = torch.autograd.grad(outputs, [*parameters.values(), centres], given, allow_unused=True)
        arrays = [np.zeros(x.shape) if d is None else _array(d) for d, x in zip(found, [*parameters.values(), centres])]
        return dict(zip(parameters, arrays)), arrays[-1]

    def _network(self) -> Tuple[Dict[str, Any], Any, Any]:
        """Parameters by name, the module, and a lock: the module is created once."""
        held = self.__dict__.get("_held")
        if held is None:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(self.seed)
                module = self.module()
            held = self.__dict__["_held"] = dict(module.named_parameters()), module, threading.Lock()
        return held

    def _terms(
        self, weights: Mapping[str, Array], means: Array, tx: Array, learns: bool = False
    ) -> Tuple[Dict[str, Any], Dict[str, Any], Any]:
        parameters, module, lock = self._network()
        with lock:
            for name, parameter in parameters.items():
                parameter.data = torch.from_numpy(np.array(weights[name])).to(parameter.dtype)
            dtype = next(iter(parameters.values())).dtype if parameters else _REAL[-1]
            centres = torch.from_numpy(means).to(dtype).requires_grad_(learns)
            found = module(centres, torch.from_numpy(tx).to(dtype))
        terms = dict(found) if isinstance(found, Mapping) else {"signals": found}
        return terms, parameters, centres
