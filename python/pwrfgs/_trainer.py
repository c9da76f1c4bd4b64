"""`Trainer`: custom training loops."""

from __future__ import annotations

import os
from typing import Any, Callable, Dict, Mapping, Optional, Tuple, Union

from . import _arrays, _pwrfgs, _strategies
from ._errors import InputError
from ._log import STEPS, log
from ._pipeline import Pipeline
from ._types import Array, Cloud, Gaussians, Stats

PathLike = Union[str, "os.PathLike[str]"]
Loss = Callable[[Array, Array], Tuple[float, Array]]


class Trainer:
    """Custom training loop: call ``step()`` until ``finished``. No files are written.

    Parameters
    ----------
    pipeline
        A ``Pipeline``, or anything from which one is made.
    dataset
        Data; default: those of the pipeline.
    train
        Links of the training set, indices or a mask [L]; default: the training set of the pipeline's split.
    loss
        A function ``loss(predictions, truths) -> (value, derivative)`` in place of the loss of the pipeline. Both arguments
        are spectra [B, H, W], powers [B] or channels [B, A, F]; ``derivative`` is that of ``value`` with respect to the
        predictions, in the same shape (∂/∂Re + i ∂/∂Im for channels). ``pwrfgs.torch.loss`` makes one from a PyTorch
        function. With ``training.stride`` the arrays hold every ``stride``-th pixel, with ``training.rays`` the drawn
        pixels [1, 1, P].
    """

    def __init__(
        self,
        pipeline: Any,
        dataset: Optional["_pwrfgs.Dataset"] = None,
        *,
        train: Optional[Any] = None,
        loss: Optional[Loss] = None,
    ) -> None:
        self._begin(pipeline, dataset, train, loss, None)

    def _begin(
        self,
        pipeline: Any,
        dataset: Optional["_pwrfgs.Dataset"],
        train: Optional[Any],
        loss: Optional[Loss],
        checkpoint: Optional[PathLike],
    ) -> None:
        if loss is not None and not callable(loss):
            raise InputError(f"loss is {loss!r}; give a function of predictions and truths")
        self.pipeline = Pipeline(pipeline)
        _strategies.check(self.pipeline)
        self.dataset = self.pipeline.load_data() if dataset is None else dataset
        self._inner = _pwrfgs.Trainer(self.pipeline._inner, self.dataset, train, loss, checkpoint)

    @classmethod
    def load(
        cls,
        path: PathLike,
        pipeline: Any,
        dataset: Optional["_pwrfgs.Dataset"] = None,
        *,
        train: Optional[Any] = None,
        loss: Optional[Loss] = None,
    ) -> "Trainer":
        """Trainer at the checkpoint ``path``, which ``save_checkpoint`` or a run wrote with the same settings, data and
        training set; a finished run keeps it with ``keep_checkpoint``. The next steps are bit-identical to those without
        the interruption; pass the same ``loss``."""
        trainer = cls.__new__(cls)
        trainer._begin(pipeline, dataset, train, loss, path)
        return trainer

    def save_checkpoint(self, path: PathLike) -> None:
        """Write a checkpoint for ``load``: parameters, moments, statistics and the step. Replaces an existing file."""
        self._inner.save_checkpoint(path)

    def step(self) -> Dict[str, Any]:
        """Perform one step: batch, gradients, Adam, then densification or pruning if due. Returns step, phase, loss, penalty
        and gaussians (N after the step). After an exception, the trainer accepts no further step."""
        report = dict(self._inner.step())
        log.log(STEPS, "step %(step)d: loss %(loss).4g, N %(gaussians)d", report)
        return report

    @property
    def done(self) -> int:
        """Number of completed steps."""
        return int(self._inner.done)

    @property
    def finished(self) -> bool:
        """Whether all steps are completed."""
        return bool(self._inner.finished)

    @property
    def cloud(self) -> Cloud:
        """Current Gaussians, as a copy."""
        cloud: Cloud = self._inner.cloud
        return cloud

    def set_cloud(self, cloud: Union[Cloud, Gaussians, Mapping[str, Any]]) -> None:
        """Replace the Gaussians, for example by those of your own optimiser.

        ``cloud`` is a ``Cloud`` (unconstrained columns, as in ``trainer.cloud``), or ``Gaussians`` in space (as in
        ``model.gaussians()``), or a mapping with the names of either. With the same number of Gaussians, moments of Adam,
        statistics and columns of pruners keep their values; otherwise they start anew. Columns of pruners may be given in a
        ``Cloud`` only."""
        self._inner.set_cloud(*_arrays.columns(cloud))

    @property
    def stats(self) -> Stats:
        """Statistics of the Gaussians since the last densification, as a copy."""
        stats: Stats = self._inner.stats
        return stats

    def prune(self, keep: Any) -> int:
        """Remove the Gaussians with ``keep`` [N] false, with their moments and statistics; returns the remaining number."""
        return int(self._inner.prune(keep))

    def model(self) -> "_pwrfgs.Model":
        """Current model."""
        return self._inner.model()

    def __repr__(self) -> str:
        return f"<Trainer of {self.pipeline.name}: step {self.done} of {self.pipeline.training.steps}, N {len(self.cloud)}>"
