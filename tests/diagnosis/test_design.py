"""Which standard manoeuvre tells which effects apart."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from told_apart import deviations, weakest

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.design.next_test_points import candidates_of
from bayes_aero.diagnosis.design.standard import standard
from bayes_aero.diagnosis.screening.selection_state import linearised
from bayes_aero.dynamics.simulated.manoeuvres import commands
from bayes_aero.dynamics.simulated.trim import Trim, trimmed
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.model.joined_channels import join
from bayes_aero.physics.atmosphere import GRAVITY, air, altitude_of_density
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.demo import TRUTH, simulate_stall

RATES = ("alpha_dot_lift", "pitch_rate_lift")
CANDIDATES = ("thrust_scale", "mass_scale", "alpha_dot_lift", "pitch_rate_lift", "sideslip_drag", "mach_drag")


@pytest.fixture(scope="module")
def state(card, model):
    """The card's model at the truth of a simulated stall, with a few candidates."""
    base = tuple(e for e in model.effects if e.name != "separation_lag")  # fixed at neutral by the card
    candidates = tuple(CATALOGUE[name] for name in CANDIDATES)
    everything = (*base, *candidates)
    changed = {p.name: p for p in model.parameters}
    parameters = tuple(changed.get(p.name, p) for e in everything for p in e.parameters)
    whole = replace(model, effects=everything, parameters=parameters, fixed=())
    full = CandidateModel(whole, tuple(e.name for e in base), candidates, {})
    theta = np.array([TRUTH.get(p.name, p.neutral) for p in parameters])
    return linearised(full, EquationError.of(join([simulate_stall(0, card=card)], card), whole), NAMES, theta)


@pytest.fixture(scope="module")
def flights(state):
    """The manoeuvres with every candidate in the model, at neutral: one model to compile for all sets of effects."""
    return standard(state, CANDIDATES)


@pytest.fixture(scope="module")
def rates(state):
    return weakest(state, RATES, standard(state, RATES))


@pytest.mark.verify
def test_thrust_and_mass_part_only_when_thrust_moves(state, flights):
    found = weakest(state, ("thrust_scale", "mass_scale"), flights)
    gained = {name: x**2 - found["records"] ** 2 for name, x in found.items()}
    assert gained["thrust_steps"] == max(gained.values()) > 2.0 * gained["elevator_doublet"]


def test_information_grows_with_amplitude(state, rates):
    less = weakest(state, RATES, standard(state, RATES, amplitude=0.5))
    for name in ("elevator_doublet", "elevator_3211"):
        assert less[name] < rates[name]


def test_one_set_of_flights_serves_several_sets_of_effects(state, rates, flights):
    """With rivals from other sets in the model, at neutral, the manoeuvres are the same flights."""
    assert weakest(state, RATES, flights) == pytest.approx(rates, rel=1e-6)


def test_a_record_without_altitude_begins_in_air_of_its_density(state):
    flights = state.responses.flights
    channels = {name: x for name, x in flights.channels.items() if name != "altitude"}
    without = replace(flights, channels=channels)
    there = replace(state, responses=EquationError.of(without, state.responses.model))
    flown = standard(there, CANDIDATES).flown["elevator_doublet"]
    begin = float(np.mean(np.asarray(flights.channels["density"])[:50]))
    assert float(flown.channels["density"][0]) == pytest.approx(begin, rel=0.01)


@pytest.mark.parametrize("height", [0.0, 4500.0, 11000.0])
def test_altitude_of_density_is_the_inverse_of_the_standard_atmosphere(height):
    """ISO 2533:1975: 1.225 kg/m3 at sea level, 0.3639 at 11 km."""
    assert altitude_of_density(float(air(jnp.asarray(height))[0])) == pytest.approx(height, abs=1e-6)
    assert altitude_of_density(1.225) == pytest.approx(0.0, abs=0.5)
    assert altitude_of_density(0.36391) == pytest.approx(11000.0, abs=2.0)


def test_a_larger_effect_is_told_apart_in_proportion(state, rates, flights):
    least = {"CLadot": 2.0, "CLq": 2.0}
    larger = weakest(state, RATES, flights, {k: 3.0 * x for k, x in least.items()})
    assert max(larger.values()) == pytest.approx(3.0 * max(rates.values()), rel=1e-6)


def test_sideslip_needs_a_sideslip(state, flights):
    found = deviations(state, ("sideslip_drag", "mach_drag"), flights)
    assert max(found, key=lambda name: found[name]["sideslip_drag", "mach_drag"]) == "sideslip"


def test_no_manoeuvre_is_proposed_whose_input_is_not_recorded(state):
    flights = state.responses.flights
    blind = replace(flights, channels={n: x for n, x in flights.channels.items() if n not in ("stabilizer", "beta")})
    flown = standard(replace(state, responses=replace(state.responses, flights=blind)), CANDIDATES)
    assert flown.refused["stabilizer_steps"] == "stabilizer was not recorded"
    assert flown.refused["sideslip"] == "beta was not recorded"
    assert {"bank_to_bank", "thrust_steps"} <= set(flown.flown)
    assert not {"stabilizer_steps", "sideslip"} & set(flown.flown)


def test_trim_is_level_flight(state):
    model, aircraft = state.full.model, state.responses.flights.aircraft
    values = dict(zip(model.names, map(float, state.theta), strict=True))
    trim = trimmed(model, values, aircraft, 95.0, 5200.0)
    CL = aircraft.mass * GRAVITY / (0.5 * 0.7198 * 95.0**2 * aircraft.wing_area)  # density of the ICAO table
    assert trim.alpha == pytest.approx((CL - TRUTH["CL0"]) / (TRUTH["CLa"] + 0.297 * TRUTH["CLaM"]), abs=0.01)
    assert 5e3 < trim.thrust < 4e4


def test_commands_begin_at_trim_and_scale():
    time = np.arange(-5.0, 60.02, 0.04)
    trim = Trim(0.1, 2e4, -0.02)

    def departures(amplitude):
        pilots = commands(time, trim, 0.15, 0.9, amplitude)
        beside = ("excitation", "phi", "beta", "stabilizer")
        return {
            name: [pilot.alpha - 0.1, pilot.thrust / 2e4 - 1.0, *(getattr(pilot, x) for x in beside)]
            for name, pilot in pilots.items()
        }

    whole, half = departures(1.0), departures(0.5)
    for name, moving in whole.items():
        assert max(np.abs(x).max() for x in moving) > 0.0, name
        for x, y in zip(moving, half[name], strict=True):
            assert x[0] == 0.0
            assert np.allclose(0.5 * x, y)


def test_one_effect_is_no_ambiguity(state):
    with pytest.raises(InputError, match="at least two"):
        candidates_of(state, ("thrust_scale",))


def test_an_effect_that_is_no_candidate_is_named(state):
    with pytest.raises(InputError, match="buffet"):
        candidates_of(state, ("thrust_scale", "buffet"))
