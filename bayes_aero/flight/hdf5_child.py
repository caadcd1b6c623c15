"""Read vectors from an HDF5 file in a process of its own. Run as a script, never imported by the package.

The HDF5 library is C code that can loop for ever on a damaged file (fuzzing found such files soon), and nothing
interrupts a loop in C. The parent, `hdf5.py`, gives this process a time limit instead.

In: the file on stdin, the wanted labels as JSON in argv[1], the most samples a channel may have in argv[2], that
all may have together in argv[3].
Out: one line of JSON, then the float64 samples of the vectors in its order. Failures: {"error": ...}.
"""

import io
import json
import sys
from contextlib import suppress

import h5py
import numpy as np

TOO_MUCH = "and the others claim more values than a record may have; is the file damaged? Otherwise cut the record"
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


def _is_dataset(file, label, available):
    link = file.get(label, getlink=True) if label in available else None
    return isinstance(link, h5py.HardLink) and isinstance(file[label], h5py.Dataset)


def _read(dataset, label, most):
    if dataset.dtype.kind not in "fiub":
        return None, f"holds {dataset.dtype} where numbers should be; store it as plain numbers"
    if dataset.size is None or dataset.size > most:
        return None, f"claims {dataset.size} samples, more than {most}; is the file damaged?"
    if dataset.ndim != 1 and dataset.size != max(dataset.shape, default=1):
        return None, f"has shape {dataset.shape} where one value a sample should be; split it up"
    if dataset.external or dataset.is_virtual:
        return None, "is stored in another file; copy the data into this one"
    values = np.asarray(dataset[()]).reshape(-1)
    attributes = dataset.attrs
    missing = np.zeros(values.shape, bool)
    for key in ("_FillValue", "missing_value"):
        if key in attributes:
            missing |= values == np.asarray(attributes[key]).reshape(-1)[0]
    values = values.astype(np.float64) * _scalar(attributes, "scale_factor", 1.0) + _scalar(
        attributes, "add_offset", 0.0
    )
    values[missing] = np.nan
    unit = _text(attributes["units"]) if "units" in attributes else None
    return (label, values, unit), None


def main():
    _limit_memory()
    labels, most, room = json.loads(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    found: list = []
    reply: dict = {}
    try:
        with h5py.File(io.BytesIO(sys.stdin.buffer.read()), "r") as file:
            reply["available"] = [str(name)[:100] for name, _ in zip(file, range(1000), strict=False)]
            wanted = {label: file[label] for label in labels if _is_dataset(file, label, reply["available"])}
            sizes = [getattr(dataset, "size", None) or 0 for dataset in wanted.values()]
            whole = sum(sizes) if max(sizes, default=0) <= most else 0  # one too large is told below
            for label, dataset in wanted.items():
                column, problem = _read(dataset, label, most) if whole <= room else (None, TOO_MUCH)
                if column is None:
                    reply["problem"] = [label, problem]
                    break
                found.append(column)
    except Exception as reason:
        reply = {"error": " ".join(str(reason).split())[:120] or type(reason).__name__}
        found = []
    reply["columns"] = [[label, values.size, unit] for label, values, unit in found]
    sys.stdout.buffer.write(json.dumps(reply).encode() + b"\n")
    for _, values, _ in found:
        sys.stdout.buffer.write(values.tobytes())


if __name__ == "__main__":
    main()
