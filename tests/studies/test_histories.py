"""histories.nc: what is in it is what the numbers were made from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from simulated_halves import halves

from bayes_aero.diagnosis.trajectories.results import LagTest
from bayes_aero.inference.scores import score
from bayes_aero.jobs.io import time_histories as histories
from bayes_aero.jobs.io.trajectories_json import _lag, _lag_of


@pytest.fixture
def groups(diagnosed, tmp_path):
    flown = histories.flights(halves(diagnosed.records[0]).paths)
    assert histories.put_histories(lambda: {**histories.diagnosed(diagnosed.view), **flown}, tmp_path) == ()
    assert [path.name for path in tmp_path.iterdir()] == ["histories.nc"]
    return histories.read_histories(tmp_path / "histories.nc")


def test_coefficients_give_the_scores_that_are_told(groups, diagnosed):
    view, (record,) = diagnosed.view, diagnosed.records
    flight = histories.flight_of(groups["coefficients"], record.name)
    assert np.array_equal(flight["time"], record.time)
    for key, fitted in (("card", view.card), ("extended", view.extended)):
        told = fitted.composition
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
    units = {name: groups["trajectories_hold_out"][f"{name}_card"].attrs["units"] for name in ("airspeed", "alpha")}
    assert units == {"airspeed": "m/s", "alpha": "rad"}


def test_a_flight_that_is_not_there_is_named(groups):
    with pytest.raises(ValueError, match="nowhere"):
        histories.flight_of(groups["trajectories_hold_out"], "nowhere")


@pytest.mark.parametrize("name", ["run/1", "Flug 7 \u00fc", "undecodable \udcff", "end\0", "~", ""])
def test_any_name_of_a_record_and_of_a_channel_is_kept(name, diagnosed, tmp_path):
    (path, *_) = halves(diagnosed.records[0]).paths
    kinds = {"q/hat": "rad/s", "p_rate/norm": "1"}
    renamed = {kind: dict(zip(kinds, getattr(path, kind).values(), strict=False)) for kind in ("measured", "simulated")}
    odd = replace(path, manoeuvre=name, **renamed)
    assert histories.put_histories(lambda: histories.flights([odd], kinds), tmp_path) == ()
    (group,) = histories.read_histories(tmp_path / "histories.nc").values()
    flight = histories.flight_of(group, name)
    for output, unit in kinds.items():
        for kind, x in (("measured", odd.measured), (odd.model, odd.simulated)):
            key = histories.column(output, kind)
            assert np.array_equal(flight[key], x[output])
            assert group[key].attrs["units"] == unit


def test_histories_that_cannot_be_written_are_told_and_leave_no_old_ones(tmp_path):
    def bad():
        raise RuntimeError("no such luck")

    (tmp_path / "histories.nc").write_bytes(b"of another run")
    assert "no such luck" in histories.put_histories(bad, tmp_path)[0]
    assert [path.name for path in tmp_path.iterdir()] == ["error.txt"]


def test_a_folder_whose_name_begins_with_a_tilde_is_no_home(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    folder = Path("~")
    folder.mkdir()
    time = np.arange(3.0)
    group = xr.Dataset({"time": ("sample", time)})
    assert histories.put_histories(lambda: {"coefficients": group}, folder) == ()
    assert (tmp_path / "~" / "histories.nc").is_file()


def test_what_was_made_from_something_else_is_refused(tmp_path):
    group = xr.Dataset({"time": ("sample", np.arange(3.0))})
    assert histories.put_histories(lambda: {"coefficients": group}, tmp_path, "this") == ()
    assert "coefficients" in histories.read_histories(tmp_path / "histories.nc", "this")
    with pytest.raises(ValueError, match="something else"):
        histories.read_histories(tmp_path / "histories.nc", "that")


def test_a_file_of_another_kind_is_refused(tmp_path):
    xr.DataTree(xr.Dataset({"a": 1.0})).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match="bayes_aero/histories/1"):
        histories.read_histories(tmp_path / "other.nc")


def test_a_lag_that_was_told_is_read_back_whole():
    """What an interrupted diagnosis takes up again says of it what was said."""
    for lag in (
        LagTest("separation_lag", 5.4, slight=True),
        LagTest("separation_lag", 25.4, True, (62.1, 15.5), ("tau2",)),
    ):
        assert repr(_lag_of(_lag(lag))) == repr(lag)  # as text, for nan is not nan
