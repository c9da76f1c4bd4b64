"""pwrfgs: pruned 3D Gaussian splatting for wireless radiance fields.

A prediction in three lines:

    import pwrfgs
    model = pwrfgs.Model.load("runs/quickstart")
    spectrum = model.predict([3.5, 2.2, 1.2])          # [H, W]

Every plugin of the toolkit is a class here, such as ``pwrfgs.LearnableMask(lambda_=0.02)``; enums of settings are in
``pwrfgs.settings``, such as ``pwrfgs.settings.Rays.Same(400)``. Custom strategies derive from ``pwrfgs.Pruner``,
``Initializer``, ``Split``, ``Baseline`` and ``Metric``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, List

from . import baselines, datasets, metrics, plot, settings
from ._errors import Error, InputError
from ._kernels import project, rasterize, rasterize_with_vjp
from ._pipeline import Pipeline
from ._plugins import *  # noqa: F403  one class for each plugin
from ._pwrfgs import Dataset, Model, __version__
from ._run import Run, SweepError, Trainer, report, run, simulate, sweep
from ._strategies import Baseline, Initializer, Metric, Pruner, Split
from ._types import Cloud, Column, Gaussians, Links, StepContext, Partition, Pose, Receiver, Room, Splats, Stats
from ._values import Value
from .metrics import repeatability
from . import _plugins

__all__: List[str] = [
    "Baseline", "Cloud", "Column", "Dataset", "Error", "Gaussians", "Initializer", "InputError", "Links", "Metric", "Model",
    "StepContext", "Partition", "Pipeline", "Pose", "Pruner", "Receiver", "Room", "Run", "Splats", "Split", "Stats", "SweepError", "Trainer",
    "Value", "__version__", "baselines", "datasets", "metrics", "plot", "project", "rasterize", "rasterize_with_vjp", "repeatability",
    "report", "run", "settings", "simulate", "sweep",
]
__all__ += _plugins.__all__


if TYPE_CHECKING:  # to checkers a module with `__getattr__` would have every name
    from . import torch as torch
else:

    def __getattr__(name: str) -> Any:
        if name == "torch":  # only where torch is
            import importlib

            return importlib.import_module("pwrfgs.torch")
        from ._values import CLASSES, unknown

        known = [*__all__, *map(str, CLASSES)]
        raise AttributeError(unknown("pwrfgs", name, known).replace("field", "name", 1).split(" (there")[0])
