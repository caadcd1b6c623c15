"""Stalls of one aircraft whose parameters scatter, identified and pooled; one more stall is looked for."""

from __future__ import annotations

import time
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from bayes_aero.flight.card.card import read_card
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.posterior.pooled.next_flight import next_flight
from bayes_aero.inference.posterior.pooled.normal_estimates import from_prior_units, to_prior_units
from bayes_aero.model.density import Density
from bayes_aero.model.model import Model
from bayes_aero.model.noise import DEFAULT, Noise
from bayes_aero.model.observations import Observations, observe
from bayes_aero.simulate.demo import DISTURBANCE, TRUTH, simulate_stall

SCATTER = 0.15  # of the priors' standard deviations


def _flown(density: Density, theta: np.ndarray, rng: np.random.Generator) -> Observations:
    """Coefficients of one stall with coloured noise that grows as the flow separates."""
    noise = [DISTURBANCE.get(p.name, p.start) for p in density.noise.parameters]
    x = jnp.asarray([*theta, *noise])
    o = density.observations
    return o.with_measured(density.replicate(x, jnp.asarray(rng.standard_normal(o.measured.shape))))


def fly_again(aircraft: int, manoeuvres: int) -> None:
    """How often the true parameters of one more stall lie in the 95 % intervals of the next flight."""
    card = read_card("attas")
    model, began = Model.from_card(card), time.perf_counter()
    clean = observe([simulate_stall(i, card=card, sensor_noise=0.0, disturbance=0.0) for i in range(2)], card, model)
    parts = [Density.of(clean.only(m % 2), model, Noise(DEFAULT)) for m in range(2)]
    centre = np.array([float(to_prior_units(p.prior, TRUTH[p.name])) for p in model.free])
    inside, jointly, truly = [], [], []
    for number in range(aircraft):
        rng = np.random.default_rng([11, number])
        theta = [
            np.array([float(from_prior_units(p.prior, v)) for p, v in zip(model.free, one, strict=True)])
            for one in centre + SCATTER * rng.standard_normal((manoeuvres + 1, len(centre)))
        ]
        flown = [_flown(parts[m % 2], theta[m], rng) for m in range(manoeuvres)]
        flown = [replace(o, names=(f"flight{m}",)) for m, o in enumerate(flown)]
        fits = {o.names[0]: fit_mle(model, o, extra_starts=2, seed=number) for o in flown}
        found = next_flight(model, flown[0], fits, seed=number)
        low, high = np.array([found.following[n].ci95 for n in model.names]).T
        inside.append((theta[-1] > low) & (theta[-1] < high))
        low, high = np.array([found.aircraft[n].ci95 for n in model.names]).T
        at = np.array([TRUTH[n] for n in model.names])
        truly.append((at > low) & (at < high))
        weights = np.array([np.linalg.inv(f.corrected) for f in fits.values()])
        covariance = np.linalg.inv(weights.sum(axis=0))
        common = covariance @ sum(w @ f.estimate for w, f in zip(weights, fits.values(), strict=True))
        jointly.append(np.abs(theta[-1] - common) < 1.96 * np.sqrt(np.diag(covariance)))
    seconds = time.perf_counter() - began
    print(f"{aircraft} aircraft of {manoeuvres} stalls, scatter {SCATTER} of the priors', {seconds:.0f} s")
    for what, one in (
        ("next stall in the interval of the next flight", inside),
        ("next stall in the interval of one value for all", jointly),
        ("true aircraft in its interval", truly),
    ):
        each = np.mean(one, axis=0)
        worst = model.names[int(np.argmin(each))]
        print(f"  {what}: {np.mean(one):.1%} (least {each.min():.0%}, {worst})")
