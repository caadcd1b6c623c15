"""Parsers that run in a process of their own. Run as a script, never imported by the package.

On damaged bytes such parsers loop for ever, crash or take all memory, and nothing interrupts them from inside. The
parent, `binary.py`, gives this process a time limit instead.

In: the file on stdin, the name of the parser in argv[1], a request as JSON in argv[2]. `hdf5` gives a reply for JSON
and the arrays behind it; the others a list of groups (a name, (n,) seconds from the file's start, and columns: names,
unit or None, (n,) numbers) and one of remarks. Each parser imports its library itself.
Out: the reply as JSON and its arrays, as `np.savez` writes them. Failures: {"error": ...}.
"""

import io
import json
import os
import sys
import tempfile
import warnings
from collections import Counter
from contextlib import redirect_stdout, suppress
from itertools import islice
from typing import Any

import numpy as np

MEMORY = 8 << 30  # bytes of address space for this process; a damaged header may ask for any amount
MOST_BYTES = 16 * 100_000_000  # most bytes that a log may unpack to


# --- ArduPilot DataFlash logs.

HEAD = 3  # bytes before the fields of a message: two marks and its type
DEGREES = {"degheading": "deg", "deglatitude": "deg", "deglongitude": "deg"}  # ArduPilot tells kinds of degrees apart
NOT_SAMPLED = ("FMT", "FMTU", "MULT", "PARM", "UNIT")  # what describes other messages, and the list of settings


def dataflash(data):
    """Every message type with TimeUS, each instance on its own."""
    from pymavlink.DFReader import FORMAT_TO_STRUCT, DFReader_binary

    class Log(DFReader_binary):
        def init_clock(self):
            """Nothing: the calendar time by GPS is not needed, and finding it reads the whole log."""

    with tempfile.TemporaryFile() as file:  # the reader maps a file; this one has no name and goes with the process
        file.write(data)
        file.flush()
        log = Log(file.fileno())
        groups, covered = [], 0
        raw = np.frombuffer(data, np.uint8)
        for kind, fmt in log.formats.items():
            covered += len(log.offsets[kind]) * fmt.len
            if "TimeUS" in fmt.columns and fmt.name not in NOT_SAMPLED:
                groups += _instances(raw, log.offsets[kind], fmt, FORMAT_TO_STRUCT)
    origin = min((int(time.min()) for _, time, _ in groups if len(time)), default=0)
    lost = len(data) - covered  # 600 are no sign of damage: a logger writes whole pages
    remarks = [f"{lost} of its {len(data)} bytes belong to no message; the rest is used"] if lost > 600 else []
    return [(name, (time - origin) / 1e6, columns) for name, time, columns in groups], remarks


def _instances(raw, offsets, fmt, types):
    """A group for each instance of a message; none of one that is odd."""
    codes = [types[code][0] for code in fmt.msg_fmts]
    codes = [f"S{code[:-1]}" if code.endswith("s") else f"<{code}" for code in codes]
    layout = np.dtype([(f"f{k}", code) for k, code in enumerate(codes)])
    starts = np.asarray(offsets, np.int64) + HEAD
    starts = starts[starts + layout.itemsize <= len(raw)]
    at = fmt.columns.index("TimeUS")
    odd = len(codes) != len(fmt.columns) or len(set(fmt.columns)) != len(codes) or layout.itemsize + HEAD != fmt.len
    if odd or not len(starts) or layout[at].kind not in "iu":
        return []
    windows = np.lib.stride_tricks.sliding_window_view(raw, layout.itemsize)
    messages = windows[starts].view(layout).reshape(-1)  # a field for each character of its format
    chosen = {"": slice(None)}
    if fmt.instance_field is not None:
        numbers = messages[f"f{fmt.columns.index(fmt.instance_field)}"]
        texts = {n: n.decode("latin-1") if isinstance(n, bytes) else n for n in np.unique(numbers)}
        chosen = {f"[{text}]": numbers == number for number, text in texts.items()}
    groups = []
    for label, rows in chosen.items():
        names = (fmt.name + label, fmt.name) if len(chosen) == 1 and label else (fmt.name + label,)
        columns = []
        for k, field in enumerate(fmt.columns):
            if k == at or field == fmt.instance_field or layout[k].kind not in "iuf":
                continue
            values, unit, factor = messages[f"f{k}"][rows], fmt.units[k] if fmt.units else "", fmt.msg_mults[k]
            # By the factor that the format itself has, as a divisor, which is more exact: 1e-7 is no double.
            scaled = values if factor is None else values / round(1.0 / factor)
            columns.append(([f"{name}.{field}" for name in names], DEGREES.get(unit, unit) or None, scaled))
        groups.append((names[0], messages[f"f{at}"][rows].astype(np.int64), columns))
    return groups


# --- HDF5: datasets, and the numbers in them.

DEPTH, MOST_DATASETS = 3, 2100
NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"  # names a dataset that holds a length alone


def hdf5(data, wanted, kept):
    """What is there, where nothing is `wanted`; else numbers and `kept` attributes of each path (and column)."""
    import h5py

    arrays, attributes = [], []
    with h5py.File(io.BytesIO(data), "r") as file:
        there = dict(islice(_datasets(file), MOST_DATASETS))
        if not wanted:
            return {"available": {path[:200]: _listed(dataset) for path, dataset in there.items()}}, []
        for path, column in wanted:
            values, given = np.asarray(there[path][()]), there[path].attrs
            if column is not None:
                values = values[column] if values.shape[0] <= values.shape[1] else values[:, column]
            arrays.append(values.reshape(-1))
            attributes.append({key: _attribute(given[key]) for key in kept if key in given})
    return {"attributes": attributes}, arrays


def _text(value):
    value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return str(value)[:60]


def _attribute(value):
    array = np.asarray(value).reshape(-1)[:2100]
    array = array.astype(array.dtype.newbyteorder("="))
    if array.dtype.kind in "iufb":
        return array.dtype.str, array.tolist()
    return "U", [_text(x) for x in array.tolist()]


def _datasets(group, path="", depth=0):
    """Paths and datasets of a group and of the groups in it; no links out of the file, no library's own groups."""
    import h5py

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


def _listed(dataset):
    """Shape and unit of a dataset, and why it, or the columns of it, cannot be channels."""
    import h5py

    matrix = dataset.ndim == 2 and "MATLAB_int_decode" not in dataset.attrs
    problem, unit = "", dataset.attrs.get("units")
    states = h5py.check_enum_dtype(dataset.dtype)
    if dataset.dtype.kind not in "fiub" or states:
        holds = "named states (an enumeration)" if states else dataset.dtype
        problem = f"holds {holds} where numbers should be; store it as plain numbers"
    elif dataset.size is None:
        problem = "holds nothing; is the file damaged?"
    elif not matrix and dataset.ndim != 1 and dataset.size != max(dataset.shape, default=1):
        problem = f"has shape {dataset.shape} where one value a sample should be; split it up"
    elif dataset.external or dataset.is_virtual:
        problem = "is stored in another file; copy the data into this one"
    return {
        "shape": [int(extent) for extent in dataset.shape or ()],
        "unit": None if unit is None else _text(unit),
        "opaque": "MATLAB_object_decode" in dataset.attrs,
        "problem": problem,
    }


# --- ASAM MDF, version 4.


def mdf4(data):
    """Every channel group that has a time channel."""
    from asammdf import MDF
    from asammdf.blocks import v4_constants as v4

    groups, remarks = [], []
    mdf: Any
    with MDF(io.BytesIO(data)) as mdf:
        # A name for each group: what the file calls it, where that is a name and no other group has it.
        texts = [group.channel_group.acq_name or group.channel_group.comment or "" for group in mdf.groups]
        named = [text if 0 < len(text) <= 60 and "<" not in text and "\n" not in text else "" for text in texts]
        labels = [t if t and named.count(t) == 1 else f"group {k}" for k, t in enumerate(named, 1)]
        listed = {k: _signals(group, remarks) for k, group in enumerate(mdf.groups)}
        counts = Counter(name for signals in listed.values() for _, name in signals)
        for k, signals in listed.items():
            if not signals or not mdf.groups[k].channel_group.cycles_nr:
                continue
            master = mdf.masters_db.get(k)
            if master is None or mdf.groups[k].channels[master].sync_type != v4.SYNC_TYPE_TIME:
                remarks.append(f"the group {labels[k]!r} has no time channel; its {len(signals)} signals are left out")
                continue
            read = mdf.select([(None, k, c) for c, _ in signals], ignore_value2text_conversions=True, copy_master=False)
            time = np.asarray(read[0].timestamps, np.float64)
            columns = []
            for (_, name), signal in zip(signals, read, strict=True):
                values, invalid = np.asarray(signal.samples), signal.invalidation_bits
                if invalid is not None and np.any(invalid) and values.dtype.kind in "fiub":
                    values = np.where(np.asarray(invalid, bool), np.nan, values)
                if values.ndim == 1 and values.dtype.kind in "fiub" and len(values) == len(time):
                    qualified = f"{labels[k]}/{name}"
                    alone = counts[name] == 1 and name != "time"
                    columns.append(([name, qualified] if alone else [qualified], signal.unit or None, values))
            groups.append((labels[k], time, columns))
    return groups, remarks


def _signals(group, remarks):
    """Index and name of the signals that hold one number a sample."""
    from asammdf.blocks import v4_constants as v4

    def formula(conversion):  # text that somebody else wrote: asammdf would have it run as a program
        inner = (getattr(conversion, "referenced_blocks", None) or {}).values()
        return getattr(conversion, "conversion_type", None) == v4.CONVERSION_TYPE_ALG or any(map(formula, inner))

    values = (v4.CHANNEL_TYPE_VALUE, v4.CHANNEL_TYPE_VIRTUAL)
    numbers = range(v4.DATA_TYPE_UNSIGNED_INTEL, v4.DATA_TYPE_REAL_MOTOROLA + 1)
    kept = []
    for index, channel in enumerate(group.channels):
        if channel.channel_type not in values or channel.data_type not in numbers or group.channel_dependencies[index]:
            continue
        if formula(channel.conversion):
            remarks.append(f"the signal {channel.name!r} is left out: its conversion is a formula")
        else:
            kept.append((index, channel.name))
    return kept


# --- PX4 ULog.


def ulog(data):
    """Every topic and instance with its time stamps."""
    from pyulog import ULog

    log = ULog(io.BytesIO(data))
    groups, without = [], []
    for topic in log.data_list:
        label = topic.name if topic.multi_id == 0 else f"{topic.name}.{topic.multi_id}"
        stamps = topic.data.get("timestamp")
        if stamps is None or stamps.dtype != np.uint64:
            without.append(label)
            continue
        time = (stamps - np.uint64(log.start_timestamp)).view(np.int64) / 1e6  # those before the start are negative
        kinds = {field.field_name: field.type_str for field in topic.field_data}
        columns = [
            ((f"{label}.{name}",), None, values)
            for name, values in topic.data.items()
            if name != "timestamp" and kinds[name] != "char" and "_padding" not in name
        ]
        groups.append((label, time, columns))
    remarks = []
    if log.file_corruption:
        remarks.append("the file is damaged in places; the samples that could be read are used")
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts) / 1000.0
        remarks.append(f"the logger lost samples {len(log.dropouts)} times, for {lost:g} s in all")
    if without:
        remarks.append(f"{len(without)} topics have no time stamps and are left out: {', '.join(without[:5])}")
    return groups, remarks


def groups_of(parsed):
    groups, remarks = parsed
    arrays, listed = [], []
    for name, time, columns in groups:
        described = [[[str(n)[:200] for n in names], unit] for names, unit, _ in columns]
        listed.append({"name": str(name)[:200], "columns": described})
        arrays += [np.asarray(time, np.float64), *(values for _, _, values in columns)]
    if (claimed := sum(array.nbytes for array in arrays)) > MOST_BYTES:
        raise ValueError(f"it unpacks to {claimed} bytes, more than {MOST_BYTES}: cut the record")
    return {"groups": listed, "remarks": [str(remark)[:500] for remark in remarks]}, arrays


PARSERS: dict[str, Any] = {"hdf5": hdf5} | {
    name: lambda data, parser=parser: groups_of(parser(data))
    for name, parser in {"dataflash": dataflash, "mdf": mdf4, "ulog": ulog}.items()
}


def main():
    with suppress(ImportError, ValueError, OSError):  # not every platform can
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    warnings.simplefilter("ignore")
    arrays: list = []
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):  # some of them print what they think of the file
        try:
            reply, arrays = PARSERS[sys.argv[1]](sys.stdin.buffer.read(), *json.loads(sys.argv[2]))
            arrays = [x.astype(x.dtype.newbyteorder("="), copy=False) for x in arrays]  # as this machine has it
        except Exception as reason:
            reply = {"error": " ".join(str(reason).split())[:120] or type(reason).__name__}
    out = io.BytesIO()
    np.savez(out, *arrays, reply=json.dumps(reply))
    sys.stdout.buffer.write(out.getbuffer())


if __name__ == "__main__":
    main()
