"""A network of one's own, and a loss: importable, as a run folder must be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pwrfgs


@dataclass
class Plane(pwrfgs.Deformation):
    """Signals that are linear in the centres and the transmitter."""

    seed: int = 0

    def weights(self):
        rng = np.random.default_rng(self.seed)
        return {"centre": 0.1 * rng.normal(size=(3, 2)), "tx": 0.1 * rng.normal(size=(3, 2)), "bias": np.full(2, 0.1)}

    def forward(self, weights, means, tx):
        by_tx = (tx @ weights["tx"])[:, None]
        return {"signals": means @ weights["centre"] + by_tx + weights["bias"]}

    def vjp(self, weights, means, tx, cotangents):
        d = cotangents["signals"]
        d_weights = {"centre": means.T @ d.sum(0), "tx": tx.T @ d.sum(1), "bias": d.sum((0, 1))}
        return d_weights, d.sum(0) @ weights["centre"].T


@dataclass
class Swelling(pwrfgs.Deformation):
    """Scales that grow with the height of the transmitter."""

    varies_geometry = True

    def weights(self):
        return {"rate": np.array([0.05])}

    def forward(self, weights, means, tx):
        grown = np.abs(tx[:, 2:]) * weights["rate"]
        return {"scales": np.broadcast_to(grown[:, None], (len(tx), len(means), 3))}

    def vjp(self, weights, means, tx, cotangents):
        return {"rate": np.array([(cotangents["scales"] * np.abs(tx[:, 2:])[:, None]).sum()])}, None


def squared(predictions, truths):
    """Mean squared error, and its derivative."""
    error = predictions - truths
    return float((np.abs(error) ** 2).mean()), 2 * error / error.size
