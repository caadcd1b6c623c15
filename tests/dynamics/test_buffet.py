"""Buffet in the equations of motion, and its intensity and length found in a simulated stall."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from gusty_flight import TRUTH

from bayes_aero.dynamics.aircraft.longitudinal import Longitudinal
from bayes_aero.dynamics.filtering.innovations import neighbour_correlation
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import segments
from bayes_aero.dynamics.system import advance
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.disturbed import disturbed
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorStatus, fit_prediction_error
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model

FINER = 5
DT, N, INTENSITY, LENGTH = 0.05, 1000, 0.15, 6.0
NOISE = {"airspeed": 0.1, "alpha": 0.001, "theta": 0.0005, "q": 0.0005, "ax": 0.02, "az": 0.05}
TRUTH = TRUTH | {"a1": 30.0, "alpha_star": 0.15}
FREE = ("CLa", "Cm0", "a1", "alpha_star")
SEPARATED = ("flow_separation", "kirchhoff_lift")


def model_of(card, *more):
    """Of which four parameters are free, and what disturbs it."""
    model = Model.from_card(card).extended(*SEPARATED)
    held = {p.name: TRUTH[p.name] for p in model.parameters if p.name not in FREE}
    return model.extended(*more, fixed=held)


@pytest.fixture(scope="module")
def shaken():
    """A flight that passes to and fro over the stall, shaken by buffet; its noise comes five times a sample."""
    card, rng, h = read_card("hfb320"), np.random.default_rng(4), DT / FINER
    model = model_of(card, "buffet")
    values = {name: jnp.asarray(x) for name, x in (TRUTH | {"buffet": INTENSITY, "buffet_length": LENGTH}).items()}
    system = Longitudinal(model, {p.name: values[p.name] for p in model.parameters}, card.aircraft, False)
    assert system.states[-1] == "buffet"
    n = N * FINER
    angle = 0.12 + 0.05 * np.sin(2.0 * np.pi * h * np.arange(n) / 12.0)
    moment = TRUTH["Cm0"] + TRUTH["CmV"] + TRUTH["Cma"] * angle - 0.018  # of the thrust
    inputs = {"elevator": -moment / TRUTH["Cmde"], "thrust": np.full(n, 9e3), "density": np.full(n, 0.792)}
    at = lambda k: {name: jnp.asarray(y[min(k, n - 1)]) for name, y in inputs.items()}
    further, seen = eqx.filter_jit(advance), eqx.filter_jit(lambda s, x, u: s.motion(x, u)[1])
    x, rows, apart = np.array([104.0, 0.12, 0.12, 0.0, 0.0]), [], []
    for k in range(n):
        if k % FINER == 0:
            found = seen(system, jnp.asarray(x), at(k))
            rows.append([float(found[name]) for name in NOISE])
            apart.append(1.0 - float(found["X"]))
        kept = np.exp(-x[0] / (LENGTH * 2.43) * h)
        shake = kept * x[4] + np.sqrt(1.0 - kept**2) * INTENSITY * rng.standard_normal()
        x = np.append(np.asarray(further(system, jnp.asarray(x), at(k), at(k + 1), h, 1))[:4], shake)
    t, inputs = DT * np.arange(N), {name: y[::FINER] for name, y in inputs.items()}
    z = np.array(rows) + np.array(list(NOISE.values())) * rng.standard_normal((N, len(NOISE)))
    record = FlightRecord.from_arrays("shaken", t, dict(zip(NOISE, z.T, strict=True)) | inputs, "simulated")
    return card, join([record], card, FLIGHT), np.array(apart)


def fitted(card, flights, *more):
    model = model_of(card, *more)
    flown = segments(flights, aircraft_dynamics(model, flights), outputs=tuple(NOISE))
    sd = [NOISE.get(name, 0.0) for name in flown.dynamics.states]
    start = np.array([TRUTH.get(p.name, p.start) for p in flown.dynamics.free])
    return fit_prediction_error(flown, 0.1 * np.array(sd), np.square(list(NOISE.values())), start=start)


@pytest.mark.verify
def test_intensity_and_length_are_found(shaken):
    card, flights, apart = shaken
    assert np.mean(apart < 0.1) > 0.2
    assert np.mean(apart > 0.5) > 0.1
    found = fitted(card, flights, "buffet")
    assert found.status is PredictionErrorStatus.CONVERGED
    known = dict(zip(found.names, zip(found.estimate, found.sd, strict=True), strict=True))
    truth = {"buffet": INTENSITY, "buffet_length": LENGTH} | {name: TRUTH[name] for name in FREE}
    for name, size in truth.items():
        estimate, sd = known[name]
        assert abs(estimate - size) < 3.0 * sd, name
    assert known["buffet"][1] < 0.2 * INTENSITY
    without = fitted(card, flights)
    assert found.log_likelihood - without.log_likelihood > 50.0
    az = tuple(NOISE).index("az")
    alike, coloured = (np.abs(neighbour_correlation(one.found)) for one in (found, without))
    assert np.max(alike) < 4.0 / np.sqrt(N)
    assert coloured[az] > 4.0 / np.sqrt(N)


@pytest.mark.verify
def test_where_buffet_is_modelled_the_sensors_are_steady(shaken):
    """Noise that grows as the flow separates stands for buffet: both would count it twice."""
    card, flights, _ = shaken
    for more, grows in (("buffet",), False), ((), True):
        model = model_of(card, *more)
        flown = segments(flights, aircraft_dynamics(model, flights), outputs=tuple(NOISE))
        swelling = replace(flown, noise_growth=3.0 * flown.noise_growth)
        assert bool(np.all(disturbed(swelling).noise_growth == 1.0)) is not grows
