"""Terms that nobody listed: the library by hand, the effect file that states one, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources

import jsonschema
import numpy as np
import pytest
from calling import called

from bayes_aero.diagnosis.terms.library import QUANTITIES, SEPARATED, Term, library
from bayes_aero.diagnosis.terms.result import FoundTerm
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.jobs.catalogue.effect_file import effect_file, write_effects
from bayes_aero.jobs.io.diagnosis_json import term_results
from bayes_aero.model.own_effects import own_effects
from bayes_aero.report.tables.diagnosis_tables import terms_table
from bayes_aero.report.text.diagnosis import diagnosis_sentences

AIRCRAFT = Aircraft(
    mass=15000.0, Ix=1e5, Iy=2e5, Iz=3e5, Ixz=1e4,
    wing_area=60.0, chord=3.0, half_span=10.0, aspect_ratio=7.0, tail_arm=15.0,
)  # fmt: skip
N = 100
SIGNALS = {
    "alpha": np.linspace(0.1, 0.2, N), "q": np.full(N, 0.2), "elevator": np.full(N, -0.2), "airspeed": np.full(N, 60.0),
    "beta": np.linspace(-0.1, 0.1, N), "p": np.full(N, 0.3), "aileron": np.full(N, 0.05), "X": np.full(N, 0.25),
    "thrust": np.full(N, 5400.0), "density": np.full(N, 1.0), "dt": np.full(N, 0.05),
    "first": np.repeat([0, N // 2], N // 2),
}  # fmt: skip
BY_NAME = {q.name: q for q in (*QUANTITIES, SEPARATED)}


def product(*names):
    return Term(tuple(BY_NAME[name] for name in names))


def terms(*, lateral=False, separated=True):
    found = library(SIGNALS, AIRCRAFT, lambda name: name in SIGNALS, lateral=lateral, separated=separated)
    assert len({t.name for t in found}) == len(found)
    return {t.name: t for t in found}


@pytest.mark.parametrize(
    ("factors", "name", "unit", "value"),
    [
        (("alpha", "alpha", "elevator"), "alpha^2 elevator", "1/rad^3", 0.1 * 0.1 * -0.2),
        (("qhat", "(1 - X)"), "qhat (1 - X)", "1", 0.2 * 3.0 / 60.0 * 0.75),
        (("phat", "aileron"), "phat aileron", "1/rad", 0.3 * 10.0 / 60.0 * 0.05),
        (("CT",), "CT", "1", 5400.0 / (0.5 * 3600.0 * 60.0)),
    ],
)
def test_a_product_has_the_value_and_the_unit_of_its_factors(factors, name, unit, value):
    term = product(*factors)
    assert (term.name, term.unit) == (name, unit)
    assert term.evaluate(SIGNALS, AIRCRAFT)[0] == pytest.approx(value, rel=1e-12)


def test_the_library_has_every_product_to_third_order():
    """Of k quantities (k + 3 choose 3) - 1 products; of separated flow the product with at most two of the others."""
    found = terms(separated=False)
    products = [t for t in found.values() if all(f.cost == 1 for f in t.factors)]
    longitudinal = {"alpha", "qhat", "elevator", "CT"}
    own = [t for t in products if {f.name for f in t.factors} <= longitudinal]
    assert len(own) == 34
    flown = [t for t in terms().values() if {f.name for f in t.factors} <= {*longitudinal, "(1 - X)"}]
    assert len([t for t in flown if "(1 - X)" in t.name]) == 1 + 4 + 10
    assert "mach" not in found


def test_terms_keep_the_symmetry_of_the_aircraft():
    """Seen in a mirror CL, CD and Cm stay the same, and CY, Cl and Cn change sign: so does every term of theirs."""
    mirror = {name: -x if name in ("beta", "p", "r", "aileron", "rudder") else x for name, x in SIGNALS.items()}
    for lateral in (False, True):
        for name, term in terms(lateral=lateral).items():
            there, here = term.evaluate(mirror, AIRCRAFT), term.evaluate(SIGNALS, AIRCRAFT)
            assert there == pytest.approx(-here if lateral else here, abs=1e-12), name
    assert "alpha" in terms()
    assert {"beta", "alpha beta"} <= set(terms(lateral=True))
    assert any(name.startswith("sign(beta) max(|beta| - ") for name in terms(lateral=True))


@pytest.mark.parametrize(("noise", "lowest"), [(0.0, 0.005), (0.01, 0.03)])
def test_no_break_of_a_lateral_quantity_lies_within_its_noise(noise, lowest):
    """Near zero noise decides the sign of beta: what that takes off the slope there looks like a dead band."""
    beta = SIGNALS["beta"] + noise * np.random.default_rng(1).standard_normal(N)
    found = library({**SIGNALS, "beta": beta}, AIRCRAFT, lambda n: n in SIGNALS, lateral=True, separated=True)
    named = [t.name for t in found if t.name.startswith("sign(beta) max(|beta| - ")]
    places = [float(name.split(" - ")[1].split(",")[0]) for name in named]
    assert places
    assert min(places) == pytest.approx(lowest, rel=0.4)


def test_breaks_and_bumps_lie_where_it_was_flown():
    found = terms()
    at_half = found["max(alpha - 0.15, 0)"]
    assert at_half.evaluate(SIGNALS, AIRCRAFT) == pytest.approx(np.maximum(SIGNALS["alpha"] - 0.15, 0.0), abs=1e-12)
    bump = found["exp(-((alpha - 0.15)/0.0192)^2/2)"]
    assert bump.evaluate(SIGNALS, AIRCRAFT).max() == pytest.approx(1.0, abs=1e-3)


def test_memory_is_a_lag_that_begins_anew_in_every_manoeuvre():
    """A step passes as 1 - exp(-t V/(T c)), sampled at the end of each interval."""
    step = np.where(np.arange(N) % 50 < 10, 0.0, 1.0)
    lagged = terms()["lag(elevator, 15 c/V)"].evaluate(SIGNALS | {"elevator": step}, AIRCRAFT)
    t = np.maximum(np.arange(50) - 9, 0) * 0.05
    assert lagged == pytest.approx(np.tile(1.0 - np.exp(-t * 60.0 / (15.0 * 3.0)), 2), abs=1e-12)
    assert terms()["lag(elevator, 15 c/V)"].code is None


FOUND = FoundTerm(
    "Cm", product("alpha", "qhat", "(1 - X)"), (-12.0, 0.5), 0.4, 55.0, 0.7, ((product("alpha", "qhat"), 0.3),), 0.5
)
MEMORY = replace(FOUND, term=terms()["lag(alpha, 5 c/V)"])


def test_an_effect_file_states_what_the_library_evaluates(tmp_path):
    both = terms() | terms(lateral=True)
    stated = [t for t in both.values() if t.code is not None]
    path = tmp_path / "found.py"
    path.write_text(effect_file([replace(FOUND, term=t) for t in stated], ["run1"]), encoding="utf-8")
    effects = own_effects([path])
    assert len(effects) == len(stated)
    for term, effect in zip(stated, effects.values(), strict=True):
        (parameter,) = effect.parameters
        added = effect.increments({parameter.name: 2.0}, SIGNALS, AIRCRAFT, {"X": SIGNALS["X"]})
        assert np.asarray(added["Cm"]) == pytest.approx(2.0 * term.evaluate(SIGNALS, AIRCRAFT), rel=1e-12)
        assert set(effect.channels) == set(term.channels)
        assert effect.sizes[parameter.name] == (0.5, 60.0)


def test_what_no_effect_file_can_state_is_not_written(tmp_path):
    path = tmp_path / "found.py"
    assert "was not written" in write_effects([MEMORY], ["run1"], path)
    assert not path.exists()


def test_a_name_of_a_record_is_no_program(tmp_path):
    path = tmp_path / "found.py"
    write_effects([FOUND], ['x"""\nraise SystemExit("run")\n"""{0}'], path)
    (effect,) = own_effects([path]).values()
    assert effect.name == "cm_alpha_qhat_separated"


def test_what_is_written_follows_the_schema():
    schema = json.loads(resources.files("bayes_aero.jobs.io.schemas").joinpath("diagnosis.schema.json").read_text())
    one = schema["properties"]["terms"] | {"$defs": schema["$defs"]}
    jsonschema.validate([term_results(FOUND), term_results(MEMORY)], one)
    assert term_results(FOUND)["ambiguous_with"] == {"alpha qhat": 0.3}


def test_a_term_is_said_with_its_factor_and_its_rivals(diagnosed):
    d = replace(diagnosed.view.diagnosis, terms=(FOUND, replace(MEMORY, others=())))
    said = [s for s in diagnosis_sentences(d) if s.startswith("Form: ")]
    assert len(said) == 3
    for told in ("Cm has a term alpha qhat (1 - X)", "40%", "+55", "from alpha qhat (30%)"):
        assert told in said[0]
    assert "depends on the past" in said[1]
    assert "No other term" in said[1]
    rows = terms_table(d).frame().reset_index().to_dict("records")
    assert (rows[0]["term"], rows[0]["size"], rows[0]["size_sd"]) == ("alpha qhat (1 - X)", -12.0, 0.5)


@pytest.mark.parametrize(("name", "said"), [("there.py", "exists"), ("effect.txt", "ends in .py")])
def test_a_file_that_is_there_or_is_no_python_is_refused_before_anything_is_done(tmp_path, name, said):
    (tmp_path / "there.py").write_text("kept = 1\n")
    done = called(tmp_path, "diagnose", "--write-effect", name, "--out", "results")
    assert done.code == 2
    assert said in done.err
    assert (tmp_path / "there.py").read_text() == "kept = 1\n"
    assert not (tmp_path / "results").exists()
