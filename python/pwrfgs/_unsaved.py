"""Data sets in memory that pipelines refer to. The text of a pipeline names them by a digest of their content; a run writes
them into its folder first.
"""

from __future__ import annotations

import contextlib
import glob
import os
import re
import shutil
from typing import Callable, Iterator, List, Optional
from weakref import WeakValueDictionary

from . import _pwrfgs
from ._errors import InputError
from ._log import log

# Data source of each kind of data, as `Dataset.save` writes them.
_SOURCES = {"spectrum": "Arrays", "power": "Nerf2Rssi", "channel": "Channels"}
_KNOWN: "WeakValueDictionary[str, _pwrfgs.Dataset]" = WeakValueDictionary()

#: Writes data to the folder of a run and returns the RON text of their source.
Store = Callable[["_pwrfgs.Dataset"], str]


def source_text(data: "_pwrfgs.Dataset") -> str:
    """RON text of the source of data: that of their folder, or for data in memory one with a digest in its place."""
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
def storing(folder: str) -> Iterator[Store]:
    """Give a function that writes data in memory to ``folder/data``, unless an earlier start has. At the end, remove what it
    wrote if no run of the folder has begun with it."""
    written: List[str] = []
    is_new = not os.path.isdir(folder)
    own = os.path.join(folder, "pipeline.ron")

    def store(data: "_pwrfgs.Dataset") -> str:
        path = os.path.join(os.path.abspath(folder), "data", data._digest)
        if not os.path.isdir(path):
            if data._source is not None:  # saved since
                return data._source
            if os.path.isfile(own) and data._digest not in _text(own):
                raise InputError(f"{folder} holds a run on other data; choose another folder with `out`, or remove it")
            written.append(path)
            log.info("writing the data to %s", path)
        return data._store(path)

    try:
        yield store
    finally:
        inside = glob.escape(folder)
        texts = [_text(path) for path in [own, *glob.glob(os.path.join(inside, "*", "pipeline.ron"))]]
        for path in written:
            if not any(os.path.basename(path) in text for text in texts):
                shutil.rmtree(path, ignore_errors=True)
                for parent in (os.path.dirname(path), folder)[: 1 + is_new]:
                    with contextlib.suppress(OSError):  # not empty
                        os.rmdir(parent)


def _text(path: str) -> str:
    with contextlib.suppress(OSError), open(path, encoding="utf-8") as file:
        return file.read()
    return ""
