"""histories.nc: what is in it is what the numbers were made from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from history_files import flight_of, read_histories
from simulated_halves import halves

from bayes_aero.inference.scores import score
from bayes_aero.jobs.io import time_histories as histories


@pytest.fixture
def groups(diagnosed, tmp_path):
    flown = histories.flights(halves(diagnosed.records[0]).paths)
    assert histories.put_histories(lambda: {**histories.diagnosed(diagnosed.view), **flown}, tmp_path) == ()
    assert [path.name for path in tmp_path.iterdir()] == ["histories.nc"]
    return read_histories(tmp_path / "histories.nc")


def test_coefficients_give_the_scores_that_are_told(groups, diagnosed):
    view, (record,) = diagnosed.view, diagnosed.records
    flight = flight_of(groups["coefficients"], record.name)
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
        flight = flight_of(groups[f"trajectories_{path.split}"], path.manoeuvre)
        assert np.array_equal(flight["time"], path.time)
        for name, error in path.errors.items():
            residual = flight[f"{name}_measured"] - flight[f"{name}_{path.model}"]
            assert np.sqrt(np.mean(residual**2)) == pytest.approx(error.rms, rel=1e-9)
    units = {name: groups["trajectories_hold_out"][f"{name}_card"].attrs["units"] for name in ("airspeed", "alpha")}
    assert units == {"airspeed": "m/s", "alpha": "rad"}


@pytest.mark.parametrize("name", ["run/1", "Flug 7 \u00fc", "undecodable \udcff", "end\0", "~", ""])
def test_any_name_of_a_record_and_of_a_channel_is_kept(name, diagnosed, tmp_path):
    (path, *_) = halves(diagnosed.records[0]).paths
    kinds = {"q/hat": "rad/s", "p_rate/norm": "1"}
    renamed = {kind: dict(zip(kinds, getattr(path, kind).values(), strict=False)) for kind in ("measured", "simulated")}
    odd = replace(path, manoeuvre=name, **renamed)
    assert histories.put_histories(lambda: histories.flights([odd], kinds), tmp_path) == ()
    (group,) = read_histories(tmp_path / "histories.nc").values()
    flight = flight_of(group, name)
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
