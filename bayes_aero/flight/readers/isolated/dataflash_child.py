"""The groups of an ArduPilot DataFlash log; run by `child.py`."""

import tempfile

import numpy as np
from pymavlink.DFReader import FORMAT_TO_STRUCT, DFReader_binary

HEAD = 3
"""Bytes before the fields of a message: two marks and its type."""

SPOILT = 600
"""Bytes without a message that are no sign of damage: a logger writes whole pages."""

DEGREES = {"degheading": "deg", "deglatitude": "deg", "deglongitude": "deg"}
"""ArduPilot tells kinds of degrees apart."""

NOT_SAMPLED = ("FMT", "FMTU", "MULT", "PARM", "UNIT")
"""What describes other messages, and the list of settings."""


class _Log(DFReader_binary):
    def init_clock(self):
        """Nothing: the calendar time by GPS is not needed, and finding it reads the whole log."""


def groups(data):
    """Every message type with TimeUS, each instance on its own."""
    with tempfile.TemporaryFile() as file:  # the reader maps a file; this one has no name and goes with the process
        file.write(data)
        file.flush()
        log = _Log(file.fileno())
        found, covered = [], 0
        raw = np.frombuffer(data, np.uint8)
        for kind, fmt in log.formats.items():
            covered += len(log.offsets[kind]) * fmt.len
            messages = _messages(raw, log.offsets[kind], fmt)
            if messages is not None and "TimeUS" in fmt.columns and fmt.name not in NOT_SAMPLED:
                found += _instances(fmt, messages)
    origin = min((int(time.min()) for _, time, _ in found if len(time)), default=0)
    lost = len(data) - covered
    remarks = [f"{lost} of its {len(data)} bytes belong to no message; the rest is used"] if lost > SPOILT else []
    return [(name, (time - origin) / 1e6, columns) for name, time, columns in found], remarks


def _messages(raw, offsets, fmt):
    """A structured array of all messages of a type, a field for each character of its format; None where it is odd."""
    if not len(offsets) or len(fmt.columns) != len(fmt.msg_fmts) or len(set(fmt.columns)) != len(fmt.columns):
        return None
    kinds = np.dtype([(f"f{k}", _dtype(code)) for k, code in enumerate(fmt.msg_fmts)])
    if kinds.itemsize + HEAD != fmt.len or kinds.itemsize == 0:
        return None
    starts = np.asarray(offsets, np.int64) + HEAD
    starts = starts[starts + kinds.itemsize <= len(raw)]
    if not len(starts):
        return None
    windows = np.lib.stride_tricks.sliding_window_view(raw, kinds.itemsize)
    return windows[starts].view(kinds).reshape(-1)


def _dtype(code):
    kind = FORMAT_TO_STRUCT[code][0]
    return np.dtype(f"S{kind[:-1]}" if kind.endswith("s") else f"<{kind}")


def _instances(fmt, messages):
    at = fmt.columns.index("TimeUS")
    time = messages[f"f{at}"]
    if time.dtype.kind not in "iu":
        return []
    chosen = {"": slice(None)}
    if fmt.instance_field is not None:
        numbers = messages[f"f{fmt.columns.index(fmt.instance_field)}"]
        chosen = {_label(number): numbers == number for number in np.unique(numbers)}
    found = []
    for label, rows in chosen.items():
        names = (fmt.name + label, fmt.name) if len(chosen) == 1 and label else (fmt.name + label,)
        columns = []
        for k, field in enumerate(fmt.columns):
            values = messages[f"f{k}"]
            if k != at and field != fmt.instance_field and values.dtype.kind in "iuf":
                columns.append(([f"{name}.{field}" for name in names], _unit(fmt, k), _scaled(fmt, k, values[rows])))
        found.append((names[0], time[rows].astype(np.int64), columns))
    return found


def _label(number):
    return f"[{number.decode('latin-1') if isinstance(number, bytes) else number}]"


def _scaled(fmt, k, values):
    """By the factor that the format itself has, as a divisor, which is more exact: 1e-7 is no double."""
    factor = fmt.msg_mults[k]
    return values if factor is None else values / round(1.0 / factor)


def _unit(fmt, k):
    unit = fmt.units[k] if fmt.units else ""
    return DEGREES.get(unit, unit) or None
