"""Trim from the model's own coefficients, whatever its parameters are called and whichever control pitches it."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.dynamics.simulated.manoeuvres import fly_standard
from bayes_aero.dynamics.simulated.trim import lead, level_speed, trimmed
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.errors import InputError
from bayes_aero.model.model import Model
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.atmosphere import GRAVITY, air
from bayes_aero.simulate.demo import TRUTH

AIRSPEED, ALTITUDE = 95.0, 5200.0
TRIM = {"Cmih": -2.0, "Cm_stick": 0.7}  # the stick pitches up as much as the demo's elevator pitches down


def stick(v, s, a, _known):
    """A moment at the tail arm and the lift that goes with it."""
    return {"Cm": v["Cm_stick"] * s["elevator"], "CL_attached": -v["Cm_stick"] * a.chord / a.tail_arm * s["elevator"]}


STICK = Effect(
    name="stick_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The stick pitches the aircraft up.",
    parameters=(Parameter("Cm_stick", "1/rad", 0.0, 0.5, "moment per stick", Prior("normal", 0.5, 1.0)),),
    channels=("elevator",),
    increments=stick,
    example=Example({"Cm_stick": 0.5}, {"elevator": 0.1}, {"Cm": 0.05, "CL_attached": -0.01}, "by hand"),
    source="our choice",
    sizes={"Cm_stick": (0.03, 3.0)},
)


def values():
    return {name: jnp.asarray(x) for name, x in (TRUTH | TRIM).items()}


def pitched_by(card, *effects):
    """The card's model with other effects in place of the elevator's."""
    return Model.of([*(e for e in card.effects if e != "elevator_moment"), *effects])


def standard(model, card):
    found = fly_standard(model, values(), card.aircraft, airspeed=AIRSPEED, altitude=ALTITUDE, dt=0.04)
    return found.channels, found.refused


def test_the_command_of_attached_flow_is_the_elevator_of_the_textbook(card):
    alpha = jnp.asarray([0.05, 0.1, 0.2])
    shares, command = lead(Model.of(card.effects), values(), card.aircraft, alpha, AIRSPEED, ALTITUDE)
    np.testing.assert_array_equal(shares, [1.0, 0.0])
    np.testing.assert_allclose(command, -(TRUTH["Cm0"] + TRUTH["Cma"] * alpha) / TRUTH["Cmde"], rtol=1e-14)


@pytest.mark.parametrize("mach", [None, 0.3])
def test_at_level_speed_the_attached_lift_carries_the_weight(card, mach):
    speed = level_speed(Model.of(card.effects), values(), card.aircraft, 0.1, ALTITUDE, mach)
    density, sound = (float(x) for x in air(jnp.asarray(ALTITUDE)))
    CL = TRUTH["CL0"] + (TRUTH["CLa"] + TRUTH["CLaM"] * (mach or speed / sound)) * 0.1
    lift = 0.5 * density * speed**2 * card.aircraft.wing_area * CL
    assert lift == pytest.approx(card.aircraft.mass * GRAVITY, rel=1e-9)


def test_a_control_that_pitches_up_is_moved_the_other_way(card):
    usual, refused = standard(Model.of(card.effects), card)
    own, refused_own = standard(pitched_by(card, STICK), card)
    assert not refused
    assert not refused_own
    for name, channels in usual.items():
        np.testing.assert_allclose(own[name]["elevator"], -channels["elevator"], atol=1e-9)
        np.testing.assert_allclose(own[name]["alpha"], channels["alpha"], atol=1e-9)


def test_a_model_without_an_elevator_is_flown_by_its_stabilizer(card):
    model = pitched_by(card, "stabilizer_trim")
    flown, refused = standard(model, card)
    assert not refused
    doublet = flown["elevator_doublet"]
    assert np.all(doublet["elevator"] == 0.0)
    assert np.ptp(doublet["stabilizer"]) > np.deg2rad(3.0)
    begin = trimmed(model, values(), card.aircraft, AIRSPEED, ALTITUDE)
    assert doublet["alpha"][:25] == pytest.approx(begin.alpha, abs=np.deg2rad(0.1))
    assert np.ptp(doublet["alpha"]) > np.deg2rad(1.0)


def test_a_model_that_no_control_pitches_cannot_be_trimmed(card):
    with pytest.raises(InputError, match="neither elevator nor stabilizer pitches it"):
        trimmed(pitched_by(card), values(), card.aircraft, AIRSPEED, ALTITUDE)
