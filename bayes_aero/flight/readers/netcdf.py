"""NetCDF, one variable a channel: classic files by scipy, NetCDF-4 by h5py."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import Column, Heading, Opened, foreign, refuse_huge, stated_unit, unpacked, vector
from bayes_aero.flight.readers.hdf5 import HDF5, open_hdf5

__all__ = ["open_netcdf"]


def open_netcdf(data: bytes) -> Opened:
    """A NetCDF file of either kind."""
    if data.startswith(HDF5):
        return open_hdf5(data, "NetCDF file")
    if not data.startswith(b"CDF"):
        raise InputError("it is neither a NetCDF-4 nor a classic NetCDF file; is it misnamed? Write it again")
    from scipy.io import netcdf_file

    with foreign("NetCDF file"):
        file = netcdf_file(io.BytesIO(data), "r", mmap=False)
        headings = [
            Heading((str(name),), None, stated_unit(getattr(v, "units", None))) for name, v in file.variables.items()
        ]
    return ClassicNetCDF(file, headings)


READS = {".nc": open_netcdf}


@dataclass(frozen=True)
class ClassicNetCDF:
    """A classic NetCDF file whose variables have been listed."""

    file: Any
    headings: Sequence[Heading]
    kind: str = "variable"
    remarks: Sequence[str] = ()

    def read(self, wanted: Mapping[str, Heading]) -> dict[str, Column]:
        """See `Opened.read`."""
        columns = {}
        for name, heading in wanted.items():
            variable = self.file.variables[heading.names[0]]
            with foreign("NetCDF file"):
                raw = np.asarray(variable.data)
                refuse_huge(name, heading.names[0], raw.size, len(wanted))
                vector(raw, name)  # its type and shape
                columns[name] = Column(unpacked(raw, vars(variable)["_attributes"], name), heading.unit)
        return columns
