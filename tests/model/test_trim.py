"""Trim of one axis and of six degrees of freedom, from the model's coefficients and against another simulator."""

import jax.numpy as jnp
import numpy as np
import pytest
import six_axes as six
import stranger_six
from stranger_six import Plane

from bayes_aero.dynamics.pilot import fly_standard
from bayes_aero.dynamics.trim import Condition, lead, level_speed, rigid_trim, trimmed
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.errors import InputError
from bayes_aero.model.model import Model
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.aircraft import GRAVITY, air
from bayes_aero.simulate.demo import TRUTH

# Trim from the model's own coefficients, whatever its parameters are called and whichever control pitches it
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


def test_the_command_is_the_textbook_s_and_of_a_control_that_pitches_up_the_other_way(card):
    alpha = jnp.asarray([0.05, 0.1, 0.2])
    shares, command = lead(Model.of(card.effects), values(), card.aircraft, alpha, AIRSPEED, ALTITUDE)
    np.testing.assert_array_equal(shares, [1.0, 0.0])
    np.testing.assert_allclose(command, -(TRUTH["Cm0"] + TRUTH["Cma"] * alpha) / TRUTH["Cmde"], rtol=1e-14)
    usual, refused = standard(Model.of(card.effects), card)
    own, refused_own = standard(pitched_by(card, STICK), card)
    assert not refused
    assert not refused_own
    for name, channels in usual.items():
        np.testing.assert_allclose(own[name]["elevator"], -channels["elevator"], atol=1e-9)
        np.testing.assert_allclose(own[name]["alpha"], channels["alpha"], atol=1e-9)


@pytest.mark.parametrize("mach", [None, 0.3])
def test_at_level_speed_the_attached_lift_carries_the_weight(card, mach):
    speed = level_speed(Model.of(card.effects), values(), card.aircraft, 0.1, ALTITUDE, mach)
    density, sound = (float(x) for x in air(jnp.asarray(ALTITUDE)))
    CL = TRUTH["CL0"] + (TRUTH["CLa"] + TRUTH["CLaM"] * (mach or speed / sound)) * 0.1
    lift = 0.5 * density * speed**2 * card.aircraft.wing_area * CL
    assert lift == pytest.approx(card.aircraft.mass * GRAVITY, rel=1e-9)


def test_a_model_is_flown_by_its_stabilizer_or_cannot_be_trimmed(card):
    model = pitched_by(card, "stabilizer_trim")
    flown, refused = standard(model, card)
    assert not refused
    doublet = flown["elevator_doublet"]
    assert np.all(doublet["elevator"] == 0.0)
    assert np.ptp(doublet["stabilizer"]) > np.deg2rad(3.0)
    begin = trimmed(model, values(), card.aircraft, AIRSPEED, ALTITUDE)
    assert doublet["alpha"][:25] == pytest.approx(begin.alpha, abs=np.deg2rad(0.1))
    assert np.ptp(doublet["alpha"]) > np.deg2rad(1.0)
    with pytest.raises(InputError, match="neither elevator nor stabilizer pitches it"):
        trimmed(pitched_by(card), values(), card.aircraft, AIRSPEED, ALTITUDE)


# Steady flight in six degrees of freedom: the equations of another simulator say that nothing changes in it
PLANE = Plane(**six.ATTACHED, Ixy=1.5e3, Iyz=-2e3)
SPEED, HEIGHT = 120.0, 4000.0


def trimmed_six(effects=(*six.LONGITUDINAL, *six.LATERAL), **condition):
    model = six.model(effects)
    asked = Condition(condition.pop("airspeed", SPEED), HEIGHT, **condition)
    return rigid_trim(model, six.values(PLANE, model), six.aircraft(PLANE), asked)


def rates(found, unequal=0.0):
    """Those of the other simulator there."""
    V, alpha, beta = (found.state[name] for name in ("airspeed", "alpha", "beta"))
    x = np.zeros(12)
    x[:3] = V * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    x[3:9] = [found.state[name] for name in ("p", "q", "r", "phi", "theta", "psi")]
    x[9] = found.state["altitude"]
    engines = 0.5 * found.thrust * np.array([1.0 + unequal, 1.0 - unequal])
    return PLANE.rates(x, np.array([*(found.controls[n] for n in ("elevator", "aileron", "rudder")), *engines]))


@pytest.mark.parametrize("condition", [
    {}, {"climb": 0.06}, {"sideslip": 0.1}, {"unequal": 1.0}, {"sideslip": None, "bank": 0.08, "unequal": 1.0},
    {"bank": 0.7, "turn_rate": None}, {"bank": None, "turn_rate": -0.04, "climb": -0.05},
])  # fmt: skip
def test_nothing_changes_in_steady_flight(condition):
    found = trimmed_six(**condition)
    slope = rates(found, condition.get("unequal", 0.0))
    np.testing.assert_allclose(slope[:6], 0.0, atol=1e-6)
    np.testing.assert_allclose(slope[6:8], 0.0, atol=1e-9)
    assert slope[9] == pytest.approx(SPEED * np.sin(condition.get("climb", 0.0)), abs=1e-6)
    turn = condition.get("turn_rate", 0.0)
    assert slope[8] == pytest.approx(slope[8] if turn is None else turn, abs=1e-9)
    if condition.get("bank") == 0.7:
        assert slope[8] > 0.05
    for name, state in (("sideslip", "beta"), ("bank", "phi")):
        if condition.get(name) is not None:
            assert found.state[state] == condition[name]


def test_level_flight_is_found_and_what_cannot_be_held_is_refused():
    x, controls = stranger_six.level(PLANE, SPEED, HEIGHT)
    found = trimmed_six()
    assert found.state["alpha"] == pytest.approx(np.arctan2(x[2], x[0]), rel=1e-6)
    assert found.controls["elevator"] == pytest.approx(controls[0], rel=1e-5)
    assert found.thrust == pytest.approx(controls[3] + controls[4], rel=1e-6)
    effects = [n for n in (*six.LONGITUDINAL, *six.LATERAL) if n not in ("rudder_yaw", "rudder_roll")]
    assert abs(trimmed_six(effects).state["phi"]) < 1e-9
    with pytest.raises(InputError, match="no steady flight at 120 m/s and 4000 m that elevator, aileron can hold"):
        trimmed_six(effects, unequal=1.0)
    with pytest.raises(InputError, match="no steady flight at 30 m/s"):
        trimmed_six(airspeed=30.0)
    with pytest.raises(InputError, match="two of sideslip, bank and turn rate"):
        Condition(SPEED, HEIGHT, bank=0.1)
