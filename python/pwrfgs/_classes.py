"""Classes of plugins, of groups of settings and of enums, created at import from the doc comments of the program."""

from __future__ import annotations

import inspect
import json
from typing import TYPE_CHECKING, Any, Callable, Dict, Iterator, List, Optional, Sequence, Tuple

from . import _pwrfgs
from ._errors import InputError
from ._prose import prose
from ._values import (
    CLASSES, GROUPS, KINDS, UNITS, VARIANTS, Value, fitting, from_json, from_ron, python_name, python_text, ron_name, to_ron,
    unknown,
)  # fmt: skip

# Letters in a line of a docstring.
WIDTH = 110

# Name, type, doc comment, and default as JSON text: None for a required field.
Field = Tuple[str, str, str, Optional[str]]


def new_class(name: str, module: str, fields: Sequence[Field], init: Callable[..., None], kind: str = "", of: str = "") -> Any:
    """Create the class of values with this name; ``kind`` is the type in a field, ``of`` the enum of a variant."""
    inside = f"{of}.{name}" if of else name
    body = {
        "__init__": init,
        "__slots__": (),
        "__module__": module,
        "__qualname__": inside,
        "_path": f"{module}.{inside}",
        "_type": kind,
        "_types": {field: words for field, words, _, _ in fields},
        "_defaults": {},
    }
    return type(name, (Value,), body)


def document(cls: Any, about: str, fields: Sequence[Field], positional: bool = False) -> None:
    """Set docstring and signature: fields with type, default and text."""
    kind = inspect.Parameter.POSITIONAL_ONLY if positional else inspect.Parameter.KEYWORD_ONLY
    names = ["value" if positional and len(fields) == 1 else python_name(field[0]) for field in fields]
    defaults = [cls._defaults.get(field[0], inspect.Parameter.empty) for field in fields]
    cls.__doc__ = about + listing(names, fields, defaults)
    cls.__signature__ = inspect.Signature(
        [inspect.Parameter(name, kind, default=default) for name, default in zip(names, defaults)]
    )


def listing(names: Sequence[str], fields: Sequence[Field], defaults: Sequence[Any]) -> str:
    """Section of a docstring with type, default and text of each field."""
    lines = ["\n\nParameters\n----------"] if fields else []
    for name, (_, words, doc, _), default in zip(names, fields, defaults):
        fixed = "" if default is inspect.Parameter.empty else f", default {python_text(default)}"
        lines += [f"{name} : {words}{fixed}", *(f"    {line}" for line in prose(doc, WIDTH - 4))]
    return "\n".join(lines)


def refuse_items(name: str, items: Sequence[Any], fields: Sequence[Field]) -> None:
    """Raise an error for settings without names."""
    if items:
        form = f", such as {name}({python_name(fields[0][0])}={items[0]!r})" if fields else ""
        raise TypeError(f"{name} takes its settings by name{form}" if fields else f"{name} has no settings")


def named(name: str, given: Dict[str, Any], types: Dict[str, str]) -> Dict[str, Any]:
    """Fields by their names in RON."""
    for field in given:
        if ron_name(field) not in types:
            raise InputError(unknown(name, field, types))
    return {ron_name(field): fitting(types[ron_name(field)], value) for field, value in given.items()}


def blamed(name: str, kinds: List[str], given: Dict[str, Any], types: Dict[str, str], fault: str) -> str:
    """Message with the invalid field, if a single field is invalid."""
    if name in fault and "`" in fault:
        return fault
    for field, value in given.items():
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
                wanted = f"; it takes a {types[field]}" if field in types else ""
                return f"{name}: `{python_name(field)}` is {value!r}: {fault}{wanted}"
    return fault if name in fault else f"{name}: {fault}"


def make_plugin(name: str, entries: List[Dict[str, Any]]) -> List[Field]:
    """Create the class of a plugin from the registry; returns its fields."""
    kinds = [entry["kind"] for entry in entries]
    found: Dict[str, Field] = {}
    for entry in entries:
        for field in entry["fields"]:
            found.setdefault(field[0], field)
    fields = list(found.values())

    def __init__(self: Value, *items: Any, **given: Any) -> None:
        refuse_items(name, items, fields)
        told = named(name, given, self._types) if entries[0]["doc"] is not None else given
        text = f"{name}({', '.join(f'{field}: {to_ron(value)}' for field, value in told.items())})"
        whole: List[Dict[str, Any]] = []
        fault: Optional[InputError] = None
        for kind in kinds:
            try:
                made = from_ron(_pwrfgs.complete(kind, text))
                whole.append(dict(made._named) if isinstance(made, Value) else {})
            except InputError as error:
                fault = fault or error
        if not whole:
            raise InputError(blamed(name, kinds, told, self._types, str(fault)))
        # A name that means two things, and could be either still, says no more than it was given.
        self._fill(name, whole[0] if len(whole) == 1 else told)

    KINDS[name] = kinds
    CLASSES[name] = new_class(name, "pwrfgs", fields, __init__)
    return fields


def by_name(name: str, fields: Sequence[Field]) -> Callable[..., None]:
    """``__init__`` of a group of settings, or of a variant with named fields; omitted fields have their default."""

    def __init__(self: Value, *items: Any, **given: Any) -> None:
        refuse_items(name, items, fields)
        told = {**self._defaults, **named(name, given, self._types)}
        missing = [python_name(field) for field, _, _, default in fields if default is None and field not in told]
        if missing:
            raise InputError(f"{name} lacks {', '.join(missing)}")
        self._fill(name, {field: told[field] for field in self._types if field in told})

    return __init__


def in_order(name: str, count: int) -> Callable[..., None]:
    """``__init__`` of a variant without names of its fields."""

    def __init__(self: Value, *items: Any, **given: Any) -> None:
        if given or len(items) != count:
            raise InputError(f"{name} takes {count} positional values, such as {name}(..)")
        self._fill(name, {}, items)

    return __init__


class Choice(type):
    """Enum of settings, with variants as attributes."""

    def __iter__(cls) -> Iterator[str]:
        return iter(VARIANTS[cls.__name__])

    if not TYPE_CHECKING:  # a checker would take every name for one that is there

        def __getattr__(cls, name: str) -> Any:
            if name.startswith("_"):
                raise AttributeError(name)
            raise AttributeError(unknown(cls.__name__, name, cls).replace("has no field", "has no variant"))


def make_choice(entry: Dict[str, Any]) -> type:
    """Create the namespace of the variants of an enum: classes, and a value for a variant without fields."""
    own = VARIANTS[entry["name"]]
    body: Dict[str, Any] = {name: made._make(name, {}) if name in UNITS else made for name, made in own.items()}
    return Choice(entry["name"], (), {**body, "__slots__": (), "__doc__": entry["doc"], "__module__": "pwrfgs.settings"})


def defaults_of(fields: Sequence[Field]) -> Dict[str, Any]:
    """Default values of fields that have a fixed one."""
    fixed = [field for field in fields if field[3] is not None and (field[3] != "null" or field[1].endswith(" or None"))]
    return {field: from_json(json.loads(str(default)), words) for field, words, _, default in fixed}


def fill() -> Dict[str, type]:
    """Create all classes; returns groups and enums by name, for ``pwrfgs.settings``."""
    types = _pwrfgs.types()
    entries_of: Dict[str, List[Dict[str, Any]]] = {}
    for entry in _pwrfgs.registry():
        if entry["name"] != "Python":
            entries_of.setdefault(entry["name"], []).append(entry)
    # First all classes, because a field may have any type; then defaults, which documentation shows.
    plugins = {name: make_plugin(name, entries) for name, entries in entries_of.items()}
    settings: List[Tuple[Any, str, Sequence[Field], bool]] = []
    for entry in types:
        name = entry["name"]
        if "fields" in entry:
            module = "pwrfgs" if name == "Pipeline" else "pwrfgs.settings"
            GROUPS[name] = new_class(name, module, entry["fields"], by_name(name, entry["fields"]), name)
            settings.append((GROUPS[name], entry["doc"], entry["fields"], True))
        for variant, doc, is_named, fields in entry.get("variants", ()):
            init = by_name(variant, fields) if is_named else in_order(variant, len(fields))
            made = new_class(variant, "pwrfgs.settings", fields, init, name, name)
            VARIANTS.setdefault(name, {})[variant] = made
            settings.append((made, doc, fields, is_named))
            if not fields:
                UNITS.add(variant)
    for name in plugins:
        for entry in entries_of[name]:
            CLASSES[name]._defaults.update(from_ron(entry["text"])._named if entry["text"] else {})
    for made, _, fields, is_named in settings:
        if is_named and made is not GROUPS["Pipeline"]:  # whose plugins depend on the data
            made._defaults = defaults_of(fields)
    for name, entries in entries_of.items():
        about = "\n\n".join("\n".join(prose(f"{entry['kind']}. {entry['doc'] or ''}", WIDTH)) for entry in entries)
        document(CLASSES[name], about, plugins[name])
    for made, doc, fields, is_named in settings:
        document(made, "\n".join(prose(doc, WIDTH)), fields, not is_named)
    groups = {name: made for name, made in GROUPS.items() if name != "Pipeline"}
    return {**groups, **{entry["name"]: make_choice(entry) for entry in types if "variants" in entry}}


SETTINGS = fill()
