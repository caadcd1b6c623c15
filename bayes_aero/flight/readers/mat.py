"""MATLAB files: vectors, structs of vectors and matrices. Nothing here loads a pickle."""

from __future__ import annotations

import io
import warnings
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import (
    MAX_VALUES,
    MOST_HEADINGS,
    MOST_VALUES_IN_ALL,
    FileColumn,
    Heading,
    OpenedFile,
    foreign,
    refuse_huge,
    vector,
)
from bayes_aero.flight.readers.hdf5 import HDF5, OBJECT, open_hdf5

NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
DEPTH = 3  # structs within structs


def open_mat(data: bytes) -> OpenedFile:
    """A MATLAB file: v5 to v7 by scipy, v7.3 by h5py. Structs are read, the other variables are only listed. The
    columns of an only matrix go by their numbers, those of several by "name(:,k)"."""
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
    structs = [name for name, (_, kind) in contents.items() if kind == "struct"]
    if claimed > 8 * MOST_VALUES_IN_ALL and structs:
        raise InputError(
            f"it claims {claimed} bytes, more than a record may have; is it damaged? Otherwise cut the record"
        )
    loaded = _loaded(data, structs, simplify_cells=True)
    fields: dict[str, np.ndarray] = {}
    for name in structs:
        if isinstance(loaded.get(name), dict):
            del contents[name]
            fields |= _fields(loaded[name], name)
    places = [_Place(name, kind, shape, None) for name, (shape, kind) in contents.items()]
    places += [_Place(path, "field", value.shape, value) for path, value in fields.items()]
    return _opened(data, places)


READS = {".mat": open_mat}


def _loaded(data: bytes, names: Iterable[str], **options: bool) -> dict[str, Any]:
    from scipy.io import loadmat

    with foreign("MATLAB file"), warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        return loadmat(io.BytesIO(data), variable_names=list(names), **options) if names else {}


def _opened(data: bytes, listed: Sequence[_Place]) -> OpenedFile:
    matrices = [place for place in listed if place.is_matrix]
    cells = [place.path for place in listed if place.kind == "cell"]
    names: tuple[str, ...] = ()  # of a matrix's columns, where one cell array of texts lies beside it
    if len(matrices) == 1 and len(cells) == 1:
        texts = np.asarray(_loaded(data, cells, simplify_cells=True)[cells[0]]).reshape(-1)
        names = tuple(map(str, texts)) if all(isinstance(text, str) for text in texts) else ()
    short = Counter(place.path.rsplit(".", 1)[-1] for place in listed)
    places, remarks = dict[Heading, _Place](), []
    for place in listed:
        last, path = place.path.rsplit(".", 1)[-1], place.path
        called = tuple(dict.fromkeys((last, path) if short[last] == 1 else (path,)))
        if not place.is_matrix:
            places[Heading(called)] = place
            continue
        count = min(place.shape)
        formed = len(names) != count
        for k in range(count):
            label = f"{called[0]}(:,{k + 1})" if formed else names[k]
            places[Heading((label,), k + 1 if len(matrices) == 1 else None, formed=formed)] = replace(place, at=k)
        if place.shape[0] < place.shape[1]:
            remarks.append(
                f"the matrix {called[0]!r} has {place.shape[0]} rows and {place.shape[1]} columns; each row is taken "
                "for a channel"
            )

    def read(wanted: Mapping[str, Heading]) -> dict[str, FileColumn]:
        for name, heading in wanted.items():
            place = places[heading]
            if place.kind not in (*NUMERIC, "field"):
                raise InputError(
                    f"channel {name} ({place.path!r}) is a {place.kind} where numbers should be; store one numeric "
                    "vector a channel, or a struct of such vectors"
                )
            refuse_huge(name, place.path, float(np.prod([float(extent) for extent in place.shape])), len(wanted))
        loaded = _loaded(data, sorted({places[h].path for h in wanted.values() if places[h].values is None}))
        return {name: FileColumn(places[heading].taken(name, loaded)) for name, heading in wanted.items()}

    return OpenedFile(list(places), read, remarks=remarks)


@dataclass(frozen=True)
class _Place:
    """A variable or a field of a struct, which is read already; one column `at` of it where it is a matrix."""

    path: str
    kind: str
    shape: tuple[int, ...]
    values: np.ndarray | None
    at: int | None = None

    @property
    def is_matrix(self) -> bool:
        return self.kind in (*NUMERIC, "field") and len(self.shape) == 2 and min(self.shape) > 1

    def taken(self, name: str, loaded: Mapping[str, Any]) -> np.ndarray:
        whole = np.asarray(loaded[self.path] if self.values is None else self.values)
        if self.at is None:
            return vector(whole, name)
        return vector(whole[:, self.at] if whole.shape[0] >= whole.shape[1] else whole[self.at], name)


def _fields(struct: Mapping[str, Any], path: str, depth: int = 1) -> Iterator[tuple[str, np.ndarray]]:
    """Numeric fields of a struct and of the structs in it, by their dotted path."""
    for key, value in struct.items():
        if isinstance(value, Mapping) and depth < DEPTH:
            yield from _fields(value, f"{path}.{key}", depth + 1)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size > 1:
            yield f"{path}.{key}", value


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
