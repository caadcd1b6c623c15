"""Terms that nobody listed, by what they make of a simulated flight: their sensitivities, and a search for one."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import six_axes as six
import stranger_six
from gusty_flight import TRUTH, gusty_flight

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.screening.selection_state import linearised
from bayes_aero.diagnosis.selection.forward_selection import forward_selection
from bayes_aero.diagnosis.terms.flown import flown_forms
from bayes_aero.diagnosis.terms.library import QUANTITIES, Term
from bayes_aero.diagnosis.terms.result import FoundTerm
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.catalogue.effect_file import effect_file
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.model.own_effects import own_effects
from bayes_aero.residuals.added_coefficients import AddedCoefficients
from bayes_aero.residuals.output_error import OutputError

BY_NAME = {q.name: q for q in QUANTITIES}
STILL = {"w": 0.0, "u": 0.0}
TWO = (11, 12)  # seeds of two flights


@pytest.fixture(scope="module")
def card():
    return read_card("hfb320")


def without_accelerometers(record: FlightRecord) -> FlightRecord:
    kept = {name: x for name, x in record.channels.items() if name not in ("ax", "az")}
    return FlightRecord.from_arrays(record.name, record.time, kept)


def flown(card, model, records) -> tuple[OutputError, np.ndarray]:
    flights = join([without_accelerometers(r) for r in records], card, FLIGHT)
    responses = OutputError.of(flights, aircraft_dynamics(model, flights))
    return responses, np.array([TRUTH.get(p.name, p.start) for p in model.free])


def test_a_term_that_the_card_has_flies_as_its_parameter(card):
    """Cm += Cmde elevator: the recorded elevator is linear between samples, as the integration takes it."""
    responses, theta = flown(card, Model.from_card(card), [gusty_flight(5, seconds=20.0)])
    added = AddedCoefficients(responses, theta)
    (slope,) = added.slopes("Cm", lambda signals: signals["elevator"][None])
    at = np.array([responses.model.names.index("Cmde")])
    known = responses.linearise(theta, at)[1][:, :, 0]
    np.testing.assert_allclose(slope, known, atol=1e-9 * np.abs(known).max())


@pytest.mark.verify
def test_a_term_of_six_degrees_of_freedom_flies_as_its_parameter(tmp_path):
    """Cn += Cndr rudder; compilation takes most of a minute."""
    plane, rng = stranger_six.Plane(**six.ATTACHED), np.random.default_rng(3)
    (tmp_path / "plane.toml").write_text(six.card_text(plane), encoding="utf-8")
    card = read_card(str(tmp_path / "plane.toml"))
    flights = join([six.record("rudder", stranger_six.fly(plane, "rudder", rng, seconds=5.0), rng)], card, ())
    model = Model.from_card(card)
    responses = OutputError.of(flights, aircraft_dynamics(model, flights))
    theta = np.array([getattr(plane, p.name) for p in model.free])
    added = AddedCoefficients(responses, theta)
    (slope,) = added.slopes("Cn", lambda signals: signals["rudder"][None])
    known = responses.linearise(theta, np.array([model.names.index("Cndr")]))[1][:, :, 0]
    np.testing.assert_allclose(slope, known, atol=1e-9 * np.abs(known).max())


def test_a_term_flies_to_first_order_as_the_effect_that_a_file_states(card, tmp_path):
    """Central differences of residuals flown with the effect; between samples alpha^2 qhat is taken as linear."""
    model = Model.from_card(card)
    term = Term((BY_NAME["alpha"], BY_NAME["alpha"], BY_NAME["qhat"]))
    path, step = tmp_path / "found.py", 1e-3
    path.write_text(effect_file([FoundTerm("Cm", term, (1.0, 0.1), 0.5, 9.0, 1.0, (), 0.1)], ["run"]), encoding="utf-8")
    records = [gusty_flight(5, seconds=20.0)]
    responses, theta = flown(card, model, records)
    wider, _ = flown(card, model.extended(*own_effects([path]).values()), records)
    added = AddedCoefficients(responses, theta)
    (slope,) = added.slopes("Cm", lambda signals: term.evaluate(signals, responses.flights.aircraft)[None])
    still = jnp.zeros(len(wider.windows.dynamics.start))
    residual = eqx.filter_jit(lambda size: wider.residual(jnp.append(jnp.asarray(theta), size), still))
    known = np.asarray(residual(-step) - residual(step)) / (2.0 * step)
    np.testing.assert_allclose(slope, known, atol=1e-4 * np.abs(known).max())


def searched(card, truth):
    """What the library finds in two flights in calm air, no catalogue beside it."""
    model = Model.from_card(card)
    records = [gusty_flight(seed, gust=STILL, truth=truth) for seed in TWO]
    records = [replace(r, name=f"run{k}") for k, r in enumerate(records)]
    responses, theta = flown(card, model, records)
    full = CandidateModel(model, tuple(e.name for e in model.effects), (), {})
    state = linearised(full, responses, responses.outputs, theta)
    return flown_forms(forward_selection(state, seed=1), seed=2)


def test_a_hidden_term_is_found_in_flight_and_its_silent_twin_has_none(card):
    size = 0.15
    found = searched(card, {"Cma2": size})
    (term,) = found.forms.terms
    assert (term.coefficient, term.term.name) == ("Cm", "alpha^2")
    assert abs(term.size[0] - size) < 1.96 * term.size[1]
    assert [(u.coefficient, u.channel) for u in found.unknown] == [("Cm", "alpha^2")]
    assert searched(card, {}).forms.terms == ()
