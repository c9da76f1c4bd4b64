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
import urllib.parse
from pathlib import Path

import python_pages

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"(\[(?:[^\[\]]|!\[[^\]]*\]\([^)]*\))*\])\(([^)\s]+)\)")
IMAGE = re.compile(r'(?:src|srcset)="(docs/images/[^"]+)"')


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
    return os.path.normpath(page).removeprefix("site/").replace("README.md", "index.md").replace(".ipynb", ".md")


def page_text(page: str, source: Path) -> str:
    """Text of a page of the repository; a notebook as Markdown, with its pictures."""
    if not page.endswith(".ipynb"):
        return (ROOT / page).read_text()
    return python_pages.notebook_page(ROOT / page, (source / place(page)).parent / "pictures")


def collect(source: Path, program: str, repository: str) -> None:
    """Writes the pages of the book into a folder. Links to other files lead to the repository."""
    summary = (ROOT / "site/SUMMARY.md").read_text()
    of_summary = [os.path.normpath("site/" + page) for _, page in LINK.findall(summary)]
    markdown = subprocess.run([program, "plugins", "--markdown"], check=True, capture_output=True, text=True).stdout
    reference = split_reference(markdown)
    api = python_pages.reference_pages()
    written = {page: page_text(page, source) for page in of_summary if page not in reference and page not in api}
    pages = {place(page): text for page, text in written.items()} | reference | api

    def copy_image(path: str) -> None:
        (source / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / path, source / path)

    def linked(page: str, text: str, link: str) -> str:
        path = os.path.normpath(os.path.join(os.path.dirname(page), link.partition("#")[0]))
        known = "://" in link or link.startswith("#") or place(path) in pages or path.endswith(".html") or (source / path).is_file()
        if path.startswith("docs/images/"):
            copy_image(path)
        elif known:
            link = link if "://" in link else link.replace("README.md", "index.md").replace(".ipynb", ".md")
        elif "example.invalid" in repository:  # the owner has not filled in the address
            return text[1:-1]
        else:
            link = f"{repository}/blob/main/{path}"
        return f"{text}({link})"

    for page, text in pages.items():
        (source / page).parent.mkdir(parents=True, exist_ok=True)
        for path in IMAGE.findall(text):
            copy_image(path)
        (source / page).write_text(LINK.sub(lambda link: linked(page, link[1], link[2]), text))
    summary = LINK.sub(lambda link: f"{link[1]}({place('site/' + link[2])})", summary)
    for contents, *chapters in (list(reference.items()), list(api.items())):
        topics = {f"python/api/{topic.lower().replace(' ', '-')}.md" for topic in python_pages.TOPICS}
        lines = [
            f"{'    ' * (1 + ('/api/' in page and page not in topics))}- [{re.match('# (.*?):?$', text, re.M)[1]}]({page})\n"
            for page, text in chapters
        ]
        head, line, tail = re.split(f"(.*{re.escape(contents[0])}\\)\n)", summary)
        summary = head + line + "".join(lines) + tail
    (source / "SUMMARY.md").write_text(summary)


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
