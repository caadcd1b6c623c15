"""The diagnosis as a job: what it writes follows its schema, is whole, and survives figures that fail."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from importlib import resources
from unittest.mock import patch

import jsonschema
import pandas as pd
import pytest
from simulated_halves import halves

from bayes_aero.diagnosis.diagnose import NO_GAIN
from bayes_aero.errors import InputError
from bayes_aero.jobs import diagnose as job
from bayes_aero.jobs.diagnose import diagnose_records, hide_one
from bayes_aero.jobs.io import result_store as kept
from bayes_aero.jobs.io.diagnosis_json import Outcome, diagnosis_results
from bayes_aero.jobs.options import DiagnoseOptions
from bayes_aero.jobs.provenance.provenance import provenance, write_json
from bayes_aero.jobs.steps import post_diagnosis as outlook
from bayes_aero.jobs.steps import post_processing as follow
from bayes_aero.report.figures import diagnosis as figures_diagnosis


def run(records, card, *, out, hidden=None, points=None, fly=None, **options):
    """The job with these in place of what chooses test points and simulates trajectories; without one, not done."""
    stages = {"test_points": points is not None, "trajectories": fly is not None}
    with patch.object(follow, "proposed_points", points), patch.object(job, "simulations", fly):
        return diagnose_records(records, card, DiagnoseOptions(**stages, **options), out=out, hidden=hidden)


def validated(path) -> dict:
    content = json.loads(path.read_text())
    schema = json.loads(resources.files("bayes_aero.jobs.io.schemas").joinpath("diagnosis.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(content, schema)
    return content


@pytest.fixture
def repeated(monkeypatch, diagnosed):
    """The job with the diagnosis already made."""
    monkeypatch.setattr(job, "diagnose", lambda *_, **__: diagnosed.view.diagnosis)
    monkeypatch.setattr(job, "view_of", lambda _: diagnosed.view)
    return diagnosed


def test_files_are_complete_and_follow_the_schema(repeated, card, tmp_path):
    found = run(repeated.records, card, out=tmp_path, hidden=repeated.hidden, figures=False)
    content = validated(tmp_path / "diagnosis.json")
    assert content["verdict"] == found.diagnosis.verdict.value
    assert [c["name"] for c in content["causes"]] == [c.name for c in found.diagnosis.causes]
    assert content["hidden"]["effects"] == repeated.hidden
    assert set(found.named) == set(repeated.hidden)
    assert "first" in found.named.values()
    assert content["provenance"]["settings"] == {"max_effects": 8}
    assert len(pd.read_csv(tmp_path / "screen.csv")) == len(content["screening"])
    assert set(pd.read_csv(tmp_path / "causes.csv")["cause"]) == {c["name"] for c in content["causes"]}
    assert not list(tmp_path.glob("*.part"))


def test_gains_are_by_coefficient(repeated, card, tmp_path):
    run(repeated.records, card, out=tmp_path, figures=False)
    gain = validated(tmp_path / "diagnosis.json")["causes"][-1]["gain"]
    assert gain["split"] == "block"
    assert set(gain["by_coefficient"]) == {"CL", "CD", "Cm"}
    assert gain["by_coefficient"]["Cm"]["r2_after"] > gain["by_coefficient"]["Cm"]["r2_before"]


def test_numbers_that_do_not_exist_are_null(repeated, card, tmp_path):
    view = repeated.view
    cause = replace(view.diagnosis.causes[0], gain=NO_GAIN, p_value=float("nan"))
    view = replace(view, diagnosis=replace(view.diagnosis, causes=(cause,)))
    content = diagnosis_results(Outcome(view), card, repeated.records, provenance(card, repeated.records, 0, {}))
    write_json(content, tmp_path / "diagnosis.json")
    (one,) = validated(tmp_path / "diagnosis.json")["causes"]
    assert one["p_value"] is None
    assert one["gain"] == {"elpd": None, "elpd_se": None, "split": "not measured", "by_coefficient": {}, "degraded": {}}


def test_a_figure_that_fails_loses_nothing(repeated, card, tmp_path, monkeypatch):
    def bad(_):
        raise ValueError("no such luck")

    monkeypatch.setattr(job, "DIAGNOSIS_FIGURES", {"bad": bad, "colour": figures_diagnosis.residual_colour})
    found = run(repeated.records, card, out=tmp_path)
    content = validated(tmp_path / "diagnosis.json")
    (told,) = found.failures
    assert told.startswith("Figure bad was not drawn: ValueError: no such luck. This is a defect of the program")
    assert content["failures"] == [told]
    assert (tmp_path / "figures" / "colour.png").stat().st_size > 10_000


def test_a_page_that_fails_loses_nothing(repeated, card, tmp_path, monkeypatch):
    def bad(*_):
        raise ValueError("no such luck")

    monkeypatch.setattr(kept, "diagnosis_page", bad)
    found = run(repeated.records, card, out=tmp_path, figures=False)
    (told,) = found.failures
    assert told.startswith("report.html was not written: ValueError: no such luck.")
    assert validated(tmp_path / "diagnosis.json")["failures"] == [told]
    assert not (tmp_path / "report.html").exists()


def test_a_stall_that_cannot_be_computed_loses_nothing(repeated, card, tmp_path, monkeypatch):
    def bad(*_):
        raise ValueError("no such luck")

    monkeypatch.setattr(follow, "with_stalls", bad)
    found = run(repeated.records, card, out=tmp_path, figures=False)
    (told,) = found.failures
    assert told.startswith("Stall left out: ValueError: no such luck.")
    page = (tmp_path / "report.html").read_text()
    assert "Stall left out: ValueError: no such luck." in page
    assert "was not made" not in page


def test_points_are_written_and_may_be_refused(repeated, card, tmp_path):
    def refused(*_):
        raise InputError("no level flight")

    run(repeated.records, card, out=tmp_path, figures=False, points=decided)
    assert validated(tmp_path / "diagnosis.json")["test_points"] == decided()
    assert len(pd.read_csv(tmp_path / "test_points.csv")) == 1
    found = run(repeated.records, card, out=tmp_path / "other", figures=False, points=refused)
    assert "no level flight" in found.notes[0]


def test_what_was_found_beside_an_interrupted_flight_is_on_disk(repeated, card, tmp_path):
    def interrupted(*_):
        end = time.monotonic() + 60.0
        while not json.loads((tmp_path / "diagnosis.json").read_text())["test_points"]:
            assert time.monotonic() < end
            time.sleep(0.05)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(repeated.records, card, out=tmp_path, points=decided, fly=interrupted)
    assert validated(tmp_path / "diagnosis.json")["test_points"] == decided()


def decided(*_):
    """One test point for one question."""
    point = {"manoeuvre": "thrust_steps", "amplitude": 1.5, "airspeed": 95.4, "altitude": 5200.0, "seconds": 60.0}
    point |= {"excursion": {"alpha": [0.07, 0.21]}, "standard_errors": [6.25], "nats_per_second": 0.3}
    questions = [{"effects": ["a", "b"], "enough": 5.0, "present": 0.7}]
    return {"questions": questions, "points": [point], "refused": {}, "envelope": {}, "stated": []}


def test_what_a_killed_run_left_is_overwritten(repeated, card, tmp_path, monkeypatch):
    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(kept.ResultStore, "put_page", killed)
        with pytest.raises(KeyboardInterrupt):
            run(
                repeated.records, card, out=tmp_path, figures=False, points=decided,
                fly=lambda *_: halves(repeated.records[0]),
            )  # fmt: skip
    left = validated(tmp_path / "diagnosis.json")
    assert left["trajectories"]["paths"]
    assert left["test_points"] == decided()
    run(repeated.records, card, out=tmp_path, figures=False)
    content = validated(tmp_path / "diagnosis.json")
    assert content["trajectories"] == {}
    assert content["test_points"] == {}
    assert (tmp_path / "report.html").stat().st_size > 10_000


def test_late_stages_that_fail_cost_nothing_that_was_found(repeated, card, tmp_path):
    def bad(*_):
        raise ValueError("no such luck")

    def refused(*_):
        raise InputError("cannot fly")

    found = run(repeated.records, card, out=tmp_path, figures=False, points=bad, fly=refused)
    content = validated(tmp_path / "diagnosis.json")
    assert content["notes"] == ["Trajectories were not simulated: cannot fly"]
    (told,) = content["failures"]
    what = "Test points that would decide what is open were not chosen: ValueError"
    assert told.startswith(f"{what}: no such luck.")
    assert [c["name"] for c in content["causes"]] == [c.name for c in found.diagnosis.causes]
    assert what in (tmp_path / "report.html").read_text()
    assert "no such luck" in (tmp_path / "error.txt").read_text()
    found = run(repeated.records, card, out=tmp_path, figures=False, fly=bad)
    assert found.failures[0].startswith("Trajectories were not simulated: ValueError: no such luck.")
    found = run(repeated.records, card, out=tmp_path, figures=False)
    assert found.failures == ()
    assert not (tmp_path / "error.txt").exists()


def test_a_state_that_cannot_be_trimmed_has_no_test_points(diagnosed, monkeypatch):
    def refused(*_, **__):
        raise InputError("level flight needs no angle of attack in range")

    monkeypatch.setattr(outlook, "next_test_points", refused)
    found = diagnosed.view.diagnosis
    known = found.aerodynamics.state.full.candidates
    rival = next(e.name for e in known if e.name != found.causes[0].name and e.parameters)
    cause = replace(found.causes[0], ambiguous_with=(rival,), stage="coefficients")
    with pytest.raises(InputError, match="level flight needs"):  # which the job notes
        outlook.proposed_points(replace(found, causes=(cause,)))
    assert outlook.proposed_points(replace(found, causes=(), together=(), absorbed=())) == {}


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
