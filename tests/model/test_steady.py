"""Conditions of the stall, from signals made by hand."""

import numpy as np
import pytest

from bayes_aero.dynamics.simulated.steady import conditions


def test_conditions_are_those_of_the_largest_lift_not_of_the_largest_angle():
    """Lift peaks in the first tenth; the angle of attack in the last, with the elevator pulled further."""
    n = 100
    alpha, elevator, az = np.full(n, 0.1), np.full(n, -0.05), np.full(n, -9.8)
    az[:10], elevator[:10] = -12.0, -0.15
    alpha[-10:], elevator[-10:] = 0.4, -0.28
    signals = {"alpha": alpha, "elevator": elevator, "az": az, "density": np.full(n, 1.0), "airspeed": np.full(n, 50.0)}
    held = conditions(signals | {"q": np.full(n, 0.3)})
    assert held["elevator"] == pytest.approx(-0.15)
    assert held["q"] == 0.0
    without = {name: x for name, x in signals.items() if name != "az"}
    assert conditions(without)["elevator"] == pytest.approx(-0.28)
