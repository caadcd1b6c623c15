"""Small sound records, how bad ones are refused, and bytes of flight logs by the published specifications."""

import io
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest

from bayes_aero.errors import InputError, plain_line
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import FlightRecord, write_record

# A small sound record, the card's channels for it, and how a bad one is refused
CHANNELS = (
    Channel("time", "s", "T", 1), Channel("alpha", "deg", "ALCG", 2), Channel("q", "deg/s", "QRGY", 3),
    Channel("airspeed", "kt", "VTAS", 4), Channel("density", "kg/m^3", "RHO", 5),
    Channel("static_pressure", "hPa", "PSTAT", 6, required=False),
    Channel("strain", "mm", "GAUGE_7", 7, required=False),
)  # fmt: skip


def remap(name: str, **fields: object) -> tuple[Channel, ...]:
    """The card's channels with one of them changed."""
    return tuple(replace(c, **fields) if c.name == name else c for c in CHANNELS)


def sound(n: int = 120, **changed: np.ndarray) -> FlightRecord:
    """A plausible slow oscillation at 25 Hz, in SI, with the given channels put in place of its own."""
    t = np.arange(n) * 0.04
    channels = {
        "time": t,
        "alpha": 0.1 + 0.05 * np.sin(t),
        "q": 0.05 * np.cos(t),
        "airspeed": 90.0 + np.sin(0.3 * t),
        "density": 0.7 + 0.001 * t,
        "static_pressure": 5.1e4 + 10.0 * t,
        "strain": 1e-3 * t,
    } | changed
    return FlightRecord.from_arrays("sound", channels.pop("time"), channels)


def written(path: Path, record: FlightRecord) -> Path:
    """The file with the record's channels of the card."""
    write_record(record, path, CHANNELS)
    return path


def refused(path: Path, channels, *words: str, **options: Any) -> str:
    """The message that reading `path` ends in; it must begin with the file and contain all the words."""
    with pytest.raises(InputError) as caught:
        read_record(path, channels, **options)
    message = str(caught.value)
    assert message.startswith(f"{plain_line(str(path))}: ")
    assert "\n" not in message
    assert [word for word in words if word not in message] == [], message
    return message


# Bytes of workbooks, and of flight logs by the formats' published specifications
def workbook(*sheets) -> bytes:
    """(title, rows) of each sheet."""
    book = openpyxl.Workbook()
    del book["Sheet"]
    for title, rows in sheets:
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def ulog(topics, start: int = 0, dropout_ms: int | None = None) -> bytes:
    """A PX4 ULog file, version 1 (docs.px4.io): topics of (name, multi_id, fields, stamps in µs, packed rows)."""

    def message(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    out = [b"ULog\x01\x12\x35\x01", struct.pack("<Q", start), message("B", bytes(40))]
    for name in dict.fromkeys(name for name, *_ in topics):
        fields = next(fields for other, _, fields, *_ in topics if other == name)
        out.append(message("F", f"{name}:uint64_t timestamp;{';'.join(fields)};".encode()))
    for number, (name, multi_id, *_) in enumerate(topics):
        out.append(message("A", struct.pack("<BH", multi_id, number) + name.encode()))
    samples = [
        (stamp, message("D", struct.pack("<HQ", number, stamp) + row))
        for number, (_, _, _, stamps, rows) in enumerate(topics)
        for stamp, row in zip(stamps, rows, strict=True)
    ]
    out += [sample for _, sample in sorted(samples)]
    if dropout_ms is not None:
        out.append(message("O", struct.pack("<H", dropout_ms)))
    return b"".join(out)


WIDTHS = {"Q": "Q", "B": "B", "b": "b", "f": "f", "c": "h", "L": "i", "d": "d", "n": "4s", "N": "16s", "Z": "64s"}


def dataflash(kinds, messages, units=(), multipliers=(), meanings=()) -> bytes:
    """A binary DataFlash log (ArduPilot, LogStructure.h): messages of (type, values as stored) in their order.

    kinds: {type: (name, format, columns)}; units and multipliers by letter; meanings: their letters for each type.
    """
    about = {
        128: ("FMT", "BBnNZ", "Type,Length,Name,Format,Columns"), 176: ("UNIT", "QbZ", "TimeUS,Id,Label"),
        177: ("FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"), 178: ("MULT", "Qbd", "TimeUS,Id,Mult"),
    }  # fmt: skip
    layouts = {kind: "<" + "".join(WIDTHS[c] for c in form) for kind, (_, form, _) in (about | kinds).items()}

    def message(kind: int, *values) -> bytes:
        return struct.pack("<BBB", 0xA3, 0x95, kind) + struct.pack(layouts[kind], *values)

    out = [
        message(128, kind, struct.calcsize(layouts[kind]) + 3, name.encode(), form.encode(), columns.encode())
        for kind, (name, form, columns) in (about | kinds).items()
    ]
    start = min((values[0] for _, values in messages), default=0)
    out += [message(176, start, ord(letter), label.encode()) for letter, label in units]
    out += [message(178, start, ord(letter), factor) for letter, factor in multipliers]
    out += [message(177, start, kind, *(letters.encode() for letters in both)) for kind, *both in meanings]
    return b"".join([*out, *(message(kind, *values) for kind, values in messages)])


def spoilt(data: bytes, seed: int, share: float = 0.02) -> bytes:
    """Some bytes changed, anywhere but in the first 16."""
    rng = np.random.default_rng(seed)
    changed = np.frombuffer(data, np.uint8).copy()
    at = rng.choice(np.arange(16, len(data)), max(1, int(share * len(data))), replace=False)
    changed[at] = rng.integers(0, 256, len(at))
    return changed.tobytes()
