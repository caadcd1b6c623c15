"""Files that a library parses in a process of its own, for the reason in `child.py`."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import MOST_VALUES_IN_ALL, OpenedFile, SampleGroup, Series, several_rates

TIME_LIMIT, PER_MEGABYTE = 20.0, 2.0
"""Seconds for the child, and more of them for each MB of the file; sound files take a tenth of that."""

MOST_BYTES = 16 * MOST_VALUES_IN_ALL  # most bytes that a file may unpack to
MOST_COLUMNS = 50_000


def ask_child(
    data: bytes, parser: str, request: Sequence[Any], limit: float, slow: str, crashed: str, kind: str
) -> tuple[dict, memoryview]:
    """What a parser of `child.py` replies on a file, and the bytes of the arrays behind it. `request` is what it is
    given beside the file. If it takes more than `limit` s, or dies, `slow` or `crashed` is raised; `kind` is what the
    file is called to the user."""
    # -P: the child must not take this folder's modules for libraries.
    command = [sys.executable, "-P", str(Path(__file__).parent / "child.py"), parser, json.dumps(request)]
    try:
        done = subprocess.run(
            command, input=data, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired as reason:
        raise InputError(slow) from reason
    end = done.stdout.find(b"\n")
    if done.returncode != 0 or end <= 0:
        raise InputError(crashed)
    reply = json.loads(done.stdout[:end])
    if "error" in reply:
        raise InputError(f"it is not a readable {kind} ({reply['error']}); is it damaged or misnamed? Write it again")
    if "refused" in reply:
        raise InputError(reply["refused"])
    return reply, memoryview(done.stdout)[end + 1 :]


def parsed_apart(data: bytes, parser: str, kind: str) -> tuple[list[SampleGroup], list[str]]:
    """All groups of samples in a file, and what is to be remarked of it; see `ask_child`."""
    limit = TIME_LIMIT + PER_MEGABYTE * len(data) / 1e6
    slow = f"the library that reads a {kind} did not finish in {limit:.0f} s; is it damaged? Write it again"
    crashed = f"the library that reads a {kind} crashed on it; is it damaged? Write it again"
    reply, payload = ask_child(data, parser, [MOST_BYTES, MOST_COLUMNS], limit, slow, crashed, kind)
    groups, start = [], 0
    for listed in reply["groups"]:
        arrays = []
        for dtype in ("<f8" if sys.byteorder == "little" else ">f8", *(column[2] for column in listed["columns"])):
            arrays.append(np.frombuffer(payload, np.dtype(dtype), listed["size"], start))
            start += arrays[-1].nbytes
        columns = zip(listed["columns"], arrays[1:], strict=True)
        series = tuple(Series(tuple(names), unit, values) for (names, unit, _), values in columns)
        groups.append(SampleGroup(listed["name"], arrays[0], series))
    return groups, reply["remarks"]


# --- Libraries that only some file formats need, and that not everybody has.


def require(suffix: str, *libraries: str) -> None:
    """Refuse a file whose suffix, as in ".mf4", needs a library that is not there."""
    for library in libraries:
        if find_spec(library) is None:
            raise InputError(
                f"reading {suffix} needs {library}, which is not installed; pip install 'bayes-aero[formats]', or "
                "write the record as .csv"
            )


# --- ArduPilot DataFlash logs, read by pymavlink: a column is a field of a message, as in "ATT.Roll".


def open_dataflash(data: bytes) -> OpenedFile:
    """A binary DataFlash log. Instances go by their number, "IMU[1].GyrX", and an only one also by "IMU.GyrX". Source:
    ArduPilot, AP_Logger: FMT, FMTU, UNIT and MULT messages describe all others."""
    require(".bin", "pymavlink")
    if b"\xa3\x95" not in data[:600]:
        raise InputError("it is not an ArduPilot DataFlash log (no message begins near its start); is it misnamed?")
    groups, remarks = parsed_apart(data, "dataflash", "DataFlash log")
    return several_rates("field", groups, remarks, 1e-6)


# --- ASAM MDF version 4, read by asammdf: a column is a signal of a channel group.


def open_mdf(data: bytes) -> OpenedFile:
    """An MDF file. A signal goes by "group/name" and, where no other group has one of its name, by its name alone.
    Source: ASAM MDF 4.1, section 4: one channel group has one master channel."""
    require(".mf4", "asammdf")
    if data[:8] not in (b"MDF     ", b"UnFinMF "):
        raise InputError("it is not an MDF file (its first bytes differ); is it misnamed?")
    if not data[8:16].startswith(b"4."):
        said = data[8:16].decode("latin-1").strip("\0 ")
        raise InputError(f"it is an MDF file of version {said!r}; convert it to version 4, and save it as .mf4")
    groups, remarks = parsed_apart(data, "mdf", "MDF file")
    return several_rates("signal", groups, remarks, 1e-9)


# --- PX4 ULog, read by pyulog: a column is a field of a topic, as in "vehicle_attitude.q[0]".


def open_ulog(data: bytes) -> OpenedFile:
    """A ULog file. A second instance of a topic goes by its number: "sensor_accel.1.x". Source: PX4 ULog file format,
    version 1."""
    require(".ulg", "pyulog")
    if not data.startswith(b"ULog\x01\x12\x35"):
        raise InputError("it is not a PX4 ULog file (its first bytes differ); is it misnamed?")
    groups, remarks = parsed_apart(data, "ulog", "ULog file")
    return several_rates("field", groups, remarks, 1e-6)


READS = {".bin": open_dataflash, ".mf4": open_mdf, ".ulg": open_ulog}
