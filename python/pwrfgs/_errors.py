"""Exceptions. Their texts are those of the command line: what is wrong, where, and what to do."""

from __future__ import annotations

from typing import Optional


class Error(Exception):
    """Any failure of the toolkit."""


class InputError(Error, ValueError):
    """Wrong input: a file, a setting or an array that cannot be used.

    ``path``, ``line`` and ``column`` say where, if a file is at fault.
    """

    path: Optional[str] = None
    line: Optional[int] = None
    column: Optional[int] = None
