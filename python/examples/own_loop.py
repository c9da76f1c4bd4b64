"""A training loop of your own in PyTorch, from data to report."""

from typing import Any

import numpy as np
import torch

import pwrfgs


class Signals(torch.nn.Module):  # centres [N, 3], transmitters [B, 3] -> signals [B, N, 2]
    def __init__(self) -> None:
        super().__init__()
        self.hidden, self.last = torch.nn.Linear(36, 64), torch.nn.Linear(64, 2)

    def forward(self, means: Any, tx: Any) -> Any:
        pairs = torch.cat(torch.broadcast_tensors(means, tx[:, None]), dim=2)
        waves = [wave(k * pairs) for k in (1, 2, 4) for wave in (torch.sin, torch.cos)]
        return self.last(torch.relu(self.hidden(torch.cat(waves, dim=2))))


class Network(pwrfgs.torch.Deformation):  # the model file names this class
    def module(self) -> torch.nn.Module:
        return Signals()


def main(steps: int = 400, out: str = "runs/own") -> pwrfgs.Run:
    pipeline = pwrfgs.Pipeline("quickstart")  # data, split, baselines and metrics
    data = pipeline.load_data()
    train, receiver = data.split(pipeline.split, seed=pipeline.seed).train, data.receivers[0]
    height, width = data[0].observation.shape
    start = pwrfgs.Trainer(pipeline, data).model().gaussians()
    columns = start.means, start.quats, np.log(start.scales), np.log(start.opacities / (1 - start.opacities))
    free = [torch.tensor(column, dtype=torch.float32).requires_grad_() for column in columns]
    torch.manual_seed(0)
    network = Signals()
    optimizer = torch.optim.Adam([*free, *network.parameters()], lr=3e-3)
    for step in range(steps):
        links = [data[int(i)] for i in np.random.default_rng(step).choice(train, 8, replace=False)]
        tx = torch.tensor(np.stack([link.tx for link in links]), dtype=torch.float32)
        truth = torch.tensor(np.stack([link.observation for link in links]))
        means, quats, scales, opacities = free[0], free[1], free[2].exp(), free[3].sigmoid()
        signals = torch.view_as_complex(network(means, tx))  # [B, N]
        image = pwrfgs.torch.rasterize(means, quats, scales, opacities, signals, receiver, height, width)
        loss = (image.abs() - truth).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    means, quats, log_scales, logits = [column.detach().numpy() for column in free]
    weights = {name: weight.detach().numpy() for name, weight in network.named_parameters()}
    model = pwrfgs.Model.from_arrays(
        means, quats, np.exp(log_scales), 1 / (1 + np.exp(-logits)), np.zeros(len(means)), receiver, height, width,
        deformation=Network(), weights=weights, tx=data.tx[train],
    )  # fmt: skip
    return pwrfgs.evaluate(model, pipeline, out=out)
