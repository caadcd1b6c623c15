"""Whether a posterior predicts what was measured (PIT), and how much it leans on its priors.

Under a correct model the values are uniform. Each sample is predicted one step ahead, given those before it in its
manoeuvre; under white noise they carry no information, and the values are those of the predictive distribution.
Sources: Dawid 1984, J. R. Stat. Soc. A 147, 278; Diebold, Gunther and Tay 1998, Int. Econ. Rev. 39, 863.
"""

from __future__ import annotations

from enum import Enum

import arviz_base as azb
import arviz_stats as azs
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax.scipy.special import ndtr
from jaxtyping import Array, Bool, Float
from scipy.stats import binom, norm

from bayes_aero.inference.identification import Histogram, Identification, PitResult
from bayes_aero.inference.likelihood.mle_result import SENSITIVITY_LIMIT
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.model.noise import Colour, Density, LogDensity, Noise

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
    """Posterior probability of less than what was measured, from draws `x` as rows; by sample and coefficient."""
    kept = x[np.linspace(0, len(x) - 1, min(len(x), DRAWS)).astype(int)]
    return np.asarray(_mean_probability(density, jnp.asarray(kept)))


@eqx.filter_jit
def _mean_probability(density: Density, x: Float[Array, "m k"]) -> Float[Array, "n c"]:
    # Noise is normal given the parameters, so each draw's probability is exact and their mean has no steps of 1/m.
    add = lambda total, row: (total + ndtr(density.standardised(row)), None)  # noqa: E731
    return jax.lax.scan(add, jnp.zeros_like(density.observations.measured), x)[0] / len(x)


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


# --- Sensitivity of a posterior to its priors: power-scaling of prior and likelihood.
# Source: Kallioinen, Paananen, Burkner and Vehtari 2024, Stat. Comput. 34, 57; `psense` of ArviZ, by Pareto-smoothed
# importance weights, without sampling again.

PRIOR_SENSITIVITY_DRAWS = 4000


class Dependence(Enum):
    """Whether the data or the prior decide a parameter, by its two sensitivities; the value is the text for the
    user."""

    DATA = "the data decide"
    BOTH = "prior and data conflict, or the prior is informative compared with the data"
    PRIOR = "the prior decides; the record contains little information on this parameter"
    NEITHER = "neither changes it: check its chains"


def prior_sensitivity(density: LogDensity, posterior: Posterior) -> pd.DataFrame:
    """A row per parameter: sensitivity to the prior, to the likelihood, and the conclusion (`Dependence`)."""
    # All priors are scaled together. `posterior` is one of `density`. The Monte Carlo error of the sensitivities is
    # about 0.01 for some thousand draws.
    tree = posterior.tree["posterior"].to_dataset()
    step = max(1, tree.sizes["chain"] * tree.sizes["draw"] // PRIOR_SENSITIVITY_DRAWS)
    x = np.stack([np.asarray(tree[name])[:, ::step] for name in density.names], axis=-1)
    prior, likelihood = (np.asarray(values) for values in _prior_and_likelihood(density, jnp.asarray(x)))
    groups = {
        "posterior": {name: x[..., i] for i, name in enumerate(density.names)},
        "log_prior": {"all": prior},
        "log_likelihood": {"all": likelihood},
    }
    both = azb.from_dict(groups)
    found = {part: azs.psense(both, group=part) for part in ("prior", "likelihood")}
    rows = {name: {part: float(found[part][name]) for part in found} for name in density.names}
    table = pd.DataFrame.from_dict(rows, orient="index")
    by = {(False, True): Dependence.DATA, (True, True): Dependence.BOTH, (True, False): Dependence.PRIOR}
    decided = (tuple(row >= SENSITIVITY_LIMIT) for row in table.to_numpy())
    table["says"] = [by.get(row, Dependence.NEITHER).value for row in decided]
    return table


@eqx.filter_jit
def _prior_and_likelihood(density: LogDensity, x: Float[Array, "chain draw k"]) -> tuple[Array, Array]:
    one = lambda row: (density.log_prior(row), density.log_likelihood(row))  # noqa: E731
    return jax.lax.map(lambda chain: jax.lax.map(one, chain), x)
