"""Exact GP of CL over (alpha, elevator, q, V): the paper's kernel, maximum marginal likelihood from one start.

k = s0^2 + sum s_i^2 x_i x_i' + sf^2 exp(-1/2 sum (x_i - x_i')^2 / l_i^2) + sn^2 delta, eleven hyperparameters, no
priors; a contender's result is theta = log [s0, s_1..s_4, sf, l_1..l_4, sn]. All climb by L-BFGS-B.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable

import numpy as np
from contender import Problem
from scipy.optimize import minimize

START = np.log([1.0, 0.5, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.0, 0.1])
LIMITS = [(-10.0, 6.0)] * 6 + [(-4.6, 6.9)] * 4 + [(-10.0, 6.0)]  # logs, those within which ours searches
TOLERANCE = {"ftol": 1e-9, "gtol": 1e-4}  # relative change and gradient at which it stops, as ours

Run = Callable[[int], np.ndarray]


def ours(problem: Problem, size: int, _: argparse.Namespace) -> Run:
    """`maximise`, which searches five directions and finds the other six in closed reach."""
    from bayes_aero.inference.gp.kernel import Priors, ReducedData, maximise, noise_to_signal

    data, flat = ReducedData.of(*problem.processes[size]), Priors.flat()
    return lambda _: maximise(noise_to_signal(START), data, flat, w=START[:6].copy(), max_iterations=200).theta


def scikit_learn(problem: Problem, size: int, _: argparse.Namespace) -> Run:
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


def tinygp_model(problem: Problem, size: int, _: argparse.Namespace) -> Run:
    """tinygp, its log-probability differentiated by JAX and compiled, SciPy's L-BFGS-B."""
    import jax
    import jax.numpy as jnp
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

    return lambda _: minimize(objective, START, jac=True, method="L-BFGS-B", bounds=LIMITS, options=TOLERANCE).x


def judge(problem: Problem, size: int, warm: list[tuple[float, np.ndarray]]) -> dict[str, float]:
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


CONTENDERS = {
    "bayes_aero": ours,
    "scikit-learn": scikit_learn,
    "tinygp": tinygp_model,
}
