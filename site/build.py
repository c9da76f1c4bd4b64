#!/usr/bin/env python3
"""Builds the site: the pages of the repository as a book, the reference, the Python API and live pages; checks all links.

    pip install ./python -r site/requirements.txt
    pwrfgs run pipelines/quickstart.ron
    python3 site/build.py runs/quickstart target/site
"""

from __future__ import annotations

import argparse
import html.parser
import os
import re
import shutil
import subprocess
import sys
import tempfile
import types
import urllib.parse
import warnings
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"(\]\()([^)\s]+)\)")


def anchor(heading: str) -> str:
    """The id that mdBook gives a heading."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def split_reference(text: str) -> dict[str, str]:
    """The reference as a page of contents and a page per chapter, by path in the book."""
    contents, *chapters = re.split(r"(?m)^## ", text)
    pages, anchors = {}, {}
    for chapter in chapters:
        name = re.match(r"\w+", chapter)[0]
        page = f"reference/{name.lower()}.md"
        pages["docs/" + page] = "# " + re.sub(r"(?m)^###(?= \w)", "##", chapter)
        anchors[name] = {re.match(r"\w+", h)[0]: f"{page}#{anchor(h)}" for h in re.findall(r"(?m)^### (.*)", chapter)}
        anchors[name][name] = page

    def linked(line: re.Match[str]) -> str:
        own = anchors[line[1]]
        names = re.sub(r"`(\w+)`", lambda n: f"[{n[0]}]({own[n[1]]})" if n[1] in own else n[0], line[3])
        return f"- [**{line[1]}**]({own[line[1]]}){line[2]}: {names}"

    return {"docs/reference.md": re.sub(r"(?m)^- \*\*(\w+)\*\*(.*?): (.*)", linked, contents), **pages}


def place(page: str) -> str:
    """Where a page of the repository is in the book."""
    return os.path.normpath(page).removeprefix("site/").replace("README.md", "index.md")


def collect(source: Path, program: str, repository: str) -> None:
    """Writes the pages of the book into a folder. Links to other files lead to the repository."""
    summary = (ROOT / "site/SUMMARY.md").read_text()
    of_summary = [os.path.normpath("site/" + page) for _, page in LINK.findall(summary)]
    markdown = subprocess.run([program, "plugins", "--markdown"], check=True, capture_output=True, text=True).stdout
    reference = split_reference(markdown)
    pages = {place(page): (ROOT / page).read_text() for page in of_summary if page not in reference} | reference

    def target(page: str, link: str) -> str:
        path = os.path.normpath(os.path.join(os.path.dirname(page), link.partition("#")[0]))
        if "://" in link or link.startswith("#") or place(path) in pages or path.endswith(".html"):
            return link.replace("README.md", "index.md")
        if path.startswith("docs/images/"):
            (source / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / path, source / path)
            return link
        return f"{repository}/blob/main/{path}"

    for page, text in pages.items():
        (source / page).parent.mkdir(parents=True, exist_ok=True)
        (source / page).write_text(LINK.sub(lambda link: f"{link[1]}{target(page, link[2])})", text))
    _, *chapters = [f"    - [{text.split()[1].rstrip(':')}]({page})\n" for page, text in reference.items()]
    summary = LINK.sub(lambda link: f"{link[1]}{place('site/' + link[2])})", summary)
    head, line, tail = re.split(r"(.*docs/reference\.md\)\n)", summary)
    (source / "SUMMARY.md").write_text(head + line + "".join(chapters) + tail)


def python_api(out: Path) -> None:
    """The Python package, from its docstrings. A module that needs torch is documented without it."""
    import pdoc

    try:
        import torch  # noqa: F401
    except ModuleNotFoundError:
        function = types.ModuleType("torch.autograd.function")
        function.once_differentiable = staticmethod
        torch = types.ModuleType("torch")
        torch.autograd = types.SimpleNamespace(Function=object)
        torch.float32 = torch.float64 = torch.complex64 = torch.complex128 = None
        sys.modules.update({"torch": torch, "torch.autograd.function": function})
    warnings.filterwarnings("ignore", module="pdoc")  # types that only type checkers import
    pdoc.render.configure(docformat="numpy", show_source=False, template_directory=ROOT / "site/pdoc")
    pdoc.pdoc("pwrfgs", "pwrfgs.torch", output_directory=out)


class Page(html.parser.HTMLParser):
    """The ids and the links of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.ids, self.links = set(), set()
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if name == "id":
                self.ids.add(value)
            elif name in ("href", "src") and value and not re.match(r"[a-z]+:", value):
                self.links.add(value)


def broken_links(site: Path) -> list[str]:
    """Links between pages of the site that lead to no file or no heading."""
    pages = {path: Page(path) for path in site.rglob("*.html") if path.parent.name != "live"}
    broken = []
    for path, page in pages.items():
        for link in page.links if path.name != "404.html" else ():
            parts = urllib.parse.urlsplit(link)
            file = (path.parent / urllib.parse.unquote(parts.path)).resolve() if parts.path else path
            wanted = urllib.parse.unquote(parts.fragment)
            if not file.is_file() or wanted and file in pages and wanted not in pages[file].ids:
                broken.append(f"{path.relative_to(site)}: {link}")
    if len(pages) < 40:
        broken.append(f"only {len(pages)} pages")
    return sorted(broken)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="run folder of the quickstart")
    parser.add_argument("out", type=Path, help="folder of the site; replaced")
    parser.add_argument("--program", default="pwrfgs", help="the program pwrfgs")
    options = parser.parse_args()
    site = options.out.resolve()
    if site.exists() and not (site / "index.html").is_file():
        parser.error(f"{site} exists and is not a site; give another folder")
    repository = re.search(r'(?m)^repository = "(.*?)"', (ROOT / "Cargo.toml").read_text())[1]
    with tempfile.TemporaryDirectory() as folder:
        book = Path(folder)
        shutil.copy(ROOT / "site/book.toml", book)
        (book / "src").mkdir()
        collect(book / "src", options.program, repository)
        subprocess.run(["mdbook", "build", book, "--dest-dir", book / "site"], check=True)
        python_api(book / "site/api")
        (book / "site/live").mkdir()
        shutil.copy(options.run / "report.html", book / "site/live")
        save = [options.program, "view", options.run, "--save", book / "site/live/view.html"]
        subprocess.run(save, check=True)
        if broken := broken_links(book / "site"):
            sys.exit("links that lead nowhere:\n" + "\n".join(broken))
        shutil.rmtree(site, ignore_errors=True)
        shutil.move(book / "site", site)
    print(f"site: {site / 'index.html'}")


if __name__ == "__main__":
    main()
