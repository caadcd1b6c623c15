"""Which manoeuvres tell which effects apart, and which test points to fly next."""

from dataclasses import replace
from types import MappingProxyType

import jax.numpy as jnp
import numpy as np
import pytest
import six_axes as six
import stranger_six
from stranger_six import Plane

from bayes_aero.diagnosis import design
from bayes_aero.diagnosis.selection_state import ENOUGH, CandidateModel, linearised
from bayes_aero.dynamics.pilot import commands
from bayes_aero.dynamics.trim import Trim, trimmed
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.model.model import Model
from bayes_aero.model.observations import join
from bayes_aero.physics.aircraft import (
    DEFAULT_RANGES,
    GRAVITY,
    NAMES,
    Axis,
    Envelope,
    air,
    altitude_of_density,
    excursion,
)
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.demo import TRUTH


# Which standard manoeuvre tells which effects apart
def deviations(state, effects, flights, sizes=MappingProxyType({})):
    """By manoeuvre, and under "records" of the records alone: deviations of each ordered pair of effects."""
    candidates, noise = {e.name: e for e in state.full.model.effects}, design.noise_of(state)
    chosen = [candidates[name] for name in effects]
    records = design.on_record(state, chosen, noise)
    present, own = design.information_of(records, noise), design.signals_of(records, chosen, sizes)
    found = {"records": present.deviations(own)}
    for name in flights.flown:
        if name not in design.NOT_BY_HAND:
            there = design.on_record(state, chosen, noise, flights, name)
            found[name] = (present + design.information_of(there, noise)).deviations(own)
    return found


def weakest(state, effects, flights, sizes=MappingProxyType({})):
    """The same of the closest pair."""
    return {name: min(of.values()) for name, of in deviations(state, effects, flights, sizes).items()}


RATES = ("alpha_dot_lift", "pitch_rate_lift")
CANDIDATES = (*RATES, "sideslip_drag", "mach_drag")


@pytest.fixture(scope="module")
def rates(state):
    return weakest(state, RATES, design.standard(state, RATES))


def test_rates_are_told_apart_by_amplitude_and_size_whatever_else_is_in_the_model(state, rates, flights):
    less = weakest(state, RATES, design.standard(state, RATES, amplitude=0.5))
    for name in ("elevator_doublet", "elevator_3211"):
        assert less[name] < rates[name]
    # With rivals from other sets in the model, at neutral, the manoeuvres are the same flights.
    assert weakest(state, RATES, flights) == pytest.approx(rates, rel=1e-6)
    least = {"CLadot": 2.0, "CLq": 2.0}
    larger = weakest(state, RATES, flights, {k: 3.0 * x for k, x in least.items()})
    assert max(larger.values()) == pytest.approx(3.0 * max(rates.values()), rel=1e-6)


def test_records_without_altitude_or_inputs(state):
    flights = state.responses.flights
    without = replace(flights, channels={n: x for n, x in flights.channels.items() if n != "altitude"})
    there = replace(state, responses=EquationError.of(without, state.responses.model))
    flown = design.standard(there, CANDIDATES).flown["elevator_doublet"]
    begin = float(np.mean(np.asarray(flights.channels["density"])[:50]))
    assert float(flown.channels["density"][0]) == pytest.approx(begin, rel=0.01)
    blind = replace(flights, channels={n: x for n, x in flights.channels.items() if n not in ("stabilizer", "beta")})
    flown = design.standard(replace(state, responses=replace(state.responses, flights=blind)), CANDIDATES)
    assert flown.refused["stabilizer_steps"] == "stabilizer was not recorded"
    assert flown.refused["sideslip"] == "beta was not recorded"
    assert {"bank_to_bank", "thrust_steps"} <= set(flown.flown)
    assert not {"stabilizer_steps", "sideslip"} & set(flown.flown)


@pytest.mark.parametrize("height", [0.0, 4500.0, 11000.0])
def test_altitude_of_density_is_the_inverse_of_the_standard_atmosphere(height):
    """ISO 2533:1975: 1.225 kg/m3 at sea level, 0.3639 at 11 km."""
    assert altitude_of_density(float(air(jnp.asarray(height))[0])) == pytest.approx(height, abs=1e-6)
    assert altitude_of_density(1.225) == pytest.approx(0.0, abs=0.5)
    assert altitude_of_density(0.36391) == pytest.approx(11000.0, abs=2.0)


def test_sideslip_needs_a_sideslip(state, flights):
    found = deviations(state, ("sideslip_drag", "mach_drag"), flights)
    assert max(found, key=lambda name: found[name]["sideslip_drag", "mach_drag"]) == "sideslip"


def test_trim_is_level_flight_and_commands_begin_there(state):
    model, aircraft = state.full.model, state.responses.flights.aircraft
    values = dict(zip(model.names, map(float, state.theta), strict=True))
    trim = trimmed(model, values, aircraft, 95.0, 5200.0)
    CL = aircraft.mass * GRAVITY / (0.5 * 0.7198 * 95.0**2 * aircraft.wing_area)  # density of the ICAO table
    assert trim.alpha == pytest.approx((CL - TRUTH["CL0"]) / (TRUTH["CLa"] + 0.297 * TRUTH["CLaM"]), abs=0.01)
    assert 5e3 < trim.thrust < 4e4
    time = np.arange(-5.0, 60.02, 0.04)
    trim = Trim(0.1, 2e4, -0.02)

    def departures(amplitude):
        pilots = commands(time, trim, 0.15, 0.9, amplitude)
        beside = ("excitation", "phi", "beta", "stabilizer")
        return {
            name: [pilot.alpha - 0.1, pilot.thrust / 2e4 - 1.0, *(np.atleast_1d(getattr(pilot, x)) for x in beside)]
            for name, pilot in pilots.items()
        }

    whole, half = departures(1.0), departures(0.5)
    for name, moving in whole.items():
        assert max(np.abs(x).max() for x in moving) > 0.0, name
        for x, y in zip(moving, half[name], strict=True):
            assert x[0] == 0.0
            assert np.allclose(0.5 * x, y)


# Which standard manoeuvre tells which lateral effects apart: flown in six degrees of freedom
CANDIDATES_SIX = (
    "thrust_asymmetry", "lateral_cg_shift", "roll_offset", "yaw_offset", "aileron_delay", "aileron_scale",
)  # fmt: skip
PLANE = Plane(**six.ATTACHED)


@pytest.fixture(scope="module")
def state_six(tmp_path_factory):
    """The card's model at the truth of an aileron and a rudder manoeuvre, with a few candidates."""
    card, rng = six.card_in(tmp_path_factory.mktemp("card"), PLANE), np.random.default_rng(1)
    records = [six.record(kind, stranger_six.fly(PLANE, kind, rng), rng) for kind in ("aileron", "rudder")]
    own = Model.from_card(card)
    candidates = tuple(CATALOGUE[name] for name in CANDIDATES_SIX)
    parameters = (*own.parameters, *(p for e in candidates for p in e.parameters))
    whole = replace(own, effects=(*own.effects, *candidates), parameters=parameters)
    full = CandidateModel(whole, tuple(e.name for e in own.effects), candidates, {})
    theta = np.array([getattr(PLANE, p.name, p.neutral) for p in whole.free])
    responses = EquationError.of(join(records, card), whole)
    return linearised(full, responses, responses.outputs, theta)


@pytest.fixture(scope="module")
def flights_six(state_six):
    return design.standard(state_six, CANDIDATES_SIX)


def test_every_manoeuvre_flies_by_the_equations_that_take_it_apart(flights_six):
    """Each record, without noise, leaves nothing of the six coefficients at the values that flew it."""
    assert {"aileron_doublet", "rudder_doublet", "sideslip", "stall_with_bank", "engine_steps"} <= set(
        flights_six.flown
    )
    assert flights_six.refused == {"stabilizer_steps": "stabilizer was not recorded"}
    at = jnp.array([flights_six.theta[name] for name in flights_six.model.names])
    for name in ("stall_with_bank", "engine_steps", "sideslip"):
        responses = EquationError.of(flights_six.flown[name], flights_six.model)
        residual, known = responses.evaluate(at)
        moved = np.ptp(np.asarray(known["measured"]), axis=0)
        assert np.all(np.abs(np.asarray(residual)[:, :6]).max(axis=0) < 0.02 * moved), name
        assert moved.min() > 0.0
    # Yawing moment of the engines over that of the rudder, by hand, at the end of a step.
    channels = flights_six.flown["engine_steps"].channels
    k = round(19.0 / 0.04)
    left, right, V = (float(channels[n][k]) for n in ("thrust_left", "thrust_right", "airspeed"))
    assert (left - right) / (left + right) == pytest.approx(0.3, rel=1e-6)
    pressure = 0.5 * float(channels["density"][k]) * V**2 * PLANE.S * PLANE.b
    Cn = (left - right) * PLANE.engine_arm / pressure
    beta, rudder, aileron, r, p = (float(channels[n][k]) for n in ("beta", "rudder", "aileron", "r", "p"))
    half = PLANE.b / (2.0 * V)
    air = PLANE.Cnbe * beta + PLANE.Cndr * rudder + PLANE.Cnda * aileron + (PLANE.Cnr * r + PLANE.Cnp * p) * half
    assert Cn + air == pytest.approx(0.0, abs=0.05 * abs(Cn))


def test_lateral_effects_are_told_apart_where_their_input_moves(state_six, flights_six):
    """A share of the mean thrust makes a moment that stays where thrust and airspeed stay."""
    found = weakest(state_six, ("thrust_asymmetry", "yaw_offset"), flights_six)
    assert max(found, key=lambda name: found[name]) == "thrust_steps"
    assert found["thrust_steps"] > 5.0 * found["engine_steps"]  # the sum of both engines stays
    found = weakest(state_six, ("lateral_cg_shift", "roll_offset"), flights_six)
    assert max(found, key=lambda name: found[name]) in ("slow_stall", "stall_with_bank")
    assert found["elevator_doublet"] > 3.0 * found["aileron_doublet"]
    found = deviations(state_six, ("aileron_delay", "aileron_scale"), flights_six)
    assert max(found, key=lambda name: found[name]["aileron_delay", "aileron_scale"]) == "aileron_doublet"


def test_six_degrees_of_freedom_need_their_inputs_and_both_axes(state_six):
    flights_six = state_six.responses.flights
    blind = replace(flights_six, channels={n: x for n, x in flights_six.channels.items() if n[:7] != "thrust_"})
    flown = design.standard(
        replace(state_six, responses=replace(state_six.responses, flights=blind)), ("roll_offset", "yaw_offset")
    )
    assert flown.refused["engine_steps"] == "thrust_left was not recorded"
    assert "rudder_doublet" in flown.flown
    model = replace(state_six.full.model, axes=(Axis.LATERAL,))
    with pytest.raises(InputError, match='add "longitudinal"'):
        design.standard(replace(state_six, full=replace(state_six.full, model=model)), CANDIDATES_SIX)


# Information of records adds up and follows closed forms; test points decide most a second, inside the envelope
RATE_SET, DRAGS = frozenset(RATES), frozenset(CANDIDATES[2:])
SETS = {RATE_SET: {"CLq": 3.5, "CLadot": 3.5}, DRAGS: {}}


def test_two_columns_in_white_noise_differ_by_the_textbook_s_deviations():
    """What is left of a signal after regression on another, over the noise; by numpy's least squares."""
    rng, sigma = np.random.default_rng(4), 0.3
    X = rng.standard_normal((200, 3)) @ np.array([[1.0, 0.6, 0.0], [0.0, 0.8, 0.5], [0.0, 0.0, 1.0]])
    told = design.Information(("one", "other", "base"), X.T @ X / sigma**2, X.T @ X / sigma**2, np.zeros(3))
    found = told.deviations({"one": {"one": 2.0}, "other": {"other": 0.5}})
    for (a, b), size, (column, rest) in zip(found, (2.0, 0.5), ((0, [1, 2]), (1, [0, 2])), strict=True):
        left = np.linalg.lstsq(X[:, rest], X[:, column], rcond=None)[1][0]
        assert found[a, b] == pytest.approx(size * np.sqrt(left) / sigma, rel=1e-10)
    twice = told + told
    assert twice.deviations({"one": {"one": 2.0}, "other": {"other": 0.5}})["one", "other"] == pytest.approx(
        np.sqrt(2.0) * found["one", "other"], rel=1e-10
    )


def test_information_of_two_records_is_the_sum_of_each_after_its_own_offsets(state):
    """An offset of a flight-path output takes the mean out of each manoeuvre; coefficients have none."""
    noise, effects = design.noise_of(state), [CATALOGUE[name] for name in CANDIDATES]
    theta = dict(zip(state.full.model.names, map(float, state.theta), strict=True))
    again = design.Standard(state.full.model, theta, {"again": state.responses.flights}, {}, {}, {}, 80.0, 0.0, 1.0)
    flown = design.on_record(state, effects, noise, again, "again")
    told, manoeuvre = design.information_of(flown, noise), flown.responses.manoeuvre
    at = [flown.full.model.names.index(label) for label in told.labels]
    expected = np.zeros_like(told.matrix)
    for part in (0, 1):
        for c, name in enumerate(flown.outputs):
            S = flown.scaled[manoeuvre == part][:, c, at]
            S = S if name in NAMES else S - S.mean(axis=0)
            expected += S.T @ S / noise.variance[c]
    np.testing.assert_allclose(told.matrix, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())
    present = design.information_of(design.on_record(state, effects, noise), noise)  # what the state knows already
    assert present.labels == told.labels
    np.testing.assert_allclose(present.matrix, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())
    first = design.information_of(flown, noise, float(np.sum(manoeuvre == 0)) * flown.responses.seconds)
    assert np.all(np.diag(first.matrix) <= np.diag(told.matrix) * (1.0 + 1e-9))


def test_points_decide_what_the_records_leave_open_inside_the_envelope(state):
    chosen = design.next_test_points(state, SETS, Envelope())
    assert {frozenset(q.effects) for q in chosen.questions} == {RATE_SET, DRAGS}
    place = [frozenset(q.effects) for q in chosen.questions].index(DRAGS)
    assert chosen.present[place] == 0.0  # no record has sideslip
    assert chosen.points[0].manoeuvre == "sideslip"
    previous = chosen.present
    for point in chosen.points:
        assert all(b >= a - 1e-9 for a, b in zip(previous, point.expected, strict=True))
        previous = point.expected
    assert chosen.points[-1].expected[place] >= ENOUGH
    assert "computer" in chosen.refused["multisine"]
    found = design.next_test_points(state, {RATE_SET: SETS[RATE_SET]}, Envelope(programmed_inputs=True))
    assert "multisine" not in found.refused
    quiet = {"load_factor": (0.85, 1.25), "altitude_loss": (-np.inf, 200.0)}
    allowed = Envelope(DEFAULT_RANGES | quiet, tuple(quiet))
    found = design.next_test_points(state, SETS, allowed)
    assert found.points
    assert any(allowed.left_by(p.excursion) for p in chosen.points)  # another choice without it
    for point in found.points:
        assert allowed.left_by(point.excursion) is None
        assert point.excursion["load_factor"][1] <= 1.25


def test_excursions_of_a_level_turn():
    """n = 1/cos phi."""
    phi = np.full(50, 0.6)
    flight = {"phi": phi, "az": -GRAVITY / np.cos(phi), "altitude": np.linspace(1000.0, 940.0, 50)}
    found = excursion(flight)
    assert found["load_factor"] == pytest.approx((1.0 / np.cos(0.6),) * 2)
    assert found["altitude_loss"] == pytest.approx((0.0, 60.0))
