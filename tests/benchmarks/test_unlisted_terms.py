"""A term that is in no catalogue, hidden in simulated stalls: its form, its size, and a card that has it."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources

import jsonschema
import numpy as np
import pytest
import unlisted_terms

from bayes_aero.diagnosis import candidate_set
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import Verdict
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card.card import read_card
from bayes_aero.jobs.catalogue.effect_file import write_effects
from bayes_aero.jobs.diagnose import diagnose_records
from bayes_aero.jobs.options import DiagnoseOptions
from bayes_aero.model.own_effects import own_effects
from bayes_aero.simulate.injection import Beyond, hidden_records

SEED = 107


def flown(values):
    beyond = Beyond((unlisted_terms.UNLISTED,), lambda _: values)
    return hidden_records({}, seed=SEED, noise="ar1", seconds=90.0, beyond=beyond)


@pytest.mark.verify
def test_a_hidden_term_is_found_written_and_then_named_as_a_cause(tmp_path):
    coefficient, name, values = unlisted_terms.draw(np.random.default_rng([SEED, 31]))
    true, records, card = values["unlisted_product"], flown(values), read_card("attas")
    found = diagnose(records, card, seed=SEED)
    assert found.failures == ()
    assert found.verdict is Verdict.UNEXPLAINED
    (term,) = found.terms
    assert (term.coefficient, term.term.name) == (coefficient, name)
    mean, sd = term.size
    assert abs(mean - true) < 1.96 * sd
    assert sd < 0.1 * abs(true)

    path = tmp_path / "found.py"
    write_effects(found.terms, [r.name for r in records], path)
    again = diagnose(records, replace(card, effect_files=(path,)), seed=SEED, gains_wanted=False)
    assert again.verdict is Verdict.EXPLAINED
    (cause,) = again.causes
    ((size,),) = [list(cause.parameters.values())]
    assert abs(size.mean - true) < 1.96 * size.sd


@pytest.mark.verify
def test_the_same_flights_without_it_get_no_term():
    found = diagnose(flown({}), read_card("attas"), seed=SEED)
    assert found.verdict is Verdict.NO_EFFECT
    assert found.terms == ()


@pytest.mark.verify
def test_without_accelerometers_a_bump_is_found_in_flight_and_written(tmp_path, monkeypatch):
    """Of few effects, which compile sooner. The bump of Cm over alpha has a width of 0.03 rad."""
    few = ("thrust_moment", "pitch_rate_lift", "mach_drag", "alpha_bias")
    monkeypatch.setattr(candidate_set, "CATALOGUE", {name: CATALOGUE[name] for name in few})
    rng = np.random.default_rng([501, 31])
    noise, (coefficient, name, values) = str(rng.choice(["white", "ar1", "buffet"])), unlisted_terms.draw(rng)
    assert (noise, coefficient, name) == ("white", "Cm", "exp")
    beyond = Beyond((unlisted_terms.UNLISTED,), lambda _: values)
    flown = hidden_records({}, seed=501, noise=noise, seconds=90.0, beyond=beyond)
    records = [unlisted_terms.without_accelerometers(r) for r in flown]
    told = diagnose_records(records, read_card("attas"), DiagnoseOptions(), out=tmp_path)
    content = json.loads((tmp_path / "diagnosis.json").read_text())
    schema = resources.files("bayes_aero.jobs.io.schemas").joinpath("diagnosis.schema.json")
    jsonschema.validate(content, json.loads(schema.read_text()))
    assert content["failures"] == []
    assert content["verdict"] == "unexplained"
    assert content["tested"]["rests_on"] == "trajectories"
    assert "exp(" in content["terms"][0]["term"]
    assert (tmp_path / "terms.csv").read_text().count("\n") == 1 + len(content["terms"])
    assert (tmp_path / "report.html").stat().st_size > 10_000
    path = tmp_path / "found.py"
    assert "effect" in write_effects(told.diagnosis.terms, ["run"], path)
    assert len(own_effects([path])) == len(content["terms"])


@pytest.mark.verify
def test_in_gusts_a_product_is_found_and_weighed(tmp_path, monkeypatch):
    """Of few effects, which compile sooner; gusts of 1 m/s."""
    few = ("thrust_moment", "pitch_rate_lift", "mach_drag", "alpha_bias", "vertical_gust", "longitudinal_gust")
    monkeypatch.setattr(candidate_set, "CATALOGUE", {name: CATALOGUE[name] for name in few})
    (coefficient, name, values), records = unlisted_terms.in_gusts(3001, False, 1.0)
    options = DiagnoseOptions(process_noise=True, trajectories=False)
    told = diagnose_records(records, read_card("hfb320"), options, out=tmp_path).diagnosis
    assert told.failures == ()
    assert told.verdict is Verdict.UNEXPLAINED
    (term,) = told.terms
    assert (term.coefficient, term.term.name) == (coefficient, name)
    assert abs(term.size[0] - values["unlisted_product"]) < 1.96 * term.size[1]
    content = json.loads((tmp_path / "diagnosis.json").read_text())
    schema = resources.files("bayes_aero.jobs.io.schemas").joinpath("diagnosis.schema.json")
    jsonschema.validate(content, json.loads(schema.read_text()))
    assert [u["coefficient"] for u in content["unexplained"]] == [coefficient]
    path = tmp_path / "found.py"
    write_effects(told.terms, ["run1", "run2"], path)
    assert len(own_effects([path])) == 1


@pytest.mark.recovery
def test_a_flight_that_breaks_down_after_its_record_leaves_the_record_whole():
    """Simulations are longer than what is kept; filters had spread what was no number there over all channels."""
    rng = np.random.default_rng([703, 31])
    rng.choice(3)  # of the noise
    for _ in range(20):
        coefficient, name, values = unlisted_terms.draw(rng)
        if "unlisted_product" in values:
            break
    assert (coefficient, name) == ("CL", "elevator CT^2")
    beyond = Beyond((unlisted_terms.UNLISTED,), lambda _: values)
    for record in hidden_records({}, seed=703, noise="ar1", seconds=90.0, beyond=beyond):
        assert all(np.all(np.isfinite(x)) for x in record.channels.values())
