"""Write flight records to files that `readers.read_record` reads."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from bayes_aero.atomic_write import write_whole
from bayes_aero.errors import InputError
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.flight.record import FlightRecord

Columns = list[tuple[Channel, np.ndarray]]  # channels to write, each with its (n,) values in the file's unit


def write_record(record: FlightRecord, path: str | os.PathLike[str], channels: Sequence[Channel]) -> None:
    """Write a record in a format that `read` reads. The file is written whole or not at all.

    Args:
        record: channels of shape (n,) in SI and radians.
        path: the file; its suffix selects the format (`WRITERS`).
        channels: those of a card; they are written in the card's units and signs.

    Raises:
        InputError: the suffix is unknown, a required channel is missing, or the file cannot be written.
    """
    target = Path(path)
    writer = WRITERS.get(target.suffix.lower())
    if writer is None:
        raise InputError(f"{target}: records are written as {', '.join(WRITERS)}; choose one of these suffixes")
    written = [channel for channel in channels if record.has(channel.name) or channel.required]
    columns = [(channel, channel.filed(record[channel.name])) for channel in written]
    try:
        write_whole(writer(columns), target)
    except InputError as reason:
        raise InputError(f"{target}: {reason}") from reason
    except OSError as reason:
        raise InputError(
            f"{target}: it cannot be written ({reason.strerror}); check the folder and its permissions"
        ) from reason


def _asc(columns: Columns) -> bytes:
    """Columns where the card puts them; zeros in the columns that it does not map."""
    for channel, _ in columns:
        if channel.column is None:
            raise InputError(f"channel {channel.name} has no column number; add column = N to the card, or write .csv")
    table = np.zeros((columns[0][1].size, max(channel.column or 0 for channel, _ in columns)))
    for channel, values in columns:
        table[:, (channel.column or 1) - 1] = values
    return _rows(table, " ")


def _csv(columns: Columns) -> bytes:
    import csv

    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow([channel.heading for channel, _ in columns])
    return header.getvalue().encode() + _rows(np.column_stack([values for _, values in columns]), ",")


def _rows(table: np.ndarray, separator: str) -> bytes:
    buffer = io.BytesIO()
    np.savetxt(buffer, table, fmt="%.17g", delimiter=separator)  # 17 digits bring back every double exactly
    return buffer.getvalue()


def _mat(columns: Columns) -> bytes:
    from scipy.io import savemat

    for channel, _ in columns:
        if re.fullmatch(r"[A-Za-z]\w{0,62}", channel.heading, re.ASCII) is None:
            raise InputError(
                f"channel {channel.name}: {channel.heading!r} cannot be a MATLAB name; give it a label of letters, "
                "digits and underscores"
            )
    buffer = io.BytesIO()
    savemat(buffer, {channel.heading: values[:, None] for channel, values in columns}, do_compression=True)
    return buffer.getvalue()


def _parquet(columns: Columns) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = [pa.field(channel.heading, pa.float64(), metadata={"units": channel.unit}) for channel, _ in columns]
    buffer = io.BytesIO()
    pq.write_table(pa.table([values for _, values in columns], schema=pa.schema(fields)), buffer)
    return buffer.getvalue()


def _netcdf(columns: Columns) -> bytes:
    import xarray as xr

    variables = {}
    for channel, values in columns:
        standard = STANDARD_CHANNELS.get(channel.name)
        about = {"units": channel.unit} | ({"long_name": standard.description} if standard else {})
        variables[channel.heading] = ("sample", values, about)
    return bytes(xr.Dataset(variables).to_netcdf(engine="h5netcdf"))


WRITERS: Mapping[str, Callable[[Columns], bytes]] = {
    **dict.fromkeys((".asc", ".txt", ".dat"), _asc), ".csv": _csv, ".mat": _mat, ".parquet": _parquet, ".nc": _netcdf,
}  # fmt: skip
