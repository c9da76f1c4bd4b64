"""PyTorch: ``rasterize`` and ``predict`` support autograd, and from PyTorch 2.0 on ``torch.func`` and ``torch.vmap``, which calls
them item by item; ``loss`` and ``Deformation`` make a loss and a network of your own for training.
Requires torch, which is imported only here."""

from __future__ import annotations

import threading
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from . import _pwrfgs, _strategies
from ._errors import InputError, missing
from ._kernels import as_pose, rasterize_with_pose_vjp
from ._types import Array, Pose, Receiver
from ._values import plugin_text

try:
    import torch
except ModuleNotFoundError:
    raise missing("torch", "torch") from None

Vjp = Callable[[Array], Sequence[Array]]

# What the kernels of this build compute in, and narrower numbers, which lose nothing on the way.
_REAL = (torch.float32, torch.float64)[: _pwrfgs.real_bytes // 4]
_COMPLEX = (torch.complex64, torch.complex128)[: _pwrfgs.real_bytes // 4]
_NAMES = ("means", "quats", "scales", "opacities", "signals")


def _array(x: torch.Tensor) -> Array:
    array: Array = x.detach().cpu().resolve_conj().resolve_neg().numpy()
    return array


def _tensor(array: Any, like: torch.Tensor) -> torch.Tensor:
    return torch.from_numpy(np.asarray(array, order="C")).to(like.device)


class _Work:
    """Function of arrays that returns its value and the vector-Jacobian product, of which the first is kept for the backward
    pass."""

    def __init__(self, function: Callable[..., Tuple[Any, Vjp]]) -> None:
        self.function = function
        self.vjp: Optional[Vjp] = None


def _of_both_forms(function: Any) -> Any:
    """Give a function with ``setup_context`` the form of PyTorch below 2.0, if necessary."""
    if not hasattr(torch.autograd.Function, "setup_context"):
        compute, setup_context = function.forward, function.setup_context

        def forward(ctx: Any, *inputs: Any) -> Any:
            output = compute(*inputs)
            setup_context(ctx, inputs, output)
            return output

        function.forward = staticmethod(forward)
    return function


def _one_by_one(function: Any, info: Any, in_dims: Sequence[Optional[int]], works: Callable[[], _Work], tensors: Any) -> Any:
    """Apply a function to each item of a batch of ``torch.vmap``."""

    def item(i: int) -> List[torch.Tensor]:
        return [x if dim is None else x.select(dim, i) for x, dim in zip(tensors, in_dims)]

    found = [function.apply(works(), *item(i)) for i in range(info.batch_size)]
    if isinstance(found[0], tuple):
        return tuple(map(torch.stack, zip(*found))), (0,) * len(found[0])
    return torch.stack(found), 0


@_of_both_forms
class _Computed(torch.autograd.Function):  # type: ignore[misc, unused-ignore]
    """Tensor that NumPy computes from tensors."""

    @staticmethod
    def forward(work: _Work, *tensors: torch.Tensor) -> torch.Tensor:
        value, work.vjp = work.function(*map(_array, tensors))
        return _tensor(value, tensors[0])

    @staticmethod
    def setup_context(ctx: Any, inputs: Tuple[Any, ...], output: Any) -> None:
        ctx.work, *tensors = inputs
        ctx.save_for_backward(*tensors)

    @staticmethod
    def backward(ctx: Any, d: torch.Tensor) -> Tuple[Any, ...]:
        return (None, *_Gradient.apply(ctx.work, d, *ctx.saved_tensors))

    @staticmethod
    def vmap(info: Any, in_dims: Any, work: _Work, *tensors: torch.Tensor) -> Any:
        return _one_by_one(_Computed, info, in_dims[1:], lambda: _Work(work.function), tensors)


@_of_both_forms
class _Gradient(torch.autograd.Function):  # type: ignore[misc, unused-ignore]
    """Gradients in the tensors of ``_Computed``, from that of its value. A function too, as transforms of ``torch.func`` demand."""

    @staticmethod
    def forward(work: _Work, d: torch.Tensor, *tensors: torch.Tensor) -> Tuple[torch.Tensor, ...]:
        if work.vjp is None:
            work.vjp = work.function(*map(_array, tensors))[1]
        return tuple(_tensor(found, x).to(x.dtype) for found, x in zip(work.vjp(_array(d)), tensors))

    @staticmethod
    def setup_context(ctx: Any, inputs: Tuple[Any, ...], output: Any) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, *d: torch.Tensor) -> Any:
        raise RuntimeError("functions of pwrfgs.torch have no second derivative")

    @staticmethod
    def vmap(info: Any, in_dims: Any, work: _Work, *tensors: torch.Tensor) -> Any:
        shared = all(dim is None for dim in in_dims[2:])  # a batch of cotangents alone
        return _one_by_one(_Gradient, info, in_dims[1:], lambda: work if shared else _Work(work.function), tensors)


def _drawing(settings: Dict[str, Any]) -> _Work:
    """Image of columns and pose."""

    def draw(
        means: Array, quats: Array, scales: Array, opacities: Array, signals: Array, position: Array, orientation: Array
    ) -> Tuple[Array, Vjp]:
        # The kernels normalise nearly normalised quaternions themselves, and reject zero.
        length = float(np.linalg.norm(orientation))
        length = 1.0 if length == 0 or abs(length - 1) < 1e-3 else length
        pose = position, orientation / length
        picture, vjp = rasterize_with_pose_vjp(means, quats, scales, opacities, signals, pose, **settings)
        return picture, lambda d: [*(found := vjp(d))[:6], found[6] / length]

    return _Work(draw)


def rasterize(
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    signals: torch.Tensor,
    pose: Union[Pose, Receiver, Sequence[Union[Pose, Receiver]], Tuple[torch.Tensor, torch.Tensor]],
    height: int = 90,
    width: int = 360,
    *,
    projector: Any = "Mercator",
    rasterizer: Any = "AlphaBlending",
    elevation_deg: Sequence[float] = (0.0, 90.0),
) -> torch.Tensor:
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

    def image(*columns: torch.Tensor) -> torch.Tensor:
        drawn: torch.Tensor = _Computed.apply(_drawing(settings), *columns)
        return drawn.to(columns[4].dtype)  # that of the signals

    if not sizes:
        return image(*given.values())
    if len(set(sizes.values())) > 1 or any(x.dim() > axes[name] + 1 for name, x in given.items()):
        shapes = ", ".join(f"{name} {list(given[name].shape)}" for name in sizes)
        raise InputError(f"different batches: {shapes}; give one leading axis of the same length B")
    if list(sizes) == ["signals"]:
        return _shared(given, image)
    count = next(iter(sizes.values()))
    return torch.stack([image(*(x[b] if name in sizes else x for name, x in given.items())) for b in range(count)])


def predict(
    model: _pwrfgs.Model,
    tx: Optional[torch.Tensor] = None,
    receiver: Union[str, int, None] = None,
    *,
    rx_pose: Optional[torch.Tensor] = None,
) -> torch.Tensor:
    """Observations of a trained model as ``model.predict``, with first-order gradients in ``tx``, positions [3] or [B, 3] of
    transmitters, or in ``rx_pose``, poses x, y, z, qx, qy, qz, qw of a moving receiver, [7] or [B, 7]; metres, float32 or
    float64. The length of an orientation, 1 within 0.001, has no effect.

    The weights of the model have no gradient. A model of link features, or with a network in Python, has no gradient in
    positions, and the calibration ``AsReleased`` has none in orientations; the backward pass reports it. Computes on the CPU for tensors on any device."""
    name, ends, width = ("tx", tx, 3) if rx_pose is None else ("rx_pose", rx_pose, 7)
    if ends is None or (tx is not None and rx_pose is not None):
        raise InputError("give tx, or rx_pose for a moving receiver")
    _check(name, ends, (torch.float32, torch.float64))
    if ends.dim() not in (1, 2) or ends.shape[-1] != width:
        raise InputError(f"{name} has shape {list(ends.shape)}, expected [{width}] or [B, {width}]")

    def observe(poses: Array) -> Tuple[Array, Vjp]:
        at: Dict[str, Any] = {name: poses.copy()}
        found = model.predict(receiver=receiver, **at)
        real = np.float64 if _pwrfgs.real_bytes == 8 else np.float32
        value = np.asarray(found, None if isinstance(found, np.ndarray) else real)  # one power is a float
        return value, lambda d: [model.predict(receiver=receiver, vjp=d, **at)[1]]

    found: torch.Tensor = _Computed.apply(_Work(observe), ends)
    return found


def _shared(given: Dict[str, torch.Tensor], image: Callable[..., torch.Tensor]) -> torch.Tensor:
    """Images of a batch of signals, as channels of one image."""
    signals = given["signals"]
    batch, waves = len(signals), signals.is_complex()
    channels = torch.view_as_real(signals) if waves else signals  # [B, N, C]
    flat = channels.permute(1, 0, 2).reshape(channels.shape[1], -1)
    drawn = image(*{**given, "signals": flat}.values())
    drawn = drawn.reshape(batch, channels.shape[2], *drawn.shape[1:])
    return torch.view_as_complex(drawn.permute(0, 2, 3, 1).contiguous()) if waves else drawn


def _check(name: str, x: Any, takes: Tuple[torch.dtype, ...]) -> None:
    dtype = getattr(x, "dtype", None)
    if isinstance(x, torch.Tensor) and dtype in takes:
        return
    found = dtype if isinstance(x, torch.Tensor) else type(x).__name__
    wanted = " or ".join(str(dtype) for dtype in takes)
    convert = "torch.complex64" if getattr(x, "is_complex", bool)() and name == "signals" else "torch.float32"
    raise InputError(f"{name}: unsupported type {found} (expected a tensor of {wanted}); use {name}.to({convert})")


def _poses(pose: Any, like: torch.Tensor) -> Tuple[torch.Tensor, torch.Tensor]:
    """Tensors of positions and orientations."""
    if isinstance(pose, (tuple, list)) and len(pose) == 2 and isinstance(pose[0], torch.Tensor):
        for name, x, width in (("position", pose[0], 3), ("orientation", pose[1], 4)):
            _check(name, x, (torch.float32, torch.float64))
            if x.dim() not in (1, 2) or x.shape[-1] != width:
                raise InputError(f"{name} has shape {list(x.shape)}, expected [{width}] or [B, {width}]")
        return pose[0], pose[1]
    is_list = isinstance(pose, list) and all(isinstance(one, Receiver) or len(one) == 2 for one in pose)
    position, orientation = zip(*map(as_pose, pose)) if is_list else as_pose(pose)

    def tensor(part: Any) -> torch.Tensor:
        return torch.tensor(part, dtype=torch.float64, device=like.device)

    return tensor(position), tensor(orientation)


def loss(function: Callable[[torch.Tensor, torch.Tensor], torch.Tensor]) -> Callable[[Array, Array], Tuple[float, Array]]:
    """Loss for ``Trainer(loss=..)`` from a PyTorch function of predictions and truths that returns a scalar tensor."""

    def evaluate(predictions: Array, truths: Array) -> Tuple[float, Array]:
        with torch.enable_grad():
            given = torch.from_numpy(predictions).requires_grad_()
            value = function(given, torch.from_numpy(truths))
            (slope,) = torch.autograd.grad(value, given)
        derivative: Array = slope.resolve_conj().numpy()
        return float(value.detach()), derivative

    return evaluate


class Deformation(_strategies.Deformation):
    """Base class of networks in PyTorch. Only ``module`` is required: it creates an ``nn.Module`` that maps centres [N, 3] and
    transmitter positions [B, 3] to signals [B, N, 2], or to a dict of the terms of ``pwrfgs.Deformation.forward``.

    The initial weights are those that PyTorch draws with ``seed``.
    """

    seed: int = 0

    def module(self) -> torch.nn.Module:
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

    def _network(self) -> Tuple[Dict[str, torch.nn.Parameter], torch.nn.Module, threading.Lock]:
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
    ) -> Tuple[Dict[str, torch.Tensor], Dict[str, torch.nn.Parameter], torch.Tensor]:
        parameters, module, lock = self._network()
        with lock:
            for name, parameter in parameters.items():
                parameter.data = torch.from_numpy(np.array(weights[name])).to(parameter.dtype)
            dtype = next(iter(parameters.values())).dtype if parameters else _REAL[-1]
            centres = torch.from_numpy(means).to(dtype).requires_grad_(learns)
            found = module(centres, torch.from_numpy(tx).to(dtype))
        terms: Dict[str, torch.Tensor] = dict(found) if isinstance(found, Mapping) else {"signals": found}
        return terms, parameters, centres
