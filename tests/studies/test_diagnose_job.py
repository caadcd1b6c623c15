"""The diagnosis as a job: what it writes follows its schema, is whole, and survives what fails late."""

import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calling import page_of, validated
from simulated_halves import halves

from bayes_aero.diagnosis import selection_state
from bayes_aero.diagnosis.diagnose import NO_GAIN
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError, plain_line
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.results import score
from bayes_aero.jobs import diagnose as job
from bayes_aero.jobs import results as histories
from bayes_aero.jobs.diagnose import diagnose_records, hide_one
from bayes_aero.jobs.options import DiagnoseOptions
from bayes_aero.jobs.results import Outcome, diagnosis_results
from bayes_aero.jobs.store import provenance, write_json
from bayes_aero.report.figures import diagnosis
from bayes_aero.simulate.injection import hidden_records


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


def run(records, card, *, out, hidden=None, points=None, fly=None, **options):
    """The job with these in place of what chooses test points and simulates trajectories; without one, not done."""
    stages = {"test_points": points is not None, "trajectories": fly is not None}
    with patch.object(job, "proposed_points", points), patch.object(job, "simulations", fly):
        return diagnose_records(records, card, DiagnoseOptions(**stages, **options), out=out, hidden=hidden)


def bad(*_):
    raise ValueError("no such luck")


@pytest.fixture
def repeated(monkeypatch, diagnosed):
    """The job with the diagnosis already made."""
    monkeypatch.setattr(job, "diagnose", lambda *_, **__: diagnosed.view.diagnosis)
    monkeypatch.setattr(job, "view_of", lambda _: diagnosed.view)
    return diagnosed


def test_files_are_complete_and_follow_the_schema(repeated, card, tmp_path):
    found = run(repeated.records, card, out=tmp_path, hidden=repeated.hidden, figures=False)
    content = validated(tmp_path / "diagnosis.json", "diagnosis")
    assert content["verdict"] == found.diagnosis.verdict.value
    assert [c["name"] for c in content["causes"]] == [c.name for c in found.diagnosis.causes]
    assert content["hidden"]["effects"] == repeated.hidden
    assert set(found.named) == set(repeated.hidden)
    assert "first" in found.named.values()
    assert content["provenance"]["settings"] == {"max_effects": 8}
    assert len(pd.read_csv(tmp_path / "screen.csv")) == len(content["screening"])
    assert set(pd.read_csv(tmp_path / "causes.csv")["cause"]) == {c["name"] for c in content["causes"]}
    assert not list(tmp_path.glob("*.part"))
    gain = content["causes"][-1]["gain"]
    assert gain["split"] == "block"
    assert set(gain["by_coefficient"]) == {"CL", "CD", "Cm"}
    assert gain["by_coefficient"]["Cm"]["r2_after"] > gain["by_coefficient"]["Cm"]["r2_before"]


def test_numbers_that_do_not_exist_are_null(repeated, card, tmp_path):
    view = repeated.view
    cause = replace(view.diagnosis.causes[0], gain=NO_GAIN, p_value=float("nan"))
    view = replace(view, diagnosis=replace(view.diagnosis, causes=(cause,)))
    content = diagnosis_results(Outcome(view), card, repeated.records, provenance(card, repeated.records, 0, {}))
    write_json(content, tmp_path / "diagnosis.json")
    (one,) = validated(tmp_path / "diagnosis.json", "diagnosis")["causes"]
    assert one["p_value"] is None
    assert one["gain"] == {"elpd": None, "elpd_se": None, "split": "not measured", "by_coefficient": {}, "degraded": {}}


FIGURES = {"bad": bad, "colour": diagnosis.residual_colour}


@pytest.mark.parametrize(("name", "broken", "told"), [
    ("DIAGNOSIS_FIGURES", FIGURES, "Figure bad"), ("diagnosis_page", bad, "report.html"), ("with_stalls", bad, "Stall"),
])  # fmt: skip
def test_a_figure_a_page_or_a_stall_that_fails_loses_nothing_else(
    repeated, card, tmp_path, monkeypatch, name, broken, told
):
    monkeypatch.setattr(job, name, broken)
    found = run(repeated.records, card, out=tmp_path, figures=broken is FIGURES)
    (said,) = found.failures
    assert said.startswith(told)
    assert "ValueError: no such luck" in said
    assert validated(tmp_path / "diagnosis.json", "diagnosis")["failures"] == [said]
    assert (tmp_path / "report.html").exists() == (told != "report.html")
    if broken is FIGURES:
        assert (tmp_path / "figures" / "colour.png").stat().st_size > 10_000
    if told == "Stall":
        assert "Stall left out: ValueError: no such luck." in page_of(tmp_path)


def test_what_was_found_beside_an_interrupted_flight_is_on_disk(repeated, card, tmp_path):
    def interrupted(*_):
        end = time.monotonic() + 60.0
        while not json.loads((tmp_path / "diagnosis.json").read_text())["test_points"]:
            assert time.monotonic() < end
            time.sleep(0.05)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(repeated.records, card, out=tmp_path, points=decided, fly=interrupted)
    assert validated(tmp_path / "diagnosis.json", "diagnosis")["test_points"] == decided()


def decided(*_):
    """One test point for one question."""
    point = {"manoeuvre": "thrust_steps", "amplitude": 1.5, "airspeed": 95.4, "altitude": 5200.0, "seconds": 60.0}
    point |= {"excursion": {"alpha": [0.07, 0.21]}, "standard_errors": [6.25], "nats_per_second": 0.3}
    questions = [{"effects": ["a", "b"], "enough": 5.0, "present": 0.7}]
    return {"questions": questions, "points": [point], "refused": {}, "envelope": {}, "stated": []}


def test_what_a_killed_run_left_is_overwritten(repeated, card, tmp_path, monkeypatch):
    def killed(*_):
        raise KeyboardInterrupt

    flown = halves(repeated.records[0])
    with monkeypatch.context() as patched:
        patched.setattr(job, "put_page", killed)
        with pytest.raises(KeyboardInterrupt):
            run(repeated.records, card, out=tmp_path, figures=False, points=decided, fly=lambda *_: flown)
    left = validated(tmp_path / "diagnosis.json", "diagnosis")
    assert left["trajectories"]["paths"]
    assert left["test_points"] == decided()
    assert len(pd.read_csv(tmp_path / "test_points.csv")) == 1
    run(repeated.records, card, out=tmp_path, figures=False)
    content = validated(tmp_path / "diagnosis.json", "diagnosis")
    assert content["trajectories"] == {}
    assert content["test_points"] == {}
    assert (tmp_path / "report.html").stat().st_size > 10_000


def refused(*_):
    raise InputError("cannot fly")


@pytest.mark.parametrize(("points", "fly", "note", "failure"), [
    (bad, refused, "cannot fly", "Test points"), (refused, bad, "cannot fly", "Trajectories"),
])  # fmt: skip
def test_late_stages_that_fail_cost_nothing_that_was_found(repeated, card, tmp_path, points, fly, note, failure):
    found = run(repeated.records, card, out=tmp_path, figures=False, points=points, fly=fly)
    content = validated(tmp_path / "diagnosis.json", "diagnosis")
    (told,), (said,) = content["notes"], content["failures"]
    assert note in told
    assert failure in said
    assert "ValueError: no such luck" in said
    assert [c["name"] for c in content["causes"]] == [c.name for c in found.diagnosis.causes]
    assert "Test points that would decide" in page_of(tmp_path)
    assert "no such luck" in (tmp_path / "error.txt").read_text()
    if points is bad:  # an error of an earlier run does not stay
        found = run(repeated.records, card, out=tmp_path, figures=False)
        assert found.failures == ()
        assert not (tmp_path / "error.txt").exists()


def test_a_state_that_cannot_be_trimmed_has_no_test_points(diagnosed, monkeypatch):
    def refused(*_, **__):
        raise InputError("level flight needs no angle of attack in range")

    monkeypatch.setattr(job, "next_test_points", refused)
    found = diagnosed.view.diagnosis
    known = found.aerodynamics.state.full.candidates
    rival = next(e.name for e in known if e.name != found.causes[0].name and e.parameters)
    cause = replace(found.causes[0], ambiguous_with=(rival,), stage="coefficients")
    with pytest.raises(InputError, match="level flight needs"):  # which the job notes
        job.proposed_points(replace(found, causes=(cause,)))
    assert job.proposed_points(replace(found, causes=(), together=(), absorbed=())) == {}


def test_a_folder_that_cannot_be_made_is_told_before_the_work(card, tmp_path, monkeypatch):
    def never(*_, **__):
        raise AssertionError("the work began")

    monkeypatch.setattr(job, "diagnose", never)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="--out"):
        run([], card, out=tmp_path / "file" / "below")


def test_hiding_is_seeded_and_hides_what_the_card_lacks(card, monkeypatch):
    monkeypatch.setattr(job, "flyable", lambda names, **_: ({names[0]: {}}, []))
    drawn = [next(iter(hide_one(card, seed)[0])) for seed in (1, 1, 2, 3, 4)]
    assert drawn[0] == drawn[1]
    assert len(set(drawn)) > 1
    assert not set(drawn) & (set(card.effects) - {"separation_lag", "reattachment_hysteresis"})


FEW = ("thrust_moment", "pitch_rate_lift", "mach_drag", "alpha_bias")


@pytest.mark.recovery
def test_numbers_histories_and_page_are_of_this_run(card, tmp_path, monkeypatch):
    """A folder that an interrupted diagnosis has left keeps nothing of it. Of few effects, which compile sooner."""
    monkeypatch.setattr(selection_state, "CATALOGUE", {name: CATALOGUE[name] for name in FEW})
    for name in ("diagnosis.json", "histories.nc"):
        (tmp_path / name).write_text("of another run")
    hidden = {"thrust_moment": {"thrust_arm": 0.6}}
    records = hidden_records(hidden, seed=413_233, seconds=40.0)
    channels = [{n: x for n, x in r.channels.items() if n not in ("ax", "ay", "az")} for r in records]
    records = [FlightRecord.from_arrays(r.name, r.time, x) for r, x in zip(records, channels, strict=True)]
    told = diagnose_records(records, card, DiagnoseOptions(max_effects=1), out=tmp_path)
    found, flown = told.diagnosis, told.view.trajectories
    content = validated(tmp_path / "diagnosis.json", "diagnosis")
    assert [c["name"] for c in content["causes"]] == [c.name for c in found.causes] != []
    assert (tmp_path / "report.html").stat().st_size > 10_000
    groups = read_histories(tmp_path / "histories.nc")
    for path, told in zip(flown.paths, content["trajectories"]["paths"], strict=True):
        flight = flight_of(groups[f"trajectories_{path.split}"], path.manoeuvre)
        residual = flight["alpha_measured"] - flight[f"alpha_{path.model}"]
        assert np.sqrt(np.mean(residual**2)) == pytest.approx(told["outputs"]["alpha"]["rms"], rel=1e-9)


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
    (tmp_path / "histories.nc").write_bytes(b"of another run")
    assert "no such luck" in histories.put_histories(bad, tmp_path)[0]
    assert [path.name for path in tmp_path.iterdir()] == ["error.txt"]
