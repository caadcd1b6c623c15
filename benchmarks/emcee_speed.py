"""Effective samples a second: this package's emcee against stock emcee on the same white-noise posterior, in one run.

    python benchmarks/emcee_speed.py [RECORD ...] [--repeats 3] [--steps 3000]

Without a record the simulated manoeuvres are used. Stock emcee is one ensemble with its default stretch move and as
many walkers as ours, the density called walker by walker in NumPy; ours is as `identify` runs it. Both begin in the
ball around the posterior mode in which ours begins. ESS is ArviZ's bulk ESS of the parameter that has least of it,
with the walkers of an ensemble laid end to end on both sides. Compilation comes before the clock.
"""

import argparse
import time
from pathlib import Path

import emcee
import jax.numpy as jnp
import numpy as np
from reference import WhitePosterior, agree, load

from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.posterior.assembly import constrain_draws, diagnose
from bayes_aero.inference.posterior.ensemble import sample_ensemble
from bayes_aero.inference.posterior.laplace import density_start, find_mode
from bayes_aero.model.density import Density
from bayes_aero.model.noise import Colour, Noise

BALL = 0.5  # of the Laplace approximation's deviation, as in `sample_ensemble`
BURN_IN = 5.0  # autocorrelation times of stock emcee left out, emcee's own advice


def check(density, theirs, mode):
    """The NumPy density has the package's values on, around and far from the mode; returns how far they are apart."""
    rng = np.random.default_rng(1)
    points = mode.unwhiten(rng.standard_normal((20, density.size)) * np.linspace(0.0, 3.0, 20)[:, None])
    ours = np.array([float(density(jnp.asarray(u))) for u in points])
    return agree(ours, np.array([theirs(u) for u in points]))


def ours_run(density, mode, seed):
    """Seconds, worst bulk ESS, and means and deviations of our sampler."""
    began = time.perf_counter()
    found = sample_ensemble(density, mode, seed=seed, predictive=False)
    seconds = time.perf_counter() - began
    return seconds, found.marginals, found.tree.attrs


def stock_run(density, theirs, mode, seed, steps):
    """Seconds in all and after burn-in, marginals after burn-in, autocorrelation time of stock emcee."""
    walkers = 2 * (density.size + 2)
    start = mode.unwhiten(np.random.default_rng(seed).standard_normal((walkers, density.size)) * BALL)
    np.random.seed(seed)  # noqa: NPY002 - emcee takes this generator only
    sampler = emcee.EnsembleSampler(walkers, density.size, theirs)
    began = time.perf_counter()
    sampler.run_mcmc(start, steps)
    seconds = time.perf_counter() - began
    tau = float(np.max(sampler.get_autocorr_time(tol=0)))
    discard = int(BURN_IN * tau)
    chain = np.swapaxes(sampler.get_chain(discard=discard), 0, 1).reshape(1, -1, density.size)
    x = np.asarray(constrain_draws(density, jnp.asarray(chain)))
    return seconds, seconds * (1.0 - discard / steps), diagnose(x, density.names), tau


def main():
    """Print both rates for every repeat, and the median ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("records", nargs="*", type=Path)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--steps", type=int, default=3000)
    options = parser.parse_args()
    _, model, observations = load(options.records)
    density = Density(observations, model, Noise(Colour.WHITE))
    theirs = WhitePosterior(density)
    mode = find_mode(density, density_start(density, fit_mle(model, observations, extra_starts=0)))
    print(f"n = {observations.n}, {density.size} parameters, densities {check(density, theirs, mode):.0e} apart")
    began = time.perf_counter()
    for _ in range(200):
        theirs(mode.u)
    print(f"NumPy density {1e6 * (time.perf_counter() - began) / 200:.0f} us")
    sample_ensemble(density, mode, predictive=False)  # compiles

    ratios = []
    for seed in range(1, options.repeats + 1):
        seconds, mine, told = ours_run(density, mode, seed)
        everything, kept, stock, tau = stock_run(density, theirs, mode, seed, options.steps)
        least = min(m.ess_bulk for m in mine.values())
        least_stock = min(m.ess_bulk for m in stock.values())
        apart = max(abs(mine[n].mean - stock[n].mean) / mine[n].sd for n in density.names)
        rate = least / seconds
        ratios.append((rate * kept / least_stock, rate * everything / least_stock))
        print(f"seed {seed}: means at most {apart:.2f} sd apart")
        print(f"  ours   ESS {least:6.0f} in {seconds:6.1f} s, burn-in included: {rate:7.1f} a second", end="")
        print(f"  (autocorrelation time {told['autocorrelation_time']:.1f}, acceptance {told['acceptance']:.2f})")
        print(
            f"  stock  ESS {least_stock:6.0f} in {kept:6.1f} s after burn-in: {least_stock / kept:7.1f} a second",
            end="",
        )
        print(f"  (autocorrelation time {tau:.0f}, {options.steps / tau:.0f} of them run)")
    without, with_burn_in = np.median(ratios, axis=0)
    print(f"median ratio: {without:.0f} x, stock's burn-in counted {with_burn_in:.0f} x")


if __name__ == "__main__":
    main()
