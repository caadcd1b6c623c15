"""Innovations: measured minus predicted one sample ahead. The state is corrected at each sample.

The gain varies with each sample as in an extended Kalman filter, or is held. Source: Jategaonkar, *Flight Vehicle
System Identification*, 2nd ed. 2015, ch. 5.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

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
from bayes_aero.dynamics.system import advance
from bayes_aero.dynamics.tangent import later


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
        start, inputs, dt, true, scale, growth = row
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

    rows = (*segment_inputs(flown, prepared), jnp.asarray(flown.noise_growth))
    return jax.vmap(one)(*rows)


@eqx.filter_jit
def prediction_errors(flown: SegmentTrajectories, theta: Float[Array, " k"], found: Filtered) -> Float[Array, "w n c"]:
    """Measured minus predicted from the samples before, in units of the recorded channels, NaN where missing.

    `found` is the result of `filter_segments` at `theta`. Its innovations are smaller, because each is also predicted
    from the outputs before it in the same sample.
    """
    prepared = prepare(flown, theta)
    *_, true, scale = segment_inputs(flown, prepared)
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

    def predict(start, inputs, dt, true, gain):
        first = {name: y[0] for name, y in inputs.items()}

        def one_sample(x, rows):
            now, then, z, K = rows
            e = z - outputs_at(prepared.sensed, x, now, names)
            e = jnp.where(jnp.isfinite(z), e, 0.0)
            estimate = x + K @ e
            return advance(prepared.sensed, estimate, now, then, dt, flown.substeps), Observed(e, x, estimate)

        rows = (inputs, later(inputs, flown.held), true, gain)
        return jax.lax.scan(one_sample, prepared.sensed.complete_start(start, first), rows)[1]

    start, inputs, dt, true, _ = segment_inputs(flown, prepared)
    return jax.vmap(predict)(start, inputs, dt, true, by.gain)


def segment_inputs(flown: SegmentTrajectories, prepared: Prepared) -> tuple[Any, ...]:
    """Initial states, inputs, sampling times, outputs and their scales by segment; outputs of padding are NaN."""
    true = jnp.where(jnp.asarray(flown.inside)[:, :, None], prepared.true, jnp.nan)
    return prepared.begin, prepared.drives, jnp.asarray(flown.dt), true, prepared.scale


def neighbour_correlation(found: Filtered) -> Float[np.ndarray, " c"]:
    """Correlation of neighbouring innovations by output, over all segments (w, ...); 0 where there are too few."""
    scaled = np.asarray(found.innovation / np.sqrt(found.variance))
    both = np.asarray(found.used[:, 1:] & found.used[:, :-1])
    one, later_one = (np.where(both, e, 0.0) for e in (scaled[:, :-1], scaled[:, 1:]))
    power = np.sqrt(np.sum(one**2, axis=(0, 1)) * np.sum(later_one**2, axis=(0, 1)))
    return np.sum(one * later_one, axis=(0, 1)) / np.where(power > 0.0, power, 1.0)
