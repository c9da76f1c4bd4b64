"""Messages for Python's ``logging``, under the name "pwrfgs"."""

from __future__ import annotations

import logging
import sys
import warnings
from typing import Any, Dict

log = logging.getLogger("pwrfgs")
# Level of training steps: below DEBUG a run of 30,000 steps would fill the log of every other library.
STEPS = logging.DEBUG


def warn(text: str) -> None:
    """Warn at the first line outside this package that led here."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back and frame.f_globals.get("__name__", "").split(".")[0] == "pwrfgs":
        level, frame = level + 1, frame.f_back
    warnings.warn(text, UserWarning, stacklevel=level)


def event(about: Dict[str, Any]) -> None:
    """Log an event of a run: stages, start, validation and messages as INFO, warnings as WARNING, steps as DEBUG."""
    what = about["what"]
    if what == "step":
        log.log(STEPS, "step %(step)d: loss %(loss).4g, N %(gaussians)d", about)
    elif what == "validation":
        log.info("step %(step)d: validation mean %(mean).4g, median %(median).4g", about)
    elif what == "start":
        log.info("training on %(data)s: step %(done)d of %(steps)d", about)
    elif what == "stage" and about["name"] == "runs":
        log.info("%(done)d of %(total)d runs have ended", about)
    elif what == "stage" and about["done"] == 0:
        log.info("%(name)s", about)
    elif what == "warning":
        log.warning("%(text)s", about)
    elif what == "message":
        log.info("%(text)s", about)
