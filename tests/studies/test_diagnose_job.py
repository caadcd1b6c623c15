"""The diagnosis as a job: what it writes follows its schema, is whole, and survives what fails late."""

import json
import shutil
import time
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calling import page_of, validated
from simulated_halves import halves

from bayes_aero.diagnosis.consistency import consistency, errors_of_diagnosis
from bayes_aero.diagnosis.diagnose import NO_GAIN
from bayes_aero.errors import InputError, plain_line
from bayes_aero.inference.results import score
from bayes_aero.jobs import diagnose as job
from bayes_aero.jobs import results as histories
from bayes_aero.jobs.options import DiagnoseOptions
from bayes_aero.jobs.store import provenance, write_json
from bayes_aero.report.figures import diagnosis

POINT = {"manoeuvre": "thrust_steps", "amplitude": 1.5, "airspeed": 95.4, "altitude": 5200.0, "seconds": 60.0}
POINT |= {"excursion": {"alpha": [0.07, 0.21]}, "standard_errors": [6.25], "nats_per_second": 0.3}
DECIDED = {"questions": [{"effects": ["a", "b"], "enough": 5.0, "present": 0.7}], "points": [POINT]}
DECIDED |= {"refused": {}, "envelope": {}, "stated": []}


def read_histories(folder):
    """All groups by name, in memory."""
    with xr.open_datatree(folder / "histories.nc", engine="h5netcdf") as tree:
        assert tree.attrs == {"schema": "bayes_aero/histories/1"}
        return {node.path.strip("/"): node.to_dataset(inherit=False).load() for node in tree.subtree if node.data_vars}


def flight_of(group, manoeuvre):
    """One manoeuvre's columns."""
    names = np.atleast_1d(group.attrs["names"]).tolist()  # a list of one comes back as that one
    rows = group["manoeuvre"].values == names.index(plain_line(manoeuvre)) + 1
    return {str(key): np.asarray(column.values)[rows] for key, column in group.data_vars.items()}


def run(records, card, *, out, hidden=None, points=None, fly=None, figures=False):
    """The job with these in place of what chooses test points and simulates trajectories; without one, not done."""
    options = DiagnoseOptions(test_points=points is not None, trajectories=fly is not None, figures=figures)
    with patch.object(job, "proposed_points", points), patch.object(job, "simulations", fly):
        return job.diagnose_records(records, card, options, out=out, hidden=hidden)


def decided(*_):
    return DECIDED


def bad(*_):
    raise ValueError("no such luck")


def refused(*_):
    raise InputError("cannot fly")


def killed(*_):
    raise KeyboardInterrupt


def test_what_the_records_are_worth_is_told_before_the_causes_and_not_checked_again(diagnosed, card):
    report, told = consistency(diagnosed.records, card), []

    def found(*_, checked, **__):
        checked(report)
        return diagnosed.view.diagnosis

    nothing_else = DiagnoseOptions(test_points=False, trajectories=False, figures=False)
    with patch.object(job, "diagnose", found), patch.object(job, "view_of", lambda _: diagnosed.view):
        done = job.diagnose_records(diagnosed.records, card, nothing_else, answer=told.append)
    assert told[0].consistency is report
    assert [x.diagnosis for x in told[1:]] == [diagnosed.view.diagnosis]
    assert done.consistency.recorded is report.recorded
    assert done.consistency == consistency(diagnosed.records, card, errors=errors_of_diagnosis(done.diagnosis))


@pytest.fixture(scope="module")
def repeated(diagnosed, card):
    """The job with the diagnosis and the checks of the records already made."""
    checks = job.record_checks(diagnosed.records, card, 0)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(job, "record_checks", lambda *_, **__: checks)
        patched.setattr(job, "diagnose", lambda *_, **__: diagnosed.view.diagnosis)
        patched.setattr(job, "view_of", lambda _: diagnosed.view)
        yield diagnosed


@pytest.fixture(scope="module")
def left(repeated, card, tmp_path_factory):
    """What a run leaves that was killed at its page, in the folder of another run."""
    folder, flown = tmp_path_factory.mktemp("killed"), halves(repeated.records[0])
    for name in ("diagnosis.json", "histories.nc", "error.txt"):
        (folder / name).write_text("of another run")
    with patch.object(job, "put_page", killed), pytest.raises(KeyboardInterrupt):
        run(repeated.records, card, out=folder, points=decided, fly=lambda *_: flown)
    return folder


def test_histories_give_the_scores_and_errors_that_are_told(left, diagnosed):
    groups, view, (record,) = read_histories(left), diagnosed.view, diagnosed.records
    flight = flight_of(groups["coefficients"], record.name)
    assert np.array_equal(flight["time"], record.time)
    for key, fitted in (("card", view.card), ("extended", view.extended)):
        for name in ("CL", "CD", "Cm"):
            assert groups["coefficients"][f"{name}_{key}"].attrs["units"] == "1"
            again = score(flight[f"{name}_measured"], flight[f"{name}_{key}"])
            assert again.r2 == pytest.approx(fitted.composition[name]["r2"], abs=1e-9)
            assert again.rmse == pytest.approx(fitted.composition[name]["rmse"], rel=1e-9)
        assert 0.0 <= flight[f"X_{key}"].min() <= flight[f"X_{key}"].max() <= 1.0
    content = validated(left / "diagnosis.json", "diagnosis")
    for path, shown in zip(halves(record).paths, content["trajectories"]["paths"], strict=True):
        flight = flight_of(groups[f"trajectories_{path.split}"], path.manoeuvre)
        assert np.array_equal(flight["time"], path.time)
        for name in path.errors:
            residual = flight[f"{name}_measured"] - flight[f"{name}_{path.model}"]
            assert np.sqrt(np.mean(residual**2)) == pytest.approx(shown["outputs"][name]["rms"], rel=1e-9)
    units = {name: groups["trajectories_hold_out"][f"{name}_card"].attrs["units"] for name in ("airspeed", "alpha")}
    assert units == {"airspeed": "m/s", "alpha": "rad"}
    assert content["test_points"] == DECIDED
    assert len(pd.read_csv(left / "test_points.csv")) == 1


def test_files_are_complete_follow_the_schema_and_keep_nothing_of_a_killed_run(left, repeated, card, tmp_path):
    left = shutil.copytree(left, tmp_path / "again")
    found = run(repeated.records, card, out=left, hidden=repeated.hidden)
    assert found.failures == ()
    content = validated(left / "diagnosis.json", "diagnosis")
    assert (content["trajectories"], content["test_points"]) == ({}, {})
    assert content["verdict"] == found.diagnosis.verdict.value
    assert [c["name"] for c in content["causes"]] == [c.name for c in found.diagnosis.causes]
    assert content["hidden"]["effects"] == repeated.hidden
    assert set(found.named) == set(repeated.hidden)
    assert "first" in found.named.values()
    assert content["provenance"]["settings"] == {"max_effects": 8, "anyway": False}
    assert len(pd.read_csv(left / "screen.csv")) == len(content["screening"])
    assert set(pd.read_csv(left / "causes.csv")["cause"]) == {c["name"] for c in content["causes"]}
    gain = content["causes"][-1]["gain"]
    assert gain["split"] == "block"
    assert set(gain["by_coefficient"]) == {"CL", "CD", "Cm"}
    assert gain["by_coefficient"]["Cm"]["r2_after"] > gain["by_coefficient"]["Cm"]["r2_before"]
    assert (left / "report.html").stat().st_size > 10_000
    assert set(read_histories(left)) == {"coefficients"}
    assert not [*left.glob("*.part"), *left.glob("error.txt")]


def test_numbers_that_do_not_exist_are_null(repeated, card, tmp_path):
    view = repeated.view
    cause = replace(view.diagnosis.causes[0], gain=NO_GAIN, p_value=float("nan"))
    view = replace(view, diagnosis=replace(view.diagnosis, causes=(cause,)))
    source = provenance(card, repeated.records, 0, {})
    write_json(
        histories.diagnosis_results(histories.Outcome(view), card, repeated.records, source), tmp_path / "d.json"
    )
    (shown,) = validated(tmp_path / "d.json", "diagnosis")["causes"]
    assert shown["p_value"] is None
    assert shown["gain"] == {
        "elpd": None, "elpd_se": None, "split": "not measured", "by_coefficient": {}, "degraded": {},
    }  # fmt: skip


FIGURES = {"DIAGNOSIS_FIGURES": {"bad": bad, "colour": diagnosis.residual_colour}, "with_stalls": bad}


@pytest.mark.parametrize(("broken", "points", "fly", "failures"), [
    (FIGURES, bad, refused, ("Test points", "Stall left out", "Figure bad")),
    ({"diagnosis_page": bad}, refused, bad, ("Trajectories", "report.html")),
])  # fmt: skip
def test_late_stages_that_fail_cost_nothing_else(repeated, card, tmp_path, monkeypatch, broken, points, fly, failures):
    for name, thing in broken.items():
        monkeypatch.setattr(job, name, thing)
    found = run(repeated.records, card, out=tmp_path, points=points, fly=fly, figures=broken is FIGURES)
    content = validated(tmp_path / "diagnosis.json", "diagnosis")
    assert content["failures"] == list(found.failures)
    assert len(found.failures) == len(failures)
    for name in failures:
        (said,) = [said for said in found.failures if said.startswith(name)]
        assert "ValueError: no such luck" in said
    (note,) = content["notes"]
    assert "cannot fly" in note
    assert [c["name"] for c in content["causes"]] == [c.name for c in found.diagnosis.causes]
    assert "no such luck" in (tmp_path / "error.txt").read_text()
    if broken is FIGURES:
        assert (tmp_path / "figures" / "colour.png").stat().st_size > 10_000
        for part in ("Test points that would decide", "Stall left out: ValueError: no such luck."):
            assert part in page_of(tmp_path)
    assert (tmp_path / "report.html").exists() == (broken is FIGURES)


def test_what_was_found_beside_an_interrupted_flight_is_on_disk(repeated, card, tmp_path):
    def interrupted(*_):
        end = time.monotonic() + 60.0
        while not json.loads((tmp_path / "diagnosis.json").read_text())["test_points"]:
            assert time.monotonic() < end
            time.sleep(0.05)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(repeated.records, card, out=tmp_path, points=decided, fly=interrupted)
    assert validated(tmp_path / "diagnosis.json", "diagnosis")["test_points"] == DECIDED


def test_a_folder_that_cannot_be_made_is_told_before_the_work(card, tmp_path, monkeypatch):
    monkeypatch.setattr(job, "diagnose", killed)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="--out"):
        run([], card, out=tmp_path / "file" / "below")


def test_hiding_is_seeded_and_hides_what_the_card_lacks(card, monkeypatch):
    monkeypatch.setattr(job, "flyable", lambda names, **_: ({names[0]: {}}, []))
    drawn = [next(iter(job.hide_one(card, seed)[0])) for seed in (1, 1, 2, 3, 4)]
    assert drawn[0] == drawn[1]
    assert len(set(drawn)) > 1
    assert not set(drawn) & (set(card.effects) - {"separation_lag", "reattachment_hysteresis"})


@pytest.mark.parametrize("name", ["run/1", "Flug 7 \u00fc", "undecodable \udcff", "end\0", "~", ""])
def test_any_name_of_a_record_and_of_a_channel_is_kept(name, diagnosed, tmp_path):
    (path, *_) = halves(diagnosed.records[0]).paths
    units = {"q/hat": "rad/s", "p_rate/norm": "1"}
    renamed = {kind: dict(zip(units, getattr(path, kind).values(), strict=False)) for kind in ("measured", "simulated")}
    odd = replace(path, manoeuvre=name, **renamed)
    assert histories.put_histories(lambda: histories.flights([odd], units), tmp_path) == ()
    (group,) = read_histories(tmp_path).values()
    flight = flight_of(group, name)
    for output, unit in units.items():
        for kind, x in (("measured", odd.measured), (odd.model, odd.simulated)):
            key = histories.column(output, kind)
            assert np.array_equal(flight[key], x[output])
            assert group[key].attrs["units"] == unit


def test_histories_that_cannot_be_written_are_told_and_leave_no_old_ones(tmp_path):
    (tmp_path / "histories.nc").write_bytes(b"of another run")
    assert "no such luck" in histories.put_histories(bad, tmp_path)[0]
    assert [path.name for path in tmp_path.iterdir()] == ["error.txt"]
