"""A handful of Gaussians to draw."""

import numpy as np

import pwrfgs

N = 6
POSE = pwrfgs.Pose((0.1, -0.2, 0.0), (0.0, 0.0, 0.38268343, 0.92387953))


def gaussians(seed=0):
    rng = np.random.default_rng(seed)
    return dict(
        means=rng.normal(size=(N, 3)) + [0, 0, 2.0], quats=rng.normal(size=(N, 4)), scales=rng.uniform(0.2, 0.5, (N, 3)),
        opacities=rng.uniform(0.2, 0.8, N), signals=rng.normal(size=(N, 2)),
    )
