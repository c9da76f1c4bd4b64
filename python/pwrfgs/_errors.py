"""Exceptions, with the same messages as the command line: problem, position and next step."""

from __future__ import annotations

from typing import Optional


class Error(Exception):
    """Any failure of the toolkit."""


class InputError(Error, ValueError):
    """Invalid input: a file, a setting or an array.

    ``path``, ``line`` and ``column`` give the position of an error in a file.
    """

    path: Optional[str] = None
    line: Optional[int] = None
    column: Optional[int] = None


def missing(package: str, extra: str) -> ImportError:
    """Exception for an optional package that is not installed; ``extra`` of pwrfgs installs it."""
    install = f"'pwrfgs[{extra}]'"
    if package == "torch":  # the build for processors alone is smaller by gigabytes, and an extra cannot name its index
        install = "torch --index-url https://download.pytorch.org/whl/cpu"
    return ImportError(f"{package} is missing; install it with: pip install {install}", name=package)
