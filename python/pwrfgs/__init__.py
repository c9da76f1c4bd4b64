"""pwrfgs: pruned 3D Gaussian splatting for wireless radiance fields.

A prediction in three lines:

    import pwrfgs
    model = pwrfgs.load("s23")                         # or a run folder, or a model file
    spectrum = model.predict([3.5, 2.2, 1.2])          # [H, W]

Every plugin of the toolkit is a class here, such as ``pwrfgs.LearnableMask(lambda_=0.02)``; enums of settings are in
``pwrfgs.settings``, such as ``pwrfgs.settings.Rays.Same(400)``. Custom strategies derive from ``pwrfgs.Pruner``,
``Initializer``, ``Split``, ``Baseline``, ``Metric`` and ``Deformation``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, List

from . import baselines, convert, datasets, metrics, plot, settings
from ._check import Check, check
from ._compare import Comparison, compare
from ._errors import Error, InputError
from ._inspection import Inspection, inspect
from ._kernels import project, rasterize, rasterize_with_vjp
from ._pipeline import Pipeline
from ._plugins import *  # noqa: F403  one class for each plugin
from ._pwrfgs import Dataset, Model, View, __version__, devices, use_device
from ._results import Finding, Interval, Located, Placement, Plan, RadioMap
from ._run import Run, evaluate, report, run, simulate
from ._spectrum import spectrum
from ._strategies import Baseline, Deformation, Initializer, Metric, Pruner, Split
from ._sweep import SweepError, sweep
from ._tasks import init, place, plan
from ._trainer import Trainer
from ._types import (
    Cloud, Column, Gaussians, Links, Partition, Pose, Receiver, ReceiverSample, Room, Sample, Splats, Stats, StepContext,
)
from ._values import Value
from .metrics import repeatability
from . import _plugins

load = Model.load

__all__: List[str] = [
    "Baseline", "Check", "Cloud", "Column", "Comparison", "Dataset", "Deformation", "Error", "Finding", "Gaussians",
    "Initializer", "InputError", "Inspection", "Interval", "Links", "Located", "Metric", "Model", "Partition",
    "Pipeline", "Placement", "Plan", "Pose", "Pruner", "RadioMap", "Receiver", "ReceiverSample", "Room", "Run",
    "Sample", "Splats", "Split", "Stats", "StepContext", "SweepError", "Trainer", "Value", "View", "__version__",
    "baselines", "check", "compare", "convert", "datasets", "devices", "evaluate", "init", "inspect", "load", "metrics",
    "place", "plan", "plot", "project", "rasterize", "rasterize_with_vjp", "repeatability", "report", "run", "settings",
    "simulate", "spectrum", "sweep", "use_device",
]
__all__ += _plugins.__all__


if TYPE_CHECKING:  # to checkers a module with `__getattr__` would have every name
    from . import sklearn as sklearn, torch as torch
else:

    def __getattr__(name: str) -> Any:
        if name in ("sklearn", "torch"):  # only where they are
            import importlib

            return importlib.import_module(f"pwrfgs.{name}")
        from ._values import unknown

        if name in settings.__all__:
            raise AttributeError(f"pwrfgs has no name `{name}`; it is pwrfgs.settings.{name}")
        raise AttributeError(unknown("pwrfgs", name, __all__).replace("field", "name", 1).split(" (there")[0])
