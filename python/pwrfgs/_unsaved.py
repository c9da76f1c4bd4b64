"""Data sets in memory that pipelines refer to. The text of a pipeline names them by a digest of their content; a run writes
them into its folder first.
"""

from __future__ import annotations

import contextlib
import contextvars
import glob
import os
import re
import shutil
from typing import Iterator, List, Optional, Tuple
from weakref import WeakValueDictionary

from . import _pwrfgs
from ._errors import InputError
from ._log import log

# Data source of each kind of data, as `Dataset.save` writes them.
_SOURCES = {"spectrum": "Arrays", "power": "Nerf2Rssi", "channel": "Channels"}
_KNOWN: "WeakValueDictionary[str, _pwrfgs.Dataset]" = WeakValueDictionary()
# Folder of the run or sweep that is about to start, and the data folders that were written for it.
_STARTING: "contextvars.ContextVar[Optional[Tuple[str, List[str]]]]" = contextvars.ContextVar("starting", default=None)


def source_text(data: "_pwrfgs.Dataset") -> str:
    """RON text of the source of data: that of their folder, or for data in memory one with a digest in its place."""
    starting = _STARTING.get()
    if starting is not None:
        path = os.path.join(starting[0], "data", data._digest)
        if data._source is None or os.path.isdir(path):
            return _stored(data, path, *starting)
    if data._source is not None:
        return data._source
    _KNOWN[data._digest] = data
    return f'{_SOURCES[data.kind]}(root: "unsaved:{data._digest}")'


def named_in(text: str, held: Optional["_pwrfgs.Dataset"]) -> Optional["_pwrfgs.Dataset"]:
    """Data in memory that the text of a pipeline names, of which it has ``held``; None if its data are in a folder."""
    name = re.search(r'"unsaved:([0-9a-f]{16})"', text)
    if name is None:
        return None
    data = held if held is not None and held._digest == name[1] else _KNOWN.get(name[1])
    if data is None:
        raise InputError(f"the data {name[0]} of the pipeline were never saved and are no longer in memory; set its `data`")
    return data


@contextlib.contextmanager
def storing(folder: str) -> Iterator[None]:
    """Write data in memory to ``folder/data`` when a text refers to them; remove them again if no run of the folder begins
    with them."""
    written: List[str] = []
    is_new = not os.path.isdir(folder)
    token = _STARTING.set((os.path.abspath(folder), written))
    try:
        yield
    finally:
        _STARTING.reset(token)
        pipelines = [_text(path) for path in _pipelines(folder)]
        for path in written:
            if not any(os.path.basename(path) in text for text in pipelines):
                shutil.rmtree(path, ignore_errors=True)
                for parent in (os.path.dirname(path), folder)[: 1 + is_new]:
                    with contextlib.suppress(OSError):  # not empty
                        os.rmdir(parent)


def _stored(data: "_pwrfgs.Dataset", path: str, folder: str, written: List[str]) -> str:
    """Write data to the folder ``path``, named by their digest, unless an earlier start has; returns their source."""
    own = os.path.join(folder, "pipeline.ron")
    if os.path.isfile(own) and os.path.basename(path) not in _text(own):
        raise InputError(f"{folder} holds a run on other data; choose another folder with `out`, or remove it")
    if not os.path.isdir(path):
        written.append(path)
        log.info("writing the data to %s", path)
    return data._store(path)


def _pipelines(folder: str) -> List[str]:
    """Pipeline files of a run or of the runs of a sweep."""
    inside = glob.escape(folder)
    return glob.glob(os.path.join(inside, "pipeline.ron")) + glob.glob(os.path.join(inside, "*", "pipeline.ron"))


def _text(path: str) -> str:
    with contextlib.suppress(OSError), open(path, encoding="utf-8") as file:
        return file.read()
    return ""
