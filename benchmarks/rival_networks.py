"""The networks that `seed_rivals.py` compares: perceptron, radial basis functions and one-step network.

Their size is chosen by an inner hold-out inside the training part, and so is their noise: none of them has a predictive
distribution, so each gets a normal one with the mean square error of that inner hold-out. The final network is then
trained on the whole training part.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares

Predict = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Problem:
    """Blocks of about 0.2 s of all manoeuvres: `inputs` (m, d) of the regression, coefficients `measured` (m, c).

    `states` (m, s) are those that the one-step network propagates. `train` and, inside it, `inner` mark blocks.
    """

    inputs: Float[np.ndarray, "m d"]
    measured: Float[np.ndarray, "m c"]
    states: Float[np.ndarray, "m s"]
    manoeuvre: Int[np.ndarray, " m"]
    train: Bool[np.ndarray, " m"]
    inner: Bool[np.ndarray, " m"]


class Guess(NamedTuple):
    """Mean and deviation at every block; what was chosen, and the processor seconds that choosing took."""

    mean: Float[np.ndarray, "m c"]
    sd: Float[np.ndarray, "m c"]
    chosen: str = ""
    choosing: float = 0.0


class Scale(NamedTuple):
    """Columns with the training part's mean 0 and deviation 1."""

    mean: np.ndarray
    sd: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray) -> Scale:
        return cls(x.mean(axis=0), x.std(axis=0))

    def down(self, x: np.ndarray) -> np.ndarray:
        return (x - self.mean) / self.sd

    def up(self, x: np.ndarray) -> np.ndarray:
        return self.mean + self.sd * x


def network(X: np.ndarray, y: np.ndarray, units: int, decay: float, seed: int) -> Predict:
    """One hidden layer of tanh, weight decay, L-BFGS to its end; inputs and outputs scaled."""
    from sklearn.neural_network import MLPRegressor

    inputs, outputs = Scale.of(X), Scale.of(y)
    net = MLPRegressor(
        hidden_layer_sizes=(units,), activation="tanh", solver="lbfgs", alpha=decay, max_iter=2000, random_state=seed
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of fits that end at the largest number of iterations
        net.fit(inputs.down(X), outputs.down(y))
    return lambda new: outputs.up(np.reshape(net.predict(inputs.down(new)), (len(new), *y.shape[1:])))


def basis(X: np.ndarray, y: np.ndarray, centres: int, width: float, ridge: float, seed: int) -> Predict:
    """Gaussian basis functions about the centres of k-means, weights by ridge regression."""
    from sklearn.cluster import KMeans
    from sklearn.linear_model import Ridge
    from sklearn.metrics.pairwise import rbf_kernel

    scale = Scale.of(X)
    places = KMeans(centres, n_init=1, random_state=seed).fit(scale.down(X)).cluster_centers_
    gamma = 0.5 / width**2
    fit = Ridge(ridge).fit(rbf_kernel(scale.down(X), places, gamma), y)
    return lambda new: fit.predict(rbf_kernel(scale.down(new), places, gamma))


def by_inner_holdout(
    fitted: Callable[..., Predict], settings: list[tuple], problem: Problem, seed: int
) -> tuple[list[tuple], Float[np.ndarray, " c"], float]:
    """The best of the settings for each coefficient, its root mean square error, and the seconds it took."""
    began = time.process_time()
    X, z, p = problem.inputs, problem.measured, problem
    fit = p.train & ~p.inner
    errors = np.array([
        [np.mean((z[p.inner, c] - fitted(X[fit], z[fit, c], *one, seed)(X[p.inner])) ** 2) for c in range(z.shape[1])]
        for one in settings
    ])  # fmt: skip
    best = np.argmin(errors, axis=0)
    return [settings[i] for i in best], np.sqrt(errors.min(axis=0)), time.process_time() - began


def static(fitted: Callable[..., Predict], settings: list[tuple], problem: Problem, seed: int) -> Guess:
    """One network for each coefficient, as there is one Gaussian process for each."""
    chosen, error, seconds = by_inner_holdout(fitted, settings, problem, seed)
    X, z, train = problem.inputs, problem.measured, problem.train
    means = [fitted(X[train], z[train, c], *one, seed)(X) for c, one in enumerate(chosen)]
    sizes = "/".join(str(one[0]) for one in chosen)
    return Guess(np.stack(means, axis=1), np.tile(error, (len(X), 1)), sizes, seconds)


def perceptron(problem: Problem, seed: int) -> Guess:
    return static(network, [(u, d) for u in (2, 4, 8, 16) for d in (0.01, 1.0)], problem, seed)


def radial_basis(problem: Problem, seed: int) -> Guess:
    grid = [(k, w, r) for k in (5, 20, 80) for w in (1.0, 2.0, 4.0, 8.0) for r in (1e-3, 1e-1)]
    return static(basis, grid, problem, seed)


def one_step(problem: Problem, seed: int, modelled: Callable[[np.ndarray], np.ndarray], start: np.ndarray, bounds: Any):
    """Neural Gauss-Newton: a network in place of the equations of motion, under the coefficients of a model.

    The network learns the next states from the present states and measured coefficients. Then Gauss-Newton finds the
    parameters whose coefficients, put into it, predict the next states best; the network is differenced.

    Source: N. K. Peyada and A. K. Ghosh, Aeronautical Journal 113 (1142), 2009: the scheme; one step at a time here.
    """
    began = time.process_time()
    p, x, z = problem, problem.states, problem.measured
    follows = np.append((p.manoeuvre[1:] == p.manoeuvre[:-1]), False)
    change = np.vstack([np.diff(x, axis=0), np.zeros((1, x.shape[1]))])

    def pairs(rows: np.ndarray) -> np.ndarray:
        return np.flatnonzero(rows & np.append(rows[1:], False) & follows)

    both = np.hstack([x, z])
    fit, held, train = pairs(p.train & ~p.inner), pairs(p.inner), pairs(p.train)
    errors = {
        units: np.sum(np.mean((change[held] - network(both[fit], change[fit], units, 1e-2, seed)(both[held])) ** 2, 0)
                      / change[fit].var(axis=0)) for units in (2, 4, 8, 16)
    }  # fmt: skip
    units = min(errors, key=lambda k: errors[k])
    seconds = time.process_time() - began
    net = network(both[train], change[train], units, 1e-2, seed)
    noise = (change[train] - net(both[train])).std(axis=0)

    def residual(theta: np.ndarray) -> np.ndarray:
        predicted = net(np.hstack([x, modelled(theta)])[train])
        return ((change[train] - predicted) / noise).ravel()

    found = least_squares(residual, start, bounds=bounds, x_scale=np.maximum(np.abs(start), 1e-2), max_nfev=60)
    mean = modelled(found.x)
    sd = np.sqrt(np.mean((z - mean)[p.train] ** 2, axis=0))
    return Guess(mean, np.tile(sd, (len(z), 1)), str(units), seconds)
