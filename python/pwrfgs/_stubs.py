"""Writes ``_plugins.pyi``, ``settings.pyi`` and ``_fields.pyi``: stubs for editors and type checkers, for the classes created
from plugins and settings, and for the fields of a pipeline.

``python -m pwrfgs._stubs`` writes them to this folder; a wheel is built with them (``backend.py``).
"""

from __future__ import annotations

import inspect
import json
import math
import os
import re
from typing import Any, Dict, List, Optional, Sequence, Tuple

from . import _pwrfgs
from ._prose import prose, wrap
from ._classes import SETTINGS
from ._values import CLASSES, GROUPS, python_name

WIDTH = 120
HEAD = "# Written by `python -m pwrfgs._stubs` from the doc comments of the program.\n\n"
PATH = "_Path: TypeAlias = Union[str, os.PathLike[str]]\n"
TYPING = ("Any", "ClassVar", "List", "Mapping", "Optional", "Sequence", "Tuple", "Union")
PLAIN = {
    "number": "float",
    "whole number": "int",
    "true or false": "bool",
    "text": "str",
    "path": "_Path",
    "two numbers": "Tuple[float, float]",
}


def annotation(words: str) -> str:
    """Type annotation of a field from its description in the registry; ``Any`` for plugins and settings."""
    if words in PLAIN:
        return PLAIN[words]
    if words.endswith(" or None"):
        return f"Optional[{annotation(words[: -len(' or None')])}]"
    if words.startswith("list of "):
        return f"Sequence[{annotation(words[len('list of ') :])}]"
    if words.startswith("(") and words.endswith(")"):
        return f"Tuple[{', '.join(map(annotation, parts(words[1:-1])))}]"
    if " or " in words:
        return f"Union[{', '.join(map(annotation, words.split(' or ')))}]"
    return "Any"


def parts(words: str) -> List[str]:
    """Split at commas outside parentheses."""
    found, depth = [""], 0
    for letter in words:
        depth += (letter == "(") - (letter == ")")
        if letter == "," and depth == 0:
            found.append("")
        else:
            found[-1] += letter
    return [part.strip() for part in found]


def literal(value: Any) -> str:
    """Default value in a stub: plain values and lists of them, else an ellipsis."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if value is None or isinstance(value, (bool, int)) or (isinstance(value, float) and math.isfinite(value)):
        return repr(value)
    if isinstance(value, (list, tuple)):
        inside = [literal(item) for item in value]
        if "..." not in inside:
            return f"[{', '.join(inside)}]" if isinstance(value, list) else f"({', '.join(inside)})"
    return "..."


def docstring(lines: Sequence[str], indent: str) -> str:
    """Format lines as a docstring."""
    escaped = [line.replace("\\", "\\\\").replace('"""', r"\"\"\"") for line in lines]
    if len(escaped) == 1 and len(indent) + len(escaped[0]) + 6 <= WIDTH and not escaped[0].endswith('"'):
        return f'{indent}"""{escaped[0]}"""\n'
    body = "\n".join(indent + line if line else "" for line in escaped[1:])
    return f'{indent}"""{escaped[0]}\n{body}\n{indent}"""\n' if body else f'{indent}"""{escaped[0]}\n{indent}"""\n'


def listing(fields: Sequence[Tuple[str, str, str]], width: int) -> List[str]:
    """Format fields (name, type, comment) in the NumPy docstring style."""
    lines = ["Parameters", "----------"]
    for name, words, text in fields:
        lines.append(f"{name} : {words}")
        lines += ["    " + line if line else "" for line in prose(text, width - 4)]
    return lines


def function(name: str, parameters: Sequence[str], result: str, indent: str, end: str) -> str:
    """Format ``def`` with parameters, on one line if they fit."""
    flat = f"{indent}def {name}({', '.join(parameters)}) -> {result}:{end}\n"
    if len(flat) <= WIDTH + 1:
        return flat
    inside = f"{indent}    {', '.join(parameters)}\n"
    if len(inside) > WIDTH + 1:
        inside = "".join(f"{indent}    {parameter},\n" for parameter in parameters)
    return f"{indent}def {name}(\n{inside}{indent}) -> {result}:{end}\n"


def plugins() -> str:
    """The text of ``_plugins.pyi``."""
    by_name: Dict[str, List[Dict[str, Any]]] = {name: [] for name in CLASSES if name}
    for entry in _pwrfgs.registry():
        if entry["name"] in by_name:
            by_name[entry["name"]].append(entry)
    text = exports(sorted(by_name))
    for name, entries in sorted(by_name.items()):
        fields: Dict[str, Tuple[str, str]] = {}
        said: List[str] = []
        for entry in entries:
            for field, words, comment, _ in entry["fields"]:
                fields.setdefault(python_name(field), (words, comment))
            whole = f"{entry['kind']}. {entry['doc'] or ''}"
            said += prose(whole, WIDTH - 4, 0 if said else 3) + [""]
        if fields:
            said += listing([(field, *about) for field, about in fields.items()], WIDTH - 4)
        else:
            said.pop()
        defaults = inspect.signature(CLASSES[name]).parameters
        parameters = ["self", "*"] if fields else ["self"]
        text += f"\nclass {name}(Value):\n" + docstring(said, "    ") + "\n"
        for field, (words, _) in fields.items():
            text += f"    {field}: {annotation(words)}\n"
            default = defaults[field].default
            known = "" if default is inspect.Parameter.empty else f" = {literal(default)}"
            parameters.append(f"{field}: {annotation(words)}{known}")
        text += function("__init__", parameters, "None", "    ", " ...")
    return HEAD + imports(PATH + text, ["Value"]) + "\n" + PATH + "\n" + text


def settings() -> str:
    """The text of ``settings.pyi``."""
    entries = sorted((entry for entry in _pwrfgs.types() if "variants" in entry), key=lambda entry: str(entry["name"]))
    text = exports(sorted(SETTINGS))
    for entry in entries:
        text += f"\nclass {entry['name']}(metaclass=Choice):\n" + docstring(prose(entry["doc"], WIDTH - 4, 3), "    ")
        for variant, comment, named, fields in entry["variants"]:
            said = prose(comment, WIDTH - (8 if fields else 4), 3)
            if not fields:
                text += f"\n    {variant}: ClassVar[Value]\n" + (docstring(said, "    ") if said else "")
                continue
            parameters = []
            for field, words, _, optional in fields:
                called = python_name(field) if named else "value" if len(fields) == 1 else f"value{field}"
                parameters.append(f"{called}: {annotation(words)}{' = ...' if optional else ''}")
            parameters = ["*", *parameters] if named else [*parameters, "/"]
            if named:
                about = [(python_name(field), words, doc) for field, words, doc, _ in fields]
                said += [*([""] if said else []), *listing(about, WIDTH - 8)]
            text += "\n    @staticmethod\n"
            text += function(variant, parameters, "Value", "    ", "" if said else " ...")
            if said:
                text += docstring(said, "        ")
    names = [f"    {name} as {name},\n" for name in sorted(SETTINGS) if name in GROUPS]
    groups = f"from ._fields import (\n{''.join(names)})\n"
    head = imports(text, ["Value"]).replace("from ._values", f"from ._classes import Choice\n{groups}from ._values")
    return HEAD + head + "\n" + text


def fields() -> str:
    """The text of ``_fields.pyi``: a class for each group of settings, and the base of ``Pipeline``."""
    groups = {str(entry["name"]): entry for entry in _pwrfgs.types() if "fields" in entry}
    text = (
        '\nclass Settings:\n    """Settings of a pipeline, by name."""\n\n'
        "    def replace(self, **fields: Any) -> Self: ...\n"
    )
    for name, entry in sorted(groups.items(), key=lambda group: (group[0] == "Pipeline", group[0])):
        own, base = ("PipelineFields", "") if name == "Pipeline" else (name, "(Settings)")
        text += f"\nclass {own}{base}:\n" + docstring(prose(entry["doc"] or name, WIDTH - 4, 3), "    ")
        parameters = ["self", "*"]
        for field, words, comment, default in entry["fields"]:
            _, write = types_of(words, groups)
            parameters.append(f"{python_name(field)}: {write}" + (" = ..." if default is not None else ""))
            text += property_of(python_name(field), words, prose(comment, WIDTH - 8, 3), groups)
        if base:
            text += "\n" + function("__init__", parameters, "None", "    ", " ...")
    return HEAD + imports(PATH + text, ["Value"], "from typing_extensions import Self, TypeAlias") + "\n" + PATH + text


def property_of(name: str, words: str, said: Sequence[str], groups: Dict[str, Any]) -> str:
    """Property of a field."""
    read, write = types_of(words, groups)
    text = f"\n    @property\n    def {name}(self) -> {read}:{'' if said else ' ...'}\n"
    text += docstring(said, "        ") if said else ""
    return text + f"    @{name}.setter\n" + function(name, ["self", f"value: {write}"], "None", "    ", " ...")


def types_of(words: str, groups: Dict[str, Any]) -> Tuple[str, str]:
    """Types that a field is read as and set from: plugins and settings are values, and are set from more types."""
    bare = words[: -len(" or None")] if words.endswith(" or None") else words
    held = annotation(words)
    if bare in groups:
        read, write = bare, f"Union[{bare}, Mapping[str, Any]]"
    elif "Any" in held:
        read, write = ("List[Any]", "Sequence[Any]") if bare.startswith("list of ") else ("Value", "Any")
    else:
        read = write = held
    if bare != words and "Optional" not in read:
        read, write = f"Optional[{read}]", write if write == "Any" else f"Optional[{write}]"
    return read, write


def imports(text: str, values: Sequence[str], extensions: str = "from typing_extensions import TypeAlias") -> str:
    """Imports that ``text`` needs from ``typing``, and ``values`` from this package."""
    code = re.sub(r'""".*?"""', "", text, flags=re.DOTALL)
    used = [name for name in TYPING if re.search(rf"\b{name}\b", code)]
    found = f"from typing import {', '.join(used)}\n\n"
    if PATH in text:
        found = f"import os\n{found}{extensions}\n\n"
    return found + f"from ._values import {', '.join(values)}\n"


def exports(names: Sequence[str]) -> str:
    """Format ``__all__``."""
    lines = wrap(", ".join(f'"{name}"' for name in names) + ",", WIDTH - 4)
    return "__all__: List[str] = [\n" + "".join(f"    {line}\n" for line in lines) + "]\n"


def main() -> None:
    """Writes the stubs."""
    here = os.path.dirname(os.path.abspath(__file__))
    for name, text in (("_plugins.pyi", plugins()), ("settings.pyi", settings()), ("_fields.pyi", fields())):
        with open(os.path.join(here, name), "w", encoding="utf-8", newline="\n") as file:
            file.write(text)


if __name__ == "__main__":
    main()
