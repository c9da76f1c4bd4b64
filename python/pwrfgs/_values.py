"""Values of a pipeline: plugins, settings and enums, their text in Python and in RON."""

from __future__ import annotations

import functools
import keyword
import math
import os
from collections.abc import Mapping as Mappings
from typing import Any, ClassVar, Dict, List, Mapping, Optional, Protocol, Set, Tuple, Type

import numpy as np

from . import _pwrfgs, _strategies
from ._errors import InputError
from ._unsaved import source_text


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

    Fields are attributes; ``repr`` is Python, without fields that have their default, and ``str`` is RON. Setting a field of a
    value from a pipeline changes that pipeline.
    """

    __slots__ = ("_name", "_named", "_items", "_owner")

    # Name of the class in Python, type that it belongs to, and types and defaults of its fields.
    _path: ClassVar[str] = ""
    _type: ClassVar[str] = ""
    _types: ClassVar[Dict[str, str]] = {}
    _defaults: ClassVar[Dict[str, Any]] = {}
    _name: Optional[str]
    _named: Dict[str, Any]
    _items: Tuple[Any, ...]
    _owner: Optional[Tuple[Owner, str]]

    @classmethod
    def _make(cls, name: Optional[str], fields: Dict[str, Any], items: Tuple[Any, ...] = ()) -> "Value":
        value: Value = object.__new__(cls)
        value._fill(name, fields, items)
        return value

    def _fill(self, name: Optional[str], fields: Dict[str, Any], items: Tuple[Any, ...] = ()) -> None:
        for slot, content in (("_name", name), ("_named", fields), ("_items", items), ("_owner", None)):
            object.__setattr__(self, slot, content)

    def _own(self, pipeline: Owner, path: str) -> None:
        object.__setattr__(self, "_owner", (pipeline, path))
        for name, field in self._named.items():
            own(field, pipeline, f"{path}.{name}" if path else name)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return with_objects(self._field(name), ron_name(name))

    def _field(self, name: str) -> Any:
        """Value of a field, in which strategies in Python are values too."""
        fields = object.__getattribute__(self, "_named")
        try:
            return fields[ron_name(name)]
        except KeyError:
            raise AttributeError(unknown(self._title(), name, fields)) from None

    def _title(self) -> str:
        return self._name or self._type or "this value"

    def __setattr__(self, name: str, value: Any) -> None:
        field = ron_name(name)
        if field not in self._named:
            raise AttributeError(unknown(self._title(), name, self._named))
        if self._owner is not None:
            pipeline, path = self._owner
            current(self, pipeline, path)
            pipeline.set({f"{path}.{field}": value})
            self._named[field] = pipeline.get(f"{path}.{field}")
        else:
            self._named.update(self.replace(**{name: value})._named)

    def __reduce__(self) -> Tuple[Any, ...]:
        return from_ron, (to_ron(self), self._type)

    def __dir__(self) -> List[str]:
        return [*super().__dir__(), *map(python_name, self._named)]

    def __repr__(self) -> str:
        return python_text(self)

    def __str__(self) -> str:
        return to_ron(self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Value) and to_ron(self) == to_ron(other)

    def __hash__(self) -> int:
        return hash(to_ron(self))

    def replace(self, **fields: Any) -> "Value":
        """Return a copy with some fields replaced."""
        merged = {**self._named, **{ron_name(name): value for name, value in fields.items()}}
        if self._path and not self._items:
            return type(self)(**{python_name(name): value for name, value in merged.items()})
        return self._make(self._name, merged, self._items)


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

    def __repr__(self) -> str:
        return python_text(list(self))

    def __reduce__(self) -> Tuple[Any, ...]:
        return Items, (list(self),)


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
    elif isinstance(value, _strategies.Strategy):
        vars(value)["_place"] = Place(pipeline, path), id(value)


class Place:
    """Place of a strategy in a pipeline."""

    def __init__(self, pipeline: Owner, path: str) -> None:
        self.pipeline, self.path = pipeline, path

    def replace(self, before: Any, after: Any) -> None:
        """Set the strategy at this place."""
        current(before, self.pipeline, self.path)
        self.pipeline.set({self.path: after})


def current(value: Any, pipeline: Owner, path: str) -> None:
    """Raise an error for a value that is no longer at its path: a change would affect another value."""
    try:
        there = to_ron(pipeline.get(path))
    except (InputError, AttributeError):
        there = ""
    if there != to_ron(value):
        raise InputError(f"`{path}` of the pipeline has changed since this value was read; read it again")


def with_objects(value: Any, field: str) -> Any:
    """Value of a field with objects in place of recorded strategies in Python; a strategy that cannot be created remains a
    value."""
    if isinstance(value, Items):
        for place, item in enumerate(value):
            list.__setitem__(value, place, with_objects(item, field))
    elif isinstance(value, Value) and value._name == "Python" and field in _strategies.FIELDS:
        try:
            made = _strategies.made(_strategies.FIELDS[field], *(value._named[name] for name in _strategies.RECORD))
        except Exception:  # whatever a module of a user raises; a run reports it
            return value
        if value._owner is not None:
            own(made, *value._owner)
        return made
    return value


# Kinds of plugins by their name (`Random` is an initializer and a split).
KINDS: Dict[str, List[str]] = {}
# Variants without fields, such as `Real`: they are written without parentheses.
UNITS: Set[str] = set()
# Classes of plugins and of groups of settings by name, and those of the variants of each enum.
CLASSES: Dict[str, Type[Value]] = {}
GROUPS: Dict[str, Type[Value]] = {}
VARIANTS: Dict[str, Dict[str, Type[Value]]] = {}


def without_none(words: str) -> str:
    """Type of a field without "or None"."""
    return words[: -len(" or None")] if words.endswith(" or None") else words


def class_of(name: Optional[str], words: str) -> Type[Value]:
    """Class of a value with this name, in a field of the type ``words``."""
    bare = without_none(words)
    if bare in GROUPS:
        return GROUPS[bare]
    if name in VARIANTS.get(bare, ()):
        return VARIANTS[bare][str(name)]
    if name in CLASSES:
        return CLASSES[str(name)]
    found = [variants[str(name)] for variants in VARIANTS.values() if name in variants]
    return found[0] if len(found) == 1 else Value


def python_text(value: Any) -> str:
    """Python expression of a value."""
    if isinstance(value, float) and not math.isfinite(value):
        return f'float("{value}")'
    if isinstance(value, list):
        return f"[{', '.join(map(python_text, value))}]"
    if isinstance(value, tuple):
        return f"({', '.join(map(python_text, value))}{',' if len(value) == 1 else ''})"
    if not isinstance(value, Value):
        return repr(value)
    if value._name == "Python":
        fields = value._named
        return f"<{fields['class']} of the module {fields['module']}, settings {fields['settings']}>"
    if not value._path:
        return repr(value._name) if value._name in UNITS else f"<{to_ron(value)}>"
    if value._items:
        return f"{value._path}({', '.join(map(python_text, value._items))})"
    if value._name in UNITS:
        return value._path
    defaults = value._defaults
    told = {name: field for name, field in value._named.items() if name not in defaults or to_ron(defaults[name]) != to_ron(field)}
    if type(value)(**{python_name(name): field for name, field in told.items()}) != value:
        told = value._named  # without fields, `Random` may be of another kind
    return f"{value._path}({', '.join(f'{python_name(name)}={python_text(field)}' for name, field in told.items())})"


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
    inside = [f"{name}: {to_ron(field)}" for name, field in value._named.items()]
    inside += [to_ron(item) for item in value._items]
    name = value._name or ""
    bare = name and not inside and name in UNITS
    return name if bare else f"{name}({', '.join(inside)})"


def from_ron(text: str, words: str = "") -> Any:
    """Parse a RON text to a value of the type ``words``."""
    return from_node(_pwrfgs.parse_ron(text), words)


def from_node(node: Any, words: str) -> Any:
    kind = node[0]
    if kind == "text":
        return node[1]
    if kind == "plain":
        return plain(node[1], words)
    if kind == "fields":
        made = class_of(node[1], words)
        return made._make(node[1] or made._type or None, {name: from_node(field, made._types.get(name, "")) for name, field in node[2]})
    name, inner = node[1], words[len("list of ") :] if words.startswith("list of ") else ""
    if kind == "list":
        return Items(from_node(item, inner) for item in node[2])
    if name == "Some" and len(node[2]) == 1:
        return from_node(node[2][0], words)
    made, items = class_of(name, words), tuple(from_node(item, "") for item in node[2])
    return made._make(name, {}, items) if name else items


def from_json(value: Any, words: str) -> Any:
    """Convert the JSON form of a default to a value of the type ``words``."""
    if isinstance(value, list):
        inner = words[len("list of ") :] if words.startswith("list of ") else ""
        items = [from_json(item, inner) for item in value]
        return Items(items) if words.startswith("list of ") else tuple(items)
    if isinstance(value, float) and float(np.float32(value)) == value:
        return float(str(np.float32(value)))  # JSON has all digits of single precision
    bare = without_none(words)
    if isinstance(value, str) and bare in VARIANTS:
        return VARIANTS[bare][value]._make(value, {})
    if not isinstance(value, dict):
        return value
    name, content = (bare, value) if bare in GROUPS else next(iter(value.items()))
    made = class_of(name, bare)
    if isinstance(content, dict):
        return made._make(name, {field: from_json(inner, made._types.get(field, "")) for field, inner in content.items()})
    return made._make(name, {}, (from_json(content, ""),))


def plain(text: str, words: str = "") -> Any:
    named = {"true": True, "false": False, "None": None, "inf": math.inf, "-inf": -math.inf, "NaN": math.nan}
    if text in named:
        return named[text]
    try:
        digits = text.replace("_", "")
        return int(digits) if digits.lstrip("+-").isdigit() else float(digits)
    except ValueError:
        if text.isidentifier() and text not in KINDS:
            UNITS.add(text)
        return class_of(text, words)._make(text, {})


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


def arguments(values: Optional[Mapping[str, Any]]) -> List[str]:
    """Convert settings to ``--set`` arguments: strings unchanged, everything else as RON."""
    if values is not None and not isinstance(values, Mappings):
        raise InputError(f'set is {values!r}; give a dict, such as {{"training.steps": 2000}}')
    return [f"{path}={value if isinstance(value, str) else to_ron(value)}" for path, value in (values or {}).items()]


def fitting(words: str, value: Any) -> Any:
    """Convert between lists and tuples as required by the field."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, tuple) and words.startswith("list of"):
        return list(value)
    if isinstance(value, list) and words.startswith(("(", "two numbers")):
        return tuple(value)
    if isinstance(value, dict) and without_none(words) in GROUPS:
        return GROUPS[without_none(words)](**value)
    if isinstance(value, str) and value in UNITS and value in VARIANTS.get(words, ()):
        return VARIANTS[words][value]._make(value, {})
    if isinstance(value, str) and value != "None" and value in words.split(" or ")[1:]:  # "whole number or Auto"
        return plain(value)
    return value
