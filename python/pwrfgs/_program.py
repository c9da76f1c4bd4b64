"""The console script ``pwrfgs``: the command-line program, compiled into the package."""

from __future__ import annotations

import signal
import sys

from . import _pwrfgs


def main() -> int:
    """Run the program with the arguments of the process; return its exit code."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the program handles Ctrl-C itself
    return _pwrfgs.program(sys.argv)
