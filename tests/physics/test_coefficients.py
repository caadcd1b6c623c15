"""Three and six coefficients, from rotations, forces put on a rigid body, and the textbook's polar."""

import json
import re
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.jobs.io import schemas
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import Aircraft
from bayes_aero.physics.coefficients import (
    body_from_lift_drag,
    coefficients,
    condition_joined,
    lift_drag_from_body,
    unsmoothed_joined,
)
from bayes_aero.physics.filters import smooth
from bayes_aero.physics.kinematics import Rotation, lever_arm


# Coefficients: rotations, and the way back from a simulated flight
def test_rotation_is_its_own_inverse_and_the_lever_arm_a_cross_product():
    rng = np.random.default_rng(1)
    CX, CZ, alpha = (jnp.asarray(rng.normal(size=20)) for _ in range(3))
    CL, CD = lift_drag_from_body(CX, CZ, alpha)
    np.testing.assert_allclose(CL**2 + CD**2, CX**2 + CZ**2, rtol=1e-12)
    np.testing.assert_allclose(body_from_lift_drag(CL, CD, alpha), (CX, CZ), atol=1e-12)
    # At zero incidence drag acts backward and lift upward.
    CL, CD = lift_drag_from_body(jnp.asarray(-0.1), jnp.asarray(-0.5), jnp.asarray(0.0))
    assert (float(CL), float(CD)) == (0.5, 0.1)
    rng = np.random.default_rng(2)
    omega, omega_dot, r = rng.normal(size=(3, 3))
    found = lever_arm(Rotation(*map(jnp.asarray, (*omega, *omega_dot))), tuple(map(float, r)))
    np.testing.assert_allclose(found, np.cross(omega_dot, r) + np.cross(omega, np.cross(omega, r)), atol=1e-12)


def test_an_elevator_that_passes_the_same_filter_keeps_its_effectiveness(card):
    """Pitch acceleration is a constant times a brisk 3-2-1-1 at 20 Hz; the pitch rate is its exact integral."""
    dt, a = 0.05, card.aircraft
    n = 400
    time = dt * np.arange(n)
    corners = 5.0 + np.cumsum([0.0, 0.1, 1.4, 0.2, 0.8, 0.2, 0.3, 0.2, 0.3, 0.1])
    elevator = np.interp(time, corners, [0.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 0.0]) * 0.04
    pitching = np.concatenate([[0.0], np.cumsum((elevator[1:] + elevator[:-1]) / 2.0) * dt])  # corners are samples
    level = {k: jnp.zeros(n) for k in ("ax", "az", "p", "r", "thrust")} | {
        "alpha": jnp.full(n, 0.05), "airspeed": jnp.full(n, 60.0), "density": jnp.full(n, 1.0),
    }  # fmt: skip
    channels = level | {"q": jnp.asarray(-8.0 * pitching), "elevator": jnp.asarray(elevator)}
    at_cg = replace(a, accelerometer=(0.0, 0.0, 0.0), reference_point=(0.0, 0.0, 0.0))
    ends = jnp.full(n, dt), jnp.zeros(n, int), jnp.full(n, n - 1)

    def effectiveness(elevator, signals, smoothing=lambda x: x):
        return np.polyfit(smoothing(jnp.asarray(elevator)), smoothing(coefficients(signals, at_cg).Cm), 1)[0]

    truth = -8.0 * a.Iy / (0.5 * 60.0**2 * a.wing_area * a.chord)
    alike = effectiveness(elevator, unsmoothed_joined(channels, (0.0, 0.0, 0.0), *ends), smooth)
    assert alike == pytest.approx(truth, rel=5e-3)
    published = effectiveness(elevator, condition_joined(channels, *ends))
    assert published / truth < 0.985  # a smoothed pitch acceleration against an elevator as recorded


# Six coefficients from forces and moments put on a rigid body with vector products
SCHEMAS = Path(schemas.__file__).parent
AIRCRAFT = Aircraft(
    mass=17_000.0, Ix=1.3e5, Iy=2.5e5, Iz=3.6e5, Ixz=1.1e4, Ixy=4e3, Iyz=-2e3, wing_area=64.0, chord=3.2,
    half_span=10.75, aspect_ratio=7.2, tail_arm=15.0, reference_point=(-0.2, 0.15, -0.12),
    accelerometer=(-1.0, 0.9, 0.1), engine=(-1.3, 0.1, -0.65), engine_inclination=0.05, engine_arm=3.0,
    lateral_length=10.75,
)  # fmt: skip
TRUE = {"CL": 0.7, "CD": 0.06, "Cm": 0.02, "CY": -0.05, "Cl": 0.004, "Cn": -0.003}
THRUST = 9_000.0, 6_000.0  # N, left and right


def flight(a: Aircraft, true=TRUE) -> dict:
    """What sensors show while the air makes these coefficients: Newton and Euler with NumPy's cross products."""
    V, rho, alpha, omega = 130.0, 0.8, 0.08, np.array([0.3, 0.08, -0.12])
    area = 0.5 * rho * V**2 * a.wing_area
    CX = true["CL"] * np.sin(alpha) - true["CD"] * np.cos(alpha)
    CZ = -true["CL"] * np.cos(alpha) - true["CD"] * np.sin(alpha)
    force = area * np.array([CX, true["CY"], CZ])
    moment = area * np.array([true["Cl"] * a.lateral_length, true["Cm"] * a.chord, true["Cn"] * a.lateral_length])
    moment += np.cross(a.reference_point, force)
    for thrust, side in zip(THRUST, (-1.0, 1.0), strict=True):
        pull = thrust * np.array([np.cos(a.engine_inclination), 0.0, -np.sin(a.engine_inclination)])
        moment += np.cross(np.add(a.engine, [0.0, side * a.engine_arm, 0.0]), pull)
        force = force + pull
    inertia = np.array([[a.Ix, -a.Ixy, -a.Ixz], [-a.Ixy, a.Iy, -a.Iyz], [-a.Ixz, -a.Iyz, a.Iz]])
    turning = np.linalg.solve(inertia, moment - np.cross(omega, inertia @ omega))
    arm = np.array(a.accelerometer)
    felt = force / a.mass + np.cross(turning, arm) + np.cross(omega, np.cross(omega, arm))
    found = dict(zip(("p", "q", "r"), omega, strict=True)) | dict(
        zip(("p_dot", "q_dot", "r_dot"), turning, strict=True)
    )
    found |= dict(zip(("ax", "ay", "az"), felt, strict=True))
    found |= {"alpha": alpha, "airspeed": V, "density": rho, "thrust": sum(THRUST)}
    return found | {"thrust_left": THRUST[0], "thrust_right": THRUST[1]}


def test_coefficients_come_back_from_a_rigid_body_six_or_three():
    signals = {name: jnp.asarray([x]) for name, x in flight(AIRCRAFT).items()}
    found = coefficients(signals, AIRCRAFT)._asdict()
    for name, value in TRUE.items():
        assert float(found[name][0]) == pytest.approx(value, abs=1e-13), name
    signals = {name: jnp.asarray([x]) for name, x in flight(AIRCRAFT).items() if name != "ay"}
    found = coefficients(signals, AIRCRAFT)
    assert found.CY is found.Cl is found.Cn is None
    assert float(found.CL[0]) == pytest.approx(TRUE["CL"], abs=1e-13)
    signals = {name: jnp.asarray([x]) for name, x in flight(AIRCRAFT).items()}
    total = {name: x for name, x in signals.items() if name != "thrust_left"}
    area = 0.5 * 0.8 * 130.0**2 * 64.0
    yaw = (THRUST[0] - THRUST[1]) * AIRCRAFT.engine_arm * np.cos(AIRCRAFT.engine_inclination) / (area * 10.75)
    moved = float(coefficients(total, AIRCRAFT).Cn[0]) - TRUE["Cn"]
    assert moved == pytest.approx(yaw, rel=1e-9)


@pytest.mark.parametrize("name", ["results", "diagnosis"])
def test_files_of_results_may_hold_every_coefficient(name):
    """Each list of coefficients in a schema has all six."""
    listed = re.findall(r'"enum": *(\[[^]]*"CL"[^]]*\])', (SCHEMAS / f"{name}.schema.json").read_text(encoding="utf-8"))
    assert listed
    assert all(set(TRUE) <= set(json.loads(names)) for names in listed)


# The drag of the stalled wing against the textbook's polar, written out by hand
EFFECTS = (
    "attached_lift", "flow_separation", "kirchhoff_lift",
    "profile_drag", "induced_drag", "separated_drag", "separated_induced_drag",
)  # fmt: skip
VALUES = {"CL0": 0.3, "CLa": 5.2, "a1": 22.0, "alpha_star": 0.27, "CD0": 0.03, "e": 0.78, "CDX": 0.06}


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_drag_is_that_of_the_attached_lift_or_of_the_lift_that_is_left(card, share):
    alpha = np.linspace(-0.05, 0.4, 60)
    model = Model.of(EFFECTS)
    signals = {name: jnp.zeros(60) for name in model.channels} | {"alpha": jnp.asarray(alpha)}
    signals |= {"airspeed": jnp.full(60, 60.0), "dt": jnp.full(60, 0.05)}
    signals |= {"alpha_dot": jnp.zeros(60), "start": jnp.arange(60) == 0}
    values = {name: jnp.asarray(x) for name, x in (VALUES | {"induced_share": share}).items()}
    known = model.flow(values, signals, card.aircraft)
    X = 0.5 * (1.0 - np.tanh(22.0 * (alpha - 0.27)))
    attached = 0.3 + 5.2 * alpha
    CL = 0.3 + 5.2 * ((1.0 + np.sqrt(X)) / 2.0) ** 2 * alpha
    square = (CL if share else attached) ** 2
    CD = 0.03 + square / (np.pi * 0.78 * card.aircraft.aspect_ratio) + 0.06 * (1.0 - X)
    np.testing.assert_allclose(known["CL"], CL, rtol=1e-6)
    np.testing.assert_allclose(known["CD"], CD, rtol=1e-6)
    assert np.ptp(CL - attached) > 0.5  # the two polars differ here
