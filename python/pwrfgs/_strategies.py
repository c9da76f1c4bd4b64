"""Custom strategies: base classes, and how a run folder records their objects."""

from __future__ import annotations

import ast
import hashlib
import importlib
import inspect
import json
import linecache
import sys
import types
from typing import TYPE_CHECKING, Any, Dict, Iterable, List, Mapping, Optional, Sequence, Set, Tuple, Union

from ._errors import InputError
from ._types import Array, Cloud, Column, Links, StepContext, Room, Stats


# Where a class keeps its source as it was when it was defined: a file may change while its class is used.
TEXT = "_pwrfgs_source"


class Strategy:
    """Common base of custom strategies."""

    def __init_subclass__(cls, **given: Any) -> None:
        super().__init_subclass__(**given)
        if not cls.__module__.startswith("pwrfgs."):
            setattr(cls, TEXT, source(cls))

    if not TYPE_CHECKING:  # to checkers, an object would have every attribute

        def __setattr__(self, name: str, value: Any) -> None:
            """Set an attribute. A setting of an object that was read from a pipeline changes the pipeline too."""
            place, holder = vars(self).get("_place", (None, None))
            if holder == id(self) and name in inspect.signature(type(self)).parameters:  # not in a copy of the object
                place.replace(self, type(self)(**{**settings_of(self), name: value}))
            object.__setattr__(self, name, value)


class Pruner(Strategy):
    """Base class of pruners. ``keep``, ``gate`` or ``score`` is required. With ``score`` alone, each prune step keeps the
    best, an equal share of the Gaussians, so that ``training.target_count`` remain at the end: as for the built-in pruners.

    An object is recorded by its class and the arguments of ``__init__``, which must be attributes of the same name (as in
    a dataclass). It is recreated from these when a run is resumed. State must be kept in columns; other state is lost.
    """

    def keep(self, cloud: Cloud, stats: Stats, context: StepContext) -> Array:
        """Mask of the Gaussians to keep, [N] bool; called at every prune step. A Gaussian is kept if all pruners keep it. If
        none would remain, the one with the highest ``score`` is kept, with a warning. Default: factor of ``gate`` not 0."""
        raise NotImplementedError

    def columns(self) -> Sequence[Column]:
        """Columns to add to the Gaussians during training; they survive cloning, pruning and checkpoints. The final model does
        not contain them."""
        return ()

    def needs(self, cloud: Cloud, context: StepContext) -> Iterable[str]:
        """Names of the statistics in ``stats.requested`` at a prune step: "weight", "largest_weight", "weight_per_area",
        "signal_weight" (as "signal_mean" and "signal_max"), "error" (also "high_error", of pixels above one half), "top"
        (pixels in which it has the largest weight), "sensitivity", "fisher", "elimination" (loss without each Gaussian in
        turn; cost grows with the square of N)."""
        return ()

    def score(self, cloud: Cloud, stats: Stats, context: StepContext) -> Array:
        """Importance of each Gaussian, [N]. With ``keep`` or ``gate``, only the highest matters, which is kept if all pruners
        together would remove everything. Default: opacity."""
        raise NotImplementedError

    def gate(self, cloud: Cloud, context: StepContext) -> Optional[Tuple[Any, ...]]:
        """Factor on opacity and scale during training: (factor [N], {column: derivative}), or None for no gate at this step.

        Factors range from 0 (omitted in this step) to 1. Factor i depends only on value i of a column, and the derivative is
        that of factor i with respect to value i. A third entry "existence" applies the factor to the blending weight alone.
        After ``prune_until`` the gate and its column are removed, and the factor of the remaining Gaussians is 1. Values
        between 0 and 1 jump to 1, which later steps must compensate.

        Check your derivative with a finite difference before training::

            h = 1e-3
            (up, _), (down, _) = factor(score + h), factor(score - h)
            assert numpy.allclose(factor(score)[1]["score"], (up - down) / (2 * h), atol=1e-3)
        """
        return None

    def penalty(self, cloud: Cloud, context: StepContext) -> Optional[Tuple[float, Dict[str, Array]]]:
        """Penalty added to the loss at every step until ``prune_until``: (value, {column: derivative}), or None. The derivative
        of the value has the shape of the column."""
        return None

    def update(self, cloud: Cloud, stats: Stats, context: StepContext) -> None:
        """Change columns in place, once after each step: ``cloud.columns["age"] += 1``."""


class Initializer(Strategy):
    """Base class of initialisers."""

    def initialize(self, room: Room, rng: Any) -> Dict[str, Any]:
        """Return a dict of ``means`` [N, 3] and ``scales`` [N, 3], [N] or a number, metres; optionally ``opacities``, ``quats``
        [N, 4] as w, x, y, z, and ``signals`` [N] complex. ``rng`` is a NumPy generator that depends on the seed."""
        raise NotImplementedError


class Split(Strategy):
    """Base class of splits."""

    def split(self, links: Links, rng: Any) -> Sequence[Array]:
        """Return (train, test) or (train, validation, test): link indices, or masks [L]."""
        raise NotImplementedError


class Baseline(Strategy):
    """Base class of baselines. ``name`` is shown in tables."""

    def fit(self, links: Links, observed: Array) -> Any:
        """Fit to links and their observations [L, ...]; returns an object with ``predict``, or None for itself."""
        return None

    def predict(self, tx: Array, receiver: int) -> Array:
        """Predict the observation for a transmitter at ``tx`` [3]."""
        raise NotImplementedError


class Metric(Strategy):
    """Base class of metrics. ``name``, ``unit`` and ``higher_is_better`` describe its values."""

    unit: str = ""
    higher_is_better: bool = True

    def evaluate(self, predictions: Array, truths: Array) -> Union[float, Array]:
        """Return one number, or one per sample [B], for predictions and truths [B, ...] (spectra are not clamped)."""
        raise NotImplementedError


class Deformation(Strategy):
    """Base class of networks: the effect of the transmitter on the Gaussians, ``pipeline.deformation``.

    ``forward`` and ``vjp`` must depend on their arguments alone. Positions are metres from the origin of the data, which is
    zero for coordinates below 1 km. Model files name the class: only Python predicts with such a model, and loading it
    imports the module of the class. ``pwrfgs.torch.Deformation`` derives all but the network by PyTorch.
    """

    replaces_signals: bool = False  # whether its signals replace those of the Gaussians, and are not added
    varies_geometry: bool = False  # whether ``forward`` returns scales or quats

    def weights(self) -> Dict[str, Array]:
        """Initial weights by name. Draw random numbers from a generator with a seed in the settings."""
        return {}

    def forward(self, weights: Mapping[str, Array], means: Array, tx: Array) -> Dict[str, Array]:
        """Terms for centres ``means`` [N, 3] and transmitters ``tx`` [B, 3]: "signals" [B, N, 2] (real and imaginary part),
        and, for a varying geometry, "scales" [B, N, 3] in metres and "quats" [B, N, 4], added to those of the Gaussians."""
        raise NotImplementedError

    def vjp(
        self, weights: Mapping[str, Array], means: Array, tx: Array, cotangents: Mapping[str, Array]
    ) -> Tuple[Dict[str, Array], Optional[Array]]:
        """Derivatives of Σ terms · ``cotangents`` with respect to every weight, by name, and to the centres [N, 3] (None for
        zero). Only training calls it. Check it with a finite difference."""
        raise NotImplementedError


BASES: Dict[str, type] = {
    "Deformation": Deformation,
    "Pruner": Pruner,
    "Initializer": Initializer,
    "Split": Split,
    "Baseline": Baseline,
    "Metric": Metric,
}
FIELDS = {
    "pruners": "Pruner", "initializer": "Initializer", "split": "Split", "baselines": "Baseline", "metrics": "Metric",
    "deformation": "Deformation",
}  # fmt: skip
# Fields that hold lists.
LISTS = ("pruners", "baselines", "metrics")
# What a pipeline records of an object.
RECORD = ("module", "class", "settings", "source")
# A class of a kind implements at least one of these methods.
REQUIRED = {
    "Deformation": ["forward"],
    "Pruner": ["keep", "gate", "score"],
    "Initializer": ["initialize"],
    "Split": ["split"],
    "Baseline": ["predict", "fit"],
    "Metric": ["evaluate"],
}


def digest(cls: type) -> str:
    """SHA-256 of the source of a class and its user-defined base classes."""
    theirs = ("builtins", "abc", "typing", "pwrfgs")
    own = [base for base in cls.__mro__ if base is cls or base.__module__.split(".")[0] not in theirs]
    texts = [vars(base).get(TEXT) or source(base) for base in own]
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def source(cls: type) -> str:
    """Source text of a class, or its byte code if there is no source."""
    try:
        return inspect.getsource(cls)
    except (OSError, TypeError, SyntaxError):
        return cell(cls) or repr(code(cls))


def cell(cls: type) -> Optional[str]:
    """Source text of a class in a notebook, found in the cell history through its functions."""
    for member in vars(cls).values():
        if not inspect.isfunction(member):
            continue
        own = member.__code__
        text = "".join(linecache.getlines(own.co_filename))
        try:
            nodes = list(ast.walk(ast.parse(text)))
        except SyntaxError:
            continue
        for node in nodes:
            if isinstance(node, ast.ClassDef) and node.name == cls.__name__ and node.end_lineno is not None:
                if node.lineno <= own.co_firstlineno <= node.end_lineno:
                    first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
                    return "".join(text.splitlines(True)[first - 1 : node.end_lineno])
    return None


def code(value: Any) -> Any:
    """Byte code without memory addresses."""
    if isinstance(value, type):
        members = sorted(vars(value).items())
        return [(name, code(own)) for name, own in members if not name.startswith("__") or inspect.isfunction(own)]
    if inspect.isfunction(value):
        return code(value.__code__)
    if isinstance(value, (staticmethod, classmethod)):
        return code(value.__func__)
    if isinstance(value, property):
        return [code(part) for part in (value.fget, value.fset) if part]
    if isinstance(value, types.CodeType):
        return value.co_code.hex(), value.co_names, [code(constant) for constant in value.co_consts]
    if isinstance(value, frozenset):
        return sorted(map(repr, value))
    plain = (str, bytes, int, float, complex, bool, type(None), tuple)
    return value if isinstance(value, plain) else type(value).__name__


def settings_of(value: Any) -> Dict[str, Any]:
    """Arguments that recreate an object."""
    cls = type(value)
    parameters = list(inspect.signature(cls).parameters.values())
    found = {}
    for parameter in parameters:
        if parameter.kind not in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
            raise InputError(
                f"{cls.__qualname__}: its argument `{parameter.name}` cannot be given by name and cannot be recorded; name all "
                "arguments of __init__, or use a dataclass"
            )
        if not hasattr(value, parameter.name):
            raise InputError(
                f"{cls.__qualname__}: its argument `{parameter.name}` is not an attribute, so a run folder cannot record it; "
                f"set self.{parameter.name} in __init__, or use a dataclass"
            )
        found[parameter.name] = getattr(value, parameter.name)
    return found


def written(value: Any) -> str:
    """Settings of an object as text."""
    try:
        return json.dumps(settings_of(value), sort_keys=True)
    except TypeError as error:
        raise InputError(f"{type(value).__qualname__}: settings must be numbers, strings and lists ({error})") from None


def described(value: Any) -> str:
    """RON text of a custom object."""
    cls = type(value)
    if isinstance(value, type):
        raise InputError(f"{value.__qualname__} is a class; give an object of it, such as {value.__qualname__}()")
    required = sum(REQUIRED.values(), [])
    if not any(callable(getattr(value, method, None)) for method in required):
        raise InputError(
            f"{value!r} is not a valid pipeline value; give a number, a string, a list, a plugin such as "
            "pwrfgs.LightGaussian(), or an object with one of the methods " + ", ".join(required)
        )
    if "<locals>" in cls.__qualname__:
        raise InputError(f"{cls.__qualname__} is defined inside a function and cannot be imported; move it to module level")
    settings = written(value)
    if written(cls(**json.loads(settings))) != settings:
        raise InputError(
            f"{cls.__qualname__}: an object recreated from its settings {settings} has other settings; store every "
            "argument of __init__ unchanged under the same name, and derive other attributes from it"
        )
    fields = {"module": cls.__module__, "class": cls.__qualname__, "settings": settings, "source": digest(cls)}
    inside = ", ".join(f"{name}: {json.dumps(text, ensure_ascii=False)}" for name, text in fields.items())
    return f"Python({inside})"


def found(module: str, name: str, source: str) -> Any:
    """Class recorded in a pipeline; an error if its source has changed."""
    try:
        own: Any = sys.modules.get(module) or importlib.import_module(module)
    except ImportError as error:
        raise InputError(
            f"`{name}` comes from the Python module `{module}`, which cannot be imported ({error}); change to its folder, or "
            "add it to PYTHONPATH"
        ) from error
    for part in name.split("."):
        own = getattr(own, part, None)
        if own is None:
            where = "this session" if module == "__main__" else f"the module `{module}`"
            raise InputError(f"unknown class `{name}` in {where}; define it before you resume the run")
    if source and digest(own) != source:
        raise InputError(
            f"the source of `{name}` in `{module}` has changed since this run began; restore the old class, "
            "or start in a new folder"
        )
    return own


def check(pipeline: Any) -> None:
    """Raise an error before training if a strategy of the pipeline cannot be created: its class has changed, also in this
    session, or is of another kind."""
    for field, kind in FIELDS.items():
        values = pipeline.get(field)
        for value in values if isinstance(values, list) else [values]:
            if getattr(value, "_name", None) == "Python":
                made(kind, *(value._named[name] for name in RECORD))


def _any_of(names: Sequence[str]) -> str:
    """Names in a sentence: `a`, `b` or `c`."""
    *others, last = [f"`{name}`" for name in names]
    return f"{', '.join(others)} or {last}" if others else last


def made(kind: str, module: str, name: str, settings: str, source: str) -> Any:
    """Create the object recorded in a pipeline."""
    cls = found(module, name, source)
    # Before it is called: a file may name anything that can be imported.
    if methods(kind, cls).isdisjoint(REQUIRED[kind]):
        raise InputError(f"`{name}` does not implement {_any_of(REQUIRED[kind])}, so it is not a {kind}")
    return cls(**json.loads(settings or "{}"))


def overrides(kind: str, value: Any) -> Set[str]:
    """Methods that the class of an object overrides."""
    return methods(kind, type(value))


def methods(kind: str, cls: Any) -> Set[str]:
    """Methods that a class overrides; others are never called."""
    base = BASES[kind]
    names: List[str] = [name for name in vars(base) if not name.startswith("_")]
    return {name for name in names if getattr(cls, name, None) not in (None, getattr(base, name))}
