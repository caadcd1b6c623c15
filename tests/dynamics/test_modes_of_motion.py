"""Modes of motion against textbooks, closed forms and a simulator that shares no code."""

import numpy as np
import pytest
import six_axes as six
import stranger_six
from stranger_six import Plane

from bayes_aero.dynamics.flight import AircraftDynamics
from bayes_aero.dynamics.linear import Steady, linear_dynamics, modes, named_modes
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.physics.aircraft import NO_AIRCRAFT, Axis

# Boeing 747 in cruise at Mach 0.8 and 40,000 ft. Etkin and Reid, Dynamics of Flight, 3rd ed. 1996, sections 6.2 and
# 6.7: speeds in ft/s, at 774 ft/s.
JET = 774.0
LONGITUDINAL = (
    [-0.006868, 0.01395, 0.0, -32.2], [-0.09055, -0.3151, 773.98, 0.0], [0.0001187, -0.001026, -0.4285, 0.0],
    [0.0, 0.0, 1.0, 0.0],
)  # fmt: skip
LATERAL = (
    [-0.0558, 0.0, -774.0, 32.2], [-0.003865, -0.4342, 0.4136, 0.0], [0.001086, -0.006112, -0.1458, 0.0],
    [0.0, 1.0, 0.0, 0.0],
)  # fmt: skip
PUBLISHED = {
    "short period": -0.3719 + 0.8875j, "phugoid": -0.003289 + 0.06723j,
    "Dutch roll": -0.03301 + 0.94655j, "roll": -0.56248, "spiral": -0.0072973,
}  # fmt: skip


def of(found):
    return {mode.name: mode.eigenvalue for mode in found}


def dynamics_of(plane, *effects, axes=six.BOTH):
    model = six.model(effects, axes)
    return AircraftDynamics(model), six.values(plane, model)


def derivative(plane, V, h):
    """Of the other simulator's rates by u, v, w, p, q, r, phi and theta in level flight, by central differences."""
    x, controls = stranger_six.level(plane, V, h)
    kept, A = np.arange(8), np.zeros((8, 8))
    for k in kept:
        step = np.zeros(12)
        step[k] = 1e-5 * (V if k < 3 else 1.0)
        ends = [plane.rates(x + sign * step, controls)[:8] for sign in (1.0, -1.0)]
        A[:, k] = (ends[0] - ends[1]) / (2.0 * step[k])
    return A


def test_the_published_modes_of_a_jet_transport():
    sideways = np.array(LATERAL)
    sideways[0, 1:] /= JET  # v to beta
    sideways[1:, 0] *= JET
    found = of(named_modes(np.array(LONGITUDINAL), ("airspeed", "w", "q", "theta"), JET))
    found |= of(named_modes(sideways, ("beta", "p", "r", "phi"), JET))
    assert set(found) == set(PUBLISHED)
    for name, value in PUBLISHED.items():
        assert abs(found[name] - value) < 1e-3 * abs(value), name


@pytest.mark.parametrize("plane", [Plane(**six.ATTACHED), Plane(**six.ATTACHED, engine_arm=0.0, Cnbe=0.05, Clbe=-0.12)])
def test_modes_are_those_of_another_simulator(plane):
    """The eigenvalues are the same in body velocities and in airspeed and flow angles."""
    dynamics, values = dynamics_of(plane, *six.LONGITUDINAL, *six.LATERAL)
    found = of(modes(dynamics, values, six.aircraft(plane), Steady(120.0, 4000.0)))
    assert set(found) == {"short period", "phugoid", "Dutch roll", "roll", "spiral"}
    theirs = np.linalg.eigvals(derivative(plane, 120.0, 4000.0))
    for name, value in found.items():
        assert np.min(np.abs(theirs - value)) < 1e-6 * max(1.0, abs(value)), name


def test_cards_of_one_axis_have_its_modes():
    """Of an aircraft with a plane of symmetry in level flight both axes are apart."""
    plane = Plane(**six.ATTACHED)
    steady = Steady(120.0, 4000.0)
    both, values = dynamics_of(plane, *six.LONGITUDINAL, *six.LATERAL)
    whole = of(modes(both, values, six.aircraft(plane), steady))
    alone, own = dynamics_of(plane, *six.LONGITUDINAL, axes=(Axis.LONGITUDINAL,))
    found = of(modes(alone, own, six.aircraft(plane), steady))
    assert set(found) == {"short period", "phugoid"}
    np.testing.assert_allclose([found[n] for n in found], [whole[n] for n in found], rtol=1e-8)
    trim = stranger_six.level(plane, 120.0, 4000.0)[0]
    side, own = dynamics_of(plane, *six.LATERAL, axes=(Axis.LATERAL,))
    alpha = float(np.arctan2(trim[2], trim[0]))
    found = of(modes(side, own, six.aircraft(plane), Steady(120.0, 4000.0, alpha)))
    assert set(found) == {"Dutch roll", "roll", "spiral"}
    np.testing.assert_allclose([found[n] for n in found], [whole[n] for n in found], rtol=1e-6)


def test_a_linear_card_has_the_eigenvalues_of_its_matrix():
    """Short period: of x^2 - (Zalpha + Mq) x + Zalpha Mq - Malpha; roll and yaw without coupling: Lp and Nr."""
    dynamics = linear_dynamics(read_card("attas_short_period"))
    values = dict.fromkeys(dynamics.names, 0.0) | dynamics.fixed | {"Zalpha": -0.9, "Malpha": -2.1, "Mq": -1.3}
    (mode,) = modes(dynamics, values, NO_AIRCRAFT, Steady(100.0, 0.0))
    assert mode.name == "short period"
    assert mode.eigenvalue == pytest.approx(np.roots([1.0, 2.2, 0.9 * 1.3 + 2.1])[0], rel=1e-12)
    dynamics = linear_dynamics(read_card("lateral"))
    values = dict.fromkeys(dynamics.names, 0.0) | {"Lp": -2.5, "Nr": -0.4}
    assert of(modes(dynamics, values, NO_AIRCRAFT, Steady(100.0, 0.0))) == {"roll": -2.5, "other": -0.4}


def test_an_unstable_aircraft_has_no_short_period_oscillation():
    plane = Plane(**six.ATTACHED, Cma=0.5)
    dynamics, values = dynamics_of(plane, *six.LONGITUDINAL, axes=(Axis.LONGITUDINAL,))
    found = modes(dynamics, values, six.aircraft(plane), Steady(120.0, 4000.0))
    theirs = np.linalg.eigvals(derivative(plane, 120.0, 4000.0))
    assert max(mode.eigenvalue.real for mode in found) > 0.1
    assert "short period, aperiodic" in {mode.name for mode in found}
    for mode in found:
        assert np.min(np.abs(theirs - mode.eigenvalue)) < 1e-6


def test_a_lag_of_the_separation_adds_a_mode_and_moves_no_other():
    """Far from the stall it does not act; its own eigenvalue is -V/(tau1 c)."""
    plane = Plane(**six.ATTACHED)
    whole, values = dynamics_of(plane, *six.LONGITUDINAL, *six.LATERAL)
    lagged, own = dynamics_of(plane, *six.LONGITUDINAL, *six.LATERAL, *six.STALL)
    own |= {"tau1": 4.0, "a1": 60.0}
    steady = Steady(150.0, 4000.0)
    found = modes(lagged, own, six.aircraft(plane), steady)
    plain = of(modes(whole, values, six.aircraft(plane), steady))
    (other,) = (mode for mode in found if mode.name == "other")
    assert other.eigenvalue.real == pytest.approx(-150.0 / (4.0 * plane.c), rel=1e-3)
    for mode in found:
        if mode is not other:
            assert abs(mode.eigenvalue - plain[mode.name]) < 1e-3


def test_motion_without_modes_is_refused():
    dynamics, values = dynamics_of(Plane(**six.ATTACHED), *six.LONGITUDINAL, *six.LATERAL)
    with pytest.raises(InputError, match="no steady flight at 20 m/s"):
        modes(dynamics, values, six.aircraft(Plane()), Steady(20.0, 4000.0))
    held = AircraftDynamics(dynamics.model, held=("beta", "phi"))
    with pytest.raises(InputError, match="holds beta, phi to the record"):
        modes(held, values, six.aircraft(Plane()), Steady(120.0, 4000.0))
    with pytest.raises(InputError, match="not finite"):
        named_modes(np.array([[np.nan]]), ("p",), 100.0)
