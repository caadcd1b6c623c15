"""What all contenders of the stall model are given, and they: maximum likelihood, posterior, Gaussian process.

Ours minimises (n/2) log det R and so finds the residual covariance R, too; peers of the fit are given the R of the
optimum as weights, and all are judged by (n/2) log det R. Posterior: white noise, the same log-density; ours runs until
its targets are met, peers a fixed number of steps with 38 walkers from the same ball. Gaussian process of CL over
(alpha, elevator, q, V): k = s0^2 + sum s_i^2 x_i x_i' + sf^2 exp(-1/2 sum (x_i - x_i')^2 / l_i^2) + sn^2 delta, without
priors, from one start by L-BFGS-B; a result is theta = log [s0, s_1..s_4, sf, l_1..l_4, sn].
"""

from __future__ import annotations

import argparse
import json
import pickle
import resource
import statistics
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from reference import Reference, WhitePosterior, agree

if TYPE_CHECKING:
    from bayes_aero.model.model import Model
    from bayes_aero.model.observations import Observations

PROBLEM, OURS = "problem.pickle", "observations.pickle"


@dataclass(frozen=True)
class Problem:
    """What all contenders are given, in plain NumPy; arrays follow the model's 14 parameters, `u` the density's 17."""

    folder: Path  # where it lies, with our own observations
    reference: Reference
    posterior: WhitePosterior
    start: np.ndarray
    R: np.ndarray  # residual covariance of the optimum, (3,), which peers get as weights
    u: np.ndarray  # posterior mode
    factor: np.ndarray  # lower Cholesky factor of the inverse curvature there
    names: tuple[str, ...]
    processes: dict[int, tuple[np.ndarray, np.ndarray]]  # scaled inputs (n, 4) and output (n,), by n


def stall(problem: Problem) -> tuple[Model, Observations]:
    """The package's own model and observations; only this loads JAX."""
    from bayes_aero.flight.card import read_card
    from bayes_aero.model.model import Model

    return Model.from_card(read_card("attas")), pickle.loads((problem.folder / OURS).read_bytes())


def run_one(block: str, name: str, size: str, options: argparse.Namespace) -> dict[str, Any]:
    """Numbers of one contender of one block, or of the preparation."""
    if block == "prepare":
        prepare(options)
        return {}
    contenders, judge = BLOCKS[block]
    problem = pickle.loads((options.folder / PROBLEM).read_bytes())  # the benchmark's own file
    try:
        run = contenders[name](problem, int(size), options)
    except ModuleNotFoundError as missing:
        return {"failed": f"{missing.name} is not installed"}
    timed = []
    while len(timed) <= options.repeats and (len(timed) < 2 or sum(s for s, _ in timed) < options.seconds):
        if len(timed) == 1 and timed[0][0] > options.seconds:
            break  # so slow that its first run has to do
        began = time.perf_counter()
        result = run(len(timed))
        timed.append((time.perf_counter() - began, result))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # before anything else is loaded
    warm = timed[1:] or timed
    numbers = {"first": timed[0][0], "warm": statistics.median(s for s, _ in warm), "runs": len(timed) - 1}
    return numbers | {"memory": peak} | judge(problem, int(size), warm)


# --- The common data: residuals and density in NumPy, shown to be ours, and samples for the processes.

INPUTS = ("alpha", "elevator", "q", "airspeed")


def prepare(options: argparse.Namespace) -> None:
    """Fill the folder from the records of the command line (none: the simulated ones of the package)."""
    from bayes_aero.flight.card import read_card
    from bayes_aero.flight.reading import read_records
    from bayes_aero.model.model import Model
    from bayes_aero.model.observations import observe
    from bayes_aero.simulate.demo import demo_records

    card = read_card("attas")
    model = Model.from_card(card)
    observations = observe(
        read_records(options.records, card.channels) if options.records else demo_records(), card, model
    )
    if options.quick:
        observations = observations.thinned()
    asked = {"of": [str(path) for path in options.records], "sizes": options.sizes, "quick": options.quick}
    lay_down(model, observations, options.folder, asked)


def lay_down(model: Model, observations: Observations, folder: Path, asked: dict) -> None:
    """What every contender reads, and last, in facts.json, what the table says of it."""
    import jax
    import jax.numpy as jnp

    from bayes_aero.inference.mle import fit_mle
    from bayes_aero.inference.results import MleStatus
    from bayes_aero.inference.sampling import density_start, find_mode
    from bayes_aero.model.observations import Colour, Density, Noise

    best = fit_mle(model, observations, extra_starts=0)
    if best.status is not MleStatus.CONVERGED:
        raise SystemExit(f"These records cannot serve for a comparison; our own fit of them: {best.status.value}")
    density = Density(observations, model, Noise(Colour.WHITE))
    mode = find_mode(density, density_start(density, best))
    reference, posterior = Reference(observations, model.names), WhitePosterior(density)
    start = np.array([p.start for p in model.free])
    apart = [
        agree(
            np.asarray(model.predicted(jnp.asarray(theta), observations.signals, observations.aircraft)).T,
            reference(theta),
        )
        for theta in (start, best.estimate)
    ]
    near = mode.unwhiten(np.random.default_rng(1).standard_normal((10, density.size)))
    values = np.array([float(density(jnp.asarray(u))) for u in near])
    apart.append(agree(values, np.array([posterior(u) for u in near])))
    processes = {n: lift_samples(observations, n) for n in asked["sizes"]}
    posed = reference, posterior, start, np.asarray(best.R), mode.u, mode.factor, density.names, processes
    (folder / OURS).write_bytes(pickle.dumps(observations))
    (folder / PROBLEM).write_bytes(pickle.dumps(Problem(folder, *posed)))
    facts = {"samples": observations.n, "manoeuvres": len(observations.names), "apart": max(apart)}
    (folder / "facts.json").write_text(json.dumps(asked | facts | {"device": jax.devices()[0].platform}))


def lift_samples(observations: Observations, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Scaled inputs (n, 4) and CL (n,) of `n` samples chosen at random, the same ones in every run."""
    from bayes_aero.inference.gp_kernel import Scaling

    if n > observations.n:
        raise SystemExit(f"The records have {observations.n} samples, fewer than the {n} of --sizes.")
    rows = np.sort(np.random.default_rng(0).choice(observations.n, n, replace=False))
    X = np.stack([np.asarray(observations.signals[name])[rows] for name in INPUTS], axis=1)
    y = np.asarray(observations.measured)[rows, 0]
    scaling = Scaling.of(X, y, INPUTS)
    return scaling.inputs(X), y / scaling.rms


# --- Maximum likelihood of the 14 parameters, from the card's start.

Fitting = Callable[[int], np.ndarray]


def our_fit(problem: Problem, _: int, __: argparse.Namespace) -> Fitting:
    """The fit alone."""
    from bayes_aero.inference.mle import descend

    model, observations = stall(problem)
    return lambda _: descend(model, observations, problem.start).theta


def ours_with_bounds(problem: Problem, _: int, __: argparse.Namespace) -> Fitting:
    """As a user calls it: with Cramer-Rao bounds and those corrected for colour."""
    from bayes_aero.inference.mle import fit_mle

    model, observations = stall(problem)
    return lambda _: fit_mle(model, observations, extra_starts=0).estimate


def scipy_with(**how: str) -> Callable[[Problem, int, argparse.Namespace], Fitting]:
    """scipy.optimize.least_squares with its defaults otherwise."""

    def prepared(problem: Problem, _: int, __: argparse.Namespace) -> Fitting:
        from scipy.optimize import least_squares

        reference, weight = problem.reference, 1.0 / np.sqrt(problem.R)[:, None]
        residual = lambda theta: (weight * (reference.measured - reference(theta))).ravel()  # noqa: E731
        return lambda _: least_squares(residual, problem.start, x_scale="jac", **how).x

    return prepared


def judged_fit(problem: Problem, _: int, warm: list[tuple[float, np.ndarray]]) -> dict[str, float]:
    """The cost reached, nats."""
    reference, theta = problem.reference, warm[-1][1]
    R = np.mean((reference.measured - reference(theta)) ** 2, axis=1)
    return {"cost": float(0.5 * reference.measured.shape[1] * np.sum(np.log(R)))}


FITS = {
    "bayes_aero": our_fit,
    "bayes_aero, with both bounds": ours_with_bounds,
    "scipy least_squares, trf": scipy_with(method="trf"),
    "scipy least_squares, lm": scipy_with(method="lm"),
}


# --- The posterior. ESS is ArviZ's bulk ESS of the parameter that has least of it, walkers laid end to end.

BALL = 0.5  # of the Laplace approximation's deviation, as in `sample_ensemble`
QUICK = {"emcee": (2, 100), "NUTS": (2, 100, 1)}  # the length of a run
BURN_IN = 5.0  # autocorrelation times that are left out, emcee's own advice


class Drawn(NamedTuple):
    """Draws (chain, draw, 17) on the scale of the data, and the share of the run that is not burn-in."""

    x: np.ndarray
    kept: float = 1.0


Sampling = Callable[[int], Drawn]


def our_sampler(engine: str) -> Callable[[Problem, int, argparse.Namespace], Sampling]:
    """`sample_ensemble` or `sample_nuts`, as `identify` runs them; their burn-in always counts."""

    def prepared(problem: Problem, _: int, options: argparse.Namespace) -> Sampling:
        from bayes_aero.inference import sampling
        from bayes_aero.model.observations import Colour, Density, Noise

        model, observations = stall(problem)
        density = Density(observations, model, Noise(Colour.WHITE))
        converged = sampling.ModeStatus.CONVERGED
        mode = sampling.PosteriorMode(problem.u, problem.factor, problem.posterior(problem.u), converged)
        ours: dict[str, tuple[Any, Any]] = {
            "emcee": (sampling.EnsembleLength, sampling.sample_ensemble),
            "NUTS": (sampling.NutsLength, sampling.sample_nuts),
        }
        length, sample = ours[engine]
        length = length(*QUICK[engine]) if options.quick else length()

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


def stock_emcee(problem: Problem, _: int, options: argparse.Namespace) -> Sampling:
    """One ensemble, its default move, the density called walker by walker.

    Of its chain (step, walker, 17) without burn-in, walkers are laid end to end, those of one half of the ensemble as a
    chain: R-hat of one chain alone is not defined.
    """
    import emcee

    def run(seed: int) -> Drawn:
        walkers = begin(problem, seed)
        np.random.seed(seed)  # noqa: NPY002 - emcee takes this generator only
        sampler = emcee.EnsembleSampler(*walkers.shape, problem.posterior)
        sampler.run_mcmc(walkers, options.steps)
        chain = sampler.get_chain()
        tau = float(np.max(emcee.autocorr.integrated_time(chain, tol=0, quiet=True)))
        discard = min(int(BURN_IN * tau), len(chain) // 2)
        halves = np.swapaxes(chain[discard:], 0, 1).reshape(2, -1, chain.shape[2])
        return Drawn(problem.posterior.bounded(halves)[0], 1.0 - discard / len(chain))

    return run


def judged_draws(problem: Problem, _: int, warm: list[tuple[float, Drawn]]) -> dict:
    """Medians over the runs of the least ESS and of its rates; the worst R-hat."""
    from bayes_aero.inference.sampling import diagnose

    rows = []
    for seconds, drawn in warm:
        marginals = diagnose(drawn.x, problem.names).values()
        least = min(m.ess_bulk for m in marginals)
        rates = {"ess": least, "rate": least / seconds, "free": least / (seconds * drawn.kept)}
        rows.append(rates | {"rhat": max(m.rhat for m in marginals)})
    medians = {name: statistics.median(row[name] for row in rows) for name in ("ess", "rate", "free")}
    return medians | {"rhat": max(row["rhat"] for row in rows)}


SAMPLERS = {"bayes_aero, emcee": our_sampler("emcee"), "bayes_aero, NUTS": our_sampler("NUTS"), "emcee": stock_emcee}


# --- The Gaussian process.

START = np.log([1.0, 0.5, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.0, 0.1])
LIMITS = [(-10.0, 6.0)] * 6 + [(-4.6, 6.9)] * 4 + [(-10.0, 6.0)]  # logs, those within which ours searches
TOLERANCE = {"ftol": 1e-9, "gtol": 1e-4}  # relative change and gradient at which it stops, as ours


def our_process(problem: Problem, size: int, _: argparse.Namespace) -> Fitting:
    """`maximise`, which searches five directions and finds the other six in closed reach."""
    from bayes_aero.inference.gp_kernel import HyperPrior, Priors, ReducedData, maximise, noise_to_signal

    data, flat = ReducedData.of(*problem.processes[size]), Priors(*5 * [HyperPrior("log-normal", 1.0, 1e6)])
    return lambda _: maximise(noise_to_signal(START), data, flat, w=START[:6].copy(), max_iterations=200).theta


def scikit_learn(problem: Problem, size: int, _: argparse.Namespace) -> Fitting:
    """GaussianProcessRegressor with analytic gradients, its own call of L-BFGS-B (ftol 2e-9)."""
    from scikit_learn_gp import from_scikit_learn, scikit_learn_model
    from sklearn.exceptions import ConvergenceWarning

    x, y = problem.processes[size]
    bounds = {"limits": tuple(np.exp(2.0 * np.array(LIMITS[0]))), "lengths": tuple(np.exp(LIMITS[6]))}

    def run(_: int) -> np.ndarray:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # of a hyperparameter at its bound: the data's doing
            found = scikit_learn_model(x, y, START, optimizer="fmin_l_bfgs_b", **bounds)
        return from_scikit_learn(found.kernel_.theta)

    return run


def tinygp_model(problem: Problem, size: int, _: argparse.Namespace) -> Fitting:
    """tinygp, its log-probability differentiated by JAX and compiled, SciPy's L-BFGS-B."""
    import jax
    import jax.numpy as jnp
    from scipy import optimize
    from tinygp import GaussianProcess, kernels, transforms

    jax.config.update("jax_enable_x64", True)
    x, y = (jnp.asarray(a) for a in problem.processes[size])

    def negative(theta: jax.Array) -> jax.Array:
        e = jnp.exp(theta)
        smooth = e[5] ** 2 * transforms.Linear(1.0 / e[6:10], kernels.ExpSquared())
        kernel = kernels.Constant(e[0] ** 2) + transforms.Linear(e[1:5], kernels.DotProduct()) + smooth
        return -GaussianProcess(kernel, x, diag=e[10] ** 2).log_probability(y)

    compiled = jax.jit(jax.value_and_grad(negative))

    def objective(theta: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = compiled(theta)
        return float(value), np.asarray(slope)

    return lambda _: (
        optimize.minimize(objective, START, jac=True, method="L-BFGS-B", bounds=LIMITS, options=TOLERANCE).x
    )


def judged_process(problem: Problem, size: int, warm: list[tuple[float, np.ndarray]]) -> dict[str, float]:
    """Log marginal likelihood at the hyperparameters found, from the textbook covariance; as a cost, nats."""
    from scipy.linalg import cho_factor, cho_solve

    x, y = problem.processes[size]
    e = np.exp(warm[-1][1])
    distance = np.sum(((x[:, None] - x) / e[6:10]) ** 2, axis=-1)
    K = e[0] ** 2 + (x * e[1:5] ** 2) @ x.T + e[5] ** 2 * np.exp(-0.5 * distance) + e[10] ** 2 * np.eye(len(x))
    factor = cho_factor(K, lower=True)
    log_determinant = 2.0 * np.sum(np.log(np.diag(factor[0])))
    value = -0.5 * (y @ cho_solve(factor, y) + log_determinant + len(y) * np.log(2.0 * np.pi))
    return {"cost": -float(value), "value": float(value)}


PROCESSES = {"bayes_aero": our_process, "scikit-learn": scikit_learn, "tinygp": tinygp_model}


BLOCKS = {"fits": (FITS, judged_fit), "samplers": (SAMPLERS, judged_draws), "processes": (PROCESSES, judged_process)}
