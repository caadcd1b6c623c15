"""Innovations: measured minus predicted one sample ahead. The state is corrected at each sample.

The gain is constant, that of the steady filter linearised at the segment's first sample, or varies with each sample as
in an extended Kalman filter. Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 5.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bayes_aero.dynamics.filtering.kalman import (
    Filtered,
    InitialState,
    Measured,
    Sampling,
    gains,
    kalman_filter,
    linearised_outputs,
    outputs_at,
)
from bayes_aero.dynamics.segments import Prepared, SegmentTrajectories, prepare
from bayes_aero.dynamics.system import System, advance
from bayes_aero.dynamics.tangent import later, motion

DOUBLINGS, RELATIVE, TINY = 60, 1e-14, 1e-300  # of the Riccati iteration, each of which squares the error


class Innovations(NamedTuple):
    """Innovations (w, n, c), referred to the record as in `segments.simulate`; states (w, n, s) before each sample;
    whether these are finite; the gain (w, s, c) and the share of each state's error that it corrects, diag(K C)."""

    innovation: Float[Array, "w n c"]
    states: Float[Array, "w n s"]
    inside: Bool[Array, "w n"]
    gain: Float[Array, "w s c"]
    correction_share: Float[Array, "w s"]


@jax.custom_jvp
def riccati(A: Float[Array, "s s"], G: Float[Array, "s s"], Q: Float[Array, "s s"]) -> Float[Array, "s s"]:
    """The stabilising P of A P + P A' - P G P + Q = 0, by doubling.

    Args:
        A: dynamics, (s, s), 1/s.
        G: information of a second of measurements, (s, s), symmetric.
        Q: spectral density of the process noise, (s, s), symmetric.

    Source: Chu, Fan, Lin 2005, Linear Algebra Appl. 396, 55 (structure-preserving doubling algorithm).
    """
    one, shift = jnp.eye(len(A)), 1.0 + 2.0 * jnp.max(jnp.sum(jnp.abs(A), axis=1))
    a = A.T - shift * one
    inverse = jnp.linalg.inv(a)
    W = jnp.linalg.inv(a.T + Q @ inverse @ G)
    E = one + 2.0 * shift * W.T
    first = (E, 2.0 * shift * inverse @ G @ W, 2.0 * shift * W @ Q @ inverse)

    def not_converged(carry):
        *_, change, count = carry
        return (change > RELATIVE) & (count < DOUBLINGS)

    def double(carry):
        E, G, H, _, count = carry
        both = jnp.linalg.inv(one + G @ H)
        increment = E.T @ H @ both @ E
        change = jnp.max(jnp.abs(increment)) / jnp.maximum(jnp.max(jnp.abs(H + increment)), TINY)
        return E @ both @ E, G + E @ both @ G @ E.T, H + increment, change, count + 1

    P = jax.lax.while_loop(not_converged, double, (*first, jnp.asarray(jnp.inf), 0))[2]
    return 0.5 * (P + P.T)


@riccati.defjvp
def _riccati_jvp(primals, tangents):
    A, G, Q = primals
    dA, dG, dQ = tangents
    P = riccati(A, G, Q)
    closed, one = A - P @ G, jnp.eye(len(A))
    right = dA @ P + P @ dA.T - P @ dG @ P + dQ
    lyapunov = jnp.kron(one, closed) + jnp.kron(closed, one)
    dP = -jnp.linalg.solve(lyapunov, right.reshape(-1)).reshape(P.shape)
    return P, 0.5 * (dP + dP.T)


def steady_gain(
    system: System, x: Float[Array, " s"], u: Any, dt: Any, F: Float[Array, " s"], R: Float[Array, " c"], names: tuple
) -> tuple[Float[Array, "s c"], Float[Array, "c s"]]:
    """Gain P C' R^-1 at one instant, and C; P solves A P + P A' - P C' R^-1 C P / dt + F F' = 0."""
    A = jax.jacfwd(lambda x: motion(system, x, u)[0])(x)
    C = jax.jacfwd(lambda x: outputs_at(system, x, u, names))(x)
    P = riccati(A, C.T @ (C / R[:, None]) / dt, jnp.diag(F**2 + system.noise_density(x, u)))
    return P @ C.T / R, C


def steady_innovations(
    flown: SegmentTrajectories,
    theta: Float[Array, " k"],
    departure: Float[Array, "w s"],
    F: Float[Array, " s"],
    R: Float[Array, " c"],
) -> Innovations:
    """One-step predictions of every segment with its steady gain; R (c,): variances of the innovations."""
    prepared = prepare(flown, theta)
    names = flown.outputs

    def predict(start, correction, inputs, dt, true, scale):
        first = {name: y[0] for name, y in inputs.items()}
        begin = prepared.sensed.complete_start(start, first) + correction
        K, C = steady_gain(prepared.sensed, begin, first, dt, F, R, names)

        def one_sample(x, rows):
            now, then, z, unit = rows
            e = z - outputs_at(prepared.sensed, x, now, names)
            e = jnp.where(jnp.isfinite(z), e, 0.0)
            ahead = advance(prepared.sensed, x + K @ e, now, then, dt, flown.substeps)
            return ahead, (x, e / unit)

        _, (x, e) = jax.lax.scan(one_sample, begin, (inputs, later(inputs, flown.held), true, scale))
        return e, x, jnp.all(jnp.isfinite(x), axis=1), K, jnp.sum(K * C.T, axis=1)

    return Innovations(*jax.vmap(predict)(*segment_inputs(flown, prepared, departure)))


def filter_segments(
    flown: SegmentTrajectories,
    theta: Float[Array, " k"],
    start_deviation: Float[Array, " s"],
    F: Float[Array, " s"],
    R: Float[Array, " c"],
) -> Filtered:
    """Every segment by the extended Kalman filter, from its measured initial state; (w, ...) in front of every array.

    `start_deviation`: standard deviation of that state, SI; `R`: variances of the measurement noise in attached flow.
    Innovations and their variances are in units of the recorded channels. Otherwise a scale error that makes the
    corrected channels smaller would increase the likelihood.
    """
    prepared = prepare(flown, theta)

    def one(*row):
        start, _, inputs, dt, true, scale, growth = row
        first = {name: y[0] for name, y in inputs.items()}
        begin = prepared.sensed.complete_start(start, first)
        noise = R * (scale * growth) ** 2
        found = kalman_filter(
            prepared.sensed,
            InitialState(begin, prepared.sensed.start_covariance(begin, first, start_deviation)),
            inputs,
            Measured(true, noise),
            F,
            flown.outputs,
            Sampling(dt, flown.substeps, flown.held),
        )
        return found._replace(innovation=found.innovation / scale, variance=found.variance / scale**2)

    nothing = jnp.zeros((len(flown.index), len(start_deviation)))
    rows = (*segment_inputs(flown, prepared, nothing), jnp.asarray(flown.noise_growth))
    return jax.vmap(one)(*rows)


@eqx.filter_jit
def prediction_errors(flown: SegmentTrajectories, theta: Float[Array, " k"], found: Filtered) -> Float[Array, "w n c"]:
    """Measured minus predicted from the samples before, in units of the recorded channels, NaN where missing.

    `found` is the result of `filter_segments` at `theta`. Its innovations are smaller, because each is also predicted
    from the outputs before it in the same sample.
    """
    prepared = prepare(flown, theta)
    *_, true, scale = segment_inputs(flown, prepared, jnp.zeros((len(flown.index), 1)))
    outputs = jax.vmap(jax.vmap(lambda x, u: outputs_at(prepared.sensed, x, u, flown.outputs)))
    return (true - outputs(found.predicted, prepared.drives)) / scale


class Observer(NamedTuple):
    """Gains (w, n, s, c) of each sample, and `whitening` (w, n, c, c): its product with the innovations is
    uncorrelated, each output predicted also from the outputs before it in the same sample."""

    gain: Float[Array, "w n s c"]
    whitening: Float[Array, "w n c c"]


def observer_of(
    flown: SegmentTrajectories, theta: Float[Array, " k"], R: Float[Array, " c"], found: Filtered
) -> Observer:
    """The gains of `filter_segments` at `theta` and `R`, to be held while parameters vary; `found` is its result."""
    prepared = prepare(flown, theta)

    def one(x, P, u, noise, used):
        return Observer(*gains(P, linearised_outputs(prepared.sensed, x, u, flown.outputs)[1], noise, used))

    noise = prepared.noise_variance(R, flown.noise_growth)
    each = jax.vmap(jax.vmap(one))
    return each(found.predicted, found.predicted_covariance, prepared.drives, noise, found.used)


class Observed(NamedTuple):
    """Innovations (w, n, c), SI, and the states (w, n, s) before and after each sample's correction."""

    innovation: Float[Array, "w n c"]
    before: Float[Array, "w n s"]
    after: Float[Array, "w n s"]


def run_observer(flown: SegmentTrajectories, theta: Float[Array, " k"], by: Observer) -> Observed:
    """Innovations of every segment by an observer with given gains."""
    prepared = prepare(flown, theta)
    names = flown.outputs

    def predict(start, _, inputs, dt, true, __, gain):
        first = {name: y[0] for name, y in inputs.items()}

        def one_sample(x, rows):
            now, then, z, K = rows
            e = z - outputs_at(prepared.sensed, x, now, names)
            e = jnp.where(jnp.isfinite(z), e, 0.0)
            estimate = x + K @ e
            return advance(prepared.sensed, estimate, now, then, dt, flown.substeps), Observed(e, x, estimate)

        rows = (inputs, later(inputs, flown.held), true, gain)
        return jax.lax.scan(one_sample, prepared.sensed.complete_start(start, first), rows)[1]

    start, nothing, inputs, dt, true, scale = segment_inputs(flown, prepared, jnp.zeros((len(flown.index), 1)))
    return jax.vmap(predict)(start, nothing, inputs, dt, true, scale, by.gain)


def segment_inputs(flown: SegmentTrajectories, prepared: Prepared, departure: Float[Array, "w s"]) -> tuple[Any, ...]:
    """Initial states, inputs and outputs by segment; outputs of padding samples are NaN."""
    true = jnp.where(jnp.asarray(flown.inside)[:, :, None], prepared.true, jnp.nan)
    return prepared.begin, departure, prepared.drives, jnp.asarray(flown.dt), true, prepared.scale


def measurement_matrix(flown: SegmentTrajectories, theta: Float[Array, " k"]) -> Float[Array, "c s"]:
    """C = dg/dx (c, s) at the first sample of the first segment."""
    prepared = prepare(flown, theta)
    first = {name: y[0, 0] for name, y in prepared.drives.items()}
    begin = prepared.sensed.complete_start(prepared.begin[0], first)
    return jax.jacfwd(lambda x: outputs_at(prepared.sensed, x, first, flown.outputs))(begin)


def neighbour_correlation(found: Filtered) -> Float[np.ndarray, " c"]:
    """Correlation of neighbouring innovations by output, over all segments (w, ...); 0 where there are too few."""
    scaled = np.asarray(found.innovation / np.sqrt(found.variance))
    both = np.asarray(found.used[:, 1:] & found.used[:, :-1])
    one, later_one = (np.where(both, e, 0.0) for e in (scaled[:, :-1], scaled[:, 1:]))
    power = np.sqrt(np.sum(one**2, axis=(0, 1)) * np.sum(later_one**2, axis=(0, 1)))
    return np.sum(one * later_one, axis=(0, 1)) / np.where(power > 0.0, power, 1.0)
