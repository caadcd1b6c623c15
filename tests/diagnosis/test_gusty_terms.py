"""Terms that nobody listed, by what they make of the innovations of a filter in gusts: sensitivities, and a search.

The filter stands at the truth of the simulator (`gusty_flight`, which shares no code): its fit is tested elsewhere.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import six_axes as six
import stranger_six
from gusty_flight import LENGTH, NOISE, TRUTH, gusty_flight

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.screening.selection_state import linearised
from bayes_aero.diagnosis.selection.forward_selection import forward_selection
from bayes_aero.diagnosis.terms.flown import flown_forms
from bayes_aero.diagnosis.terms.library import QUANTITIES, Term
from bayes_aero.diagnosis.terms.result import FoundTerm
from bayes_aero.dynamics.filtering.innovations import filter_segments
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import segments
from bayes_aero.flight.card.card import read_card
from bayes_aero.inference.likelihood.disturbed import disturbed
from bayes_aero.jobs.catalogue.effect_file import effect_file
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.model.own_effects import own_effects
from bayes_aero.residuals.added_to_filter import AddedToFilter
from bayes_aero.residuals.filter_error import FilterError

BY_NAME = {q.name: q for q in QUANTITIES}
GUST = {"w": 1.0, "u": 1.0}
TWO = (11, 12)  # seeds of two flights
MOVED = 1e-3  # share of the sensors' deviations in a second: process noise of the states beside the gusts


@pytest.fixture(scope="module")
def card():
    return read_card("hfb320")


def filtered(card, records, known, noise):
    """Records by a filter at `known` parameters and deviations of the sensors' `noise`, as `FilterError.after` asks."""
    flights = join(records, card, FLIGHT)
    flown = disturbed(segments(flights, aircraft_dynamics(Model.from_card(card), flights)))
    theta = np.array([known.get(p.name, p.start) for p in flown.dynamics.free])
    R = np.array([noise[name] for name in flown.outputs]) ** 2
    sd = np.array([noise[name] if name in FLIGHT else 0.0 for name in flown.dynamics.states])
    found = eqx.filter_jit(filter_segments)(flown, jnp.asarray(theta), sd, MOVED * sd, R)
    return flown, theta, R, found


def followed(card, records, known, noise) -> tuple[FilterError, np.ndarray]:
    """The innovations of these, and the parameters."""
    flown, theta, *rest = filtered(card, records, known, noise)
    return FilterError.after(flown, theta, *rest, flown.dynamics), theta


def in_gusts(card, truth=None, seconds=60.0, seeds=TWO) -> tuple[FilterError, np.ndarray]:
    """The innovations of flights, at the values of the simulator without `truth`."""
    records = [gusty_flight(seed, gust=GUST, truth=truth, seconds=seconds) for seed in seeds]
    records = [replace(r, name=f"run{k}") for k, r in enumerate(records)]
    known = TRUTH | {"vertical_gust": GUST["w"], "longitudinal_gust": GUST["u"]}
    known |= {f"{name}_gust_length": LENGTH for name in ("vertical", "longitudinal")}
    return followed(card, records, known, NOISE)


@pytest.fixture(scope="module")
def short(card):
    return in_gusts(card, seconds=15.0, seeds=TWO[:1])


def test_a_term_that_the_card_has_is_foreseen_as_its_parameter(short):
    """Cm += Cmde elevator: the recorded elevator is linear between samples, as the integration takes it."""
    responses, theta = short
    (slope,) = AddedToFilter(responses, theta).slopes("Cm", lambda signals: signals["elevator"][None])
    known = responses.linearise(theta, np.array([responses.model.names.index("Cmde")]))[1][:, :, 0]
    np.testing.assert_allclose(slope, known, atol=1e-8 * np.abs(known).max())  # the card's tail arm is 1e9 m


@pytest.mark.verify
def test_a_term_of_six_degrees_of_freedom_is_foreseen_as_its_parameter(tmp_path):
    """Cn += Cndr rudder; compilation takes most of a minute."""
    plane, rng = stranger_six.Plane(**six.ATTACHED), np.random.default_rng(3)
    (tmp_path / "plane.toml").write_text(six.card_text(plane), encoding="utf-8")
    card = read_card(str(tmp_path / "plane.toml"))
    records = [six.record("rudder", stranger_six.fly(plane, "rudder", rng, seconds=5.0), rng)]
    known = {p.name: getattr(plane, p.name) for p in Model.from_card(card).free}
    responses, theta = followed(card, records, known, defaultdict(lambda: 0.01))
    (slope,) = AddedToFilter(responses, theta).slopes("Cn", lambda signals: signals["rudder"][None])
    at = np.array([responses.model.names.index("Cndr")])
    wanted = responses.linearise(theta, at)[1][:, :, 0]
    np.testing.assert_allclose(slope, wanted, atol=1e-9 * np.abs(wanted).max())


MORE = (
    "sideslip_scale",
    "bank_angle_bias",
    "sideslip_vane_position",
    "rudder_roll",
    "sideslip_incidence",
    "wing_lift_difference",
)


def test_innovations_of_six_degrees_of_freedom_change_as_their_sensitivities_say(tmp_path):
    """Of effects that the filter's model lacks, one of which parts its separation point in two; central differences.

    The states of the filter are angles of attitude. Effects at neutral leave its innovations.
    """
    plane, rng = stranger_six.Plane(tau1=20.0), np.random.default_rng(3)
    effects = [n for n in (*six.LONGITUDINAL, *six.LATERAL, *six.STALL) if n not in MORE]
    (tmp_path / "plane.toml").write_text(six.card_text(plane, effects), encoding="utf-8")
    card = read_card(str(tmp_path / "plane.toml"))
    flight = stranger_six.fly(plane, "stall_in_bank", rng, gust=0.7)
    records = [six.record("stall", {name: x[-100:] for name, x in flight.items()}, rng)]
    known = {p.name: getattr(plane, p.name) for p in Model.from_card(card).free}
    flown, theta, *rest = filtered(card, records, known, defaultdict(lambda: 0.01, altitude=1.0, airspeed=0.1))
    dynamics = flown.dynamics
    own = FilterError.after(flown, theta, *rest, dynamics)
    assert dynamics.states[6:9] == ("phi", "theta", "psi")
    model = own.model.extended(*MORE)
    simulated = aircraft_dynamics(model, own.flights)  # its states are a quaternion, and two separation points
    wider = FilterError.after(flown, theta, *rest, simulated)
    assert wider.windows.dynamics.states == (*dynamics.states[:-1], "X_right", "X_left")
    at = dict(zip(own.model.names, theta, strict=True))
    wide = np.array([at.get(p.name, p.neutral) for p in model.free])
    residual = lambda x: np.asarray(wider.evaluate(x)[0])
    np.testing.assert_allclose(residual(wide), np.asarray(own.evaluate(theta)[0]), atol=1e-9)
    sought = [model.names.index(name) for name in ("Cnbe", *(p.name for p in model.free if p.name not in at))]
    slopes = wider.linearise(wide, np.array(sought))[1]
    for slope, place in zip(np.moveaxis(slopes, -1, 0), sought, strict=True):
        size = np.abs(slope).max()
        assert size > 1e-6, model.names[place]
        step = 1e-4 / size * np.eye(len(wide))[place]  # the altitude, of thousands of metres, is rounded
        difference = (residual(wide - step) - residual(wide + step)) / 2e-4 * size
        np.testing.assert_allclose(slope, difference, atol=1e-5 * size, err_msg=model.names[place])


def test_parts_of_the_jackknife_lie_within_a_manoeuvre_and_have_some_seconds(short):
    responses, _ = short
    parts, manoeuvre = responses.jackknife_blocks, responses.manoeuvre
    assert set(np.bincount(parts) * responses.seconds) == {5.0}
    assert len(set(zip(parts.tolist(), manoeuvre.tolist(), strict=True))) == parts.max() + 1 == 3


def test_a_term_changes_innovations_as_the_effect_that_a_file_states(short, tmp_path):
    """Central differences of innovations with the effect, the gains held; between samples alpha elevator is linear."""
    responses, theta = short
    term = Term((BY_NAME["alpha"], BY_NAME["elevator"]))
    path, step = tmp_path / "found.py", 1e-3
    path.write_text(effect_file([FoundTerm("Cm", term, (1.0, 0.1), 0.5, 9.0, 1.0, (), 0.1)], ["run"]), encoding="utf-8")
    model = responses.model.extended(*own_effects([path]).values())
    windows = replace(responses.windows, dynamics=replace(responses.windows.dynamics, model=model))
    wider = replace(responses, windows=windows, model=model)
    aircraft = responses.flights.aircraft
    (slope,) = AddedToFilter(responses, theta).slopes("Cm", lambda signals: term.evaluate(signals, aircraft)[None])
    at = model.names.index(own_effects([path]).popitem()[1].parameters[0].name)

    def residual(size):
        return np.asarray(wider.evaluate(np.insert(theta, at, size))[0])

    known = (residual(-step) - residual(step)) / (2.0 * step)
    np.testing.assert_allclose(slope, known, atol=5e-4 * np.abs(known).max())


def test_the_least_share_of_a_single_sample_is_a_fifth_of_that_of_a_mean_over_five(short):
    """A constant in white noise: the share of the variance that it takes, by numpy."""
    responses, theta = short
    full = CandidateModel(responses.model, tuple(e.name for e in responses.model.effects), (), {})
    state = linearised(full, responses, responses.outputs, theta)
    x = 0.02 + np.random.default_rng(3).standard_normal((20_000, 5))
    single, mean = (0.02**2 / np.mean(np.square(part)) for part in (x, x.mean(axis=1)))
    assert state.least_share(mean) == pytest.approx(single, rel=0.03)


def searched(card, truth):
    """What the library finds in two flights in gusts, no catalogue beside it."""
    responses, theta = in_gusts(card, truth)
    model = responses.model
    full = CandidateModel(model, tuple(e.name for e in model.effects), (), {})
    state = linearised(full, responses, responses.outputs, theta)
    return flown_forms(forward_selection(state, seed=1), seed=2)


def test_a_hidden_term_is_found_in_gusts_and_its_silent_twin_has_none(card):
    size = -0.7
    found = searched(card, {"Cma2": size})
    (term,) = found.forms.terms
    assert (term.coefficient, term.term.name) == ("Cm", "alpha^2")
    assert abs(term.size[0] - size) < 1.96 * term.size[1]
    assert [(u.coefficient, u.channel) for u in found.unknown] == [("Cm", "alpha^2")]
    assert searched(card, {}).forms.terms == ()
