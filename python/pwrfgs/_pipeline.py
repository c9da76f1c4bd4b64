"""`Pipeline`: all settings of a run as one value."""

from __future__ import annotations

import inspect
import os
import re
from typing import TYPE_CHECKING, Any, List, Mapping, Optional, Sequence, Tuple, Union

from . import _pwrfgs, _strategies
from ._classes import Field, listing
from ._errors import InputError
from ._fields import PipelineFields
from ._unsaved import Store, named_in
from ._values import Value, from_ron, own, plugin_text, ron_name, to_ron, unknown, with_objects

Source = Union[str, "os.PathLike[str]", "Pipeline"]


def is_text(source: Any) -> bool:
    """Whether a string is RON, and not a path."""
    if not isinstance(source, str) or (len(source) < 4096 and os.path.exists(source)):
        return False
    return re.match(r"(?:Pipeline)?\s*\(", without_comments(source)) is not None


def without_comments(text: str) -> str:
    """RON text without leading comments."""
    return re.sub(r"\A(?:\s+|//[^\n]*|/\*.*?\*/|#!\[[^\]]*\])*", "", text, flags=re.DOTALL)


def field_text(path: str, value: Any) -> str:
    """RON text of a value for a field. Fields of plugins take their names too, such as "voxel"."""
    kind = _strategies.FIELDS.get(path)
    if kind is None:
        return to_ron(value)
    if path not in _strategies.LISTS:
        return plugin_text(kind, value, None)
    if not isinstance(value, (list, tuple)):
        raise InputError(f"{path} is {value!r}; give a list, such as [{value!r}]")
    return f"[{', '.join(plugin_text(kind, item, None) for item in value)}]"


class Pipeline(PipelineFields):
    """All settings of a run: data, split, initialiser, pruners, training, baselines and metrics.

    ``Pipeline("my.ron")`` reads a file, ``Pipeline("quickstart")`` a pipeline of the package (``pwrfgs pipelines`` lists them),
    ``Pipeline("Pipeline(name: ..)")`` a text, and ``Pipeline(name="first", data=Teacher(), initializer=Random())`` combines values. Fields are attributes, at any depth:
    ``pipeline.training.steps = 2000``. Each change is validated at once. ``str`` is RON with every default written out.
    ``help(pipeline.training)`` lists the settings of a group. A strategy in Python is read as an object of its class, if its
    module can be imported.

    Relative paths start at the folder of the file, or at the current directory.
    """

    __slots__ = ("_inner", "_data")
    _inner: _pwrfgs.Pipeline
    # Data set in memory, until it is saved; None for data in a folder.
    _data: Optional["_pwrfgs.Dataset"]

    def __init__(self, source: Optional[Source] = None, **fields: Any) -> None:
        if isinstance(source, Pipeline):
            inner = source._inner.copied()
        elif source is None:
            text = ", ".join(f"{name}: {field_text(name, value)}" for name, value in fields.items())
            inner, fields = _pwrfgs.Pipeline.parse(f"Pipeline({text})", "pipeline", os.getcwd()), {}
        elif isinstance(source, str) and is_text(source):
            inner = _pwrfgs.Pipeline.parse(source, "pipeline", os.getcwd())
        elif isinstance(source, _pwrfgs.Dataset):
            raise InputError("expected a pipeline, got a Dataset; give Pipeline.for_data(data)")
        else:
            path = os.fspath(source)
            if os.path.isdir(path):
                path = os.path.join(path, "pipeline.ron")
            text = _pwrfgs.pipeline_text(path)
            inner = _pwrfgs.Pipeline.parse(text, os.path.relpath(path), os.path.dirname(os.path.abspath(path)))
        self._begin(inner, source._data if isinstance(source, Pipeline) else None)
        if fields:
            self.set(fields)

    def _begin(self, inner: _pwrfgs.Pipeline, data: Optional["_pwrfgs.Dataset"]) -> None:
        object.__setattr__(self, "_inner", inner)
        object.__setattr__(self, "_data", data)
        self._hold()

    def _hold(self) -> None:
        """Keep the data in memory to which the text refers."""
        object.__setattr__(self, "_data", named_in(self._inner.text(), self._data))

    @classmethod
    def for_data(
        cls, data: "_pwrfgs.Dataset", name: str = "pipeline", *, effort: str = "normal", accept: Sequence[str] = ()
    ) -> "Pipeline":
        """Pipeline for data: the shipped pipeline for their kind, with split and settings for their size, as ``pwrfgs init``
        writes it. The data need no folder: ``pwrfgs.run(pwrfgs.Pipeline.for_data(data))`` writes them into the run folder.
        ``effort`` is ``fast`` (one model), ``normal`` (two minutes for small sets) or ``best`` (more models).
        ``accept`` are names of ``data.findings()`` that are accepted."""
        if not isinstance(data, _pwrfgs.Dataset):
            raise InputError(f"data: expected a Dataset, got {type(data).__name__}; Dataset.from_arrays makes one")
        source = to_ron(data)
        root = from_ron(source)._named.get("root")
        return cls(_pwrfgs.suggest_pipeline(data, source, root, name, effort, list(accept)))

    def get(self, path: str) -> Any:
        """Return the value at ``path``, such as ``"training.steps"`` or ``"pruners.LearnableMask.lambda"``."""
        value: Any = self._values()
        field = ""
        for step in path.split(".") if path else ():
            if isinstance(value, list):
                named = [item for item in value if getattr(item, "_name", None) == step]
                try:
                    value = named[0] if named else value[int(step)]
                except (ValueError, IndexError):
                    raise InputError(f"{path}: unknown entry `{step}`") from None
            else:
                field = ron_name(step)
                value = value._field(step) if isinstance(value, Value) else getattr(value, step)
        return with_objects(value, field)

    def _values(self) -> Value:
        """All fields as one value."""
        value: Value = from_ron(self._inner.text(), "Pipeline")
        own(value, self, "")
        return value

    def set(self, values: Mapping[str, Any], **more: Any) -> "Pipeline":
        """Set values by path, all or none: ``pipeline.set({"training.steps": 2000})``."""
        every = {**dict(values), **more}
        self._inner.set([(path, field_text(path, value)) for path, value in every.items()])
        self._hold()
        return self

    def _set_arguments(self, arguments: List[str]) -> None:
        """Set values by arguments of ``--set``."""
        self._inner.set_arguments(arguments)
        self._hold()

    def _settled(self, store: Optional[Store] = None) -> "Pipeline":
        """Pipeline with data in a folder: where data in memory were saved since, or where ``store`` writes them."""
        text = None if self._data is None else self._data._source if store is None else store(self._data)
        if text is None:
            return self
        settled = self.copy()
        settled._inner.set([("data", text)])
        settled._hold()
        return settled

    def __reduce__(self) -> Tuple[Any, ...]:
        return _read, (self._inner.text(), self.folder, self._data)

    def copy(self) -> "Pipeline":
        """Return a copy."""
        return Pipeline(self)

    def save(self, path: Union[str, "os.PathLike[str]"]) -> None:
        """Write a new pipeline file for the command line; relative paths become absolute. Data in memory are an error: a file
        refers to data by path."""
        settled = self._settled()
        if settled._data is not None:
            raise InputError("a pipeline file refers to data by path; call save(path) of the data first")
        settled._inner.save(os.fspath(path))

    def load_data(self) -> "_pwrfgs.Dataset":
        """Load the data set of the pipeline; data in memory are returned as they are."""
        return self._inner.data() if self._data is None else self._data

    @property
    def folder(self) -> str:
        """Base folder of relative paths."""
        return os.fspath(self._inner.folder)

    if not TYPE_CHECKING:  # a checker would take every name for a field; `_fields.pyi` has those that are there

        def __getattr__(self, name: str) -> Any:
            if name.startswith("_"):
                raise AttributeError(name)
            return getattr(self._values(), name)

        def __setattr__(self, name: str, value: Any) -> None:
            if name not in self._field_names():
                raise AttributeError(unknown("Pipeline", name, self._field_names()))
            self.set({name: value})

    def _field_names(self) -> List[str]:
        return list(self._values()._named)

    def __dir__(self) -> List[str]:
        return [*super().__dir__(), *self._field_names()]

    def __repr__(self) -> str:
        fields = self._values()._named
        data, initializer = (fields[field]._named.get("class", fields[field]._name) for field in ("data", "initializer"))
        return f"<Pipeline {self.name}: {data}, {initializer}, {self.training.steps} steps>"

    def __str__(self) -> str:
        return self._inner.text()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Pipeline) and str(self) == str(other)

    def __hash__(self) -> int:
        return hash(str(self))


_FIELDS: List[Field] = next(entry["fields"] for entry in _pwrfgs.types() if entry["name"] == "Pipeline")
Pipeline.__doc__ = inspect.cleandoc(Pipeline.__doc__ or "") + listing(
    [name for name, _, _, _ in _FIELDS], _FIELDS, [inspect.Parameter.empty] * len(_FIELDS)
)


def _read(text: str, folder: str, data: Optional["_pwrfgs.Dataset"]) -> Pipeline:
    """Restore a pickled pipeline with its data in memory."""
    pipeline = Pipeline.__new__(Pipeline)
    pipeline._begin(_pwrfgs.Pipeline.parse(text, "pipeline", folder), data)
    return pipeline
