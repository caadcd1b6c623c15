"""Binary files: MATLAB .mat, Parquet, NetCDF. Nothing here loads a pickle."""

from __future__ import annotations

import io
import warnings
import zlib
from collections.abc import Sequence

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.columns import MAX_VALUES, MOST_HEADINGS, Column, foreign, located, refuse_huge, vector
from bayes_aero.flight.hdf5 import read_hdf5

__all__ = ["read_mat", "read_netcdf", "read_parquet"]

_HDF5 = b"\x89HDF\r\n\x1a\n"
_NUMERIC = {
    "double",
    "single",
    "logical",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
}


def read_mat(data: bytes, channels: Sequence[Channel]) -> dict[str, Column]:
    """MATLAB file, one vector a channel: v5 to v7 by scipy, v7.3 by h5py."""
    if data[512:520] == _HDF5 or data[:8] == _HDF5:
        return read_hdf5(data, channels, "MATLAB v7.3 file")
    if len(data) < 136 or data[126:128] not in (b"IM", b"MI"):
        raise InputError("it is not a MATLAB file of version 5 to 7.3; in MATLAB, save it again with -v7")
    from scipy.io import loadmat, whosmat

    _bounded_mat(data)
    with foreign("MATLAB file"), warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # scipy warns where a file holds one name twice
        contents = {name: (shape, kind) for name, shape, kind in whosmat(io.BytesIO(data))}
    wanted = located(channels, list(contents), "variable")
    for channel in wanted:
        shape, kind = contents[channel.heading]
        if kind not in _NUMERIC:
            raise InputError(
                f"channel {channel.name} ({channel.heading!r}) is a {kind} where numbers should be; store "
                f"one numeric "
                f"vector a channel (a struct: save(file, '-struct', 'name'))"
            )
        refuse_huge(channel, float(np.prod([float(extent) for extent in shape])), len(wanted))
    with foreign("MATLAB file"), warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        values = loadmat(io.BytesIO(data), variable_names=[channel.heading for channel in wanted])
    return {channel.name: Column(vector(np.asarray(values[channel.heading]), channel.name)) for channel in wanted}


def _bounded_mat(data: bytes) -> None:
    """Refuse a compressed element that claims to unpack into more than a record can hold."""
    order = "little" if data[126:128] == b"IM" else "big"
    position, count = 128, 0
    while position + 8 <= len(data):
        count += 1
        if count > MOST_HEADINGS:
            raise InputError(f"it has more than {MOST_HEADINGS} variables; is it a flight record?")
        kind = int.from_bytes(data[position : position + 4], order)
        size = int.from_bytes(data[position + 4 : position + 8], order)
        if kind == 15:  # miCOMPRESSED
            with foreign("MATLAB file"):
                inner = zlib.decompressobj().decompress(data[position + 8 : position + 8 + min(size, 4096)], 8)
            claimed = int.from_bytes(inner[4:8], order)
        else:
            claimed = size
        if claimed > 8 * MAX_VALUES + 4096:
            raise InputError(
                f"it claims a variable of {claimed} bytes; is it damaged? In MATLAB, save it again with -v7"
            )
        position += 8 + size


def read_parquet(data: bytes, channels: Sequence[Channel]) -> dict[str, Column]:
    """Parquet, one numeric column a channel."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with foreign("Parquet file"):
        file = pq.ParquetFile(pa.BufferReader(data))
        schema = file.schema_arrow
        groups = (file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups))
        rows = max(file.metadata.num_rows, sum(groups))
    wanted = located(channels, list(schema.names), "column")
    for channel in wanted:
        field = schema.field(channel.heading)
        kind = field.type
        if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
            raise InputError(
                f"channel {channel.name} ({channel.heading!r}) holds {kind} where numbers should be; store "
                f"it as plain "
                f"numbers, and time as seconds"
            )
        refuse_huge(channel, rows, len(wanted))
    with foreign("Parquet file"):
        table = file.read(columns=[channel.heading for channel in wanted], use_threads=False)
        columns = {}
        for channel in wanted:
            values = table.column(channel.heading).cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
            unit = (schema.field(channel.heading).metadata or {}).get(b"units")
            unit = None if unit is None else unit.decode("utf-8", "replace")
            columns[channel.name] = Column(vector(values, channel.name), unit)
    return columns


def read_netcdf(data: bytes, channels: Sequence[Channel]) -> dict[str, Column]:
    """NetCDF, one variable a channel in the root group: classic by scipy, NetCDF-4 by h5py."""
    if data.startswith(_HDF5):
        return read_hdf5(data, channels, "NetCDF file")
    if not data.startswith(b"CDF"):
        raise InputError("it is neither a NetCDF-4 nor a classic NetCDF file; is it misnamed? Write it again")
    from scipy.io import netcdf_file

    with foreign("NetCDF file"):
        file = netcdf_file(io.BytesIO(data), "r", mmap=False, maskandscale=True)
        available = [str(name) for name in file.variables]
    columns = {}
    wanted = located(channels, available, "variable")
    for channel in wanted:
        variable = file.variables[channel.heading]
        with foreign("NetCDF file"):
            raw = np.asarray(variable.data)
            refuse_huge(channel, raw.size, len(wanted))
            vector(raw, channel.name)  # before masking, which can fail on odd types
            values = np.ma.filled(np.ma.asarray(variable[:]).astype(np.float64), np.nan)
            unit = getattr(variable, "units", None)
        text = unit.decode("latin-1") if isinstance(unit, bytes) else None
        columns[channel.name] = Column(vector(values, channel.name), text)
    return columns
