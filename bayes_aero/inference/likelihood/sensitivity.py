"""Compiled functions of the maximum-likelihood fit: sensitivities of the model, and full Gauss-Newton steps."""

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

ANDERSON_MEMORY = 3  # steps that Anderson acceleration looks back on


class Data(eqx.Module):
    """The observations of a fit with only the signals that the model reads, so that calls transfer little data."""

    signals: dict[str, Array]
    measured: Float[Array, "n c"]
    aircraft: Aircraft
    model: Model = eqx.field(static=True)


def data_of(model: Model, observations: Observations) -> Data:
    """The model with its part of the observations."""
    read = {"alpha", "dt", "start", *model.channels}
    signals = {name: signal for name, signal in observations.signals.items() if name in read}
    return Data(signals, observations.measured, observations.aircraft, model)


class Point(NamedTuple):
    """The fit at `theta` after `steps` steps. The gradient is that of the log-likelihood at constant R."""

    theta: Float[np.ndarray, " k"]
    cost: float  # (n/2) log det R: the concentrated negative log-likelihood without its constant
    R: Float[np.ndarray, " c"]
    information: Float[np.ndarray, "k k"]  # sum S' R^-1 S
    gradient: Float[np.ndarray, " k"]
    steps: int


def _sensitivities(data: Data, theta: Float[Array, " k"]):
    """Per coefficient the residual (n,) and the sensitivities S (k, n); and the separation point (n,).

    One parameter at a time, so that JAX omits derivatives that are zero or constant; what the parameters share is
    compiled once. Parameters come before samples, so that matrix products are contiguous.
    """
    values = data.model.values(theta)

    def predict(name: str, x: Float[Array, ""]) -> tuple[list[Array], Array]:
        known = data.model.flow(values | {name: x}, data.signals, data.aircraft)
        return [known[coefficient] for coefficient in data.model.coefficients], known["X"]

    columns = [jax.jvp(partial(predict, name), (values[name],), (jnp.ones(()),)) for name in data.model.names]
    predicted, X = columns[0][0]
    S = [jnp.stack([slope[i] for _, (slope, _) in columns]) for i in range(len(predicted))]
    return [data.measured[:, i] - y for i, y in enumerate(predicted)], S, X


@eqx.filter_jit
def evaluate(data: Data, theta: Float[Array, " k"]):
    """Residual (n, c), sensitivities (n, c, k) and separation point (n,); too large to transfer at every step."""
    residual, S, X = _sensitivities(data, theta)
    return jnp.stack(residual, axis=1), jnp.stack([s.T for s in S], axis=1), X


def full_steps(
    data: Data,
    start: Float[np.ndarray, " k"],
    lower: Float[np.ndarray, " k"],
    upper: Float[np.ndarray, " k"],
    tolerance: float,
    max_steps: int,
) -> Point:
    """At most `max_steps` full Gauss-Newton steps from `start`, while each lowers the cost and stays within the bounds.

    Gauss-Newton neglects the model's curvature, so its last steps shrink by a constant factor; Anderson acceleration
    (Walker and Ni 2011, SIAM J. Numer. Anal. 49, 1715) estimates that factor from the last steps. The loop ends where
    the expected gain in log-likelihood is below `tolerance`, or before the first step that does not lower the cost.
    With `max_steps` = 0 only `start` is evaluated.
    """
    arguments = map(jnp.asarray, (start, lower, upper, tolerance, max_steps))  # none static: one compilation
    found = _full_steps(data, *arguments)
    theta, cost, R, information, gradient, steps = map(np.asarray, found)
    return Point(theta, float(cost), R, information, gradient, int(steps))


@eqx.filter_jit
def _full_steps(data: Data, start: Array, lower: Array, upper: Array, tolerance: Array, max_steps: Array):
    n, k = data.measured.shape[0], start.shape[0]

    def newton(point):
        _, _, _, A, g, _ = point
        scale = jnp.sqrt(jnp.diag(A))
        factor = jnp.linalg.cholesky(A / jnp.outer(scale, scale))  # NaN where singular: the step is then refused
        step = jax.scipy.linalg.cho_solve((factor, True), g / scale) / scale
        return step, 0.5 * step @ g

    def evaluate_at(theta, steps):
        residual, S, _ = _sensitivities(data, theta)
        R = [jnp.mean(r**2) for r in residual]
        information = sum(s @ s.T / v for s, v in zip(S, R, strict=True))
        gradient = sum(s @ r / v for s, r, v in zip(S, residual, R, strict=True))
        R = jnp.stack(R)
        return theta, 0.5 * n * jnp.sum(jnp.log(R)), R, information, gradient, steps

    def accelerated(point, plain, step_memory, change_memory):
        """Anderson's step: that of the combination of the last points at which the next plain step vanishes."""
        weighed = change_memory @ point[3]
        gram = weighed @ change_memory.T
        ridge = jnp.finfo(gram.dtype).eps * jnp.trace(gram) + jnp.finfo(gram.dtype).tiny
        share = jnp.linalg.solve(gram + ridge * jnp.eye(ANDERSON_MEMORY), weighed @ plain)
        step = plain - share @ (step_memory + change_memory)
        return jnp.where(inside(point[0] + step), step, plain)

    def inside(theta):
        return jnp.all((theta > lower) & (theta < upper))

    def body(state):
        point, plain, step, step_memory, change_memory, _ = state
        trial = evaluate_at(point[0] + step, point[-1] + 1)
        first = point[-1] < 0
        accepted = first | (trial[1] < point[1])
        was_plain = jnp.all(step == plain)
        point = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), trial, point)
        new, gain = newton(point)
        stored = accepted & ~first
        step_memory = jnp.where(stored, jnp.roll(step_memory, 1, axis=0).at[0].set(step), 0.0)
        change_memory = jnp.where(stored, jnp.roll(change_memory, 1, axis=0).at[0].set(new - plain), 0.0)
        step = accelerated(point, new, step_memory, change_memory)
        # An accelerated step without gain is discarded with the memory, and the plain step is tried.
        go_on = (accepted | ~was_plain) & inside(point[0] + step) & (gain >= tolerance) & (point[-1] < max_steps)
        return point, new, step, step_memory, change_memory, go_on

    # The loop evaluates the start as the result of a zero step, so that the sensitivities are compiled once.
    no_point = (jnp.asarray(start), jnp.inf, jnp.zeros(data.measured.shape[1]), jnp.eye(k), jnp.zeros(k), -1)
    nothing, empty = jnp.zeros(k), jnp.zeros((ANDERSON_MEMORY, k))
    begin = (no_point, nothing, nothing, empty, empty, True)
    return jax.lax.while_loop(lambda state: state[-1], body, begin)[0]
