"""MATLAB files: vectors, structs of vectors and matrices. Nothing here loads a pickle."""

from __future__ import annotations

import io
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import (  # fmt: skip
    MAX_VALUES,
    MOST_HEADINGS,
    MOST_VALUES_IN_ALL,
    Column,
    Heading,
    Opened,
    foreign,
    refuse_huge,
    vector,
)
from bayes_aero.flight.readers.hdf5 import HDF5, OBJECT, open_hdf5

__all__ = ["open_mat"]

NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
DEPTH = 3  # structs within structs


def open_mat(data: bytes) -> Opened:
    """A MATLAB file: v5 to v7 by scipy, v7.3 by h5py."""
    if data[512:520] == HDF5 or data[:8] == HDF5:
        return open_hdf5(data, "MATLAB v7.3 file")
    if len(data) < 136 or data[126:128] not in (b"IM", b"MI"):
        raise InputError("it is not a MATLAB file of version 5 to 7.3; in MATLAB, save it again with -v7")
    from scipy.io import whosmat

    claimed = _bounded(data)
    with foreign("MATLAB file"), warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # scipy warns where a file holds one name twice
        contents = {name: (shape, kind) for name, shape, kind in whosmat(io.BytesIO(data))}
    if contents and all(kind in ("opaque", "object", "function") for _, kind in contents.values()):
        raise InputError(OBJECT)
    if claimed > 8 * MOST_VALUES_IN_ALL and any(kind == "struct" for _, kind in contents.values()):
        raise InputError(
            f"it claims {claimed} bytes, more than a record may have; is it damaged? Otherwise cut the record"
        )
    structs = _structs(data, [name for name, (_, kind) in contents.items() if kind == "struct"])
    return MatFile(data, {n: c for n, c in contents.items() if n not in structs}, structs)


READS = {".mat": open_mat}


class MatFile:
    """A MATLAB file whose variables have been listed; `structs` are read, the other variables are not yet."""

    kind = "variable"

    def __init__(self, data: bytes, contents: Mapping[str, tuple[tuple[int, ...], str]], structs: Mapping) -> None:
        self.data, self.remarks = data, list[str]()
        self.places: dict[Heading, _Place] = {}
        fields = [(path, value) for name, it in structs.items() for path, value in _fields(it, name)]
        matrices = [n for n, (shape, kind) in contents.items() if kind in NUMERIC and _is_matrix(shape)]
        matrices += [path for path, value in fields if _is_matrix(value.shape)]
        names = _cell_names(data, contents) if len(matrices) == 1 else ()
        short = Counter([*contents, *(path.rsplit(".", 1)[-1] for path, _ in fields)])
        for name, (shape, kind) in contents.items():
            self._add(_Place(name, kind, shape, None), (name,), name in matrices, len(matrices), names)
        for path, value in fields:
            last = path.rsplit(".", 1)[-1]
            called = (last, path) if short[last] == 1 else (path,)
            self._add(_Place(path, "field", value.shape, value), called, path in matrices, len(matrices), names)

    @property
    def headings(self) -> Sequence[Heading]:
        """Variables and fields; the columns of an only matrix go by their numbers, of several by "name(:,k)"."""
        return list(self.places)

    def _add(self, place: _Place, called: tuple[str, ...], matrix: bool, matrices: int, names: Sequence[str]) -> None:
        if not matrix:
            self.places[Heading(called)] = place
            return
        count = min(place.shape)
        for k in range(count):
            formed = len(names) != count
            label = f"{called[0]}(:,{k + 1})" if formed else names[k]
            self.places[Heading((label,), k + 1 if matrices == 1 else None, formed=formed)] = place.column(k)
        if place.shape[0] < place.shape[1]:
            self.remarks.append(
                f"the matrix {called[0]!r} has {place.shape[0]} rows and {place.shape[1]} columns; each row is taken "
                "for a channel"
            )

    def read(self, wanted: Mapping[str, Heading]) -> dict[str, Column]:
        """See `Opened.read`."""
        from scipy.io import loadmat

        for name, heading in wanted.items():
            place = self.places[heading]
            if place.kind not in (*NUMERIC, "field"):
                raise InputError(
                    f"channel {name} ({place.path!r}) is a {place.kind} where numbers should be; store one numeric "
                    "vector a channel, or a struct of such vectors"
                )
            refuse_huge(name, place.path, float(np.prod([float(extent) for extent in place.shape])), len(wanted))
        unread = {self.places[h].path for h in wanted.values() if self.places[h].values is None}
        with foreign("MATLAB file"), warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            loaded = loadmat(io.BytesIO(self.data), variable_names=sorted(unread)) if unread else {}
        return {name: Column(self.places[heading].taken(name, loaded)) for name, heading in wanted.items()}


@dataclass(frozen=True)
class _Place:
    """A variable or a field of a struct; one column of it where it is a matrix."""

    path: str
    kind: str
    shape: tuple[int, ...]
    values: np.ndarray | None
    at: int | None = None

    def column(self, k: int) -> _Place:
        return _Place(self.path, self.kind, self.shape, self.values, k)

    def taken(self, name: str, loaded: Mapping[str, Any]) -> np.ndarray:
        whole = np.asarray(loaded[self.path] if self.values is None else self.values)
        if self.at is None:
            return vector(whole, name)
        return vector(whole[:, self.at] if whole.shape[0] >= whole.shape[1] else whole[self.at], name)


def _is_matrix(shape: Sequence[int]) -> bool:
    return len(shape) == 2 and min(shape) > 1


def _structs(data: bytes, names: Sequence[str]) -> dict[str, Any]:
    if not names:
        return {}
    from scipy.io import loadmat

    with foreign("MATLAB file"), warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        loaded = loadmat(io.BytesIO(data), variable_names=list(names), simplify_cells=True)
    return {name: loaded[name] for name in names if isinstance(loaded.get(name), dict)}


def _fields(struct: Mapping[str, Any], path: str, depth: int = 1) -> Iterator[tuple[str, np.ndarray]]:
    """Numeric fields of a struct and of the structs in it, by their dotted path."""
    for key, value in struct.items():
        if isinstance(value, Mapping) and depth < DEPTH:
            yield from _fields(value, f"{path}.{key}", depth + 1)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size > 1:
            yield f"{path}.{key}", value


def _cell_names(data: bytes, contents: Mapping[str, tuple[tuple[int, ...], str]]) -> tuple[str, ...]:
    """The names of a matrix's columns, where one cell array of texts lies beside it."""
    cells = [name for name, (_, kind) in contents.items() if kind == "cell"]
    if len(cells) != 1:
        return ()
    from scipy.io import loadmat

    with foreign("MATLAB file"):
        texts = np.asarray(loadmat(io.BytesIO(data), variable_names=cells, simplify_cells=True)[cells[0]]).reshape(-1)
    return tuple(str(text) for text in texts) if all(isinstance(text, str) for text in texts) else ()


def _bounded(data: bytes) -> int:
    """Bytes that all elements claim; refuses one that claims to unpack into more than a record can hold."""
    order = "little" if data[126:128] == b"IM" else "big"
    position, count, total = 128, 0, 0
    while position + 8 <= len(data):
        count += 1
        if count > MOST_HEADINGS:
            raise InputError(f"it has more than {MOST_HEADINGS} variables; is it a flight record?")
        kind = int.from_bytes(data[position : position + 4], order)
        size = int.from_bytes(data[position + 4 : position + 8], order)
        if kind == 15:  # miCOMPRESSED
            with foreign("MATLAB file"):
                inner = zlib.decompressobj().decompress(data[position + 8 : position + 8 + min(size, 4096)], 8)
            claimed = int.from_bytes(inner[4:8], order)
        else:
            claimed = size
        if claimed > 8 * MAX_VALUES + 4096:
            raise InputError(
                f"it claims a variable of {claimed} bytes; is it damaged? In MATLAB, save it again with -v7"
            )
        position, total = position + 8 + size, total + claimed
    return total
