"""Files that a library parses in a process of its own, for the reason in `child.py`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import MOST_VALUES_IN_ALL
from bayes_aero.flight.readers.rates import Group, Series

__all__ = ["parsed_apart"]

TIME_LIMIT, PER_MEGABYTE = 20.0, 2.0
"""Seconds for the child, and more of them for each MB of the file; sound files take a tenth of that."""

MOST_BYTES = 16 * MOST_VALUES_IN_ALL
"""Most bytes that a file may unpack to."""

MOST_COLUMNS = 50_000


def parsed_apart(data: bytes, parser: str, kind: str) -> tuple[list[Group], list[str]]:
    """All groups of samples in a file, and what is to be remarked of it.

    Args:
        data: the file.
        parser: the script beside this one that holds the function `groups`.
        kind: what the file is called to the user.

    Raises:
        InputError: the file is damaged or too large.
    """
    here = Path(__file__).parent
    # -P: the child must not take this folder's text.py and the like for libraries.
    command = [sys.executable, "-P", str(here / "child.py"), str(here / parser), str(MOST_BYTES), str(MOST_COLUMNS)]
    limit = TIME_LIMIT + PER_MEGABYTE * len(data) / 1e6
    try:
        done = subprocess.run(
            command, input=data, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired as reason:
        raise InputError(
            f"the library that reads a {kind} did not finish in {limit:.0f} s; is it damaged? Write it again"
        ) from reason
    end = done.stdout.find(b"\n")
    if done.returncode != 0 or end < 0:
        raise InputError(f"the library that reads a {kind} crashed on it; is it damaged? Write it again")
    reply = json.loads(done.stdout[:end])
    if "error" in reply:
        raise InputError(f"it is not a readable {kind} ({reply['error']}); is it damaged or misnamed? Write it again")
    if "refused" in reply:
        raise InputError(reply["refused"])
    return _unpacked(reply["groups"], done.stdout, end + 1), reply["remarks"]


def _unpacked(listed: list[dict], payload: bytes, start: int) -> list[Group]:
    groups = []
    for group in listed:
        arrays = []
        for dtype in ("<f8" if sys.byteorder == "little" else ">f8", *(column[2] for column in group["columns"])):
            arrays.append(np.frombuffer(payload, np.dtype(dtype), group["size"], start))
            start += arrays[-1].nbytes
        series = (
            Series(tuple(names), unit, values)
            for (names, unit, _), values in zip(group["columns"], arrays[1:], strict=True)
        )
        groups.append(Group(group["name"], arrays[0], tuple(series)))
    return groups
