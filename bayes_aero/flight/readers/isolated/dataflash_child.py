"""The groups of an ArduPilot DataFlash log; run by `child.py`."""

import tempfile

import numpy as np
from pymavlink.DFReader import FORMAT_TO_STRUCT, DFReader_binary

HEAD = 3  # bytes before the fields of a message: two marks and its type
SPOILT = 600  # bytes without a message that are no sign of damage: a logger writes whole pages
DEGREES = {"degheading": "deg", "deglatitude": "deg", "deglongitude": "deg"}  # ArduPilot tells kinds of degrees apart
NOT_SAMPLED = ("FMT", "FMTU", "MULT", "PARM", "UNIT")  # what describes other messages, and the list of settings


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
    codes = [FORMAT_TO_STRUCT[code][0] for code in fmt.msg_fmts]
    codes = [f"S{code[:-1]}" if code.endswith("s") else f"<{code}" for code in codes]
    kinds = np.dtype([(f"f{k}", code) for k, code in enumerate(codes)])
    if kinds.itemsize + HEAD != fmt.len or kinds.itemsize == 0:
        return None
    starts = np.asarray(offsets, np.int64) + HEAD
    starts = starts[starts + kinds.itemsize <= len(raw)]
    if not len(starts):
        return None
    windows = np.lib.stride_tricks.sliding_window_view(raw, kinds.itemsize)
    return windows[starts].view(kinds).reshape(-1)


def _instances(fmt, messages):
    at = fmt.columns.index("TimeUS")
    time = messages[f"f{at}"]
    if time.dtype.kind not in "iu":
        return []
    chosen = {"": slice(None)}
    if fmt.instance_field is not None:
        numbers = messages[f"f{fmt.columns.index(fmt.instance_field)}"]
        texts = {n: n.decode("latin-1") if isinstance(n, bytes) else n for n in np.unique(numbers)}
        chosen = {f"[{text}]": numbers == number for number, text in texts.items()}
    found = []
    for label, rows in chosen.items():
        names = (fmt.name + label, fmt.name) if len(chosen) == 1 and label else (fmt.name + label,)
        columns = []
        for k, field in enumerate(fmt.columns):
            values = messages[f"f{k}"]
            if k == at or field == fmt.instance_field or values.dtype.kind not in "iuf":
                continue
            unit, factor = fmt.units[k] if fmt.units else "", fmt.msg_mults[k]
            # By the factor that the format itself has, as a divisor, which is more exact: 1e-7 is no double.
            scaled = values[rows] if factor is None else values[rows] / round(1.0 / factor)
            columns.append(([f"{name}.{field}" for name in names], DEGREES.get(unit, unit) or None, scaled))
        found.append((names[0], time[rows].astype(np.int64), columns))
    return found
