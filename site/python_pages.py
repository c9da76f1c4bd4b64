"""Pages of the book about the Python package: its functions and classes by topic, from their docstrings, and its notebooks."""

from __future__ import annotations

import base64
import importlib
import inspect
import json
import re
import sys
from pathlib import Path
from typing import Any

#: Public names by topic: a class has its own page, a function stands on the page of its topic.
TOPICS = {
    "Data": ["Dataset", "Receiver", "Pose", "Partition", "inspect", "Inspection", "Finding", "simulate"]
    + ["spectrum", "convert", "datasets"],
    "Runs": ["run", "Run", "check", "Check", "evaluate", "report", "sweep", "SweepError", "compare", "Comparison", "View", "devices", "use_device"],
    "Pipelines": ["Pipeline", "Value", "settings", "init"],
    "Models": ["load", "Model", "Gaussians", "Interval"],
    "Tasks": ["RadioMap", "Located", "plan", "Plan", "place", "Placement"],
    "Strategies": ["Pruner", "Initializer", "Split", "Baseline", "Metric", "Deformation"]
    + ["Cloud", "Column", "Stats", "StepContext", "Room", "Links", "Sample", "ReceiverSample"],
    "Training loops": ["Trainer", "project", "rasterize", "rasterize_with_vjp", "Splats", "torch"],
    "scikit-learn": ["sklearn"],
    "Scores": ["metrics", "baselines", "repeatability"],
    "Plots": ["plot"],
    "Errors": ["Error", "InputError"],
}


class Absent(type):
    """Stands for a module that is not installed, and for everything in it."""

    def __getattr__(cls, name: str) -> Absent:
        if name.startswith("_"):
            raise AttributeError(name)
        return Absent(name, (), {})


def load_package() -> Any:
    """The package; its modules for PyTorch and scikit-learn are documented without them too."""
    for names in (["torch"], ["sklearn", "sklearn.base", "sklearn.metrics", "sklearn.utils.validation"]):
        try:
            importlib.import_module(names[0])
        except ModuleNotFoundError:
            sys.modules.update({name: Absent(name, (), {}) for name in names})
    return importlib.import_module("pwrfgs")


def signature(item: Any) -> str:
    """Arguments of a function, with types as its source names them."""
    try:
        text = str(inspect.signature(item))
    except (TypeError, ValueError):
        return "(..)"
    text = re.sub(r"numpy\.ndarray\[.*?\]\]|_?[Nn]p\.ndarray", "Array", text)
    text = re.sub(r"(?:_pwrfgs|_pipeline|_results|_types|pwrfgs)\.", "", text)
    text = re.sub(r"""(: |-> )["']+([^"']+)["']+""", r"\1\2", text).removesuffix(" -> None")
    text = re.sub(r"\((?:self|cls)(?:: [^,)]+)?(?:, /)?(?:, |(?=\)))", "(", text)
    if len(text) < 100:
        return text
    inner, _, returned = text[1:].rpartition(")")
    depth, line, lines = 0, "", []
    for letter in inner:
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0:
            lines, line = [*lines, line.strip()], ""
        else:
            line += letter
    return "(\n" + "".join(f"    {part},\n" for part in [*lines, line.strip()]) + ")" + returned


def described(item: Any) -> str:
    """Docstring as Markdown."""
    from pdoc.docstrings import convert

    return re.sub("(?m)^#{6} (.*)", r"**\1**", convert(inspect.getdoc(item) or "", "numpy", None))


def function_text(name: str, item: Any, heading: str) -> str:
    return f"{heading} {name}\n\n```python\n{name}{signature(item)}\n```\n\n{described(item)}\n\n"


def class_text(name: str, item: type) -> str:
    """Page of a class: how to make one, its attributes, its methods."""
    head = f"# {name}\n\n```python\nclass {name}{'' if issubclass(item, Exception) else signature(item)}\n```\n\n{described(item)}\n\n"
    public = [(n, m) for n, m in inspect.getmembers(item) if not n.startswith("_") and not hasattr(Exception, n)]
    values = [(n, m) for n, m in public if inspect.isdatadescriptor(m) and n not in getattr(item, "_fields", ()) and inspect.getdoc(m)]
    methods = [(n, m) for n, m in public if inspect.isroutine(m) or inspect.isclass(m)]
    methods = [(n, m) for n, m in methods if inspect.getdoc(m) and (getattr(m, "__module__", None) or "pwrfgs").startswith("pwrfgs")]
    plain = [n for n, m in public if isinstance(m, load_package().Value)]
    if plain:
        head += f"Values without settings: {', '.join(f'`{n}`' for n in plain)}.\n\n"
    text = "".join(f"- **{n}**: {' '.join(inspect.getdoc(m).split())}\n" for n, m in values)
    if text:
        head += f"## Attributes\n\n{text}\n"
    return head + ("## Methods\n\n" if methods else "") + "".join(function_text(n, m, "###") for n, m in methods)


def module_text(name: str, item: Any) -> str:
    """Page of a module: all its functions and classes."""
    members = [(n, m) for n, m in inspect.getmembers(item) if not n.startswith("_") and getattr(m, "__module__", "") == item.__name__]
    functions = "".join(function_text(f"{name}.{n}", m, "##") for n, m in members if inspect.isfunction(m))
    classes = "".join(class_text(f"{name}.{n}", m).replace("\n## ", "\n### ").replace("# ", "## ", 1) for n, m in members if isinstance(m, type))
    return f"# {name}\n\n{described(item)}\n\n{functions}{classes}"


def reference_pages() -> dict[str, str]:
    """Pages of the reference by path: contents, and each topic with its functions, followed by its classes and modules. Every
    public name that is no plugin must have a topic."""
    package = load_package()
    listed = [name for names in TOPICS.values() for name in names]
    missing = {n for n in package.__all__ if n not in package._plugins.__all__ and n != "__version__"} - set(listed)
    if missing:
        sys.exit(f"site/python_pages.py: no topic has {', '.join(sorted(missing))}")
    contents, pages = "# Python reference\n\nPlugins are classes too; [Plugins and settings](../../docs/reference.md) describes them.\n\n", {}
    for topic, names in TOPICS.items():
        page, items = topic.lower().replace(" ", "-"), {name: getattr(package, name) for name in names}
        lines, functions = "", ""
        for name, item in items.items():
            is_function = inspect.isfunction(item)
            first = described(item).split("\n\n")[0].replace("\n", " ")
            lines += f"- [`{name}`]({f'#{name.lower()}' if is_function else f'{name}.md'}): {first}\n"
            functions += function_text(name, item, "##") if is_function else ""
        contents += f"- [{topic}]({page}.md): {', '.join(f'`{name}`' for name in names)}\n"
        pages[f"python/api/{page}.md"] = f"# {topic}\n\n{lines}\n{functions}"
        for name, item in items.items():
            if not inspect.isfunction(item):
                pages[f"python/api/{name}.md"] = (class_text if isinstance(item, type) else module_text)(name, item)
    return {"python/api/index.md": contents, **pages}


def notebook_page(path: Path, pictures: Path) -> str:
    """A notebook as Markdown, with the outputs that it stores; pictures are written into a folder beside the page."""
    parts = []
    for number, cell in enumerate(json.loads(path.read_text())["cells"]):
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for k, output in enumerate(cell.get("outputs", [])):
            data = output.get("data", {})
            if "image/png" in data:
                name = f"{path.stem}-{number}-{k}.png"
                pictures.mkdir(parents=True, exist_ok=True)
                (pictures / name).write_bytes(base64.b64decode(data["image/png"]))
                parts.append(f"![output of this cell]({pictures.name}/{name})")
            elif "text/html" in data:
                lines = "".join(data["text/html"]).split("\n")
                parts.append("\n".join(line.strip() for line in lines if line.strip()))
            elif text := output.get("text", data.get("text/plain")):
                parts.append(f"```text\n{''.join(text).rstrip()}\n```")
    return "\n\n".join(parts) + "\n"
