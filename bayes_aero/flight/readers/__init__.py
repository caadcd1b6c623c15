"""File formats: each opens a file's bytes, lists its columns and reads those that are wanted."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from bayes_aero.flight.readers.base import Opened
from bayes_aero.flight.readers.excel import open_excel
from bayes_aero.flight.readers.isolated.dataflash import open_dataflash
from bayes_aero.flight.readers.isolated.mdf import open_mdf
from bayes_aero.flight.readers.isolated.ulog import open_ulog
from bayes_aero.flight.readers.mat import open_mat
from bayes_aero.flight.readers.netcdf import open_netcdf
from bayes_aero.flight.readers.parquet import open_parquet
from bayes_aero.flight.readers.text import open_text

__all__ = ["READERS"]

READERS: Mapping[str, Callable[[bytes], Opened]] = {
    ".asc": open_text,
    ".txt": open_text,
    ".dat": open_text,
    ".csv": open_text,
    ".tsv": open_text,
    ".mat": open_mat,
    ".parquet": open_parquet,
    ".nc": open_netcdf,
    ".xlsx": open_excel,
    ".mf4": open_mdf,
    ".ulg": open_ulog,
    ".bin": open_dataflash,
}
"""What opens a file, by its suffix."""
