"""The datasets of an HDF5 file and the numbers in them; run by `child.py`."""

import io
from itertools import islice

import h5py
import numpy as np

TOO_MUCH = "and the others claim more values than a record may have; is the file damaged? Otherwise cut the record"
DEPTH, MOST = 3, 2100
NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"
"""What NetCDF names a dataset that holds a length and no numbers."""


def answer(data, wanted, kept, most, room):
    """What is there, where nothing is `wanted`; else the numbers as stored. wanted: path and, of a matrix, column of
    each. kept: attributes that go with them. most: samples that a channel may have; room: that all may have."""
    found: list = []
    reply: dict = {}
    with h5py.File(io.BytesIO(data), "r") as file:
        there = dict(islice(_datasets(file), MOST))
        if not wanted:
            reply["available"] = {path[:200]: _listed(dataset) for path, dataset in there.items()}
        sizes = [there[path].size or 0 for path, _ in wanted]
        whole = sum(sizes) if max(sizes, default=0) <= most else 0  # one that is too large is refused below
        for place, (path, column) in enumerate(wanted):
            problem = TOO_MUCH if whole > room else _problem(there[path], column, most)
            if problem:
                reply["problem"] = [place, problem]
                break
            values = np.asarray(there[path][()])
            if column is not None:
                values = values[column] if values.shape[0] <= values.shape[1] else values[:, column]
            values = values.reshape(-1)
            attributes = there[path].attrs
            given = {key: _attribute(attributes[key]) for key in kept if key in attributes}
            found.append((values.astype(values.dtype.newbyteorder("=")), given))
    reply["vectors"] = [(x.dtype.str, x.size, given) for x, given in found]
    return reply, [x for x, _ in found]


def _text(value):
    value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return str(value)[:60]


def _attribute(value):
    """Type and values of an attribute, as JSON has them."""
    array = np.asarray(value).reshape(-1)[:2100]
    array = array.astype(array.dtype.newbyteorder("="))
    if array.dtype.kind in "iufb":
        return array.dtype.str, array.tolist()
    return "U", [_text(x) for x in array.tolist()]


def _datasets(group, path="", depth=0):
    """Paths and datasets of a group and of the groups in it; no links out of the file, no library's own groups."""
    for name in group:
        link = group.get(name, getlink=True)
        if not isinstance(link, h5py.HardLink) or name.startswith("#"):
            continue
        item, where = group[name], f"{path}{name}"
        if isinstance(item, h5py.Dataset):
            if not _text(item.attrs.get("NAME", "")).startswith(NO_VARIABLE):
                yield where, item
        elif isinstance(item, h5py.Group) and depth < DEPTH:
            yield from _datasets(item, f"{where}/", depth + 1)


def _problem(dataset, column, most):
    """Why a dataset, or a column of it, cannot be one channel."""
    if dataset.dtype.kind not in "fiub":
        return f"holds {dataset.dtype} where numbers should be; store it as plain numbers"
    if h5py.check_enum_dtype(dataset.dtype):
        return "holds named states (an enumeration) where numbers should be; store it as plain numbers"
    if dataset.size is None or dataset.size > most:
        return f"claims {dataset.size} samples, more than {most}; is the file damaged?"
    if column is None and dataset.ndim != 1 and dataset.size != max(dataset.shape, default=1):
        return f"has shape {dataset.shape} where one value a sample should be; split it up"
    if dataset.external or dataset.is_virtual:
        return "is stored in another file; copy the data into this one"
    return None


def _listed(dataset):
    attributes = dataset.attrs
    return {
        "shape": [int(extent) for extent in dataset.shape or ()],
        "numbers": dataset.dtype.kind in "fiub" and "MATLAB_int_decode" not in attributes,
        "unit": _text(attributes["units"]) if "units" in attributes else None,
        "opaque": "MATLAB_object_decode" in attributes,
    }
