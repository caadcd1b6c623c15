"""Parquet, one column a channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import Column, Heading, foreign, refuse_huge, vector

__all__ = ["open_parquet"]


def open_parquet(data: bytes) -> ParquetTable:
    """Opens with pyarrow."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with foreign("Parquet file"):
        file = pq.ParquetFile(pa.BufferReader(data))
        groups = (file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups))
        rows = max(file.metadata.num_rows, sum(groups))
        headings = [Heading((field.name,), number, _unit(field)) for number, field in enumerate(file.schema_arrow, 1)]
    return ParquetTable(file, rows, headings)


READS = {".parquet": open_parquet}


@dataclass(frozen=True)
class ParquetTable:
    """A Parquet file whose schema has been read."""

    file: Any
    rows: int
    headings: Sequence[Heading]
    kind: str = "column"
    remarks: Sequence[str] = ()

    def read(self, wanted: Mapping[str, Heading]) -> dict[str, Column]:
        """See `Opened.read`. Time stamps come back in seconds from the first one."""
        import pyarrow as pa

        for name, heading in wanted.items():
            label, kind = heading.names[0], self.file.schema_arrow.field(heading.names[0]).type
            if not (_is_numeric(kind) or pa.types.is_timestamp(kind)):
                raise InputError(
                    f"channel {name} ({label!r}) holds {kind} where numbers should be; store it as plain numbers, and "
                    "time as seconds or time stamps"
                )
            refuse_huge(name, label, self.rows, len(wanted))
        with foreign("Parquet file"):
            table = self.file.read(columns=[h.names[0] for h in wanted.values()], use_threads=False)
            return {name: _column(table.column(h.names[0]), name, h) for name, h in wanted.items()}


def _is_numeric(kind: Any) -> bool:
    import pyarrow as pa

    return pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)


def _unit(field: Any) -> str | None:
    unit = (field.metadata or {}).get(b"units")
    return None if unit is None else unit.decode("utf-8", "replace")


def _column(values: Any, name: str, heading: Heading) -> Column:
    import pyarrow as pa

    if pa.types.is_timestamp(values.type):
        stamps = values.to_numpy().astype("datetime64[ns]")
        first = stamps[~np.isnat(stamps)][:1]
        return Column((stamps - first) / np.timedelta64(1, "s") if len(first) else np.full(len(stamps), np.nan), "s")
    return Column(vector(values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), name), heading.unit)
