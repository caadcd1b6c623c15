"""histories.nc: what is in it is what the numbers were made from."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from simulated_halves import halves

from bayes_aero.inference.scores import score
from bayes_aero.report.diagnosed import composition
from bayes_aero.studies import histories


@pytest.fixture
def groups(diagnosed, tmp_path):
    path = tmp_path / "histories.nc"
    flown = histories.flights(halves(diagnosed.records[0]).paths)
    histories.put_histories({**histories.diagnosed(diagnosed.view), **flown}, path)
    assert not list(tmp_path.glob("*.part"))
    return histories.read_histories(path)


def test_coefficients_give_the_scores_that_are_told(groups, diagnosed):
    view, (record,) = diagnosed.view, diagnosed.records
    flight = histories.flight_of(groups["coefficients"], record.name)
    assert np.array_equal(flight["time"], record.time)
    for key, fitted in (("card", view.card), ("extended", view.extended)):
        told = composition(view, fitted)
        for name in ("CL", "CD", "Cm"):
            assert groups["coefficients"][f"{name}_{key}"].attrs["units"] == "1"
            again = score(flight[f"{name}_measured"], flight[f"{name}_{key}"])
            assert again.r2 == pytest.approx(told[name]["r2"], abs=1e-9)
            assert again.rmse == pytest.approx(told[name]["rmse"], rel=1e-9)
        assert 0.0 <= flight[f"X_{key}"].min() <= flight[f"X_{key}"].max() <= 1.0


def test_trajectories_give_the_errors_that_are_told(groups, diagnosed):
    for path in halves(diagnosed.records[0]).paths:
        flight = histories.flight_of(groups[f"trajectories_{path.split}"], path.manoeuvre)
        assert np.array_equal(flight["time"], path.time)
        for name, error in path.errors.items():
            residual = flight[f"{name}_measured"] - flight[f"{name}_{path.model}"]
            assert np.sqrt(np.mean(residual**2)) == pytest.approx(error.rms, rel=1e-9)
    units = {name: groups["trajectories_unseen"][f"{name}_card"].attrs["units"] for name in ("airspeed", "alpha")}
    assert units == {"airspeed": "m/s", "alpha": "rad"}


def test_a_flight_that_is_not_there_is_named(groups):
    with pytest.raises(ValueError, match="nowhere"):
        histories.flight_of(groups["trajectories_unseen"], "nowhere")


def test_a_file_of_another_kind_is_refused(tmp_path):
    xr.DataTree(xr.Dataset({"a": 1.0})).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match="bayes_aero/histories/1"):
        histories.read_histories(tmp_path / "other.nc")
