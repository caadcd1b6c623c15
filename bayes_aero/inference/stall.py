"""The stall in two numbers with intervals: the highest steady lift coefficient, and the angle at which it is reached.

Quasi-steady: CL(alpha) at alpha-dot = 0 and zero rates, all other signals at their median near the stall. The maximum
is sought over the recorded angles; where it is at their edge, the record does not contain the stall.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.simulated.trim import conditions, steady_flow
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.inference.identification import Identification, Interval, Stall
from bayes_aero.inference.posterior.posterior import Posterior, PosteriorStatus
from bayes_aero.model.model import Model

POINTS = 241  # angles: less than 0.1 deg apart over 20 deg, and the maximum is found between them
DRAWS = 400
LEVELS = (0.025, 0.5, 0.975)
RATE_SHARES = (0.05, 0.95)  # quantiles of the recorded alpha-dot at which separation is shown beside the steady one


def stall_of(model: Model, draws: Float[np.ndarray, "m k"], signals: Mapping[str, Any], aircraft: Aircraft) -> Stall:
    """The stall over draws of the free parameters (columns as `model.names`), within the angles that `signals` hold."""
    thin = draws[np.unique(np.linspace(0, len(draws) - 1, min(DRAWS, len(draws))).astype(int))]
    flown = np.asarray(signals["alpha"])
    alpha = np.linspace(float(flown.min()), float(flown.max()), POINTS)
    low, high = np.quantile(np.asarray(signals["alpha_dot"]), RATE_SHARES)
    rates = np.array([min(low, 0.0), 0.0, max(high, 0.0)])
    reference = conditions(signals)
    held = {name: jnp.asarray(value) for name, value in reference.items()}
    found = _flows(model, jnp.asarray(thin), jnp.asarray(alpha), jnp.asarray(rates), held, aircraft)
    X, CL, CD = (np.asarray(found[name]) for name in ("X", "CL", "CD"))  # (m, rates, angles)
    steady, drag = CL[:, 1], CD[:, 1]
    peak, place, edge = maxima(alpha, steady)
    return Stall(
        alpha=alpha,
        CL=np.quantile(steady, LEVELS, axis=0),
        CD=np.quantile(drag, LEVELS, axis=0),
        rates=rates,
        X=np.moveaxis(np.quantile(X, LEVELS, axis=0), 0, 1),
        CL_max=Interval.of(peak),
        alpha_max=Interval.of(place),
        at_edge=float(np.mean(edge)),
        reference=reference,
    )


def stall_of_posterior(model: Model, posterior: Posterior, signals: Mapping[str, Any], aircraft: Aircraft) -> Stall:
    """`stall_of` the draws of a posterior, without its noise parameters."""
    return stall_of(model, posterior.draws()[:, [posterior.names.index(n) for n in model.names]], signals, aircraft)


def stall_of_run(run: Identification) -> Stall | None:
    """CLmax and its angle from the first posterior that converged; without one there is none."""
    for key, posterior in run.posteriors.items():
        if key != "white" and posterior.status is PosteriorStatus.CONVERGED:
            o = run.observations
            return stall_of_posterior(run.model, posterior, o.signals, o.aircraft)
    return None


def maxima(x: Float[np.ndarray, " g"], y: Float[np.ndarray, "m g"]):
    """Maximum of every row, its position (by a parabola through three even points), and whether it is at an edge."""
    i = np.argmax(y, axis=1)
    edge = (i == 0) | (i == len(x) - 1)
    j = np.clip(i, 1, len(x) - 2)
    rows = np.arange(len(y))
    before, here, after = y[rows, j - 1], y[rows, j], y[rows, j + 1]
    bend = np.where(edge, -1.0, before - 2.0 * here + after)
    shift = np.where(edge | (bend >= 0.0), 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, -1.0))
    step = x[1] - x[0]
    peak = np.where(edge, y[rows, i], here - 0.25 * (before - after) * shift)
    return peak, np.where(edge, x[i], x[j] + shift * step), edge


@eqx.filter_jit
def _flows(model, thetas: Float[Array, "m k"], alpha: Float[Array, " g"], rates: Float[Array, " r"], held, aircraft):
    flows = jax.vmap(lambda theta, rate: steady_flow(model, theta, alpha, rate, held, aircraft), in_axes=(None, 0))
    return jax.lax.map(lambda theta: flows(theta, rates), thetas)
