"""The exported FMU by another library, fmpy: its description, and a simulation through a recorded stall."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from exported_models import stall
from jsbsim_flights import simulated

from bayes_aero.dynamics.aircraft import Longitudinal
from bayes_aero.export.fmu import write_fmu
from bayes_aero.simulate.demo import simulate_stall

fmpy = pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu")
LARGEST = 1e-3  # of an output's range, at `STEP`
STEP = 0.001  # s: a step holds its inputs


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The FMU, the package's flight, and what the FMU gives along it."""
    found, folder = stall(5.0), tmp_path_factory.mktemp("fmu")
    path = write_fmu(found, folder)
    record = simulate_stall(0, sensor_noise=0.0, disturbance=0.0).window(25.0, 50.0)
    c = record.channels
    inputs = {"elevator": c["elevator"], "thrust": c["thrust_left"] + c["thrust_right"]}
    start = {name: float(c[name][0]) for name in ("airspeed", "alpha", "theta", "q", "altitude")} | {"X": 1.0}
    system = Longitudinal(found.model, {n: jnp.asarray(x) for n, x in found.values.items()}, found.aircraft)
    flight = simulated(system, start, inputs, record.dt)
    flight |= {"elevator": inputs["elevator"], "mach": _mach(flight)}
    time = record.time - record.time[0]
    names = found.program.inputs_of("signal")
    signals = np.zeros(len(time), dtype=[("time", float), *((name, float) for name in names)])
    signals["time"] = time
    for name in names:
        signals[name] = flight[name]
    steps = {"output_interval": STEP, "step_size": STEP}
    told = fmpy.simulate_fmu(str(path), stop_time=float(time[-1]), input=signals, validate=True, **steps)
    return SimpleNamespace(found=found, path=path, time=time, flight=flight, told=told)


def _mach(flight):
    from bayes_aero.physics.aircraft import air

    return flight["airspeed"] / np.asarray(air(flight["altitude"])[1])


def test_the_description_is_valid(exported):
    from fmpy.validation import validate_fmu

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


@pytest.mark.parametrize("name", ["CL", "CD", "Cm", "X"])
def test_it_follows_the_packages_flight(exported, name):
    """Its own part is the lag of the separation point; the flow along the way is the input."""
    expected, told = exported.flight[name], exported.told
    there = np.interp(exported.time, told["time"], told[name])
    if name == "X":
        assert np.ptp(expected) > 0.3
    error = np.abs(there - expected)[25:]  # X begins at its static value of either alpha-dot
    assert error.max() <= LARGEST * np.ptp(expected)


def test_parameters_can_be_set_and_it_runs_from_rest(exported):
    signals = {"airspeed": 90.0, "alpha": 0.1, "mach": 0.3}
    usual, told = (
        fmpy.simulate_fmu(str(exported.path), stop_time=0.1, output_interval=0.1, start_values=signals | more)
        for more in ({}, {"parameter.CL0": 0.55})
    )
    assert told["CL"][-1] - usual["CL"][-1] == pytest.approx(0.55 - 0.15, abs=1e-12)
    # Cm = Cm0 + Cma alpha + Cmq q c/V with V = 1 m/s, attached flow.
    rest = {"airspeed": 0.0, "alpha": 0.02, "mach": 0.0, "q": 0.1, "elevator": 0.0, "alpha_dot": 0.0}
    start = {n: x for n, x in rest.items() if n in exported.found.program.inputs_of("signal")}
    told = fmpy.simulate_fmu(str(exported.path), stop_time=0.1, output_interval=0.1, start_values=start)
    v, chord = exported.found.values, exported.found.aircraft.chord
    X = told["X"][-1]
    right = v["Cm0"] + v["Cma"] * 0.02 + v["Cmq"] * 0.1 * chord + v["CmX"] * (1.0 - X)
    assert told["Cm"][-1] == pytest.approx(right, rel=1e-9)
