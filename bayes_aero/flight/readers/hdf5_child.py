"""Read vectors from an HDF5 file in a process of its own. Run as a script, never imported by the package.

The HDF5 library is C code that can loop for ever on a damaged file (fuzzing found such files soon), and nothing
interrupts a loop in C. The parent, `hdf5.py`, gives this process a time limit instead.

In: the file on stdin, the wanted datasets as JSON in argv[1] (path and, of a matrix, the column counted from 0; none:
list what is there), the most samples a channel may have in argv[2], that all may have together in argv[3].
Out: one line of JSON, then the float64 samples of the vectors in its order. Failures: {"error": ...}.
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
MEMORY = 8 << 30
"""Bytes of address space for this process; a damaged header may ask for any amount."""


def _limit_memory():
    with suppress(ImportError, ValueError, OSError):  # not every platform can
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))


def _text(value):
    value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return str(value)[:60]


def _scalar(attributes, key, default):
    """A numeric attribute of CF conventions, or the default."""
    return float(np.asarray(attributes[key]).reshape(-1)[0]) if key in attributes else default


def _datasets(group, path="", depth=0):
    """Paths and datasets of a group and of the groups in it; no links out of the file, no library's own groups."""
    for name in group:
        link = group.get(name, getlink=True)
        if not isinstance(link, h5py.HardLink) or name.startswith("#"):
            continue
        item, where = group[name], f"{path}{name}"
        if isinstance(item, h5py.Dataset):
            yield where, item
        elif isinstance(item, h5py.Group) and depth < DEPTH:
            yield from _datasets(item, f"{where}/", depth + 1)


def _read(dataset, column, most):
    if dataset.dtype.kind not in "fiub":
        return None, f"holds {dataset.dtype} where numbers should be; store it as plain numbers"
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
    attributes = dataset.attrs
    missing = np.zeros(values.shape, bool)
    for key in ("_FillValue", "missing_value"):
        if key in attributes:
            missing |= values == np.asarray(attributes[key]).reshape(-1)[0]
    values = values.astype(np.float64) * _scalar(attributes, "scale_factor", 1.0) + _scalar(
        attributes, "add_offset", 0.0
    )
    values[missing] = np.nan
    return values, None


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
    wanted, most, room = json.loads(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
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
                found.append(values)
    except Exception as reason:
        reply = {"error": " ".join(str(reason).split())[:120] or type(reason).__name__}
        found = []
    reply["sizes"] = [values.size for values in found]
    sys.stdout.buffer.write(json.dumps(reply).encode() + b"\n")
    for values in found:
        sys.stdout.buffer.write(values.tobytes())


if __name__ == "__main__":
    main()
