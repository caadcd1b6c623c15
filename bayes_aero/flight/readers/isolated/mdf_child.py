"""The groups of an ASAM MDF file of version 4; run by `child.py`."""

import io
import os
from collections import Counter
from typing import Any

import numpy as np

os.environ["NUMEXPR_SANITIZE"] = "1"  # formulas in the file are text that somebody else wrote
os.environ["NUMEXPR_MAX_THREADS"] = "1"

import numexpr
from asammdf import MDF
from asammdf.blocks import v4_blocks
from asammdf.blocks import v4_constants as v4

v4_blocks.lambdify = None  # asammdf hands a formula that numexpr refuses to sympy, which would run it as Python
NUMBERS = range(v4.DATA_TYPE_UNSIGNED_INTEL, v4.DATA_TYPE_REAL_MOTOROLA + 1)
VALUES = (v4.CHANNEL_TYPE_VALUE, v4.CHANNEL_TYPE_VIRTUAL)


def groups(data):
    """Every channel group that has a time channel."""
    found, remarks = [], []
    mdf: Any
    with MDF(io.BytesIO(data)) as mdf:
        # A name for each group: what the file calls it, where that is a name and no other group has it.
        said = [group.channel_group.acq_name or group.channel_group.comment or "" for group in mdf.groups]
        named = [text if 0 < len(text) <= 60 and "<" not in text and "\n" not in text else "" for text in said]
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
            found.append((labels[k], time, columns))
    return found, remarks


def _signals(group, remarks):
    """Index and name of the signals that hold one number a sample."""
    kept = []
    for index, channel in enumerate(group.channels):
        if channel.channel_type not in VALUES or channel.data_type not in NUMBERS or group.channel_dependencies[index]:
            continue
        if _formulas_work(channel.conversion):
            kept.append((index, channel.name))
        else:
            remarks.append(f"the signal {channel.name!r} is left out: the formula of its conversion cannot be used")
    return kept


def _formulas_work(conversion):
    """Whether numexpr takes each formula of X alone; asammdf would hand out raw values without a word."""
    if not isinstance(conversion, v4_blocks.ChannelConversion):
        return True
    if conversion.conversion_type == v4.CONVERSION_TYPE_ALG:
        try:
            numexpr.evaluate(conversion.formula.replace("X1", "X"), {"X": np.ones(1)}, {})
        except Exception:
            return False
    return all(_formulas_work(inner) for inner in (conversion.referenced_blocks or {}).values())
