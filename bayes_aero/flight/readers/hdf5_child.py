"""Read vectors from an HDF5 file in a process of its own. Run as a script, never imported by the package.

The HDF5 library is C code that can loop for ever on a damaged file (fuzzing found such files soon), and nothing
interrupts a loop in C. The parent, `hdf5.py`, gives this process a time limit instead.

In: the file on stdin; as JSON in argv[1] the wanted datasets (path and, of a matrix, the column counted from 0; none:
list what is there) and the attributes that go with them; the most samples a channel may have in argv[2], that all may
have together in argv[3].
Out: one line of JSON, then the samples of the vectors in its order, as stored. Failures: {"error": ...}.
"""

import io
import json
import sys
from contextlib import suppress
from itertools import islice

import h5py
import numpy as np

TOO_MUCH = "and the others claim more values than a record may have; is the file damaged? Otherwise cut the record"
DEPTH, MOST = 3, 2100
NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"
"""What NetCDF names a dataset that holds a length and no numbers."""
MEMORY = 8 << 30
"""Bytes of address space for this process; a damaged header may ask for any amount."""


def _limit_memory():
    with suppress(ImportError, ValueError, OSError):  # not every platform can
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))


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


def _read(dataset, column, most):
    if dataset.dtype.kind not in "fiub":
        return None, f"holds {dataset.dtype} where numbers should be; store it as plain numbers"
    if h5py.check_enum_dtype(dataset.dtype):
        return None, "holds named states (an enumeration) where numbers should be; store it as plain numbers"
    if dataset.size is None or dataset.size > most:
        return None, f"claims {dataset.size} samples, more than {most}; is the file damaged?"
    if column is None and dataset.ndim != 1 and dataset.size != max(dataset.shape, default=1):
        return None, f"has shape {dataset.shape} where one value a sample should be; split it up"
    if dataset.external or dataset.is_virtual:
        return None, "is stored in another file; copy the data into this one"
    values = np.asarray(dataset[()])
    if column is not None:
        values = values[column] if values.shape[0] <= values.shape[1] else values[:, column]
    values = values.reshape(-1)
    return values.astype(values.dtype.newbyteorder("=")), None


def _listed(dataset):
    attributes = dataset.attrs
    return {
        "shape": [int(extent) for extent in dataset.shape or ()],
        "numbers": dataset.dtype.kind in "fiub" and "MATLAB_int_decode" not in attributes,
        "unit": _text(attributes["units"]) if "units" in attributes else None,
        "opaque": "MATLAB_object_decode" in attributes,
    }


def main():
    _limit_memory()
    (wanted, kept), most, room = json.loads(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    found: list = []
    reply: dict = {}
    try:
        with h5py.File(io.BytesIO(sys.stdin.buffer.read()), "r") as file:
            there = dict(islice(_datasets(file), MOST))
            if not wanted:
                reply["available"] = {path[:200]: _listed(dataset) for path, dataset in there.items()}
            sizes = [there[path].size or 0 for path, _ in wanted]
            whole = sum(sizes) if max(sizes, default=0) <= most else 0  # one too large is told below
            for place, (path, column) in enumerate(wanted):
                values, problem = _read(there[path], column, most) if whole <= room else (None, TOO_MUCH)
                if values is None:
                    reply["problem"] = [place, problem]
                    break
                attributes = there[path].attrs
                found.append((values, {key: _attribute(attributes[key]) for key in kept if key in attributes}))
    except Exception as reason:
        reply = {"error": " ".join(str(reason).split())[:120] or type(reason).__name__}
        found = []
    reply["vectors"] = [(x.dtype.str, x.size, given) for x, given in found]
    sys.stdout.buffer.write(json.dumps(reply).encode() + b"\n")
    for values, _ in found:
        sys.stdout.buffer.write(values.tobytes())


if __name__ == "__main__":
    main()
