"""Strategies of one's own: base classes to derive from, and how a run folder records an object of them."""

from __future__ import annotations

import ast
import hashlib
import importlib
import inspect
import json
import linecache
import sys
import types
from typing import Any, Dict, Iterable, List, Optional, Sequence, Set, Tuple, Union

from ._errors import InputError
from ._types import Array, Cloud, Column, Links, Moment, Room, Stats


# Where a class keeps its source as it was when it was defined: a file may change while its class is used.
TEXT = "_pwrfgs_source"


class Strategy:
    """What classes of one's own have in common."""

    def __init_subclass__(cls, **given: Any) -> None:
        super().__init_subclass__(**given)
        if not cls.__module__.startswith("pwrfgs."):
            setattr(cls, TEXT, source(cls))


class Pruner(Strategy):
    """Decides which Gaussians stay. Only ``keep`` is required.

    An object is recorded by its class and the arguments of ``__init__``, each of which must be an attribute of the same
    name (a dataclass has it so); from these it is made anew when a run is resumed. What it must remember lies in columns;
    anything else is lost.
    """

    def keep(self, cloud: Cloud, stats: Stats, moment: Moment) -> Array:
        """True for each Gaussian that stays, [N] bool; asked at every prune step. Of several pruners all must agree. Where
        none would be left, the one of the highest ``score`` stays, with a warning."""
        raise NotImplementedError

    def columns(self) -> Sequence[Column]:
        """Columns to add to the Gaussians while they are trained; they survive cloning, pruning and checkpoints. The model
        that is left has none of them."""
        return ()

    def needs(self, cloud: Cloud, moment: Moment) -> Iterable[str]:
        """Names of what ``stats.asked`` shall hold at a prune step: "weight", "largest_weight", "weight_per_area",
        "signal_weight" (as "signal_mean" and "signal_max"), "error" (also "high_error", of pixels above one half), "top"
        (pixels where it is the heaviest), "sensitivity", "fisher", "elimination" (the true loss without each, in turn: work
        that grows with the square of their number)."""
        return ()

    def score(self, cloud: Cloud, stats: Stats, moment: Moment) -> Array:
        """How much each matters, [N], larger is better: who stays if all pruners together would leave nothing. By opacity
        where it is left out."""
        raise NotImplementedError

    def gate(self, cloud: Cloud, moment: Moment) -> Optional[Tuple[Any, ...]]:
        """A factor on opacity and scale while training: (factor [N], {column: derivative}), or None for no gate at this step.

        Factors go from 0 (left out of the step) to 1. Each is worked out of the Gaussian's own number in a column, and the
        derivative is that of factor i by number i. A third entry "presence" puts the factor on the light that a Gaussian
        takes alone. At ``prune_until`` gate and column fall away, and the Gaussians that are left count whole: let ``keep``
        drop what the gate has shut; what still lies between 0 and 1 then jumps to 1, and the steps after it must make up
        for that.

        Check a derivative of yours against a difference before you train with it::

            h = 1e-3
            (up, _), (down, _) = factor(score + h), factor(score - h)
            assert numpy.allclose(factor(score)[1]["score"], (up - down) / (2 * h), atol=1e-3)
        """
        return None

    def penalty(self, cloud: Cloud, moment: Moment) -> Optional[Tuple[float, Dict[str, Array]]]:
        """A number added to the loss at every step until ``prune_until``: (value, {column: derivative}), the derivative of
        the value by every number of the column, in its shape; or None."""
        return None

    def update(self, cloud: Cloud, stats: Stats, moment: Moment) -> None:
        """Changes columns in place, once after each step: ``cloud.columns["age"] += 1``."""


class Initializer(Strategy):
    """Places the Gaussians."""

    def initialize(self, room: Room, rng: Any) -> Dict[str, Any]:
        """A dict of ``means`` [N, 3] and ``scales`` [N, 3], [N] or a number, metres; and, if wanted, ``opacities``, ``quats``
        [N, 4] as w, x, y, z, and ``signals`` [N] complex. ``rng`` is a generator of NumPy's that follows from the seed."""
        raise NotImplementedError


class Split(Strategy):
    """Divides the links."""

    def split(self, links: Links, rng: Any) -> Sequence[Array]:
        """(train, test) or (train, validation, test): places of links, or masks [L]."""
        raise NotImplementedError


class Baseline(Strategy):
    """Predicts without Gaussians, beside the model. ``name`` is what tables call it."""

    def fit(self, links: Links, observed: Array) -> Any:
        """Learns from links and what was observed of them, [L, ...]; gives what has ``predict``, or None for itself."""
        return None

    def predict(self, tx: Array, receiver: int) -> Array:
        """What is observed of a transmitter at ``tx`` [3]."""
        raise NotImplementedError


class Metric(Strategy):
    """Scores predictions. ``name``, ``unit`` and ``higher_is_better`` say what its numbers are."""

    unit: str = ""
    higher_is_better: bool = True

    def evaluate(self, predictions: Array, truths: Array) -> Union[float, Array]:
        """A number, or one a sample [B], of predictions and truths [B, ...] (spectra are not clamped)."""
        raise NotImplementedError


BASES: Dict[str, type] = {
    "Pruner": Pruner,
    "Initializer": Initializer,
    "Split": Split,
    "Baseline": Baseline,
    "Metric": Metric,
}
FIELDS = {
    "pruners": "Pruner", "initializer": "Initializer", "split": "Split", "baselines": "Baseline", "metrics": "Metric",
}  # fmt: skip
REQUIRED = {"Pruner": "keep", "Initializer": "initialize", "Split": "split", "Baseline": "predict", "Metric": "evaluate"}
FIT_MAY_GIVE_IT = "Baseline"


def digest(cls: type) -> str:
    """SHA-256 of the source of a class, and of one's own classes that it derives from."""
    theirs = ("builtins", "abc", "typing", "pwrfgs")
    own = [base for base in cls.__mro__ if base is cls or base.__module__.split(".")[0] not in theirs]
    texts = [vars(base).get(TEXT) or source(base) for base in own]
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def source(cls: type) -> str:
    """Its text; of a class of a plain prompt, which has none, its code."""
    try:
        return inspect.getsource(cls)
    except (OSError, TypeError, SyntaxError):
        return cell(cls) or repr(code(cls))


def cell(cls: type) -> Optional[str]:
    """The text of a class of a notebook: the interpreter keeps that of its cells, and functions say which is theirs."""
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
    """Code without its places in memory."""
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
    """The arguments that make an equal object."""
    cls = type(value)
    parameters = list(inspect.signature(cls).parameters.values())
    found = {}
    for parameter in parameters:
        if parameter.kind not in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
            raise InputError(
                f"{cls.__qualname__}: its argument `{parameter.name}` cannot be given by name, and so not be recorded; name all "
                "arguments of __init__, or make the class a dataclass"
            )
        if not hasattr(value, parameter.name):
            raise InputError(
                f"{cls.__qualname__}: its argument `{parameter.name}` is no attribute; a run folder must be able to say what "
                f"it was, so set self.{parameter.name} in __init__, or make the class a dataclass"
            )
        found[parameter.name] = getattr(value, parameter.name)
    return found


def written(value: Any) -> str:
    """Its settings as text."""
    try:
        return json.dumps(settings_of(value), sort_keys=True)
    except TypeError as error:
        raise InputError(f"{type(value).__qualname__}: its settings must be numbers, texts and lists ({error})") from None


def described(value: Any) -> str:
    """An object of one's own class as a pipeline records it."""
    cls = type(value)
    if isinstance(value, type):
        raise InputError(f"{value.__qualname__} is a class; give an object of it, such as {value.__qualname__}()")
    if not any(callable(getattr(value, method, None)) for method in REQUIRED.values()) and not hasattr(value, "fit"):
        raise InputError(
            f"{value!r} is nothing that a pipeline holds; give a number, a text, a list, a plugin such as "
            "pwrfgs.LightGaussian(), or an object with one of the methods " + ", ".join(REQUIRED.values())
        )
    if "<locals>" in cls.__qualname__:
        raise InputError(f"{cls.__qualname__} is defined inside a function, where nobody finds it again; move it out")
    settings = written(value)
    if written(cls(**json.loads(settings))) != settings:
        raise InputError(
            f"{cls.__qualname__}: made anew from its settings {settings} it has others; keep every argument of __init__ as it "
            "was given, under the same name, and work out the rest from it"
        )
    fields = {"module": cls.__module__, "class": cls.__qualname__, "settings": settings, "source": digest(cls)}
    inside = ", ".join(f"{name}: {json.dumps(text, ensure_ascii=False)}" for name, text in fields.items())
    return f"Python({inside})"


def found(module: str, name: str, source: str) -> Any:
    """The class that a pipeline records; refuses one whose source has changed since."""
    try:
        own: Any = sys.modules.get(module) or importlib.import_module(module)
    except ImportError as error:
        raise InputError(
            f"`{name}` comes from the Python module `{module}`, which cannot be imported ({error}); stand where it lies, or "
            "add its folder to PYTHONPATH"
        ) from error
    for part in name.split("."):
        own = getattr(own, part, None)
        if own is None:
            where = "this session" if module == "__main__" else f"the module `{module}`"
            raise InputError(f"there is no class `{name}` in {where}; define it before the run is resumed")
    if source and digest(own) != source:
        raise InputError(
            f"the source of `{name}` in `{module}` has changed since this run began, and what is left of it would be another "
            "experiment; give the old class back, or start in a new folder"
        )
    return own


def check(pipeline: Any) -> None:
    """Refuses a pipeline whose strategies cannot be made, before anything is trained: a class that has changed since, also one
    that this session has used before, or one of another kind."""
    for field, kind in FIELDS.items():
        values = pipeline.get(field)
        for value in values if isinstance(values, list) else [values]:
            if getattr(value, "_name", None) == "Python":
                made(kind, *(value._fields[name] for name in ("module", "class", "settings", "source")))


def made(kind: str, module: str, name: str, settings: str, source: str) -> Any:
    """The object that a pipeline records."""
    cls = found(module, name, source)
    required, has = REQUIRED[kind], methods(kind, cls)
    # Before it is called: a file may name anything that can be imported.
    if required not in has and not (kind == FIT_MAY_GIVE_IT and "fit" in has):
        raise InputError(f"`{name}` has no method `{required}` of its own, and so is no {kind}")
    return cls(**json.loads(settings or "{}"))


def overrides(kind: str, value: Any) -> Set[str]:
    """The methods that the class of an object has of its own."""
    return methods(kind, type(value))


def methods(kind: str, cls: Any) -> Set[str]:
    """The methods that a class has of its own: the others are never called."""
    base = BASES[kind]
    names: List[str] = [name for name in vars(base) if not name.startswith("_")]
    return {name for name in names if getattr(cls, name, None) not in (None, getattr(base, name))}
