"""Convert doc comments of the Rust source to docstrings."""

from __future__ import annotations

import re
import textwrap
from typing import List, Optional


def prose(text: str, width: int, taken: int = 0) -> List[str]:
    """Wrap a doc comment to lines of ``width``, with ``taken`` characters used in the first. Paragraphs are filled; Rust
    examples and links are removed."""
    lines: List[str] = []
    paragraph: List[str] = []
    fence: Optional[str] = None

    def flush() -> None:
        if any(line.startswith("|") for line in paragraph):  # a table
            lines.extend(paragraph)
        else:
            indent = "" if lines else " " * taken
            lines.extend(line.strip() for line in wrap(" ".join(paragraph), width, indent))
        paragraph.clear()

    for line in text.splitlines():
        mark = line.strip()
        if mark.startswith("```"):
            flush()
            kept = mark != "```" if fence is None else fence != "```"  # a block that names no language is Rust
            if kept:
                lines.append(mark)
            fence = mark if fence is None else None
        elif fence is not None:
            if fence != "```":
                lines.append(line.rstrip())
        elif not mark or mark.startswith("# "):
            flush()
            if lines and lines[-1]:
                lines.append("")
            if mark:
                lines += [mark[2:] + ":", ""]
        else:
            if mark.startswith("- "):  # an item of a list
                flush()
            mark = re.sub(r"\[(`[^`]+`)\](\([^)]*\))?", r"\1", mark)
            paragraph.append(mark.replace("`crate::", "`"))
    flush()
    while lines and not lines[-1]:
        lines.pop()
    return lines


def wrap(text: str, width: int, indent: str = "") -> List[str]:
    """Wrap text without breaking words."""
    return textwrap.wrap(text, width, initial_indent=indent, break_long_words=False, break_on_hyphens=False)
