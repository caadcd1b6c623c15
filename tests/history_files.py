"""histories.nc as a user reads it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from bayes_aero.errors import plain_line


def read_histories(path: Path) -> Mapping[str, xr.Dataset]:
    """All groups by name, in memory."""
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        assert tree.attrs == {"schema": "bayes_aero/histories/1"}
        return {node.path.strip("/"): node.to_dataset(inherit=False).load() for node in tree.subtree if node.data_vars}


def flight_of(group: xr.Dataset, manoeuvre: str) -> dict[str, np.ndarray]:
    """One manoeuvre's columns."""
    names = np.atleast_1d(group.attrs["names"]).tolist()  # a list of one comes back as that one
    own = group["manoeuvre"].values == names.index(plain_line(manoeuvre)) + 1
    return {str(key): np.asarray(column.values)[own] for key, column in group.data_vars.items()}
