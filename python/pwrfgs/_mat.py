"""Real matrices of MATLAB files of version 5, the format of scenarios before DeepMIMO used NumPy's."""

from __future__ import annotations

import io
import os
import struct
import zlib
from typing import IO, Any, Callable, Sequence

import numpy as np

from ._types import Array

# Types of elements, and of numbers by their code.
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
# Classes of arrays of numbers, and the flag of complex ones.
_NUMERIC, _COMPLEX = range(6, 16), 0x08
# Largest element that describes a matrix, bytes.
_MOST_BYTES = 1000


class _Inflated(io.RawIOBase):
    """Compressed bytes, as a file. The checksum is compared at its end."""

    def __init__(self, packed: bytes) -> None:
        self._inflate, self._rest = zlib.decompressobj(), packed

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        piece = self._inflate.decompress(self._rest, len(buffer))
        self._rest = self._inflate.unconsumed_tail
        if not piece and not self._inflate.eof:
            raise ValueError("the file is cut")
        buffer[: len(piece)] = piece
        return len(piece)


def read_matrix(path: str, name: str, check_size: Callable[[Sequence[int], bool], None]) -> Array:
    """Matrix ``name``, the first variable of the file; ``check_size`` gets shape and whether it is real, before it is read."""
    with open(path, "rb") as raw:
        order = {b"IM": "<", b"MI": ">"}.get(raw.read(128)[126:])
        if order is None:
            raise ValueError("it is no MATLAB file of version 5")
        kind, size = struct.unpack(f"{order}II", raw.read(8))
        file: IO[bytes] = raw
        if kind == _COMPRESSED:
            file = io.BufferedReader(_Inflated(raw.read(min(size, os.path.getsize(path)))))
            kind, size = struct.unpack(f"{order}II", file.read(8))
        if kind != _MATRIX:
            raise ValueError("it holds no matrix")
        (flags,) = struct.unpack(f"{order}I4x", _element(file, order))
        shape = np.frombuffer(_element(file, order), f"{order}i4").tolist()
        found = _element(file, order).decode("latin-1")
        if found != name:
            raise ValueError(f"its variable is {found[:60]!r}")
        check_size(shape, min(shape) >= 0 and flags & 0xFF in _NUMERIC and not flags >> 8 & _COMPLEX)
        values = _numbers(file, order, shape)
        if file is not raw and file.read(1):
            raise ValueError("the file goes on after the matrix")
        return values


def _element(file: IO[bytes], order: str) -> bytes:
    """Small element: its type and size, then its bytes."""
    word, data = struct.unpack(f"{order}I4s", file.read(8))
    if word >> 16:  # size and type in one word, followed by the bytes
        short: bytes = data[: word >> 16]
        return short
    (size,) = struct.unpack(f"{order}I", data)
    if size > _MOST_BYTES:
        raise ValueError("its description is too long")
    return file.read(size + -size % 8)[:size]


def _numbers(file: IO[bytes], order: str, shape: Sequence[int]) -> Array:
    """Element of numbers, column by column."""
    word, data = struct.unpack(f"{order}I4s", file.read(8))
    number, size = np.dtype(order + _NUMBERS[word & 0xFFFF]), word >> 16
    wanted = int(np.prod(shape, dtype=object)) * number.itemsize
    if not size:
        (size,) = struct.unpack(f"{order}I", data)
        data = file.read(wanted + -wanted % 8)[:wanted] if size == wanted else b""
    if not size == wanted <= len(data):
        raise ValueError(f"it has {size} bytes of numbers, expected {wanted}")
    return np.frombuffer(data[:wanted], number).reshape(shape, order="F")
