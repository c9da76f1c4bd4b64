"""`pwrfgs.torch` against central differences, by PyTorch's own check. Runs without pytest, for the Python that has torch may
be another than the one of the other tests. Wants the package in double precision."""

import numpy as np
import torch

import pwrfgs.torch
from gaussians import POSE, gaussians


def main() -> None:
    tensors = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in gaussians(3).values()]
    for rasterizer in ("AlphaBlending", "ArrayResponse"):

        def picture(*given, rasterizer=rasterizer):
            return pwrfgs.torch.rasterize(*given, POSE, 12, 48, rasterizer=rasterizer)

        assert torch.autograd.gradcheck(picture, tensors, eps=1e-7, atol=1e-4, rtol=1e-3, nondet_tol=0)
    single = [x.detach().to(torch.float32).requires_grad_() for x in tensors]
    loss = pwrfgs.torch.rasterize(*single, POSE, 12, 48).square().mean()
    loss.backward()
    for name, x in zip(gaussians(3), single):
        assert x.grad is not None and x.grad.shape == x.shape and x.grad.dtype == x.dtype, name
        assert np.isfinite(x.grad.numpy()).all() and x.grad.abs().sum() > 0, name


if __name__ == "__main__":
    main()
    print(f"gradcheck passed, torch {torch.__version__}")
