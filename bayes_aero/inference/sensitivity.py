"""The compiled half of maximum likelihood: sensitivities of the model, and full Gauss-Newton steps with them."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Observations
from bayes_aero.physics.coefficients import NAMES


class Data(eqx.Module):
    """What a fit needs of the observations: only the signals that the model reads, so that a call hands over little."""

    signals: dict[str, Array]
    measured: Float[Array, "n 3"]
    aircraft: Aircraft
    model: Model = eqx.field(static=True)


def data_of(model: Model, observations: Observations) -> Data:
    """The model with its part of the observations."""
    read = {"alpha", "dt", "start", *model.channels}
    signals = {name: signal for name, signal in observations.signals.items() if name in read}
    return Data(signals, observations.measured, observations.aircraft, model)


class Point(NamedTuple):
    """The fit at `theta`, after `taken` steps. The gradient is that of the log-likelihood, R being what it is there."""

    theta: Float[np.ndarray, " k"]
    cost: float  # (n/2) log det R: the concentrated negative log-likelihood without its constant
    R: Float[np.ndarray, " 3"]
    information: Float[np.ndarray, "k k"]  # sum S' R^-1 S
    gradient: Float[np.ndarray, " k"]
    taken: int


def _sensitivities(data: Data, theta: Float[Array, " k"]):
    """Per coefficient the residual (n,) and the sensitivities S (k, n); and the separation point (n,).

    One parameter at a time, for then JAX knows where a derivative is zero or constant and leaves that part out; what
    the parameters share is compiled once. Parameters before samples: contiguous matrix products.
    """
    values = data.model.values(theta)

    def predict(name: str, x: Float[Array, ""]) -> tuple[list[Array], Array]:
        known = data.model.flow(values | {name: x}, data.signals, data.aircraft)
        return [known[coefficient] for coefficient in NAMES], known["X"]

    columns = [jax.jvp(partial(predict, name), (values[name],), (jnp.ones(()),)) for name in data.model.names]
    predicted, X = columns[0][0]
    S = [jnp.stack([slope[i] for _, (slope, _) in columns]) for i in range(len(NAMES))]
    return [data.measured[:, i] - y for i, y in enumerate(predicted)], S, X


@eqx.filter_jit
def evaluate(data: Data, theta: Float[Array, " k"]):
    """Residual (n, 3), sensitivities (n, 3, k) and separation point (n,): too large to hand over at every step."""
    residual, S, X = _sensitivities(data, theta)
    return jnp.stack(residual, axis=1), jnp.stack([s.T for s in S], axis=1), X


def full_steps(
    data: Data,
    start: Float[np.ndarray, " k"],
    lower: Float[np.ndarray, " k"],
    upper: Float[np.ndarray, " k"],
    decrement: float,
    most: int,
) -> Point:
    """At most `most` full Gauss-Newton steps from `start`, while each lowers the cost and stays within the bounds.

    Ends where a step would gain less than `decrement` in log-likelihood, or before the first step that is not good;
    `most` = 0 only looks at `start`.
    """
    arguments = map(jnp.asarray, (start, lower, upper, decrement, most))  # none static: one compilation
    found = _full_steps(data, *arguments)
    theta, cost, R, information, gradient, taken = map(np.asarray, found)
    return Point(theta, float(cost), R, information, gradient, int(taken))


@eqx.filter_jit
def _full_steps(data: Data, start: Array, lower: Array, upper: Array, decrement: Array, most: Array):
    n, k = data.measured.shape[0], start.shape[0]

    def step_from(point):
        _, _, _, A, g, _ = point
        scale = jnp.sqrt(jnp.diag(A))
        factor = jnp.linalg.cholesky(A / jnp.outer(scale, scale))  # NaN where singular: the step is then not good
        step = jax.scipy.linalg.cho_solve((factor, True), g / scale) / scale
        return step, 0.5 * step @ g

    def look(theta, taken):
        residual, S, _ = _sensitivities(data, theta)
        R = [jnp.mean(r**2) for r in residual]
        information = sum(s @ s.T / v for s, v in zip(S, R, strict=True))
        gradient = sum(s @ r / v for s, r, v in zip(S, residual, R, strict=True))
        R = jnp.stack(R)
        return theta, 0.5 * n * jnp.sum(jnp.log(R)), R, information, gradient, taken

    def body(state):
        point, step, _ = state
        trial = look(point[0] + step, point[-1] + 1)
        first = point[-1] < 0
        good = first | (trial[1] < point[1])
        point = jax.tree.map(lambda new, old: jnp.where(good, new, old), trial, point)
        step, gain = step_from(point)
        ahead = point[0] + step
        inside = jnp.all((ahead > lower) & (ahead < upper))
        return point, step, good & inside & (gain >= decrement) & (point[-1] < most)

    # The loop begins by looking at the start, as if a step of zero led there: so it compiles the sensitivities once.
    nowhere = (jnp.asarray(start), jnp.inf, jnp.zeros(3), jnp.eye(k), jnp.zeros(k), -1)
    return jax.lax.while_loop(lambda state: state[2], body, (nowhere, jnp.zeros(k), True))[0]
