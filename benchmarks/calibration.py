"""Simulation-based calibration: ranks of the truth among posterior draws, over data drawn from the prior.

    python benchmarks/calibration.py emcee 300 --out calibration      # stall posterior, AR(1) noise
    python benchmarks/calibration.py NUTS 300 --out calibration
    python benchmarks/calibration.py gp 300 --out calibration         # hyperparameters of a Gaussian process
    python benchmarks/calibration.py report --out calibration         # tables of what is there

Every replicate is one line of OUT/<what>.jsonl; a study that was interrupted goes on where it stopped.

Source: Talts, Betancourt, Simpson, Vehtari and Gelman 2018, arXiv:1804.06788; the bands of the ranks' distribution
function are simultaneous, after Sailynoja, Burkner and Vehtari 2022, Stat. Comput. 32, 32 (ArviZ).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd
from arviz_stats.ecdf_utils import ecdf_pit
from jaxtyping import Float, Int
from studies import Row, parser_of, rows_of, run_seeds

from bayes_aero.flight.card import read_card
from bayes_aero.inference.gp import Budget, sample_posterior, systematic_resample
from bayes_aero.inference.gp_kernel import Priors, ReducedData, find_map
from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.results import Posterior
from bayes_aero.inference.sampling import density_start, sample_ensemble, sample_nuts, search_modes
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Colour, Density, Noise, Observations, observe
from bayes_aero.simulate.demo import simulate_stall

DRAWS = 99  # posterior draws that a truth is ranked among: ranks 0 to 99
BAND = 0.95  # simultaneous over the whole distribution function of one parameter
BAND_DRAWS = 10_000  # simulated rank samples behind the band
EVERY = 16  # samples of the demo's two manoeuvres: 282 at 1.6 Hz, so that the prior matters beside the data
INPUTS, SAMPLES = ("alpha", "elevator"), 80  # of the Gaussian process
ENGINES: dict[str, Callable[..., Posterior]] = {"emcee": sample_ensemble, "NUTS": sample_nuts}
STUDIES = (*ENGINES, "gp")


def rank(truth: Float[np.ndarray, " k"], draws: Float[np.ndarray, "m k"]) -> Int[np.ndarray, " k"]:
    """How many of `DRAWS` evenly thinned draws lie below the truth."""
    kept = draws[np.linspace(0, len(draws) - 1, DRAWS).astype(int)]
    return np.sum(kept < truth, axis=0)


def band_of(ranks: Sequence[int] | np.ndarray) -> tuple[bool, float]:
    """Whether the distribution function of ranks from 0 to `DRAWS` stays within the simultaneous band of the uniform
    one, and the largest difference of the two. Within its rank a truth is placed at random."""
    n = len(ranks)
    within = np.random.default_rng(0).uniform(size=n)
    share = np.sort((np.asarray(ranks) + within) / (DRAWS + 1))
    at, lower, upper = _limits(n)
    found = np.searchsorted(share, at, side="right") / n
    return bool(np.all((found >= lower) & (found <= upper))), float(np.abs(found - at).max())


@cache
def _limits(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the distribution function of n uniform values is looked at, and its band there."""
    uniform = np.linspace(0.0, 1.0, n)
    at, _, lower, upper = ecdf_pit(uniform, BAND, BAND_DRAWS, rng=np.random.default_rng(1))
    return np.asarray(at), np.asarray(lower), np.asarray(upper)


def replicate(seed: int, names: Sequence[str], ranks: Int[np.ndarray, " k"], status: str) -> Row:
    """The truth's ranks among `DRAWS` draws, by parameter, and how the sampler says it ended."""
    return {"seed": seed, "ranks": dict(zip(names, map(int, ranks), strict=True)), "status": status}


def stall_replicate(model: Model, observations: Observations, engine: str, seed: int) -> Row:
    """Parameters and AR(1) noise drawn from their priors, coefficients simulated, inferred as a user would.

    `observations` lend their signals only.
    """
    rng = np.random.default_rng([seed, 5])
    maker = Density(observations, model, Noise(Colour.AR1))
    x = maker.sample_prior(rng, 1)[0]
    white = jnp.asarray(rng.standard_normal((observations.n, 3)))
    data = observations.with_measured(maker.replicate(jnp.asarray(x), white))
    density = Density(data, model, Noise(Colour.AR1))
    mode = search_modes(density, density_start(density, fit_mle(model, data, seed=seed)), data.n, seed=seed)
    posterior = ENGINES[engine](density, mode, seed=seed, predictive=False)
    return replicate(seed, density.names, rank(x, rng.permutation(posterior.draws())), posterior.status.name.lower())


def process_replicate(inputs: Float[np.ndarray, "n d"], names: tuple[str, ...], seed: int) -> Row:
    """Hyperparameters drawn from their priors, a sample function with noise, sampled by exact weights.

    `inputs` in deviations. Draws are those that exact weights resample.
    """
    rng, priors = np.random.default_rng([seed, 6]), Priors()
    d = inputs.shape[1]
    theta = priors.sample(rng, d, 1)[0]
    y = np.linalg.cholesky(covariance(theta, inputs)) @ rng.standard_normal(len(inputs))
    data = ReducedData.of(inputs, y)
    best = find_map(data, priors, starts=4, polish=1, seed=seed)[0]
    found = sample_posterior(best, data, priors, budget=Budget(draws=400, seed=seed))
    own = rank(theta, rng.permutation(found.theta[systematic_resample(found.log_weight, seed)]))
    linear, length = ([f"{kind}[{name}]" for name in names] for kind in ("linear", "length_scale"))
    return replicate(seed, ["constant", *linear, "signal", *length, "noise"], own, found.status.name)


def covariance(theta: Float[np.ndarray, " p"], x: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n n"]:
    """Constant, linear, squared exponential and noise, written out: independent of the engine that it tests."""
    d = x.shape[1]
    constant, linear, signal = np.exp(theta[0]), np.exp(theta[1 : d + 1]), np.exp(theta[d + 1])
    length, noise = np.exp(theta[d + 2 : 2 * d + 2]), np.exp(theta[-1])
    scaled = x / length
    squared = ((scaled[:, None] - scaled[None]) ** 2).sum(axis=2)
    K = constant**2 + (x * linear) @ (x * linear).T + signal**2 * np.exp(-0.5 * squared)
    return K + noise**2 * np.eye(len(x))


def calibration_table(replicates: Sequence[Row]) -> pd.DataFrame:
    """A row per parameter: mean rank (0.5 wanted), share that 50 and 90 % intervals cover, inside the band or not."""
    rows = {}
    for name in replicates[0]["ranks"]:
        ranks = np.array([r["ranks"][name] for r in replicates])
        place = (ranks + 0.5) / (DRAWS + 1)
        rows[name] = {
            "replicates": len(ranks),
            "mean rank": place.mean(),
            "in 50 %": np.mean(np.abs(place - 0.5) <= 0.25),
            "in 90 %": np.mean(np.abs(place - 0.5) <= 0.45),
            "inside band": band_of(ranks)[0],
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def study(what: str) -> Callable[[int], Row]:
    """One replicate as a row, by its seed."""
    card = read_card("attas")
    model = Model.from_card(card)
    observations = observe([simulate_stall(i, card=card) for i in range(2)], card, model)
    if what != "gp":
        thinned = observations.thinned(EVERY)
        return lambda seed: stall_replicate(model, thinned, what, seed)
    x = np.stack([np.asarray(observations.signals[name]) for name in INPUTS], axis=1)
    x = x[np.linspace(0, len(x) - 1, SAMPLES).astype(int)]
    x = (x - x.mean(axis=0)) / x.std(axis=0)
    return lambda seed: process_replicate(x, INPUTS, seed)


def report(out: Path) -> None:
    """Tables of the replicates so far."""
    for what in STUDIES:
        if not (found := rows_of(out / f"{what}.jsonl")):
            continue
        print(f"\n{what}: {len(found)} replicates; {dict(Counter(r['status'] for r in found))}")
        table = calibration_table(found)
        print(table.to_string(float_format=lambda v: f"{v:.3f}"))
        outside = int((~table["inside band"].astype(bool)).sum())
        print(f"outside the 95 % band: {outside} of {len(table)}; by chance alone {0.05 * len(table):.1f} are expected")


if __name__ == "__main__":
    given = parser_of(__doc__, "calibration", (*STUDIES, "report"), count=300).parse_args()
    if given.what == "report":
        report(given.out)
    else:
        run_seeds(given, f"{given.what}.jsonl", study(given.what), one_length=True)
