"""The package: public names, no inference in reports, compiled once, checked as it runs."""

from __future__ import annotations

import ast
import inspect
import os
import re
import subprocess
import sys
from dataclasses import replace
from importlib import import_module, resources
from pathlib import Path

import jax
import matplotlib.figure
import numpy as np
import pytest
import xarray as xr
from beartype.roar import BeartypeCallHintViolation

import bayes_aero as ba
import bayes_aero.effects as effects
from bayes_aero.cli.fits import identify as command
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import theil_parts
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight import reading
from bayes_aero.flight.health import Consistency
from bayes_aero.flight.health.channel import channel_health
from bayes_aero.flight.text import open_text
from bayes_aero.inference.results import Posterior, PosteriorStatus
from bayes_aero.jobs.check import RecordChecks
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.model.observations import DEFAULT, Colour
from bayes_aero.physics.filters import smooth
from bayes_aero.report.pages.estimates import ordered
from bayes_aero.simulate.demo import simulate_stall

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
    """A model composed in one line and fitted."""
    return ba.fit(clean_records, card, model=ba.Model.from_card(card).extended("thrust_moment"))


def test_a_composed_model_keeps_the_card_s_priors_and_finds_nothing_where_nothing_is(fitted, card):
    kept = {p.name: p for p in fitted.run.model.parameters}
    assert all(kept[p.name] == p for p in ba.Model.from_card(card).parameters)
    table = fitted.table()  # the simulation's line of thrust goes through the centre of gravity
    assert list(table.index) == list(ordered(fitted.mle.names, fitted.mle.parameters))
    assert abs(fitted.mle.estimate[fitted.mle.names.index("thrust_arm")]) < 0.05  # m
    np.testing.assert_allclose(table.loc["Cmq", "crb"], fitted.mle.crb[fitted.mle.names.index("Cmq")])


def test_figures_are_drawn_and_what_cannot_be_is_said(fitted):
    figure = ba.plot(fitted, width=10.0)
    assert isinstance(figure, matplotlib.figure.Figure)
    assert figure.get_size_inches()[0] == 10.0
    for name, words in (("trace_emcee", "no posterior"), ("florest", "forest")):
        with pytest.raises(ba.InputError, match=words):
            ba.plot(fitted, name)
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
    source = {str(p.relative_to(PACKAGE)): p.read_text(encoding="utf-8") for p in PACKAGE.rglob("*.py")}
    alone = re.compile(r"(?<!def )\b(channel_health|consistency|same_records)\(")
    assert {name for name, text in source.items() if alone.search(text)} == {
        "flight/health/channel.py",
        "jobs/check.py",
    }
    makes = {name for name, text in source.items() if "record_checks(" in text}
    jobs = {f"jobs/{name}.py" for name in ("check", "identify", "fly", "diagnose", "qualify")}
    assert makes == {"explore/opened.py", "api.py", *jobs}


# What holds in the whole package
ENTRY = '''
"""Drag of the elevator, squared."""
from bayes_aero.effects.longitudinal import ELEVATOR_DRAG
from dataclasses import replace
ELEVATOR_DRAG_AGAIN = replace(ELEVATOR_DRAG, name="elevator_drag_again")
'''


def test_an_effect_is_one_entry_and_a_second_of_its_name_is_refused(tmp_path, monkeypatch):
    def beside(name: str, text: str) -> None:
        """The package as if this file lay in it."""
        (tmp_path / f"{name}.py").write_text(text)
        monkeypatch.delitem(sys.modules, f"{effects.__name__}.{name}", raising=False)

    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    beside("more_drag", ENTRY)
    found = effects._discover()
    assert found.keys() - CATALOGUE.keys() == {"elevator_drag_again"}
    assert list(found) == sorted(found)
    beside("drag_twice", ENTRY.replace("elevator_drag_again", "elevator_drag"))
    with pytest.raises(InputError, match="second effect elevator_drag"):
        effects._discover()


def test_a_file_format_is_one_entry(tmp_path, monkeypatch, card):
    monkeypatch.setitem(reading.READERS, ".flights", lambda raw: open_text(raw[::-1]))
    record = simulate_stall(0, card=card)
    ba.write_record(record, tmp_path / "stall.csv", card.channels)
    (tmp_path / "stall.flights").write_bytes((tmp_path / "stall.csv").read_bytes()[::-1])
    one, other = (reading.read_record(tmp_path / f"stall.{end}", card.channels) for end in ("csv", "flights"))
    assert one.channels.keys() == other.channels.keys()
    assert all(np.array_equal(one[name], other[name]) for name in one.channels)


BELOW = ("diagnosis", "inference", "residuals", "dynamics", "model")
PROBLEMS = {"state", "responses", "aerodynamics"}  # regression problems, from which anything can be fitted
COMPUTE = {
    *("evaluate", "linearise", "refitted", "first_order", "coefficients", "flow", "predict", "draws"),
    *("standard_normal", "default_rng", "lstsq", "solve"),
}
PACKAGE = Path(str(resources.files(ba)))
MODULES = sorted(PACKAGE.joinpath("report").rglob("*.py"))


def taken(tree: ast.Module) -> list[tuple[str, str]]:
    """Modules of the layers below and the names that are imported from them."""
    found = [(n.module, a.name) for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module for a in n.names]
    return [(module, name) for module, name in found if module.split(".")[:2] in [["bayes_aero", x] for x in BELOW]]


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_report_takes_results_and_computes_none(path):
    tree = ast.parse(path.read_text())
    for module, name in taken(tree):
        thing = getattr(import_module(module), name)
        assert not inspect.ismodule(thing), f"{module}.{name}: import its results by name"
        computes = inspect.isfunction(thing) or hasattr(thing, "__wrapped__")
        assert not computes, f"{module}.{name} computes"
    assert not {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)} & PROBLEMS
    called = {node.func for node in ast.walk(tree) if isinstance(node, ast.Call)}
    assert not {function.attr for function in called if isinstance(function, ast.Attribute)} & COMPUTE


def test_records_of_other_names_run_the_compiled_programs(diagnosed, card):
    """After one diagnosis the same flight under another name compiles nothing."""
    traced = []

    def listen(event, _, **about):
        if event == "/jax/core/compile/jaxpr_trace_duration":
            traced.append(about.get("fun_name", "?"))

    jax.monitoring.register_event_duration_secs_listener(listen)
    (record,) = diagnosed.records
    settings = DiagnosisSettings(max_effects=1, gains=False)
    first = diagnose([record], card, settings=settings)
    traced.clear()
    again = diagnose([replace(record, name="the same flight")], card, settings=settings)
    assert [c.name for c in again.causes] == [c.name for c in first.causes] != []
    assert not set(traced) & {"_linearise", "_residuals"}, traced
    jax.jit(lambda x: x + 1.0)(1.0)
    assert "<lambda>" in traced, "tracing was not listened to"


WHOLE_LOOPS = " --xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000"


@pytest.mark.parametrize(("flags", "added"), [
    ("--xla_cpu_multi_thread_eigen=false", " --xla_cpu_use_fusion_emitters=false" + WHOLE_LOOPS),
    ("--xla_cpu_use_fusion_emitters=true", WHOLE_LOOPS),
    ("--xla_cpu_use_fusion_emitters=true" + WHOLE_LOOPS.replace("1000000", "1024"), ""),
])  # fmt: skip
def test_former_emitters_and_whole_loops_are_asked_for_unless_flags_say_otherwise(flags, added):
    """And the compiler knows the flags: an unknown one would end the process at the first program."""
    code = "import os, bayes_aero, jax; print(os.environ['XLA_FLAGS']); print(float(jax.numpy.ones(2).sum()))"
    environment = os.environ | {"XLA_FLAGS": flags}
    ended = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert ended.stdout.splitlines() == [flags + added, "2.0"]


@pytest.mark.parametrize(("use", "given"), [(smooth, ("no signal", 0.1)), (theil_parts, (np.zeros(3), np.zeros(4)))])
def test_types_and_shapes_are_checked_as_the_package_runs_under_test(use, given):
    with pytest.raises(BeartypeCallHintViolation):
        use(*given)
