"""Values of a pipeline: plugins, settings and choices, and their RON text."""

from __future__ import annotations

import functools
import inspect
import keyword
import math
import os
from typing import TYPE_CHECKING, Any, Dict, Iterator, List, Mapping, Optional, Protocol, Set, Tuple

import numpy as np

from . import _pwrfgs
from ._errors import InputError
from ._prose import prose
from ._unsaved import source_text

# Letters in a line of a docstring.
WIDTH = 110


class Owner(Protocol):
    """Values by path, such as a pipeline."""

    def get(self, path: str) -> Any: ...

    def set(self, values: Mapping[str, Any]) -> Any: ...


def python_name(name: str) -> str:
    """Field name in Python: ``lambda`` is ``lambda_``."""
    return name + "_" if keyword.iskeyword(name) else name


def ron_name(name: str) -> str:
    """Inverse of ``python_name``."""
    bare = name[:-1] if name.endswith("_") else name
    return bare if keyword.iskeyword(bare) else name


class Value:
    """Value of a pipeline with a name and fields, such as ``LearnableMask(lambda_=0.02)``.

    Fields are attributes; ``repr`` is RON. Setting a field of a value from a pipeline changes that pipeline.
    """

    __slots__ = ("_name", "_fields", "_items", "_owner")

    _name: Optional[str]
    _fields: Dict[str, Any]
    _items: Tuple[Any, ...]
    _owner: Optional[Tuple[Owner, str]]

    @classmethod
    def _make(cls, name: Optional[str], fields: Dict[str, Any], items: Tuple[Any, ...] = ()) -> "Value":
        value: Value = Value.__new__(CLASSES.get(name, Value) if name else Value)
        object.__setattr__(value, "_name", name)
        object.__setattr__(value, "_fields", fields)
        object.__setattr__(value, "_items", items)
        object.__setattr__(value, "_owner", None)
        return value

    def _own(self, pipeline: Owner, path: str) -> None:
        object.__setattr__(self, "_owner", (pipeline, path))
        for name, field in self._fields.items():
            own(field, pipeline, f"{path}.{name}" if path else name)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        fields = object.__getattribute__(self, "_fields")
        try:
            return fields[ron_name(name)]
        except KeyError:
            raise AttributeError(unknown(self._name or "this value", name, fields)) from None

    def __setattr__(self, name: str, value: Any) -> None:
        field = ron_name(name)
        if field not in self._fields:
            raise AttributeError(unknown(self._name or "this value", name, self._fields))
        if self._owner is not None:
            pipeline, path = self._owner
            current(self, pipeline, path)
            pipeline.set({f"{path}.{field}": value})
            self._fields[field] = pipeline.get(f"{path}.{field}")
        else:
            self._fields.update(self.replace(**{name: value})._fields)

    def __reduce__(self) -> Tuple[Any, ...]:
        return from_ron, (to_ron(self),)

    def __dir__(self) -> List[str]:
        return [*super().__dir__(), *map(python_name, self._fields)]

    def __repr__(self) -> str:
        return to_ron(self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Value) and to_ron(self) == to_ron(other)

    def __hash__(self) -> int:
        return hash(to_ron(self))

    def replace(self, **fields: Any) -> "Value":
        """Return a copy with some fields replaced."""
        merged = {**self._fields, **{ron_name(name): value for name, value in fields.items()}}
        if self._name in KINDS:
            made = CLASSES[self._name](**{python_name(name): value for name, value in merged.items()})
            assert isinstance(made, Value)
            return made
        return Value._make(self._name, merged, self._items)


def unknown(what: str, name: str, fields: Any) -> str:
    """Message for an unknown field, with the known fields and the nearest name."""
    import difflib

    names = [python_name(field) for field in fields]
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"; did you mean `{near[0]}`?" if near else ""
    there = f" (fields: {', '.join(names)})" if names else ""
    return f"{what} has no field `{name}`{hint}{there}"


class Items(List[Any]):
    """List of a pipeline: changes also apply to the pipeline."""

    _owner: Optional[Tuple[Owner, str]] = None

    def _own(self, pipeline: Owner, path: str) -> None:
        self._owner = (pipeline, path)
        for place, item in enumerate(self):
            own(item, pipeline, f"{path}.{place}")

    def __reduce__(self) -> Tuple[Any, ...]:
        return from_ron, (to_ron(self),)


def changing(method: str) -> Any:
    """List method that changes the pipeline first, so that rejected values do not enter the list."""
    plainly = getattr(list, method)

    def change(self: Items, *given: Any, **named: Any) -> Any:
        changed = list(self)
        result = plainly(changed, *given, **named)
        if self._owner is not None:
            pipeline, path = self._owner
            current(self, pipeline, path)
            pipeline.set({path: changed})
            changed = pipeline.get(path)
        list.__setitem__(self, slice(None), changed)
        return self if method in ("__iadd__", "__imul__") else result

    return functools.wraps(plainly)(change)


for _method in (
    "append", "clear", "extend", "insert", "pop", "remove", "reverse", "sort",
    "__setitem__", "__delitem__", "__iadd__", "__imul__",
):  # fmt: skip
    setattr(Items, _method, changing(_method))


def own(value: Any, pipeline: Owner, path: str) -> None:
    """Connect values from a pipeline to it, so that changes apply to it."""
    if isinstance(value, (Value, Items)):
        value._own(pipeline, path)


def current(value: Any, pipeline: Owner, path: str) -> None:
    """Raise an error for a value that is no longer at its path: a change would affect another value."""
    try:
        there = pipeline.get(path)
    except (InputError, AttributeError):
        there = None
    if there != value:
        raise InputError(f"`{path}` of the pipeline has changed since this value was read; read it again")


# Kinds of plugins by their name (`Random` is an initializer and a split), and the classes made of them.
KINDS: Dict[str, List[str]] = {}
# Variants without fields, such as `Real`: they are written without parentheses.
UNITS: Set[str] = set()
CLASSES: Dict[Optional[str], type] = {}


def to_ron(value: Any) -> str:
    """RON text of a Python value."""
    if value is None:
        return "None"
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (float, np.floating)):
        number = float(value)
        if math.isfinite(number):
            return repr(number)
        return "NaN" if math.isnan(number) else ("inf" if number > 0 else "-inf")
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, os.PathLike):
        return quoted(os.fspath(value))
    if isinstance(value, np.ndarray):
        return to_ron(value.tolist())
    if isinstance(value, Value):
        return value_text(value)
    if isinstance(value, dict):
        return "(" + ", ".join(f"{ron_name(str(name))}: {to_ron(field)}" for name, field in value.items()) + ")"
    if isinstance(value, list):
        return "[" + ", ".join(map(to_ron, value)) + "]"
    if isinstance(value, tuple):
        return "(" + ", ".join(map(to_ron, value)) + ")"
    if isinstance(value, _pwrfgs.Dataset):
        return source_text(value)
    if isinstance(value, type) and issubclass(value, Value):
        return to_ron(value())
    from . import _strategies

    return _strategies.described(value)


def quoted(text: str) -> str:
    """Quoted RON string."""

    def letter(c: str) -> str:
        return "\\" + c if c in '"\\' else c if c.isprintable() else f"\\u{{{ord(c):x}}}"

    try:
        text.encode()
    except UnicodeEncodeError:
        raise InputError(f"{text!r} is not valid UTF-8 text") from None
    return '"' + "".join(map(letter, text)) + '"'


def value_text(value: Value) -> str:
    """RON text ``Name(field: value)``."""
    inside = [f"{name}: {to_ron(field)}" for name, field in value._fields.items()]
    inside += [to_ron(item) for item in value._items]
    name = value._name or ""
    bare = name and not inside and name in UNITS
    return name if bare else f"{name}({', '.join(inside)})"


def from_ron(text: str) -> Any:
    """Parse a RON text to a value."""
    return from_node(_pwrfgs.parse_ron(text))


def from_node(node: Any) -> Any:
    kind = node[0]
    if kind == "text":
        return node[1]
    if kind == "plain":
        return plain(node[1])
    if kind == "fields":
        return Value._make(node[1], {name: from_node(field) for name, field in node[2]})
    name, items = node[1], [from_node(item) for item in node[2]]
    if kind == "list":
        return Items(items)
    if name == "Some" and len(items) == 1:
        return items[0]
    return Value._make(name, {}, tuple(items)) if name else tuple(items)


def plain(text: str) -> Any:
    named = {"true": True, "false": False, "None": None, "inf": math.inf, "-inf": -math.inf, "NaN": math.nan}
    if text in named:
        return named[text]
    try:
        digits = text.replace("_", "")
        return int(digits) if digits.lstrip("+-").isdigit() else float(digits)
    except ValueError:
        if text.isidentifier() and text not in KINDS:
            UNITS.add(text)
        return Value._make(text, {})


def plugin_text(kind: str, value: Any, settings: Optional[Dict[str, Any]]) -> str:
    """RON text of a plugin of this kind: a value, a name with settings, or a custom object."""
    if isinstance(value, str):
        if "(" in value:
            if settings:
                raise InputError(f"{kind}: {value} already has settings; pass all settings in one place")
            return value
        names = [name for name, kinds in KINDS.items() if kind in kinds]
        wanted = value.replace("_", "").lower()
        found = [name for name in names if name.lower() == wanted]
        if not found:
            raise InputError(unknown(f"{kind}", value, names).replace("has no field", "has no plugin"))
        value = CLASSES[found[0]](**(settings or {}))
    elif settings:
        raise InputError("settings need a plugin name; an object has its own settings")
    return to_ron(value)


def fitting(words: str, value: Any) -> Any:
    """Convert between lists and tuples as required by the field."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, tuple) and words.startswith("list of"):
        return list(value)
    if isinstance(value, list) and words.startswith(("(", "two numbers")):
        return tuple(value)
    if isinstance(value, str) and words in CHOICE_NAMES:
        return Value._make(value, {}) if value in CHOICE_NAMES[words] else value
    return value


def blamed(name: str, kinds: List[str], named: Dict[str, Any], fields: Dict[str, Tuple[str, str]], fault: str) -> str:
    """Message with the invalid field, if a single field is invalid."""
    if name in fault and "`" in fault:
        return fault
    for field, value in named.items():
        text = f"{name}({field}: {to_ron(value)})"
        tried = []
        for kind in kinds:
            try:
                _pwrfgs.complete(kind, text)
                break
            except InputError as error:
                tried.append(str(error))
        else:
            if fault in tried:
                wanted = f"; it takes a {fields[field][0]}" if field in fields else ""
                return f"{name}: `{python_name(field)}` is {value!r}: {fault}{wanted}"
    return fault if name in fault else f"{name}: {fault}"


def make_class(name: str, entries: List[Dict[str, Any]]) -> type:
    """Create the class of a plugin from the registry."""
    kinds = [entry["kind"] for entry in entries]
    fields: Dict[str, Tuple[str, str]] = {}
    for entry in entries:
        for field, words, doc, _ in entry["fields"]:
            fields.setdefault(field, (words, doc))

    def __init__(self: Value, *items: Any, **given: Any) -> None:
        if items:
            first = next(iter(fields), None)
            form = f"{python_name(first)}={items[0]!r}" if first else ""
            raise TypeError(f"{name} takes its settings by name, such as {name}({form})" if first else f"{name} has no settings")
        named = {ron_name(field): value for field, value in given.items()}
        for field in given:
            if entries[0]["doc"] is not None and ron_name(field) not in fields:
                raise InputError(unknown(name, field, fields))
        named = {field: fitting(fields[field][0], value) if field in fields else value for field, value in named.items()}
        text = f"{name}({', '.join(f'{field}: {to_ron(value)}' for field, value in named.items())})"
        whole: List[Dict[str, Any]] = []
        fault: Optional[InputError] = None
        for kind in kinds:
            try:
                made = from_ron(_pwrfgs.complete(kind, text))
                whole.append(dict(made._fields) if isinstance(made, Value) else {})
            except InputError as error:
                fault = fault or error
        if not whole:
            raise InputError(blamed(name, kinds, named, fields, str(fault)))
        object.__setattr__(self, "_name", name)
        # A name that means two things, and could be either still, says no more than it was given.
        object.__setattr__(self, "_fields", whole[0] if len(whole) == 1 else named)
        object.__setattr__(self, "_items", ())
        object.__setattr__(self, "_owner", None)

    defaults: Dict[str, Any] = {}
    for entry in entries:
        if entry["text"]:
            whole = from_ron(entry["text"])
            defaults.update(whole._fields if isinstance(whole, Value) else {})
    parameters = [
        inspect.Parameter(
            python_name(field), inspect.Parameter.KEYWORD_ONLY, default=defaults.get(field, inspect.Parameter.empty)
        )
        for field in fields
    ]
    about = "\n\n".join("\n".join(prose(f"{entry['kind']}. {entry['doc'] or ''}", WIDTH)) for entry in entries)
    listing = "\n".join(f"{python_name(field)} : {words}\n    {doc}" for field, (words, doc) in fields.items())
    body = {
        "__init__": __init__,
        "__slots__": (),
        "__doc__": about + (f"\n\nParameters\n----------\n{listing}" if listing else ""),
        "__signature__": inspect.Signature(parameters),
        "__module__": "pwrfgs",
    }
    return type(name, (Value,), body)


class Choice(type):
    """Enum of settings, with variants as attributes."""

    def __iter__(cls) -> Iterator[str]:
        return iter(getattr(cls, "_variants"))

    if not TYPE_CHECKING:  # a checker would take every name for one that is there

        def __getattr__(cls, name: str) -> Any:
            if name.startswith("_"):
                raise AttributeError(name)
            raise AttributeError(unknown(cls.__name__, name, cls).replace("has no field", "has no variant"))


def make_choice(entry: Dict[str, Any]) -> type:
    """Create the namespace of enum variants, such as ``Rays.Same(400)`` and ``Readout.Real``."""
    body: Dict[str, Any] = {"__doc__": entry["doc"], "__module__": "pwrfgs.settings", "_variants": []}
    for variant, doc, named, fields in entry["variants"]:
        body["_variants"].append(variant)
        if not fields:
            UNITS.add(variant)
            body[variant] = Value._make(variant, {})
            continue

        def build(
            *items: Any, _variant: str = variant, _named: bool = named, _fields: Any = fields, **given: Any
        ) -> Value:
            names = [field[0] for field in _fields]
            if not _named:
                if given or len(items) != len(names):
                    raise InputError(f"{_variant} takes {len(names)} positional values, such as {_variant}(..)")
                return Value._make(_variant, {}, items)
            if items:
                raise InputError(f"{_variant} needs named fields: {', '.join(names)}")
            missing = [field[0] for field in _fields if not field[3] and field[0] not in map(ron_name, given)]
            if missing:
                raise InputError(f"{_variant} lacks {', '.join(map(python_name, missing))}")
            for field in given:
                if ron_name(field) not in names:
                    raise InputError(unknown(_variant, field, names))
            return Value._make(_variant, {ron_name(field): value for field, value in given.items()})

        names = [python_name(field[0] if named else field[0].strip("_0") or "value") for field in fields]
        listing = "\n".join(f"{name} : {field[1]}\n    {field[2]}" for name, field in zip(names, fields))
        build.__name__ = build.__qualname__ = variant
        build.__doc__ = f"{doc}\n\nParameters\n----------\n{listing}"
        kind = inspect.Parameter.KEYWORD_ONLY if named else inspect.Parameter.POSITIONAL_ONLY
        parameters = [inspect.Parameter(name, kind) for name in names]
        build.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        body[variant] = staticmethod(build)
    return Choice(entry["name"], (), body)


def fill() -> None:
    """Create a class for every plugin."""
    by_name: Dict[str, List[Dict[str, Any]]] = {}
    for entry in _pwrfgs.registry():
        if entry["name"] != "Python":
            by_name.setdefault(entry["name"], []).append(entry)
    for name, entries in by_name.items():
        KINDS[name] = [entry["kind"] for entry in entries]
        CLASSES[name] = make_class(name, entries)


TYPES = [entry for entry in _pwrfgs.types() if "variants" in entry]
# Variants of a type that have no fields: a text may name them.
CHOICE_NAMES: Dict[str, Set[str]] = {
    entry["name"]: {variant for variant, _, _, fields in entry["variants"] if not fields} for entry in TYPES
}
fill()
CHOICES: Dict[str, type] = {entry["name"]: make_choice(entry) for entry in TYPES}
