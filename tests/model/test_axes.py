"""Models of one axis, of both, and of two wings."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expit

from bayes_aero.diagnosis.selection_state import CandidateModel, candidate_model
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import CardParameter
from bayes_aero.model.model import Model
from bayes_aero.parameter import Prior
from bayes_aero.physics.aircraft import LATERAL, NAMES, Axis
from bayes_aero.simulate.demo import TRUTH

# Which effects a model of one axis has, proposes and computes, and in which reference lengths its defaults stand
BOTH = tuple(Axis)
NO_CANDIDATES = {  # of those that act in pitch: forms that stand for others, random air, what nothing else shows
    "alpha_drag", "speed_lift", "speed_drag", "speed_moment", "stabilizer_lift", "stabilizer_drag", "buffet",
    "vertical_gust", "longitudinal_gust", "heading_delay", "pitot_position",
}  # fmt: skip


def candidates(card, everything, axes) -> CandidateModel:
    """Those of a card's effects that act on `axes`."""
    names = [name for name in card.effects if CATALOGUE[name].acts_on(axes)]
    fixed = {k: v for k, v in card.fixed.items() if k in {p.name for n in names for p in CATALOGUE[n].parameters}}
    return candidate_model(Model.of(names, fixed, axes), everything)


def test_cards_of_each_axis_have_its_candidates_and_no_others(card, everything):
    pitch = candidates(card, everything, (Axis.LONGITUDINAL,))
    names = {e.name for e in pitch.candidates}
    acting = {name for name, effect in CATALOGUE.items() if effect.acts_on((Axis.LONGITUDINAL,))}
    assert names == acting - {*card.effects} - NO_CANDIDATES | {"separation_lag"}  # held by the card
    assert names >= {"pitch_rate_bias", "thrust_moment", "alpha_dot_lift", "mass_scale", "sideslip_drag"}
    assert pitch.not_testable == {}
    lateral = {name for name, effect in CATALOGUE.items() if effect.axes == (Axis.LATERAL,)}
    assert {"roll_damping", "sideslip_yaw", "rudder_side_force"} <= lateral
    assert not lateral & {e.name for e in pitch.model.effects}
    both = {e.name for e in candidates(card, everything, BOTH).candidates}
    assert both >= names | {"roll_damping", "aileron_yaw", "spoiler_roll", "side_force_offset"}
    found = candidates(card, everything, (Axis.LATERAL,))
    assert found.model.coefficients == LATERAL
    names = {e.name for e in found.model.effects} | set(found.not_testable)
    assert {"roll_damping", "sideslip_bias", "mass_scale", "roll_rate_bias"} <= names
    assert not {"pitch_rate_lift", "kirchhoff_lift", "thrust_moment", "elevator_lift", "mach_drag"} & names
    with pytest.raises(InputError, match=r'effect roll_damping acts on Cl .* add "lateral" to the axes'):
        Model.of([*card.effects, "roll_damping"])
    with pytest.raises(InputError, match="effect pitch_damping acts on Cm of the longitudinal axis"):
        Model.of(["roll_damping", "pitch_damping"], axes=(Axis.LATERAL,))


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)
def test_what_adds_to_coefficients_of_one_axis_acts_on_it(effect):
    added = set(effect.example.increments)
    if effect.stage > Stage.AIRCRAFT and added & set(LATERAL):
        assert effect.axes == (BOTH if added & set(NAMES) else (Axis.LATERAL,))
    if effect.stage > Stage.AIRCRAFT and added and added <= {*NAMES, "CL_attached"}:
        assert effect.axes == (Axis.LONGITUDINAL,)


TERMS = ["roll_damping", "sideslip_roll", "yaw_damping", "rudder_side_force", "pitch_damping"]
LENGTHS = [  # of the card, and the defaults that they change
    ({}, set()), ({"rate_length": 1.5795}, {"Cmq"}), ({"lateral_rate_length": 21.5}, {"Clp", "Cnr"}),
    ({"lateral_rate_length": 43.0, "lateral_length": 10.75}, {"Clp", "Clbe", "Cnr"}),
]  # fmt: skip


@pytest.mark.parametrize(("lengths", "changed"), LENGTHS)
def test_defaults_in_the_lengths_of_a_card_are_the_same_forces_and_moments(card, lengths, changed):
    """Moments in N m: c or c/2, b or b/2 or 2V is only how defaults are written; what a card states stays."""
    signals = {"alpha": 0.1, "p": 0.2, "q": 0.1, "r": -0.1, "beta": 0.03, "rudder": 0.05, "airspeed": 80.0}
    signals = {name: jnp.asarray([x]) for name, x in signals.items()}

    def moments(aircraft, **changes):
        of_terms = replace(card, aircraft=aircraft, effects=tuple(TERMS), fixed={}, changes=changes, axes=BOTH)
        model = Model.from_card(of_terms)
        values = {p.name: p.start for p in model.parameters} | {"CYdr": 0.2}
        flow, scale = (
            model.flow(values, signals, aircraft),
            {"Cl": aircraft.moment_length, "Cn": aircraft.moment_length},
        )
        return [float(flow[name][0]) * scale.get(name, 1.0) for name in ("CY", "Cl", "Cn", "Cm")], model

    usual, before = moments(card.aircraft)
    other, after = moments(replace(card.aircraft, **lengths))
    assert all(abs(x) > 1e-4 for x in usual)
    np.testing.assert_allclose(other, usual, rtol=1e-12)
    assert {p.name for p, q in zip(before.parameters, after.parameters, strict=True) if p.prior != q.prior} == changed
    stated = {"Cmq": CardParameter(start=-20.0, prior=Prior("normal", -20.0, 5.0))}
    (pitch,) = (p for p in moments(replace(card.aircraft, **lengths), **stated)[1].parameters if p.name == "Cmq")
    assert (pitch.start, pitch.prior.normal) == (-20.0, (-20.0, 5.0))


# Two separation points, left and right: each wing at its own incidence, one mechanism for all that follows
N, DT = 300, 0.04
TELL_APART = {"wing_asymmetry": 0.012, "roll_rate_incidence": 0.6, "sideslip_incidence": 0.2, "aileron_incidence": -0.3}
WINGS = ("wing_lift_difference", "wing_drag_difference")


def signals() -> dict[str, jax.Array]:
    t = np.arange(N) * DT
    s = {
        "alpha": 0.2 + 0.13 * np.sin(0.8 * t), "alpha_dot": 0.104 * np.cos(0.8 * t), "airspeed": 80.0 + 5.0 * np.cos(t),
        "q": 0.05 * np.cos(t), "elevator": -0.1 * np.sin(t), "mach": np.full(N, 0.25), "p": 0.2 * np.sin(1.3 * t),
        "beta": 0.06 * np.cos(0.9 * t), "aileron": 0.1 * np.sin(0.7 * t), "dt": np.full(N, DT), "start": t == 0.0,
    }  # fmt: skip
    return {name: jnp.asarray(x) for name, x in s.items()}


def model_and_values(card, tell=TELL_APART, **changes):
    """The card's model with wings told apart by effects `tell`, whose values they have, and the demo's truth."""
    own = {p.name: x for name, x in tell.items() for p in CATALOGUE[name].parameters}
    model = Model.of([*card.effects, *tell, *WINGS], axes=BOTH)
    return model, {k: jnp.asarray(v) for k, v in (TRUTH | own | changes).items()}


def difference(s, aircraft) -> np.ndarray:
    """Incidence of the right wing less that of the left."""
    roll = 2.0 * 0.6 * np.asarray(s["p"]) * aircraft.half_span / np.asarray(s["airspeed"])
    return 0.012 + roll + 0.2 * np.asarray(s["beta"]) - 0.3 * np.asarray(s["aileron"])


def test_each_wing_stalls_by_itself_and_rolls_and_yaws_as_strips_do(card):
    s, a = signals(), card.aircraft
    model, v = model_and_values(card, tau1=0.0, tau2=0.0)
    known = model.flow(v, s, a)
    alpha, half = np.asarray(s["alpha"]), difference(s, a) / 2.0
    sides = {1.0: half, -1.0: -half}
    points = {side: expit(-2.0 * TRUTH["a1"] * (alpha + x - TRUTH["alpha_star"])) for side, x in sides.items()}
    right, left = points.values()
    np.testing.assert_allclose(known["X"], (right + left) / 2.0, rtol=1e-10)
    np.testing.assert_allclose(known["X_difference"], right - left, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(model.static_separation(v, s, a), known["X"], rtol=1e-14)
    assert np.abs(right - left).max() > 0.2
    # Force of either wing at 4/(3 pi) of the half span, moment r x F about body axes in N m.
    pressure_area, roll, yaw = 1234.0, 0.0, 0.0
    for side, X in points.items():
        lift = TRUTH["CLa"] * alpha * ((1.0 + np.sqrt(X)) / 2.0) ** 2 * pressure_area / 2.0
        drag = TRUTH["CDX"] * (1.0 - X) * pressure_area / 2.0
        y = side * 4.0 / (3.0 * np.pi) * a.half_span
        along, down = lift * np.sin(alpha) - drag * np.cos(alpha), -lift * np.cos(alpha) - drag * np.sin(alpha)
        roll, yaw = roll + y * down, yaw - y * along
    span = 2.0 * a.half_span
    np.testing.assert_allclose(known["Cl"], roll / pressure_area / span, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(known["Cn"], yaw / pressure_area / span, rtol=1e-7, atol=1e-12)


def test_wings_that_are_alike_are_one(card):
    s = signals()
    one = Model.of([*card.effects], axes=BOTH)
    v = {k: jnp.asarray(x) for k, x in (TRUTH | {"tau1": 12.0}).items()}
    expected = one.flow(v, s, card.aircraft)
    model, alike = model_and_values(card, dict.fromkeys(TELL_APART, 0.0), tau1=12.0)
    for found in (model.flow(alike, s, card.aircraft), Model.of([*card.effects]).flow(v, s, card.aircraft)):
        for name in ("X", "CL", "CD", "Cm", "Cl", "Cn", "X_difference"):
            np.testing.assert_array_equal(found[name], expected[name], name)
