"""How often 95 % intervals cover the truth: bounds and posteriors side by side on simulated noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float

from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.posterior.ensemble import EnsembleLength, sample_ensemble
from bayes_aero.inference.posterior.laplace import density_start, find_mode
from bayes_aero.model.density import Density
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import Observations
from bayes_aero.progress import Progress

METHODS = ("CRB", "corrected CRB", "white posterior", "AR(1) posterior")
Z95 = 1.959963984540054


@dataclass(frozen=True)
class Coverage:
    """`inside[m, r, k]` is 1 where method m's interval of parameter k covered the truth in replicate r, else 0.

    `width` is its length. Both are NaN where a method was not tried.
    """

    names: tuple[str, ...]
    inside: Float[np.ndarray, "methods replicates k"]
    width: Float[np.ndarray, "methods replicates k"]
    converged: Float[np.ndarray, " replicates"]

    def table(self) -> pd.DataFrame:
        """Share covered, a row per parameter and one for all, a column per method."""
        shares = pd.DataFrame(np.nanmean(self.inside, axis=1).T, index=list(self.names), columns=list(METHODS))
        shares.loc["all"] = shares.mean()
        return shares


def coverage_study(
    model: Model,
    observations: Observations,
    truth: Mapping[str, float],
    noise: Mapping[str, float],
    *,
    replicates: int,
    seed: int,
    white: int | None = None,
    ensembles: int = 2,
    max_steps: int = 1000,
    progress: Progress | None = None,
) -> Coverage:
    """Simulate coefficients from `truth` with AR(1) noise, infer them in four ways, count covered parameters.

    `observations` lend their signals only. Intervals: estimate +- 1.96 bounds, and equal-tailed posterior intervals.
    Every replicate is counted, converged or not; `converged` is the share of its posteriors that were. The posterior
    under white noise, which is there to be seen failing, is sampled for the first `white` replicates (default: all).
    """
    theta = np.array([truth[name] for name in model.names])
    maker = Density(observations, model, Noise(Colour.AR1))
    x_true = jnp.asarray(np.concatenate([theta, [noise[p.name] for p in maker.noise.parameters]]))
    rng = np.random.default_rng(seed)
    inside, width, good = [], [], []
    for replicate in range(replicates):
        draws = jnp.asarray(rng.standard_normal((observations.n, 3)))
        data = observations.with_measured(maker.replicate(x_true, draws))
        mle = fit_mle(model, data, start=theta, extra_starts=0)
        low = [mle.estimate - Z95 * mle.crb, mle.estimate - Z95 * mle.crb_corrected]
        high = [mle.estimate + Z95 * mle.crb, mle.estimate + Z95 * mle.crb_corrected]
        sound = []
        for colour in (Colour.WHITE, Colour.AR1):
            if colour is Colour.WHITE and white is not None and replicate >= white:
                low.append(np.full(len(theta), np.nan))
                high.append(np.full(len(theta), np.nan))
                continue
            density = Density(data, model, Noise(colour))
            mode = find_mode(density, density_start(density, mle))
            posterior = sample_ensemble(
                density, mode, seed=replicate, length=EnsembleLength(ensembles, max_steps), predictive=False
            )
            ends = np.array([posterior.marginals[name].ci95 for name in model.names])
            low.append(ends[:, 0])
            high.append(ends[:, 1])
            sound.append(posterior.status.name == "CONVERGED")
        inside.append(
            [np.where(np.isnan(a), np.nan, (a <= theta) & (theta <= b)) for a, b in zip(low, high, strict=True)]
        )
        width.append([b - a for a, b in zip(low, high, strict=True)])
        good.append(np.mean(sound))
        if progress:
            progress(f"replicate {replicate + 1}", (replicate + 1) / replicates)
    return Coverage(
        model.names, np.swapaxes(np.array(inside), 0, 1), np.swapaxes(np.array(width), 0, 1), np.array(good)
    )
