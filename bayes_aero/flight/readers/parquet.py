"""Parquet, one column a channel, read by pyarrow."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import FileColumn, Heading, OpenedFile, foreign, refuse_huge, vector


def open_parquet(data: bytes) -> OpenedFile:
    """A Parquet file; its time stamps come back in seconds from the first one."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with foreign("Parquet file"):
        file = pq.ParquetFile(pa.BufferReader(data))
        schema = file.schema_arrow
        groups = (file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups))
        rows = max(file.metadata.num_rows, sum(groups))
        units = [(field.metadata or {}).get(b"units") for field in schema]
        units = [None if unit is None else unit.decode("utf-8", "replace") for unit in units]
        headings = [
            Heading((name,), k, unit) for k, (name, unit) in enumerate(zip(schema.names, units, strict=True), 1)
        ]

    def read(wanted: Mapping[str, Heading]) -> dict[str, FileColumn]:
        for name, heading in wanted.items():
            label, kind = heading.names[0], schema.field(heading.names[0]).type
            allowed = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_timestamp)
            if not any(fits(kind) for fits in allowed):
                raise InputError(
                    f"channel {name} ({label!r}) holds {kind} where numbers should be; store it as plain numbers, and "
                    "time as seconds or time stamps"
                )
            refuse_huge(name, label, rows, len(wanted))
        with foreign("Parquet file"):
            table = file.read(columns=[h.names[0] for h in wanted.values()], use_threads=False)
            return {name: _column(table.column(h.names[0]), name, h) for name, h in wanted.items()}

    return OpenedFile(headings, read, "column")


READS = {".parquet": open_parquet}


def _column(values: Any, name: str, heading: Heading) -> FileColumn:
    import pyarrow as pa

    if pa.types.is_timestamp(values.type):
        stamps = values.to_numpy().astype("datetime64[ns]")
        first = stamps[~np.isnat(stamps)][:1]
        seconds = (stamps - first) / np.timedelta64(1, "s") if len(first) else np.full(len(stamps), np.nan)
        return FileColumn(seconds, "s")
    numbers = values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
    return FileColumn(vector(numbers, name), heading.unit)
