"""Exported models in JSBSim and as an FMU against the model itself: coefficients, forces and whole flights."""

from dataclasses import replace
from types import SimpleNamespace

import fmpy
import jax.numpy as jnp
import numpy as np
import pytest
from export_round_trip import CONTROLS, FOOT, POUND, SLUG, STATES, flown, loaded, simulated, started
from exported_models import BOTH, everything, modelled, six, stall
from fmpy.validation import validate_fmu

from bayes_aero.dynamics.aircraft import Longitudinal, RigidBody
from bayes_aero.export.simulators import PROPERTIES, write_fmu
from bayes_aero.physics.aircraft import air
from bayes_aero.simulate.demo import simulate_stall

LARGEST = 1e-3  # of an output's range, between another simulator and the package's own simulation
STALL_FRAMES, SIX_FRAMES = 25, 80  # a sample of 40 ms; JSBSim's first step is of first order
STEP = 0.001  # s: a step of the FMU holds its inputs


@pytest.fixture(scope="module")
def random_flights(tmp_path_factory):
    """Random states of JSBSim with every effect, as it reads them, and the outputs there."""
    found = everything()
    sim = loaded(found, tmp_path_factory.mktemp("everything"))
    sim.set_dt(0.01)
    rng, rows = np.random.default_rng(5), []
    others = set(found.program.inputs_of("signal")) - {*PROPERTIES, *CONTROLS}
    inputs = {n: f"bayes-aero/input/{n.replace('_', '-')}-rad" for n in sorted(others)} | CONTROLS
    for _ in range(40):
        for name, known in inputs.items():
            sim[known] = rng.uniform(0.0, 4e4) if name == "thrust" else rng.uniform(-0.2, 0.2)
        sim["fcs/flap-pos-deg"] = rng.uniform(0.0, 20.0)
        angles = {name: rng.uniform(-0.2, 0.2) for name in ("beta", "theta", "phi", "p", "q", "r")}
        start = angles | {"alpha": rng.uniform(-0.1, 0.4), "airspeed": rng.uniform(60.0, 140.0)}
        started(sim, start | {"altitude": rng.uniform(500.0, 8000.0)})
        sim.run()
        rows.append({name: sim[known] for name, known in inputs.items()} | _read(sim, found))
    return found, {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _read(sim, found):
    told = {name: sim[known] * factor for name, (known, factor) in STATES.items()}
    told |= {"flap": np.radians(sim["fcs/flap-pos-deg"]), "mach": sim["velocities/mach"]}
    told |= {"density": sim["atmosphere/rho-slugs_ft3"] * SLUG / FOOT**3}
    told |= {"alpha_dot": sim["bayes-aero/state/alpha-dot-rad_sec"]}
    told |= {name: sim[f"bayes-aero/state/{name}"] for name in found.points}
    told |= {name: sim[f"bayes-aero/coefficient/{name}"] for name in found.model.coefficients}
    told |= {f"force_{n}": sim[f"forces/fb{n}-aero-lbs"] * POUND for n in "xyz"}
    told |= {f"moment_{n}": sim[f"moments/{n}-aero-lbsft"] * POUND * FOOT for n in "lmn"}
    told |= {f"engine_{n}": sim[f"moments/{n}-external-lbsft"] * POUND * FOOT for n in "lmn"}
    told |= {f"total_{n}": sim[f"moments/{n}-total-lbsft"] * POUND * FOOT for n in "lmn"}
    return told | {f"{n}_dot": sim[f"accelerations/{n}dot-rad_sec2"] for n in "pqr"}


def test_coefficients_of_every_effect_are_the_models(random_flights):
    found, sim = random_flights
    expected = modelled(found, sim, {name: sim[name] for name in found.points})
    for name, x in expected.items():
        np.testing.assert_allclose(sim[name], x, rtol=1e-9, atol=1e-9 * np.ptp(x), err_msg=name)
        assert np.ptp(x) > 0.01


def test_forces_moments_and_turning_have_the_units_the_lengths_and_the_inertia_of_the_card(random_flights):
    """Newtons and newton metres from SI coefficients by the definition, with the arm of the reference point; Euler's
    equations with the tensor of the card's products, where the angular velocity is that of the frame before."""
    found, sim = random_flights
    a = found.actual_aircraft
    area = 0.5 * sim["density"] * sim["airspeed"] ** 2 * a.wing_area
    sin, cos = np.sin(sim["alpha"]), np.cos(sim["alpha"])
    force = area[:, None] * np.stack(
        [sim["CL"] * sin - sim["CD"] * cos, sim["CY"], -sim["CL"] * cos - sim["CD"] * sin], axis=1
    )
    lengths = np.array([a.lateral_length, a.chord, a.lateral_length])
    moment = area[:, None] * lengths * np.stack([sim["Cl"], sim["Cm"], sim["Cn"]], axis=1)
    moment += np.cross(a.reference_point, force)
    size = np.abs(force).max(), np.abs(moment).max()
    np.testing.assert_allclose(np.stack([sim[f"force_{n}"] for n in "xyz"], axis=1), force, atol=1e-9 * size[0])
    np.testing.assert_allclose(np.stack([sim[f"moment_{n}"] for n in "lmn"], axis=1), moment, atol=1e-9 * size[1])
    thrust = sim["thrust"][:, None] * [np.cos(a.engine_inclination), 0.0, -np.sin(a.engine_inclination)]
    engine = np.cross(a.engine, thrust)
    told = np.stack([sim[f"engine_{n}"] for n in "lmn"], axis=1)
    np.testing.assert_allclose(told, engine, atol=1e-9 * np.abs(engine).max())
    tensor = np.array([[a.Ix, -a.Ixy, -a.Ixz], [-a.Ixy, a.Iy, -a.Iyz], [-a.Ixz, -a.Iyz, a.Iz]])
    spin, total = (np.stack([sim[n] for n in names], axis=1) for names in ("pqr", ("total_l", "total_m", "total_n")))
    faster = np.linalg.solve(tensor, (total - np.cross(spin, spin @ tensor)).T).T
    told = np.stack([sim[f"{n}_dot"] for n in "pqr"], axis=1)
    np.testing.assert_allclose(told, faster, atol=1e-9 * np.abs(faster).max())


def within(found, expected, names):
    """Largest difference by output, over its range; JSBSim has no forces yet in the initial state."""
    sizes = {n: float(np.abs(found[n] - expected[n])[1:].max() / np.ptp(expected[n])) for n in names}
    assert max(sizes.values()) <= LARGEST, sizes


def recorded_stall(found, begin, end):
    """The package's system, the state and the inputs of a recorded stall without noise, and the record."""
    record = simulate_stall(0, sensor_noise=0.0, disturbance=0.0).window(begin, end)
    c = record.channels
    inputs = {"elevator": c["elevator"], "thrust": c["thrust_left"] + c["thrust_right"]}
    start = {name: float(c[name][0]) for name in ("airspeed", "alpha", "theta", "q", "altitude")} | {"X": 1.0}
    system = Longitudinal(found.model, {n: jnp.asarray(x) for n, x in found.values.items()}, found.aircraft)
    return system, start, inputs, record


def test_a_stall_is_flown_as_the_package_flies_it(tmp_path):
    """The elevator and the thrust of a recorded stall: airspeed, alpha, pitch, rate and altitude."""
    found = stall(5.0)
    system, start, inputs, record = recorded_stall(found, 0.0, 60.0)
    outputs = {n: STATES[n] for n in ("airspeed", "alpha", "theta", "q", "altitude")}
    outputs |= {n: (f"bayes-aero/coefficient/{n}", 1.0) for n in ("CL", "CD", "Cm")} | {
        "X": ("bayes-aero/state/X", 1.0)
    }
    sim = flown(loaded(found, tmp_path), start, inputs, record.dt, STALL_FRAMES, outputs)
    expected = simulated(system, start, inputs, record.dt, X=sim["X"][0])
    assert np.ptp(expected["X"]) > 0.3
    within(sim, expected, outputs)


def test_six_degrees_of_freedom_are_flown_as_the_package_flies_them(tmp_path):
    """Doublets of all controls: products of inertia, lateral forces, and a lag of the separation point."""
    found, dt = six(), 0.04
    time = np.arange(0.0, 8.0, dt)
    pulse = lambda begin: np.interp(time - begin, [0.0, 0.4, 1.0, 1.4, 2.0, 2.4], [0.0, 1.0, 1.0, -1.0, -1.0, 0.0])
    inputs = {"elevator": -0.02 - 0.05 * pulse(0.5), "aileron": 0.03 * pulse(2.0), "rudder": 0.04 * pulse(4.0)}
    inputs |= {"thrust": np.full(len(time), 3e4)}
    start = {"airspeed": 95.0, "alpha": 0.12, "theta": 0.12, "altitude": 5000.0}
    values = {n: jnp.asarray(x) for n, x in found.values.items()}
    sim = flown(loaded(found, tmp_path), start, inputs, dt, SIX_FRAMES, STATES | {"X": ("bayes-aero/state/X", 1.0)})
    expected = simulated(RigidBody(found.model, values, found.aircraft), start, inputs, dt, X=sim["X"][0])
    assert found.model.axes == BOTH
    within(sim, expected, STATES)


def test_an_aircraft_at_rest_falls_and_words_of_its_card_end_no_comment(tmp_path):
    """From 0 m/s with free fall of 0.5 s: every coefficient and state stays a number, and the speed is g t. The title
    would close the comment of the XML."""
    sim = loaded(replace(stall(5.0), title="x --> <aerodynamics> <-- & --->"), tmp_path)
    assert sim["metrics/Sw-sqft"] == pytest.approx(64.0 / FOOT**2, rel=1e-6)
    sim.set_dt(0.01)
    started(sim, {"airspeed": 0.0, "altitude": 5000.0, "alpha": 0.0, "theta": 0.0, "q": 0.0})
    for _ in range(50):
        sim.run()
    read = [sim[f"bayes-aero/coefficient/{n}"] for n in ("CL", "CD", "Cm")]
    assert np.all(np.isfinite([*read, sim["velocities/q-rad_sec"], sim["bayes-aero/state/X"]]))
    assert sim["velocities/vt-fps"] * FOOT == pytest.approx(9.80665 * sim["simulation/sim-time-sec"], rel=0.05)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The FMU, the package's flight, and what the FMU gives along it."""
    found, folder = stall(5.0), tmp_path_factory.mktemp("fmu")
    path = write_fmu(found, folder)
    system, start, inputs, record = recorded_stall(found, 25.0, 50.0)
    flight = simulated(system, start, inputs, record.dt)
    flight |= {"elevator": inputs["elevator"], "mach": flight["airspeed"] / np.asarray(air(flight["altitude"])[1])}
    time = record.time - record.time[0]
    names = found.program.inputs_of("signal")
    signals = np.zeros(len(time), dtype=[("time", float), *((name, float) for name in names)])
    signals["time"] = time
    for name in names:
        signals[name] = flight[name]
    steps = {"output_interval": STEP, "step_size": STEP}
    told = fmpy.simulate_fmu(str(path), stop_time=float(time[-1]), input=signals, validate=True, **steps)
    return SimpleNamespace(found=found, path=path, time=time, flight=flight, told=told)


def test_the_description_is_valid_and_it_follows_the_packages_flight(exported):
    """Its own part is the lag of the separation point; the flow along the way is the input."""
    assert validate_fmu(str(exported.path)) == []
    description = fmpy.read_model_description(str(exported.path))
    assert description.fmiVersion == "2.0"
    assert description.coSimulation is not None
    by_kind: dict = {}
    for variable in description.modelVariables:
        by_kind.setdefault(variable.causality, set()).add(variable.name)
    assert by_kind["input"] == set(exported.found.program.inputs_of("signal"))
    assert {"CL", "CD", "Cm", "X"} <= by_kind["output"]
    start = {v.name: float(v.start) for v in description.modelVariables if v.causality == "parameter"}
    assert start["parameter.CLa"] == exported.found.values["CLa"]
    assert np.ptp(exported.flight["X"]) > 0.3
    for name in ("CL", "CD", "Cm", "X"):
        expected = exported.flight[name]
        error = np.abs(np.interp(exported.time, exported.told["time"], exported.told[name]) - expected)
        assert error[25:].max() <= LARGEST * np.ptp(expected), name  # X begins at its static value of either alpha-dot


def test_parameters_can_be_set(exported):
    signals = {"airspeed": 90.0, "alpha": 0.1, "mach": 0.3}
    usual, changed = (
        fmpy.simulate_fmu(str(exported.path), stop_time=0.1, output_interval=0.1, start_values=signals | more)
        for more in ({}, {"parameter.CL0": 0.55})
    )
    assert changed["CL"][-1] - usual["CL"][-1] == pytest.approx(0.55 - 0.15, abs=1e-12)
