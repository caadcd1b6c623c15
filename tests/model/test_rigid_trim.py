"""Steady flight in six degrees of freedom: the equations of another simulator say that nothing changes in it."""

from __future__ import annotations

import numpy as np
import pytest
import six_axes as six
import stranger_six
from stranger_six import Plane

from bayes_aero.dynamics.simulated.rigid_trim import Condition, rigid_trim
from bayes_aero.errors import InputError

PLANE = Plane(**six.ATTACHED, Ixy=1.5e3, Iyz=-2e3)
SPEED, HEIGHT = 120.0, 4000.0


def trimmed(effects=(*six.LONGITUDINAL, *six.LATERAL), **condition):
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


@pytest.mark.parametrize(
    "condition",
    [
        {},
        {"climb": 0.06},
        {"sideslip": 0.1},
        {"unequal": 1.0},
        {"sideslip": None, "bank": 0.08, "unequal": 1.0},
        {"bank": 0.7, "turn_rate": None},
        {"bank": None, "turn_rate": -0.04, "climb": -0.05},
    ],
)
def test_nothing_changes_in_steady_flight(condition):
    found = trimmed(**condition)
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


def test_level_flight_is_that_of_a_solver_of_its_own():
    x, controls = stranger_six.level(PLANE, SPEED, HEIGHT)
    found = trimmed()
    assert found.state["alpha"] == pytest.approx(np.arctan2(x[2], x[0]), rel=1e-6)
    assert found.controls["elevator"] == pytest.approx(controls[0], rel=1e-5)
    assert found.thrust == pytest.approx(controls[3] + controls[4], rel=1e-6)


def test_one_engine_without_a_rudder_is_no_steady_straight_flight():
    effects = [n for n in (*six.LONGITUDINAL, *six.LATERAL) if n not in ("rudder_yaw", "rudder_roll")]
    assert abs(trimmed(effects).state["phi"]) < 1e-9
    with pytest.raises(InputError, match="no steady flight at 120 m/s and 4000 m that elevator, aileron can hold"):
        trimmed(effects, unequal=1.0)


def test_what_no_wing_carries_is_refused():
    with pytest.raises(InputError, match="no steady flight at 30 m/s"):
        trimmed(airspeed=30.0)


def test_two_of_sideslip_bank_and_turn_rate_are_given():
    with pytest.raises(InputError, match="two of sideslip, bank and turn rate"):
        Condition(SPEED, HEIGHT, bank=0.1)
