"""Log likelihood of the innovations of `innovations.filter_segments`, with a fast gradient for samplers.

Reverse differentiation of a filter stores all intermediate values of every sample. Here the filter runs once. Outputs,
motion and their first and second derivatives by the state are then computed for all samples at once along its path, so
that the loop over the samples, and its reverse, contains only products of small matrices. Value and gradient are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.filtering.kalman import (
    correct,
    linearised_outputs,
    log_density_terms,
    outputs_at,
    predicted_covariance,
    value_and_slope,
)
from bayes_aero.dynamics.segments import SegmentTrajectories, prepare
from bayes_aero.dynamics.system import System, advance
from bayes_aero.dynamics.tangent import later


class NoisePoint(NamedTuple):
    """Parameters (k,), process noise (s,) as in `filter_segments`, and variances of the measurement noise (c,)."""

    theta: Float[Array, " k"]
    F: Float[Array, " s"]
    R: Float[Array, " c"]


class _Path(NamedTuple):
    """States (w, n, s) before and after each sample's correction."""

    before: Float[Array, "w n s"]
    after: Float[Array, "w n s"]


class _FilterInputs(NamedTuple):
    """Inputs of the filter: the state before the first sample (w, s), its covariance (w, s, s), inputs at each sample
    and at the next one (w, n), corrected outputs, the variances of their noise, and the derivatives of the corrected
    outputs by the recorded ones (w, n, c)."""

    system: System
    begin: Float[Array, "w s"]
    covariance: Float[Array, "w s s"]
    now: dict[str, Array]
    then: dict[str, Array]
    measured: Float[Array, "w n c"]
    variance: Float[Array, "w n c"]
    scale: Float[Array, "w n c"]


class _Local(NamedTuple):
    """By sample: measured minus predicted outputs at the predicted state; predicted next state and noise density at the
    corrected state. `matrix`, `transition` and `density_slope` are their derivatives by the state, `matrix_slope` and
    `transition_slope` the second derivatives."""

    residual: Float[Array, "w n c"]
    matrix: Float[Array, "w n c s"]
    matrix_slope: Float[Array, "w n c s s"]
    predicted: Float[Array, "w n s"]
    transition: Float[Array, "w n s s"]
    transition_slope: Float[Array, "w n s s s"]
    density: Float[Array, "w n s"]
    density_slope: Float[Array, "w n s s"]


def innovations_density(
    flown: SegmentTrajectories, point: NoisePoint, start_deviation: Float[Array, " s"]
) -> Float[Array, ""]:
    """Log likelihood of all segments: the sum of `kalman.log_likelihood` over `innovations.filter_segments`.

    Args:
        flown: segments of flights; without names (`nameless`), so that records of any name share a compiled program.
        point: parameters and noise.
        start_deviation: standard deviation of the measured initial state, (s,), SI.
    """
    return _density(point, flown, start_deviation)


def _value(point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array) -> Array:
    return _filter_segments(point, flown, start_deviation)[0]


_density = eqx.filter_custom_vjp(_value)


@_density.def_fwd
def _forward(_perturbed: Any, point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array):
    path = _filter_segments(point, flown, start_deviation)[1]
    return jax.value_and_grad(_log_likelihood_along)(point, flown, start_deviation, path)


@_density.def_bwd
def _backward(slope: NoisePoint, cotangent: Array, *_: Any):
    return jax.tree.map(lambda g: cotangent * g, slope)


def _filter_inputs(point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array) -> _FilterInputs:
    prepared = prepare(flown, point.theta)
    true = jnp.where(jnp.asarray(flown.inside)[:, :, None], prepared.true, jnp.nan)
    begin = prepared.initial_states
    return _FilterInputs(
        prepared.sensed,
        begin,
        prepared.initial_covariance(begin, start_deviation),
        prepared.drives,
        later(prepared.drives, flown.held),
        true,
        prepared.noise_variance(point.R, flown.noise_growth),
        prepared.scale,
    )


def _filter_segments(point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array) -> tuple[Array, _Path]:
    """The log likelihood, and the path of the filter."""
    rows = _filter_inputs(point, flown, start_deviation)
    system = rows.system

    def one(begin, covariance, now, then, measured, variance, scale, dt):
        def one_sample(carry, row):
            x, P, total = carry
            now, then, z, variance, scale = row
            y, C = linearised_outputs(system, x, now, flown.outputs)
            correction, P, e, S, used = correct(P, C, z - y, variance)
            after = x + correction
            step = lambda x: advance(system, x, now, then, dt, flown.substeps)  # noqa: E731
            density = point.F**2 + system.noise_density(after, now)
            predicted, transition = value_and_slope(step, after)
            P = predicted_covariance(transition, P, density, dt)
            return (predicted, P, total + log_density_terms(e / scale, S / scale**2, used)), _Path(x, after)

        start = (begin, covariance, jnp.zeros(()))
        (_, _, total), path = jax.lax.scan(one_sample, start, (now, then, measured, variance, scale))
        return total, path

    total, path = jax.vmap(one)(*rows[1:], jnp.asarray(flown.dt))
    return jnp.sum(total), path


def _log_likelihood_along(point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array, path: _Path) -> Array:
    """The log likelihood along a given path, exact to first order in the change of the path with the point."""
    path = jax.lax.stop_gradient(path)
    rows = _filter_inputs(point, flown, start_deviation)
    local = _linearise_along(rows, point.F, flown, path)
    noise = (rows.variance, rows.scale)
    by_segment = jax.vmap(_linear)(rows.begin, rows.covariance, noise, jnp.asarray(flown.dt), path, local)
    return jnp.sum(by_segment)


def _linearise_along(rows: _FilterInputs, F: Array, flown: SegmentTrajectories, path: _Path) -> _Local:
    """Linearise all samples at once. The highest derivatives depend on the path only, not on the point."""
    dt = jnp.broadcast_to(jnp.asarray(flown.dt)[:, None], path.before.shape[:2])
    over_samples = lambda f: jax.vmap(jax.vmap(f))  # noqa: E731

    def functions(system: System) -> tuple[Callable[[Array], Array], ...]:
        return (
            lambda x: over_samples(lambda x, u: outputs_at(system, x, u, flown.outputs))(x, rows.now),
            lambda x: over_samples(lambda *y: advance(system, y[0], y[1], y[2], y[3], flown.substeps))(
                x, rows.now, rows.then, dt
            ),
            lambda x: over_samples(system.noise_density)(x, rows.now),
        )

    outputs_of, motion_of, density_of = functions(rows.system)
    (y, matrix), (predicted, transition) = _by_state(outputs_of, path.before), _by_state(motion_of, path.after)
    outputs_of, motion_of, density_held = functions(jax.lax.stop_gradient(rows.system))
    matrix_slope = _by_state(lambda x: _by_state(outputs_of, x)[1], path.before)[1]
    transition_slope = _by_state(lambda x: _by_state(motion_of, x)[1], path.after)[1]
    density_slope = _by_state(density_held, path.after)[1]
    matrix_slope, transition_slope, density_slope = jax.lax.stop_gradient(
        (matrix_slope, transition_slope, density_slope)
    )
    density = F**2 + density_of(path.after)
    return _Local(
        rows.measured - y, matrix, matrix_slope, predicted, transition, transition_slope, density, density_slope
    )


def _by_state(f: Callable[[Array], Array], x: Float[Array, "w n s"]) -> tuple[Array, Array]:
    """f and its derivative by the state of the same sample, the last axis."""
    along = lambda e: jax.jvp(f, (x,), (jnp.broadcast_to(e, x.shape),))  # noqa: E731
    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(x.shape[-1]))


def _linear(begin: Array, covariance: Array, noise: Any, dt: Array, path: _Path, local: _Local) -> Array:
    """Log likelihood of one segment by the filter linearised along the path.

    The reverse pass computes each step again, which costs less than storing it.
    """

    @jax.checkpoint
    def one_sample(carry, row):
        x, P, total = carry
        local, before, after, (variance, scale) = row
        held = jax.lax.stop_gradient(local)
        dx = x - before
        matrix, residual = local.matrix + local.matrix_slope @ dx, local.residual - held.matrix @ dx
        correction, P, e, S, used = correct(P, matrix, residual, variance)
        dx = x + correction - after
        transition, density = local.transition + local.transition_slope @ dx, local.density + local.density_slope @ dx
        P = predicted_covariance(transition, P, density, dt)
        total = total + log_density_terms(e / scale, S / scale**2, used)
        return (local.predicted + held.transition @ dx, P, total), None

    start = (begin, covariance, jnp.zeros(()))
    return jax.lax.scan(one_sample, start, (local, path.before, path.after, noise))[0][2]
