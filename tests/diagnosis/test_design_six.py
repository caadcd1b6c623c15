"""Which standard manoeuvre tells which lateral effects apart: flown in six degrees of freedom."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import six_axes as six
import stranger_six
from stranger_six import Plane
from told_apart import deviations, weakest

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.design.standard import standard
from bayes_aero.diagnosis.screening.selection_state import linearised
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.residuals.equation_error import EquationError

CANDIDATES = (
    "thrust_asymmetry", "lateral_cg_shift", "roll_offset", "yaw_offset", "sideslip_bias", "aileron_delay",
    "aileron_scale",
)  # fmt: skip
PLANE = Plane(**six.ATTACHED)


@pytest.fixture(scope="module")
def state(tmp_path_factory):
    """The card's model at the truth of an aileron and a rudder manoeuvre, with a few candidates."""
    path = tmp_path_factory.mktemp("card") / "another.toml"
    path.write_text(six.card_text(PLANE), encoding="utf-8")
    card, rng, records = read_card(str(path)), np.random.default_rng(1), []
    for kind in ("aileron", "rudder"):
        channels = six.recorded(stranger_six.fly(PLANE, kind, rng), rng)
        channels["thrust"] = channels["thrust_left"] + channels["thrust_right"]
        time = channels.pop("time")
        records.append(FlightRecord.from_arrays(kind, time, channels, "simulated"))
    own = Model.from_card(card)
    candidates = tuple(CATALOGUE[name] for name in CANDIDATES)
    parameters = (*own.parameters, *(p for e in candidates for p in e.parameters))
    whole = replace(own, effects=(*own.effects, *candidates), parameters=parameters)
    full = CandidateModel(whole, tuple(e.name for e in own.effects), candidates, {})
    known = six.values(PLANE, whole)
    theta = np.array([float(known[name]) for name in whole.names])
    responses = EquationError.of(join(records, card), whole)
    return linearised(full, responses, responses.outputs, theta)


@pytest.fixture(scope="module")
def flights(state):
    return standard(state, CANDIDATES)


def test_every_manoeuvre_flies_by_the_equations_that_take_it_apart(flights):
    """Each record, without noise, leaves nothing of the six coefficients at the values that flew it."""
    assert {"aileron_doublet", "rudder_doublet", "sideslip", "stall_with_bank", "engine_steps"} <= set(flights.flown)
    assert flights.refused == {"stabilizer_steps": "stabilizer was not recorded"}
    at = jnp.array([flights.theta[name] for name in flights.model.names])
    for name in ("stall_with_bank", "engine_steps", "sideslip"):
        responses = EquationError.of(flights.flown[name], flights.model)
        residual, known = responses.evaluate(at)
        moved = np.ptp(np.asarray(known["measured"]), axis=0)
        assert np.all(np.abs(np.asarray(residual)[:, :6]).max(axis=0) < 0.02 * moved), name
        assert moved.min() > 0.0


def test_uneven_engines_are_held_straight_by_the_rudder(flights):
    """Yawing moment of the engines over that of the rudder, by hand, at the end of a step."""
    channels = flights.flown["engine_steps"].channels
    k = round(19.0 / 0.04)
    left, right, V = (float(channels[n][k]) for n in ("thrust_left", "thrust_right", "airspeed"))
    assert (left - right) / (left + right) == pytest.approx(0.3, rel=1e-6)
    pressure = 0.5 * float(channels["density"][k]) * V**2 * PLANE.S * PLANE.b
    Cn = (left - right) * PLANE.engine_arm / pressure
    beta, rudder, aileron, r, p = (float(channels[n][k]) for n in ("beta", "rudder", "aileron", "r", "p"))
    half = PLANE.b / (2.0 * V)
    air = PLANE.Cnbe * beta + PLANE.Cndr * rudder + PLANE.Cnda * aileron + (PLANE.Cnr * r + PLANE.Cnp * p) * half
    assert Cn + air == pytest.approx(0.0, abs=0.05 * abs(Cn))


def test_an_engine_s_share_is_told_from_an_offset_where_thrust_moves(state, flights):
    """A share of the mean thrust makes a moment that stays where thrust and airspeed stay."""
    found = weakest(state, ("thrust_asymmetry", "yaw_offset"), flights)
    assert max(found, key=lambda name: found[name]) == "thrust_steps"
    assert found["thrust_steps"] > 5.0 * found["engine_steps"]  # the sum of both engines stays


def test_a_centre_of_gravity_is_told_from_an_offset_where_lift_moves(state, flights):
    found = weakest(state, ("lateral_cg_shift", "roll_offset"), flights)
    assert max(found, key=lambda name: found[name]) in ("slow_stall", "stall_with_bank")
    assert found["elevator_doublet"] > 3.0 * found["aileron_doublet"]


def test_errors_of_the_aileron_s_sensor_need_an_aileron(state, flights):
    found = deviations(state, ("aileron_delay", "aileron_scale"), flights)
    assert max(found, key=lambda name: found[name]["aileron_delay", "aileron_scale"]) == "aileron_doublet"


def test_no_manoeuvre_is_proposed_whose_input_is_not_recorded(state):
    flights = state.responses.flights
    blind = replace(flights, channels={n: x for n, x in flights.channels.items() if n[:7] != "thrust_"})
    flown = standard(replace(state, responses=replace(state.responses, flights=blind)), ("roll_offset", "yaw_offset"))
    assert flown.refused["engine_steps"] == "thrust_left was not recorded"
    assert "rudder_doublet" in flown.flown


def test_a_card_of_the_lateral_axis_alone_is_told_what_it_lacks(state):
    model = replace(state.full.model, axes=(Axis.LATERAL,))
    with pytest.raises(InputError, match='add "longitudinal"'):
        standard(replace(state, full=replace(state.full, model=model)), CANDIDATES)
