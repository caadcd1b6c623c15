"""The posterior of the stall model under white noise: ours and stock emcee on the same log-density.

Ours runs until its targets are met; peers run a fixed number of steps with 38 walkers and emcee's stretch move, from
the same ball around the mode. ESS is ArviZ's bulk ESS of the parameter that has least of it, with the walkers of an
ensemble laid end to end everywhere.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from contender import Problem, stall

BALL = 0.5  # of the Laplace approximation's deviation, as in `sample_ensemble`
QUICK = {"emcee": (2, 100), "NUTS": (2, 100, 1)}  # the length of a run
BURN_IN = 5.0  # autocorrelation times that are left out, emcee's own advice


class Drawn(NamedTuple):
    """Draws (chain, draw, 17) on the scale of the data, and the share of the run that is not burn-in."""

    x: np.ndarray
    kept: float = 1.0


Run = Callable[[int], Drawn]


def ours(engine: str) -> Callable[[Problem, int, argparse.Namespace], Run]:
    """`sample_ensemble` or `sample_nuts`, as `identify` runs them; their burn-in always counts."""

    def prepared(problem: Problem, _: int, options: argparse.Namespace) -> Run:
        from bayes_aero.inference.sampling import ModeStatus, PosteriorMode
        from bayes_aero.model.noise import Colour, Density, Noise

        model, observations = stall(problem)
        density = Density(observations, model, Noise(Colour.WHITE))
        mode = PosteriorMode(problem.u, problem.factor, problem.posterior(problem.u), ModeStatus.CONVERGED)
        if engine == "emcee":
            from bayes_aero.inference.sampling import EnsembleLength as Length
            from bayes_aero.inference.sampling import sample_ensemble as sample
        else:
            from bayes_aero.inference.sampling import NutsLength as Length
            from bayes_aero.inference.sampling import sample_nuts as sample
        length: Any = Length(*QUICK[engine]) if options.quick else Length()

        def run(seed: int) -> Drawn:
            found = sample(density, mode, seed=seed, predictive=False, length=length)
            posterior = found.tree["posterior"].to_dataset()
            return Drawn(np.stack([np.asarray(posterior[name]) for name in problem.names], axis=-1))

        return run

    return prepared


def begin(problem: Problem, seed: int) -> np.ndarray:
    """As many walkers as ours (38), around the mode."""
    size = len(problem.u)
    normal = np.random.default_rng(seed).standard_normal((2 * (size + 2), size))
    return problem.u + BALL * normal @ problem.factor.T


def halves(chain: np.ndarray) -> tuple[np.ndarray, float]:
    """A chain (step, walker, k) without its burn-in, and the share that is left.

    Walkers are laid end to end, those of one half of the ensemble as a chain: R-hat of one chain alone is not defined.
    """
    import emcee

    tau = float(np.max(emcee.autocorr.integrated_time(chain, tol=0, quiet=True)))
    discard = min(int(BURN_IN * tau), len(chain) // 2)
    return np.swapaxes(chain[discard:], 0, 1).reshape(2, -1, chain.shape[2]), 1.0 - discard / len(chain)


def end_to_end(problem: Problem, chain: np.ndarray) -> Drawn:
    """The draws of a chain (step, walker, 17) of u."""
    u, kept = halves(chain)
    return Drawn(problem.posterior.bounded(u)[0], kept)


def stock_emcee(problem: Problem, _: int, options: argparse.Namespace) -> Run:
    """One ensemble, its default move, the density called walker by walker."""
    import emcee

    def run(seed: int) -> Drawn:
        walkers = begin(problem, seed)
        np.random.seed(seed)  # noqa: NPY002 - emcee takes this generator only
        sampler = emcee.EnsembleSampler(*walkers.shape, problem.posterior)
        sampler.run_mcmc(walkers, options.steps)
        return end_to_end(problem, sampler.get_chain())

    return run


def judge(problem: Problem, _: int, warm: list[tuple[float, Drawn]]) -> dict:
    """Medians over the runs of the least ESS and of its rates; the worst R-hat; means, to see that they agree."""
    from bayes_aero.inference.sampling import diagnose

    names = problem.names
    ess, rate, free, rhat = [], [], [], []
    for seconds, drawn in warm:
        marginals = diagnose(drawn.x, names)
        least = min(m.ess_bulk for m in marginals.values())
        ess.append(least)
        rate.append(least / seconds)
        free.append(least / (seconds * drawn.kept))
        rhat.append(max(m.rhat for m in marginals.values()))
    x = np.concatenate([drawn.x.reshape(-1, len(names)) for _, drawn in warm])
    told = {"ess": statistics.median(ess), "rate": statistics.median(rate), "free": statistics.median(free)}
    return told | {"rhat": max(rhat), "mean": x.mean(axis=0).tolist(), "sd": x.std(axis=0).tolist()}


CONTENDERS = {
    "bayes_aero, emcee": ours("emcee"),
    "bayes_aero, NUTS": ours("NUTS"),
    "emcee": stock_emcee,
}
