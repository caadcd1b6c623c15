"""Extended Kalman filter of a system that is disturbed: one-step predictions, their covariances, and the smoother.

The state moves as dx = f(x, u) dt + F dw (w: independent Wiener processes, one a state) and outputs are measured at
the samples, z = g(x, u) + v, with independent noise of variance R. Missing samples are NaN. Outputs are taken one after
the other, which for a diagonal R is the same as all at once and needs no factorisation. Source: Bryson and Ho, *Applied
Optimal Control*, 1975, ch. 12; smoother: Rauch, Tung, Striebel 1965.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from bayes_aero.dynamics.system import Row, System, advance
from bayes_aero.dynamics.tangent import later, motion


class Filtered(NamedTuple):
    """One segment of n samples, s states and c outputs.

    `predicted`, `predicted_covariance`: the state before a sample was used; `state`, `covariance`: after it;
    `transition` (s, s): from there to the next sample. `innovation` (c): measured minus predicted, given the
    outputs before it in the same sample; `variance`: its variance; `used`: whether there was a measurement.
    """

    predicted: Float[Array, "n s"]
    predicted_covariance: Float[Array, "n s s"]
    state: Float[Array, "n s"]
    covariance: Float[Array, "n s s"]
    transition: Float[Array, "n s s"]
    innovation: Float[Array, "n c"]
    variance: Float[Array, "n c"]
    used: Bool[Array, "n c"]


def outputs_at(system: System, x: Float[Array, " s"], u: Row, names: Sequence[str]) -> Float[Array, " c"]:
    """Outputs of these names at one instant."""
    state = zip(system.states, x, strict=True)
    found = motion(system, x, u)[1] | {name: value for name, value in state if name in system.shown}
    return jnp.stack([found[name] for name in names])


def gathered_noise(transition: Float[Array, "s s"], density: Float[Array, " s"], dt: Any) -> Float[Array, "s s"]:
    """Covariance (s, s) that white noise of spectral `density` (s,) makes of the state in a sample of `dt` seconds.

    The integral of Phi(t) W Phi(t)' by Simpson's rule, with the square root of the transition in the middle. It is
    exact to the third power of dt, with which a gust changes the pitch rate within a sample.
    """
    W, one = jnp.diag(density), jnp.eye(len(density))
    away = transition - one
    half = one + 0.5 * away - 0.125 * away @ away
    return dt / 6.0 * (transition @ W @ transition.T + 4.0 * half @ W @ half.T + W)


def gathered_slopes(
    transition: Float[Array, "s s"],
    decayed: Float[Array, "s m"],
    density: Float[Array, " s"],
    by: Float[Array, "s m"],
    dt: Any,
) -> Float[Array, "s s m"]:
    """Derivative of `gathered_noise` in m directions: `decayed` of the transition's diagonal, `by` of the density."""
    away = transition - jnp.eye(len(density))
    half = jnp.eye(len(density)) + 0.5 * away - 0.125 * away @ away
    both = transition[:, None] * transition[None] + 4.0 * half[:, None] * half[None]
    driven = (both.reshape(-1, len(density)) @ by).reshape(*both.shape[:2], -1)
    whole, middle = density[:, None] * transition.T, density[:, None] * half.T
    bent = 0.5 * middle - 0.125 * away @ middle
    further = (away[:, None] * middle.T[None]).reshape(-1, len(density)) @ decayed
    side = decayed[:, None] * (whole + 4.0 * bent)[:, :, None] - 0.5 * further.reshape(driven.shape)
    own = jnp.eye(len(density))[:, :, None] * by[:, None]
    return dt / 6.0 * (driven + own + side + jnp.moveaxis(side, 0, 1))


class Begin(NamedTuple):
    """State before the first sample, (s,), SI, and its covariance, (s, s)."""

    mean: Float[Array, " s"]
    covariance: Float[Array, "s s"]


class Measured(NamedTuple):
    """Outputs (n, c), SI, NaN where missing, and the variances of their noise."""

    values: Float[Array, "n c"]
    variance: Float[Array, "n c"]


class Sampling(NamedTuple):
    """Sample time, s; Runge-Kutta steps a sample; whether inputs are held between samples or linear."""

    dt: Any
    substeps: int = 1
    held: bool = False


def kalman_filter(
    system: System,
    begin: Begin,
    inputs: Mapping[str, Float[Array, " n"]],
    measured: Measured,
    F: Float[Array, " s"],
    names: tuple[str, ...],
    sampling: Sampling,
) -> Filtered:
    """Filter one segment.

    Args:
        system: what moves.
        begin: the state before the first sample.
        inputs: recorded inputs by name, (n,).
        measured: outputs with their noise.
        F: process noise by state beside the system's own, (s,), unit of the state per square root of a second.
        names: outputs in the order of `measured`.
        sampling: of inputs and outputs.

    Returns:
        predictions, estimates, innovations and their variances.
    """

    def further(carry, row):
        x, P = carry
        now, then, z, variance = row
        y, C = seen_at(system, x, now, names)
        moved, P_estimate, e, S, used = corrected(P, C, z - y, variance)
        estimate = x + moved
        step = lambda x: advance(system, x, now, then, sampling.dt, sampling.substeps)  # noqa: E731
        ahead, transition = with_slope(step, estimate)
        density = F**2 + system.noise_density(estimate, now)
        found = Filtered(x, P, estimate, P_estimate, transition, e, S, used)
        return (ahead, covariance_ahead(transition, P_estimate, density, sampling.dt)), found

    now = {name: jnp.asarray(x) for name, x in inputs.items()}
    rows = (now, later(now, sampling.held), measured.values, measured.variance)
    return jax.lax.scan(further, (begin.mean, begin.covariance), rows)[1]


def seen_at(system: System, x: Float[Array, " s"], u: Row, names: Sequence[str]) -> tuple[Array, Array]:
    """Outputs (c,) at one instant and their derivative by the state (c, s)."""
    return with_slope(lambda x: outputs_at(system, x, u, names), x)


def with_slope(f: Callable[[Array], Array], x: Float[Array, " s"]) -> tuple[Array, Array]:
    """f and its derivative by the state, the last axis, for one evaluation: of f and `jacfwd` of it the compiler would
    make two, for it does not see that their loops are the same."""
    return jax.vmap(lambda e: jax.jvp(f, (x,), (e,)), out_axes=(None, -1))(jnp.eye(len(x)))


def corrected(
    P: Float[Array, "s s"], C: Float[Array, "c s"], away: Float[Array, " c"], variance: Float[Array, " c"]
) -> tuple[Array, Array, Array, Array, Array]:
    """Correction of the state (s,) by one sample's outputs, and the covariance (s, s) after it.

    `away` is measured minus predicted, NaN where missing. Then innovations (c,), their variances, and which were there.
    The outputs are no loop: a loop costs more than what it does for each of so few.
    """
    there = jnp.isfinite(away)

    def one(carry, output):
        moved, P = carry
        h, away, r, use = output
        e, Ph = away - jnp.sum(h * moved), jnp.sum(P * h, axis=1)
        S = jnp.sum(h * Ph) + r
        K = jnp.where(use, Ph / S, 0.0)
        return (moved + K * e, P - K[:, None] * Ph), (jnp.where(use, e, 0.0), jnp.where(use, S, 1.0))

    rows = (C, jnp.where(there, away, 0.0), variance, there)
    (moved, P), (e, S) = jax.lax.scan(one, (jnp.zeros(len(P)), P), rows, unroll=True)
    return moved, P, e, S, there


def gains(
    P: Float[Array, "s s"], C: Float[Array, "c s"], variance: Float[Array, " c"], there: Bool[Array, " c"]
) -> tuple[Float[Array, "s c"], Float[Array, "c c"]]:
    """What `corrected` does to measured minus predicted: gain, and the matrix that makes innovations of it.

    One output after the other, too. All samples' matrices factorised at once are a call of LAPACK that shares the
    threads with whatever runs beside it: two of them (jaxlib 0.10) wait for each other for ever.
    """

    def one(carry, output):
        P, gain = carry
        h, r, use, own = output
        Ph = jnp.sum(P * h, axis=1)
        K = jnp.where(use, Ph / (jnp.sum(h * Ph) + r), 0.0)
        row = own - jnp.where(use, jnp.sum(h[:, None] * gain, axis=0), 0.0)
        return (P - K[:, None] * Ph, gain + K[:, None] * row), row

    rows = (C, variance, there, jnp.eye(len(C)))
    (_, gain), innovate = jax.lax.scan(one, (P, jnp.zeros(C.T.shape)), rows, unroll=True)
    return gain, innovate


def covariance_ahead(
    transition: Float[Array, "s s"], P: Float[Array, "s s"], density: Float[Array, " s"], dt: Any
) -> Float[Array, "s s"]:
    """Covariance (s, s) a sample later, of the state and what white noise of `density` (s,) adds to it."""
    ahead = transition @ P @ transition.T + gathered_noise(transition, density, dt)
    return 0.5 * (ahead + ahead.T)


def log_terms(e: Float[Array, " c"], S: Float[Array, " c"], used: Bool[Array, " c"]) -> Float[Array, ""]:
    """Log density of one sample's innovations `e` of variance `S`."""
    return -0.5 * jnp.sum(jnp.where(used, jnp.log(2.0 * jnp.pi * S) + e**2 / S, 0.0))


def log_likelihood(found: Filtered) -> Float[Array, ""]:
    """Log density of all measured samples, each given those before it."""
    return jnp.sum(jax.vmap(log_terms)(found.innovation, found.variance, found.used))


def smoothed(found: Filtered) -> tuple[Float[Array, "n s"], Float[Array, "n s s"]]:
    """States given all samples, and their covariances (Rauch, Tung and Striebel)."""

    def back(carry, row):
        x, P = carry
        estimate, covariance, transition, predicted, ahead = row
        gain = jnp.linalg.solve(ahead, transition @ covariance).T
        x = estimate + gain @ (x - predicted)
        P = covariance + gain @ (P - ahead) @ gain.T
        return (x, P), (x, P)

    last = (found.state[-1], found.covariance[-1])
    rows = (
        found.state[:-1],
        found.covariance[:-1],
        found.transition[:-1],
        found.predicted[1:],
        found.predicted_covariance[1:],
    )
    _, (x, P) = jax.lax.scan(back, last, rows, reverse=True)
    return jnp.concatenate([x, last[0][None]]), jnp.concatenate([P, last[1][None]])
