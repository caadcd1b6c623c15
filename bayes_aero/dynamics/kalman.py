"""Extended Kalman filter: one-step predictions, their covariances, and the smoother.

The state follows dx = f(x, u) dt + F dw (w: independent Wiener processes, one a state). Outputs are measured at the
samples, z = g(x, u) + v, with independent noise of variance R. Missing samples are NaN. Outputs are processed one after
the other, which for a diagonal R is equivalent to all at once and needs no factorisation. Source: Bryson and Ho,
*Applied Optimal Control*, 1975, ch. 12; smoother: Rauch, Tung, Striebel 1965.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from bayes_aero.dynamics.segments import Prepared, SegmentTrajectories, prepare
from bayes_aero.dynamics.system import Row, System, advance, later, motion


class Filtered(NamedTuple):
    """One segment of n samples, s states and c outputs."""

    predicted: Float[Array, "n s"]  # before the sample was used
    predicted_covariance: Float[Array, "n s s"]
    state: Float[Array, "n s"]  # after it
    covariance: Float[Array, "n s s"]
    transition: Float[Array, "n s s"]  # from there to the next sample
    innovation: Float[Array, "n c"]  # measured minus predicted, given the outputs before it in the same sample
    variance: Float[Array, "n c"]  # of the innovation
    used: Bool[Array, "n c"]  # whether there was a measurement


def outputs_at(system: System, x: Float[Array, " s"], u: Row, names: Sequence[str]) -> Float[Array, " c"]:
    """Outputs (c,) of these names at one instant."""
    state = zip(system.states, x, strict=True)
    outputs = motion(system, x, u)[1] | {name: value for name, value in state if name in system.state_outputs}
    return jnp.stack([outputs[name] for name in names])


def discrete_noise(transition: Float[Array, "s s"], density: Float[Array, " s"], dt: Any) -> Float[Array, "s s"]:
    """Discrete process-noise covariance (s, s): white noise of spectral `density` (s,) over a sample of `dt` seconds.
    The integral of Phi(t) W Phi(t)' by Simpson's rule, with the square root of the transition at mid-sample. It is
    exact to the third power of dt, the order at which a gust changes the pitch rate within a sample."""
    W, one = jnp.diag(density), jnp.eye(len(density))
    change = transition - one
    half = one + 0.5 * change - 0.125 * change @ change
    return dt / 6.0 * (transition @ W @ transition.T + 4.0 * half @ W @ half.T + W)


def discrete_noise_slopes(
    transition: Float[Array, "s s"],
    decayed: Float[Array, "s m"],
    density: Float[Array, " s"],
    by: Float[Array, "s m"],
    dt: Any,
) -> Float[Array, "s s m"]:
    """Derivative of `discrete_noise` in m directions: `decayed` of the transition's diagonal, `by` of the density."""
    change = transition - jnp.eye(len(density))
    half = jnp.eye(len(density)) + 0.5 * change - 0.125 * change @ change
    both = transition[:, None] * transition[None] + 4.0 * half[:, None] * half[None]
    by_density = (both.reshape(-1, len(density)) @ by).reshape(*both.shape[:2], -1)
    full, middle = density[:, None] * transition.T, density[:, None] * half.T
    half_slope = 0.5 * middle - 0.125 * change @ middle
    cross = (change[:, None] * middle.T[None]).reshape(-1, len(density)) @ decayed
    side = decayed[:, None] * (full + 4.0 * half_slope)[:, :, None] - 0.5 * cross.reshape(by_density.shape)
    own = jnp.eye(len(density))[:, :, None] * by[:, None]
    return dt / 6.0 * (by_density + own + side + jnp.moveaxis(side, 0, 1))


class FilterInputs(NamedTuple):
    """What a filter reads of one segment: begin, inputs now and a sample later, outputs (NaN: missing), noise."""

    begin: Float[Array, "*w s"]
    covariance: Float[Array, "*w s s"]
    now: dict[str, Array]
    then: dict[str, Array]
    measured: Float[Array, "*w n c"]
    variance: Float[Array, "*w n c"]
    scale: Float[Array, "*w n c"]
    dt: Any


def filter_inputs(
    flown: SegmentTrajectories, prepared: Prepared, start_deviation: Float[Array, " s"], R: Float[Array, " c"]
) -> FilterInputs:
    """Inputs of the filter of every segment, from its measured initial state; outputs of padding are NaN."""
    begin = prepared.initial_states
    return FilterInputs(
        begin,
        prepared.initial_covariance(begin, start_deviation),
        prepared.drives,
        later(prepared.drives, flown.held),
        flown.only_inside(prepared.true),
        prepared.noise_variance(R, flown.noise_growth),
        prepared.scale,
        jnp.asarray(flown.dt),
    )


def kalman_filter(
    system: System,
    rows: FilterInputs,
    F: Float[Array, " s"],
    names: tuple[str, ...],
    substeps: int = 1,
    keep: Callable[[Filtered], Any] = lambda sample: sample,
) -> Any:
    """Filter one segment; what `keep` takes of each sample's `Filtered`, by default all of it. `F`: process noise by
    state in addition to the system's own, unit of the state per square root of a second; `names` of the outputs in the
    order of `rows.measured`. Innovations and their variances are in units of the recorded channels. Otherwise a scale
    error that makes the corrected channels smaller would increase the likelihood."""

    def one_sample(carry, row):
        x, P = carry
        now, then, z, variance, scale = row
        y, C = linearised_outputs(system, x, now, names)
        correction, P_estimate, e, S, used = correct(P, C, z - y, variance)
        estimate = x + correction
        step = lambda x: advance(system, x, now, then, rows.dt, substeps)  # noqa: E731
        ahead, transition = value_and_slope(step, estimate)
        density = F**2 + system.noise_density(estimate, now)
        sample = Filtered(x, P, estimate, P_estimate, transition, e / scale, S / scale**2, used)
        return (ahead, predicted_covariance(transition, P_estimate, density, rows.dt)), keep(sample)

    by_sample = (rows.now, rows.then, rows.measured, rows.variance, rows.scale)
    return jax.lax.scan(one_sample, (rows.begin, rows.covariance), by_sample)[1]


def linearised_outputs(system: System, x: Float[Array, " s"], u: Row, names: Sequence[str]) -> tuple[Array, Array]:
    """Outputs (c,) and their derivative by the state (c, s) at one instant."""
    return value_and_slope(lambda x: outputs_at(system, x, u, names), x)


def value_and_slope(f: Callable[[Array], Array], x: Float[Array, " s"]) -> tuple[Array, Array]:
    """f and its derivative by the state (the last axis) from one evaluation; of f and its `jacfwd` the compiler would
    evaluate f twice, because it does not merge their loops."""
    return jax.vmap(lambda e: jax.jvp(f, (x,), (e,)), out_axes=(None, -1))(jnp.eye(len(x)))


def correct(
    P: Float[Array, "s s"],
    C: Float[Array, "c s"],
    residual: Float[Array, " c *m"],
    variance: Float[Array, " c"],
    used: Bool[Array, " c"] | None = None,
) -> tuple[Array, Array, Array, Array, Array]:
    """Correction of the state (s, *m) by the outputs of one sample, the covariance after it, and the innovations
    (c, *m). `P`: covariance of the predicted state; `C`: derivative of the outputs by it; `residual`: measured minus
    predicted, with its derivatives in further columns; `variance`: of the measurement noise; `used`: which outputs were
    measured, by default those that are not NaN. Also returned: the variances of the innovations, and `used`. The loop
    over the outputs is unrolled, which is faster for so few."""
    used = jnp.isfinite(residual) if used is None else used
    column = lambda x: x.reshape(x.shape + (1,) * (residual.ndim - 1))  # noqa: E731

    def one(carry, output):
        correction, P = carry
        h, residual, r, use = output
        e, Ph = residual - jnp.sum(column(h) * correction, axis=0), jnp.sum(P * h, axis=1)
        S = jnp.sum(h * Ph) + r
        K = jnp.where(use, Ph / S, 0.0)
        return (correction + column(K) * e, P - K[:, None] * Ph), (jnp.where(use, e, 0.0), jnp.where(use, S, 1.0))

    rows = (C, jnp.where(column(used), residual, 0.0), variance, used)
    begin = (jnp.zeros((len(P), *residual.shape[1:])), P)
    (correction, P), (e, S) = jax.lax.scan(one, begin, rows, unroll=True)
    return correction, P, e, S, used


def gains(
    P: Float[Array, "s s"], C: Float[Array, "c s"], variance: Float[Array, " c"], used: Bool[Array, " c"]
) -> tuple[Float[Array, "s c"], Float[Array, "c c"]]:
    """Gain of `correct`, and the matrix that whitens measured minus predicted: what it makes of each output alone."""
    gain, _, whitening, _, _ = correct(P, C, jnp.eye(len(C)), variance, used)
    return gain, whitening


def predicted_covariance(
    transition: Float[Array, "s s"], P: Float[Array, "s s"], density: Float[Array, " s"], dt: Any
) -> Float[Array, "s s"]:
    """Covariance (s, s) of the state one sample later, with white noise of spectral `density` (s,)."""
    ahead = transition @ P @ transition.T + discrete_noise(transition, density, dt)
    return 0.5 * (ahead + ahead.T)


def log_density_terms(e: Float[Array, " c"], S: Float[Array, " c"], used: Bool[Array, " c"]) -> Float[Array, ""]:
    """Log density of one sample's innovations `e` of variance `S`."""
    return -0.5 * jnp.sum(jnp.where(used, jnp.log(2.0 * jnp.pi * S) + e**2 / S, 0.0))


def log_likelihood(found: Filtered) -> Float[Array, ""]:
    """Log density of all measured samples, each given those before it."""
    return jnp.sum(jax.vmap(log_density_terms)(found.innovation, found.variance, found.used))


def smooth(found: Filtered) -> tuple[Float[Array, "n s"], Float[Array, "n s s"]]:
    """Smoothed states and their covariances (Rauch, Tung and Striebel)."""

    def back(carry, row):
        x, P = carry
        estimate, covariance, transition, predicted, ahead = row
        gain = jnp.linalg.solve(ahead, transition @ covariance).T
        x = estimate + gain @ (x - predicted)
        P = covariance + gain @ (P - ahead) @ gain.T
        return (x, P), (x, P)

    last = (found.state[-1], found.covariance[-1])
    rows = tuple(y[:-1] for y in (found.state, found.covariance, found.transition))
    rows = (*rows, found.predicted[1:], found.predicted_covariance[1:])
    _, (x, P) = jax.lax.scan(back, last, rows, reverse=True)
    return jnp.concatenate([x, last[0][None]]), jnp.concatenate([P, last[1][None]])


# --- Log likelihood of the innovations of `innovations.filter_segments`, with a fast gradient for samplers.
# Reverse differentiation of a filter stores all intermediate values of every sample. Here the filter runs once.
# Outputs, motion and their first and second derivatives by the state are then computed for all samples at once along
# its path, so that the loop over the samples, and its reverse, contains only products of small matrices. Value and
# gradient are exact.


class NoisePoint(NamedTuple):
    """Parameters (k,), process noise (s,) as in `filter_segments`, and variances of the measurement noise (c,)."""

    theta: Float[Array, " k"]
    F: Float[Array, " s"]
    R: Float[Array, " c"]


class _Path(NamedTuple):
    """States before and after each sample's correction."""

    before: Float[Array, "w n s"]
    after: Float[Array, "w n s"]


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


def _filter_path(point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array) -> tuple[Array, _Path]:
    prepared = prepare(flown, point.theta)

    def keep(sample):
        return log_density_terms(sample.innovation, sample.variance, sample.used), _Path(sample.predicted, sample.state)

    each = jax.vmap(lambda rows: kalman_filter(prepared.sensed, rows, point.F, flown.outputs, flown.substeps, keep))
    terms, path = each(filter_inputs(flown, prepared, start_deviation, point.R))
    return jnp.sum(terms), path


@eqx.filter_custom_vjp
def _density(point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array) -> Array:
    return _filter_path(point, flown, start_deviation)[0]


@_density.def_fwd
def _forward(_perturbed: Any, point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array):
    path = _filter_path(point, flown, start_deviation)[1]
    return jax.value_and_grad(_log_likelihood_along)(point, flown, start_deviation, path)


@_density.def_bwd
def _backward(slope: NoisePoint, cotangent: Array, *_: Any):
    return jax.tree.map(lambda g: cotangent * g, slope)


def innovations_density(
    flown: SegmentTrajectories, point: NoisePoint, start_deviation: Float[Array, " s"]
) -> Float[Array, ""]:
    """Log likelihood of `innovations.filter_segments`; `flown` is `nameless`, to share compiled programs."""
    return _density(point, flown, start_deviation)


def _log_likelihood_along(point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array, path: _Path) -> Array:
    """The log likelihood along a given path, exact to first order in the change of the path with the point."""
    path = jax.lax.stop_gradient(path)
    prepared = prepare(flown, point.theta)
    rows = filter_inputs(flown, prepared, start_deviation, point.R)
    local = _linearise_along(prepared.sensed, rows, point.F, flown, path)

    def of_segment(rows: FilterInputs, path: _Path, local: _Local) -> Array:
        """By the filter linearised along the path. The reverse pass computes each step again: storing costs more."""

        @jax.checkpoint
        def one_sample(carry, row):
            x, P, total = carry
            local, before, after, variance, scale = row
            held = jax.lax.stop_gradient(local)
            dx = x - before
            matrix, residual = local.matrix + local.matrix_slope @ dx, local.residual - held.matrix @ dx
            correction, P, e, S, used = correct(P, matrix, residual, variance)
            dx = x + correction - after
            transition = local.transition + local.transition_slope @ dx
            P = predicted_covariance(transition, P, local.density + local.density_slope @ dx, rows.dt)
            total = total + log_density_terms(e / scale, S / scale**2, used)
            return (local.predicted + held.transition @ dx, P, total), None

        by_sample = (local, path.before, path.after, rows.variance, rows.scale)
        return jax.lax.scan(one_sample, (rows.begin, rows.covariance, jnp.zeros(())), by_sample)[0][2]

    return jnp.sum(jax.vmap(of_segment)(rows, path, local))


def _linearise_along(system: System, rows: FilterInputs, F: Array, flown: SegmentTrajectories, path: _Path) -> _Local:
    dt = jnp.broadcast_to(rows.dt[:, None], path.before.shape[:2])
    over_samples = lambda f: jax.vmap(jax.vmap(f))  # noqa: E731

    def functions(system: System) -> tuple[Callable[[Array], Array], ...]:
        outputs = over_samples(lambda x, u: outputs_at(system, x, u, flown.outputs))
        motion = over_samples(lambda x, now, then, dt: advance(system, x, now, then, dt, flown.substeps))
        density = over_samples(system.noise_density)
        return (
            lambda x: outputs(x, rows.now),
            lambda x: motion(x, rows.now, rows.then, dt),
            lambda x: density(x, rows.now),
        )

    def by_state(f: Callable[[Array], Array], x: Float[Array, "w n s"]) -> tuple[Array, Array]:
        along = lambda e: jax.jvp(f, (x,), (jnp.broadcast_to(e, x.shape),))  # noqa: E731
        return jax.vmap(along, out_axes=(None, -1))(jnp.eye(x.shape[-1]))

    outputs_of, motion_of, density_of = functions(system)
    (y, matrix), (predicted, transition) = by_state(outputs_of, path.before), by_state(motion_of, path.after)
    outputs_of, motion_of, density_held = functions(jax.lax.stop_gradient(system))
    second = lambda f, x: by_state(lambda x: by_state(f, x)[1], x)[1]  # noqa: E731
    slopes = second(outputs_of, path.before), second(motion_of, path.after), by_state(density_held, path.after)[1]
    matrix_slope, transition_slope, density_slope = jax.lax.stop_gradient(slopes)
    density = F**2 + density_of(path.after)
    return _Local(
        rows.measured - y, matrix, matrix_slope, predicted, transition, transition_slope, density, density_slope
    )
