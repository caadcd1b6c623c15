"""Modes of motion and objective tests of a fit to trajectories."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np

from bayes_aero.diagnosis.trajectories.motion.flown_modes import flown_modes, steady_of
from bayes_aero.diagnosis.trajectories.motion.objective_tests import Manoeuvre, objective_tests
from bayes_aero.diagnosis.trajectories.motion.results import Motion
from bayes_aero.diagnosis.trajectories.results import FITTED, ProcessNoise, TrajectoryFit
from bayes_aero.dynamics.flight import AircraftDynamics
from bayes_aero.dynamics.linear import LinearDynamics
from bayes_aero.dynamics.output_biases import unbiased
from bayes_aero.effect import Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.tolerances import OBJECTIVE_TESTS

LATERAL = ("beta", "p", "r", "phi")
CONTROLS = ("aileron", "rudder", "spoiler")  # what the names of lateral controls begin with


def motion_of(flown: TrajectoryFit, beside: ProcessNoise | None = None) -> Motion | None:
    """Modes with standard errors, and tests of the lateral motion where it is simulated.

    Modes are of the estimates with process noise where that fit is `preferred`; the tests are of output error's
    trajectories. None without a model of the aircraft, and where the fit did not converge.
    """
    if flown.of_path or not flown.converged:
        return None
    steady = steady_of(flown.fit.flown.flights)
    found, why_not = (), ""
    filtered = beside if beside is not None and beside.preferred else None
    try:
        found = flown_modes(flown.fit, steady, filtered)
    except InputError as reason:
        why_not = str(reason)
    flights = manoeuvres_of(flown) if set(LATERAL) & set(flown.outputs) else []
    tests, untested = objective_tests(flights)
    shown = {row.entry for row in tests}
    sources = {test.name: test.source for test in OBJECTIVE_TESTS if test.entry in shown}
    linear = isinstance(unbiased(flown.fit.flown.dynamics), LinearDynamics)
    about = (math.nan, math.nan) if linear else (steady.airspeed, steady.altitude)
    return Motion(*about, found, why_not, tests, untested, sources, filtered is not None)


def manoeuvres_of(flown: TrajectoryFit) -> list[Manoeuvre]:
    """What the tests need of every fitted manoeuvre inside the envelope."""
    flights = flown.fit.flown.flights
    names = [n for n in flights.channels if n.startswith(CONTROLS)]
    X, found = _separation(flown), []
    for order, name in enumerate(flown.manoeuvres):
        path = flown.path(name, FITTED)
        own = np.flatnonzero(flights.manoeuvre == order)
        own = own[np.isin(flights.time[own], path.time)]
        if path.inside and len(own) == len(path.time):
            controls = {n: np.asarray(flights.channels[n], float)[own] for n in names}
            part = None if X is None else X[own]
            found.append(Manoeuvre(name, path.time, path.measured, path.simulated, controls, part))
    return found


def _separation(flown: TrajectoryFit) -> np.ndarray | None:
    """The static separation point along the records, (n,); None where the model has none."""
    dynamics, flights = unbiased(flown.fit.flown.dynamics), flown.fit.flown.flights
    if not isinstance(dynamics, AircraftDynamics):
        return None
    if not any(e.stage is Stage.SEPARATION for e in dynamics.model.acting):
        return None
    values = dynamics.values(jnp.asarray(flown.fit.estimate[: len(dynamics.free)]))
    signals = dict(dynamics.corrected(values, flights.channels, flights.aircraft))
    signals.setdefault("alpha_dot", jnp.zeros(flights.n))
    aircraft = dynamics.model.actual_aircraft(values, flights.aircraft)
    return np.asarray(dynamics.model.static_separation(values, signals, aircraft))
