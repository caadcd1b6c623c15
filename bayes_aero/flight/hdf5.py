"""HDF5 files: NetCDF-4 and MATLAB's v7.3, read in a child process for the reason in `hdf5_child.py`."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.columns import MAX_VALUES, MOST_VALUES_IN_ALL, Column, located

__all__ = ["list_hdf5", "read_hdf5"]

TIME_LIMIT = 20.0
"""Seconds for the child; a sound record takes about a third of one."""


def read_hdf5(data: bytes, channels: Sequence[Channel], kind: str) -> dict[str, Column]:
    """The channels of an HDF5 file that holds vectors in its root group; `kind` names it to the user."""
    if find_spec("h5py") is None:
        raise InputError(f"this {kind} is an HDF5 file, and h5py is not installed; install h5py, or write .csv")
    reply, payload = _ask(data, [channel.heading for channel in channels], kind)
    if "error" in reply:
        raise InputError(f"it is not a readable {kind} ({reply['error']}); is it damaged or misnamed? Write it again")
    by_heading = {channel.heading: channel for channel in channels}
    if "problem" in reply:
        label, problem = reply["problem"]
        raise InputError(f"channel {by_heading[label].name} ({label!r}) {problem}")
    columns, start = {}, 0
    for label, size, unit in reply["columns"]:
        columns[label] = Column(np.frombuffer(payload, np.float64, size, start), unit)
        start += 8 * size
    known = [name for name in reply["available"] if name in columns or name not in by_heading]
    return {channel.name: columns[channel.heading] for channel in located(channels, known, "variable")}


def list_hdf5(data: bytes, kind: str) -> list[str]:
    """Names in the root group."""
    reply, _ = _ask(data, [], kind)
    if "error" in reply:
        raise InputError(f"it is not a readable {kind} ({reply['error']}); is it damaged or misnamed? Write it again")
    return reply["available"]


def _ask(data: bytes, labels: list[str], kind: str) -> tuple[dict, bytes]:
    child = Path(__file__).with_name("hdf5_child.py")
    # -P: the child must not take this folder's text.py and the like for libraries.
    command = [sys.executable, "-P", str(child), json.dumps(labels), str(MAX_VALUES), str(MOST_VALUES_IN_ALL)]
    try:
        done = subprocess.run(command, input=data, capture_output=True, timeout=TIME_LIMIT, check=False)
    except subprocess.TimeoutExpired as reason:
        raise InputError(
            f"the HDF5 library did not finish reading it in {TIME_LIMIT:g} s; the {kind} is damaged: write it again"
        ) from reason
    head, _, payload = done.stdout.partition(b"\n")
    if done.returncode != 0 or not head:
        raise InputError(f"the HDF5 library crashed on it; the {kind} is damaged: write it again")
    return json.loads(head), payload
