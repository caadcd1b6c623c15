"""Probability integral transform of each measured coefficient under its predictive distribution.

Under a correct model the values are uniform. Each sample is predicted one step ahead, given those before it in its
manoeuvre; under white noise they carry no information, and the values are those of the predictive distribution.
Sources: Dawid 1984, J. R. Stat. Soc. A 147, 278; Diebold, Gunther and Tay 1998, Int. Econ. Rev. 39, 863.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Bool, Float
from scipy.stats import binom, norm

from bayes_aero.inference.identification import Histogram, Identification, PitResult
from bayes_aero.model.density import Density
from bayes_aero.model.noise import Colour, Noise

DRAWS = 200  # of the posterior: the probability of a sample hardly varies between them; our choice
MAX_BINS, MIN_PER_BIN = 20, 20
BAND = 0.95  # that all bars of uniform values lie inside


def pit_of(run: Identification) -> PitResult | None:
    """The transform of a run's samples by its first posterior under the chosen noise; None without a posterior."""
    engine = next((key for key in run.posteriors if key != "white"), None)
    if engine is None:
        return None
    posterior = run.posteriors[engine]
    density = Density.of(run.observations, run.model, Noise(Colour(posterior.noise)), run.mle.bias)
    values = pit(density, posterior.draws()[:, [posterior.names.index(name) for name in density.names]])
    columns, start = [values[:, c] for c in range(values.shape[1])], np.asarray(density.observations.start)
    bars, correlation = tuple(map(histogram, columns)), tuple(neighbours(column, start) for column in columns)
    return PitResult(engine, values, bars, correlation)


def pit(density: Density, x: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "n c"]:
    """Posterior probability of less than what was measured, from draws `x` as rows; by sample and coefficient.

    Noise is normal given the parameters, so each draw's probability is exact and their mean has no steps of 1/m.
    """
    kept = x[np.linspace(0, len(x) - 1, min(len(x), DRAWS)).astype(int)]
    return np.asarray(_mean(density, jnp.asarray(kept)))


@eqx.filter_jit
def _mean(density: Density, x: Float[Array, "m k"]) -> Float[Array, "n c"]:
    def add(total, row):
        return total + ndtr(density.standardised(row)), None

    total, _ = jax.lax.scan(add, jnp.zeros_like(density.observations.measured), x)
    return total / len(x)


def histogram(values: Float[np.ndarray, " n"]) -> Histogram:
    """Bars of `values`, with a band by Bonferroni: exact for one bar, a little wide for all together."""
    n = len(values)
    bins = int(np.clip(n // MIN_PER_BIN, 2, MAX_BINS))
    count, edges = np.histogram(values, bins=bins, range=(0.0, 1.0))
    tail = 0.5 * (1.0 - BAND) / bins
    lower, upper = binom.ppf([tail, 1.0 - tail], n, 1.0 / bins)
    return Histogram(edges, count * bins / n, float(lower * bins / n), float(upper * bins / n))


def neighbours(values: Float[np.ndarray, " n"], start: Bool[np.ndarray, " n"]) -> float:
    """Correlation of neighbouring values within manoeuvres, on the normal scale; 0 if they are independent."""
    z = norm.ppf(np.clip(values, 1e-12, 1.0 - 1e-12))
    inside = ~np.asarray(start, bool)[1:]
    return float(np.corrcoef(z[1:][inside], z[:-1][inside])[0, 1])
