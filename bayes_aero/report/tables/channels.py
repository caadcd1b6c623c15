"""The channels of a record: where each is taken from, its unit and range."""

from __future__ import annotations

from bayes_aero.flight.reading.inspection import ChannelReport, RecordReport
from bayes_aero.report.tables.table import Table, columns_of


def channel_table(record: RecordReport) -> Table:
    """A row for each channel; values are in the file's own units."""
    column = columns_of(record.channels)
    unit, values = "unit → inside", "range in the file"
    return Table(
        [
            column(lambda c: c.name, page="channel", terminal="channel"),
            column(lambda c: c.place, page="taken from", terminal="taken from", words=True),
            column(lambda c: c.unit if c.unit == c.si else f"{c.unit} → {c.si}", page=unit, terminal=unit),
            column(lambda c: f"{c.lowest:.5g} to {c.highest:.5g}", page=values, terminal=values),
            column(_remark, page="remark", terminal="", words=True),
        ],
        f"{sampling(record)}; {record.gaps} gaps, {record.uneven} uneven steps",
        terminal_title="",
    )


def sampling(record: RecordReport) -> str:
    """Samples, duration and rate."""
    rate = f"{1.0 / record.dt:.4g} Hz" if record.dt > 0.0 else "no sampling rate"
    return f"{record.samples} samples, {record.duration:.6g} s, {rate}"


def _remark(c: ChannelReport) -> str:
    return ", ".join([*(["sign reversed"] if c.sign < 0 else []), *([] if c.moves else ["does not move"])])
