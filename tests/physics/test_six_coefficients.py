"""Six coefficients from forces and moments put on a rigid body with vector products."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.jobs.io import schemas
from bayes_aero.physics.coefficients import coefficient_noise, coefficients, stacked_coefficients

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


def test_all_six_come_back_from_a_rigid_body_with_a_full_inertia_tensor():
    signals = {name: jnp.asarray([x]) for name, x in flight(AIRCRAFT).items()}
    found = coefficients(signals, AIRCRAFT)._asdict()
    for name, value in TRUE.items():
        assert float(found[name][0]) == pytest.approx(value, abs=1e-13), name


def test_without_the_lateral_accelerometer_there_are_three():
    signals = {name: jnp.asarray([x]) for name, x in flight(AIRCRAFT).items() if name != "ay"}
    found = coefficients(signals, AIRCRAFT)
    assert found.CY is found.Cl is found.Cn is None
    assert float(found.CL[0]) == pytest.approx(TRUE["CL"], abs=1e-13)


def test_thrust_of_one_engine_alone_yaws_only_where_both_are_recorded():
    signals = {name: jnp.asarray([x]) for name, x in flight(AIRCRAFT).items()}
    total = {name: x for name, x in signals.items() if name != "thrust_left"}
    area = 0.5 * 0.8 * 130.0**2 * 64.0
    yaw = (THRUST[0] - THRUST[1]) * AIRCRAFT.engine_arm * np.cos(AIRCRAFT.engine_inclination) / (area * 10.75)
    moved = float(coefficients(total, AIRCRAFT).Cn[0]) - TRUE["Cn"]
    assert moved == pytest.approx(yaw, rel=1e-9)


def test_propagated_noise_of_six_is_the_scatter_of_perturbed_records():
    rng = np.random.default_rng(5)
    print("seed 5")
    n = 20_000
    noise = {"ay": 0.02, "az": 0.05, "ax": 0.02, "alpha": 1e-3, "airspeed": 0.2, "thrust": 200.0}  # white, unfiltered
    exact = {name: jnp.full(n, x) for name, x in flight(AIRCRAFT).items()}
    noisy = {name: x + noise.get(name, 0.0) * rng.standard_normal(n) for name, x in exact.items()}
    names = tuple(TRUE)
    scatter = np.std(np.asarray(stacked_coefficients(noisy, AIRCRAFT, names)), axis=0)
    stated = np.asarray(coefficient_noise(exact, AIRCRAFT, noise, 0.04, (), names))[0]
    np.testing.assert_allclose(scatter, stated, rtol=0.03)


def test_files_of_results_may_hold_every_coefficient():
    """Each list of coefficients in a schema has all six."""
    for name in ("results", "diagnosis"):
        schema = json.loads((SCHEMAS / f"{name}.schema.json").read_text(encoding="utf-8"))
        listed = [names for names in enumerations(schema) if "CL" in names]
        assert listed, name
        assert all(set(TRUE) <= set(names) for names in listed), name


def enumerations(part) -> list:
    """Every list of allowed words in a schema."""
    if isinstance(part, dict):
        own = [part["enum"]] if isinstance(part.get("enum"), list) else []
        return own + [x for value in part.values() for x in enumerations(value)]
    return [x for value in part for x in enumerations(value)] if isinstance(part, list) else []
