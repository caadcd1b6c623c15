"""The public names, and what a user does with them in a few lines."""

import inspect
import re
from dataclasses import replace
from pathlib import Path

import matplotlib.figure
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import bayes_aero as ba
from bayes_aero.cli.fits import identify as command
from bayes_aero.flight.health import channel_health
from bayes_aero.flight.health.finding import Consistency
from bayes_aero.inference.results import Posterior, PosteriorStatus
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.jobs.steps.record_checks import RecordChecks
from bayes_aero.model.noise import DEFAULT, Colour
from bayes_aero.report.tables.comparison import ordered

PUBLIC = {
    "CATALOGUE", "Card", "Diagnosed", "Effect", "Fit", "FlightRecord", "InputError", "Model", "Parameter", "Prior",
    "Stage", "__version__", "diagnose", "fit", "flight_path", "fly", "gpr", "next_flight", "plot", "read", "read_card",
    "sample", "write_record",
}  # fmt: skip


def test_public_names_are_locked_documented_and_typed():
    """Adding or removing one is a decision: it changes this list."""
    assert set(ba.__all__) == PUBLIC
    assert {name for name in PUBLIC if getattr(ba, name, None) is None} == set()
    for name in sorted(PUBLIC - {"CATALOGUE", "__version__"}):
        thing = getattr(ba, name)
        assert inspect.getdoc(thing), name
        if inspect.isfunction(thing):
            assert "return" in thing.__annotations__, name
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        ba.identfy  # noqa: B018


@pytest.fixture(scope="module")
def fitted(clean_records, card):
    """A model composed in three lines and fitted."""
    model = ba.Model.from_card(card).extended("thrust_moment")
    return ba.fit(clean_records, card, model=model)


def test_a_composed_model_keeps_the_card_s_priors_and_finds_nothing_where_nothing_is(fitted, card):
    base = ba.Model.from_card(card)
    kept = {p.name: p for p in fitted.run.model.parameters}
    assert all(kept[p.name] == p for p in base.parameters)
    i = fitted.mle.names.index("thrust_arm")
    assert abs(fitted.mle.estimate[i]) < 0.05  # m; the simulation's line of thrust goes through the centre of gravity


def test_table_and_plot(fitted):
    table = fitted.table()
    assert isinstance(table, pd.DataFrame)
    assert list(table.index) == list(ordered(fitted.mle.names, fitted.mle.parameters))
    np.testing.assert_allclose(table.loc["Cmq", "crb"], fitted.mle.crb[fitted.mle.names.index("Cmq")])
    figure = ba.plot(fitted, width=10.0)
    assert isinstance(figure, matplotlib.figure.Figure)
    assert figure.get_size_inches()[0] == 10.0
    with pytest.raises(ba.InputError, match="no posterior"):
        ba.plot(fitted, "trace_emcee")
    with pytest.raises(ba.InputError, match="forest"):
        ba.plot(fitted, "florest")
    with pytest.raises(ba.InputError, match="gpr"):
        fitted.validation()


def test_posteriors_under_different_noise_models_are_kept_apart(fitted):
    """Side by side they would be read as engines that disagree."""
    sampled = Posterior("emcee", "ar1", fitted.mle.names, xr.DataTree(), {}, PosteriorStatus.CONVERGED, 0.0)
    beside = ba.Fit(replace(fitted.run, noise=Colour.AR1, posteriors={"emcee": sampled}))
    with pytest.raises(ba.InputError, match="under ar1 noise"):
        ba.sample(beside, engine="nuts", noise="buffet-ar1")


def test_one_noise_model_is_the_default_everywhere():
    for function in (ba.sample, IdentifyOptions, command):
        assert Colour(inspect.signature(function).parameters["noise"].default) is DEFAULT


@pytest.mark.parametrize("use", [ba.fit, ba.diagnose])
def test_arrays_that_are_no_numbers_are_refused_in_one_sentence(use, diagnosed, card):
    record = diagnosed.records[0]
    gone = record.channels["alpha"].copy()
    gone[100:110] = np.nan
    with pytest.raises(ba.InputError, match=r"record .*: channel alpha is empty or not a number .*10 of"):
        use([replace(record, channels={**record.channels, "alpha": gone})], card)
    with pytest.raises(ba.InputError, match="channel time runs backwards"):
        use([replace(record, time=record.time[::-1])], card)


def test_diagnosed_says_what_the_view_holds_and_what_is_in_doubt(diagnosed, card):
    a_view = diagnosed.view
    found = ba.Diagnosed(a_view, card)
    assert found.verdict == a_view.diagnosis.verdict.value
    assert set(found.table()["cause"]) == set(found.causes)
    assert found.sentences[0]
    assert found.doubts == []
    assert {"name", "score", "p_value"} <= set(found.screen().columns)
    assert isinstance(ba.plot(found), matplotlib.figure.Figure)
    record = diagnosed.records[0]
    checks = RecordChecks(channel_health([record, replace(record, name="copy")], card), Consistency("not asked for"))
    found = ba.Diagnosed(diagnosed.view, card, checks)
    assert any("copy: is the same record as" in said for said in found.doubts)
    assert found.sentences[: len(found.doubts)] == found.doubts


def test_whatever_reads_records_makes_the_same_checks():
    """Health, identity and consistency are asked for at one place, and every command gets there."""
    package = Path(ba.__file__).parent
    source = {str(p.relative_to(package)): p.read_text(encoding="utf-8") for p in package.rglob("*.py")}
    alone = re.compile(r"(?<!def )\b(channel_health|consistency|same_records)\(")
    assert {name for name, text in source.items() if alone.search(text)} == {
        "flight/health/__init__.py",
        "jobs/steps/record_checks.py",
    }
    makes = {name for name, text in source.items() if "record_checks(" in text}
    jobs = {f"jobs/{name}.py" for name in ("check", "identify", "fly", "diagnose", "qualify")}
    assert makes == {"jobs/steps/record_checks.py", "explore/opened.py", "api.py", *jobs}
