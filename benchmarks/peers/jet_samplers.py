"""The posterior of the small jet: ours and aeroid 0.5, whose MCMC is the stretch move with its density from JAX.

Ours samples initial states (4) beside the parameters (11) and noise levels (6); aeroid is given the initial state of
the optimum. ESS is of the 17 that both have. Priors are wide; those of noise levels are each package's own.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from contender import Problem
from jet import aeroid_problem, jet_of, our_fit
from samplers import QUICK, Drawn, halves, worth

WALKERS = 38
FLAT = 1e4  # deviation of the priors, as ours has them in output_error_speed.py


def common(problem: Problem) -> tuple[str, ...]:
    """Names of the parameters that both sides sample."""
    jet = jet_of(problem)
    return (*jet.names, *(f"sigma_{name}" for name in jet.outputs))


def ours(engine: str) -> Callable[[Problem, int, argparse.Namespace], Callable[[int], Drawn]]:
    """`sample_ensemble` or `sample_nuts` on the density of the fit."""

    def prepared(problem: Problem, _: int, options: argparse.Namespace) -> Callable[[int], Drawn]:
        from output_error_speed import problem as jet_problem
        from trajectory_density import trajectory_density

        from bayes_aero.inference.posterior.ensemble import EnsembleLength, sample_ensemble
        from bayes_aero.inference.posterior.laplace import find_mode
        from bayes_aero.inference.posterior.nuts import NutsLength, sample_nuts

        fit = our_fit(jet_problem()[0])
        density = trajectory_density(fit)
        mode = find_mode(density, density.start(fit))
        sample, of = (sample_ensemble, EnsembleLength) if engine == "emcee" else (sample_nuts, NutsLength)
        length: Any = of(*QUICK[engine]) if options.quick else of()
        names = common(problem)

        def run(seed: int) -> Drawn:
            found = sample(density, mode, seed=seed, predictive=False, length=length)
            posterior = found.tree["posterior"].to_dataset()
            return Drawn(np.stack([np.asarray(posterior[name]) for name in names], axis=-1))

        return run

    return prepared


def aeroid_infer(problem: Problem, _: int, options: argparse.Namespace) -> Callable[[int], Drawn]:
    """aeroid.infer from the optimum; its burn-in is left out here, as that of every peer."""
    import aeroid

    jet = jet_of(problem)
    model, data = aeroid_problem(jet, "jax")
    priors = {name: aeroid.Normal(float(x), FLAT) for name, x in zip(jet.names, jet.start, strict=True)}
    names = common(problem)
    initial = dict(zip(names, [*map(float, jet.estimate), *jet.sigma.values()], strict=True))

    def run(seed: int) -> Drawn:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that a chain is short: the table has its R-hat
            found = aeroid.infer(
                model, data, priors, x0=jet.begin, initial=initial, n_walkers=WALKERS, n_steps=options.steps,
                burn_in=0, seed=seed, backend="jax",
            )  # fmt: skip
        order = [found.names.index(name) for name in names]
        chain, kept = halves(found.samples[:, order].reshape(options.steps, WALKERS, len(names)))
        return Drawn(chain, kept)

    return run


def judge(problem: Problem, _: int, warm: list[tuple[float, Drawn]]) -> dict:
    """As for the stall."""
    return worth(warm, common(problem))


CONTENDERS = {"bayes_aero, emcee": ours("emcee"), "bayes_aero, NUTS": ours("NUTS"), "aeroid, MCMC": aeroid_infer}
