"""The modules of the package use each other in one direction, also in functions and for type checkers."""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from typing import Dict, Iterator, Optional

from conftest import ROOT


def imported(text: str) -> Iterator[str]:
    """Yield the names below the package that a module imports at any depth; the package itself is `__init__`."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from ((name.name + ".__init__").split(".")[1] for name in node.names if name.name.split(".")[0] == "pwrfgs")
        elif isinstance(node, ast.ImportFrom):
            package, _, module = ("pwrfgs." * node.level + (node.module or "")).rstrip(".").partition(".")
            if package == "pwrfgs":
                yield from [module.split(".")[0]] if module else [name.name for name in node.names]


def circle(texts: Dict[str, str]) -> Optional[str]:
    """Return a circle of modules. A name of the package that is no module is of `__init__`; `_pwrfgs` is compiled."""
    uses = {name: {use if use in texts else "__init__" for use in imported(text) if use != "_pwrfgs"} for name, text in texts.items()}
    try:
        TopologicalSorter(uses).prepare()
    except CycleError as error:
        return " <- ".join(error.args[1])
    return None


def test_modules_use_each_other_in_one_direction() -> None:
    files = (ROOT / "python" / "pwrfgs").glob("*.py")
    assert circle({path.stem: path.read_text() for path in files}) is None


def test_finds_imports_at_any_depth() -> None:
    lower = "if TYPE_CHECKING:\n    from .upper import Pipeline"
    for text in [lower, "def f():\n    from . import upper", "import pwrfgs.upper", "from pwrfgs import upper"]:
        assert circle({"upper": "from .lower import Value", "lower": text}) is not None
    assert circle({"upper": "from .lower import Value", "lower": "import numpy as upper"}) is None
    assert circle({"__init__": "from .run import run", "run": "import pwrfgs"}) is not None
