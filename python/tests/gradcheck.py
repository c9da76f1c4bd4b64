"""`pwrfgs.torch`: types in both builds, and in the one of double precision against central differences, by PyTorch's own check.
Runs without pytest, for the Python that has torch may be another than the one of the other tests."""

import numpy as np
import torch

import pwrfgs.torch
from gaussians import POSE, gaussians

REAL, COMPLEX = (torch.float64, torch.complex128) if pwrfgs._pwrfgs.real_bytes == 8 else (torch.float32, torch.complex64)


def tensors(seed, waves=False, dtype=REAL):
    """The columns of a few Gaussians, which want gradients; signals are complex if they are waves."""
    given = gaussians(seed)
    given["signals"] = given["signals"] @ [1, 1j] if waves else given["signals"]
    types = {"signals": {torch.float32: torch.complex64}.get(dtype, COMPLEX) if waves else dtype}
    return {name: torch.tensor(x).to(types.get(name, dtype)).requires_grad_() for name, x in given.items()}


def refused(change, words):
    given = {**tensors(3), **change}
    try:
        pwrfgs.torch.rasterize(**given, pose=POSE, height=12, width=48)
    except pwrfgs.InputError as error:
        assert words in str(error), error
    else:
        raise AssertionError(f"{words}: not refused")


def complex_signals_are_those_of_numpy():
    given = tensors(3, waves=True)
    picture = pwrfgs.torch.rasterize(**given, pose=POSE, height=12, width=48)
    arrays = {name: x.detach().numpy() for name, x in given.items()}
    want, vjp = pwrfgs.rasterize_with_vjp(**arrays, pose=POSE, height=12, width=48)
    assert picture.dtype == COMPLEX and picture.shape == (12, 48) and np.array_equal(picture.detach().numpy(), want)
    picture.abs().square().sum().backward()
    for (name, x), found in zip(given.items(), vjp(2 * want)):
        assert x.grad.dtype == x.dtype and np.allclose(x.grad.numpy(), found, rtol=1e-4, atol=1e-6), name
    assert given["signals"].grad.imag.abs().sum() > 0
    # A lazy conjugate is a view without numbers of its own.
    turned = pwrfgs.torch.rasterize(**{**given, "signals": given["signals"].detach().conj()}, pose=POSE, height=12, width=48)
    assert np.allclose(turned.detach().numpy(), want.conj())
    pwrfgs.torch.rasterize(**given, pose=POSE, height=12, width=48).conj().imag.sum().backward()


def gradients_have_the_types_of_their_tensors():
    single = tensors(3, dtype=torch.float32)
    pwrfgs.torch.rasterize(**single, pose=POSE, height=12, width=48).square().mean().backward()
    for name, x in single.items():
        assert x.grad is not None and x.grad.shape == x.shape and x.grad.dtype == x.dtype, name
        assert np.isfinite(x.grad.numpy()).all() and x.grad.abs().sum() > 0, name


def what_cannot_be_computed_is_refused():
    plain = tensors(3)
    if REAL == torch.float32:
        refused({"means": plain["means"].double()}, "means: unsupported type torch.float64")
        refused({"signals": plain["signals"].double()}, "use signals.to(torch.float32)")
        refused({"signals": plain["signals"].to(torch.complex128)}, "use signals.to(torch.complex64)")
    refused({"scales": plain["scales"].half()}, "scales: unsupported type torch.float16")
    refused({"means": plain["means"].to(COMPLEX)}, "means: unsupported type")
    refused({"opacities": [0.5] * 6}, "opacities: unsupported type list")
    picture = pwrfgs.torch.rasterize(**plain, pose=POSE, height=12, width=48)
    (slope,) = torch.autograd.grad(picture.square().sum(), plain["means"], create_graph=True)
    try:
        slope.square().sum().backward()
    except RuntimeError as error:
        assert "once_differentiable" in str(error), error
    else:
        raise AssertionError("a second derivative did not raise an error")


def derivatives_are_central_differences():
    for waves, rasterizer in [(False, "AlphaBlending"), (False, "ArrayResponse"), (True, "AlphaBlending"), (True, "ArrayResponse")]:

        def picture(*given, rasterizer=rasterizer):
            return pwrfgs.torch.rasterize(*given, POSE, 12, 48, rasterizer=rasterizer)

        given = list(tensors(3, waves).values())
        assert torch.autograd.gradcheck(picture, given, eps=1e-7, atol=1e-4, rtol=1e-3, nondet_tol=0)


def main() -> None:
    complex_signals_are_those_of_numpy()
    gradients_have_the_types_of_their_tensors()
    what_cannot_be_computed_is_refused()
    if REAL == torch.float64:
        derivatives_are_central_differences()


if __name__ == "__main__":
    main()
    print(f"gradcheck of {REAL} passed, torch {torch.__version__}")
