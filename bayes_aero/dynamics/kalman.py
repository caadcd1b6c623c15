"""Extended Kalman filter: one-step predictions, the smoother, innovations and their derivatives.

The state follows dx = f(x, u) dt + F dw (w: independent Wiener processes, one a state). Outputs are measured at the
samples, z = g(x, u) + v, with independent noise of variance R. Missing samples are NaN. Outputs are processed one after
the other, which for a diagonal R is equivalent to all at once and needs no factorisation. Source: Bryson and Ho,
*Applied Optimal Control*, 1975, ch. 12; smoother: Rauch, Tung, Striebel 1965; innovations: Jategaonkar, *Flight Vehicle
System Identification*, 2nd ed. 2015, ch. 5; the linearised filter: Jazwinski, *Stochastic Processes and Filtering
Theory*, 1970, ch. 8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bayes_aero.dynamics.segments import Prepared, SegmentTrajectories, prepare
from bayes_aero.dynamics.system import (
    Row,
    System,
    advance,
    between,
    later,
    linear_step,
    motion,
    stage_points,
    stage_table,
)
from bayes_aero.processes import compiled_at

Theta = Float[Array, " k"]
PerState = Float[Array, " s"]
PerOutput = Float[Array, " c"]
NoisePoint = tuple[Theta, PerState, PerOutput]
Square = Float[Array, "s s"]
States = Float[Array, "w n s"]

# --- One sample.


def outputs_at(system: System, x: PerState, u: Row, names: Sequence[str]) -> PerOutput:
    """Outputs (c,) of these names at one instant."""
    state = zip(system.states, x, strict=True)
    outputs = motion(system, x, u)[1] | {name: value for name, value in state if name in system.state_outputs}
    return jnp.stack([outputs[name] for name in names])


def discrete_noise(transition: Square, density: PerState, dt: Any) -> Square:
    """Discrete process-noise covariance (s, s): white noise of spectral `density` (s,) over a sample of `dt` seconds.
    The integral of Phi(t) W Phi(t)' by Simpson's rule, with the square root of the transition at mid-sample. It is
    exact to the third power of dt, the order at which a gust changes the pitch rate within a sample."""
    W, identity = jnp.diag(density), jnp.eye(len(density))
    change = transition - identity
    half = identity + 0.5 * change - 0.125 * change @ change
    return dt / 6.0 * (transition @ W @ transition.T + 4.0 * half @ W @ half.T + W)


def discrete_noise_slopes(
    transition: Square, decayed: Float[Array, "s m"], density: PerState, by: Float[Array, "s m"], dt: Any
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
    by_noise = jnp.eye(len(density))[:, :, None] * by[:, None]
    return dt / 6.0 * (by_density + by_noise + side + jnp.moveaxis(side, 0, 1))


def _each_sample(f: Callable[..., Any]) -> Callable[..., Any]:
    return jax.vmap(jax.vmap(f))


def value_and_slope(f: Callable[[Array], Array], x: PerState) -> tuple[Array, Array]:
    """f and its derivative by the state (the last axis) from one evaluation; of f and its `jacfwd` the compiler would
    evaluate f twice, because it does not merge their loops."""
    return jax.vmap(lambda e: jax.jvp(f, (x,), (e,)), out_axes=(None, -1))(jnp.eye(len(x)))


def correct(
    P: Square,
    C: Float[Array, "c s"],
    residual: Float[Array, " c *m"],
    variance: PerOutput,
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
    P: Square, C: Float[Array, "c s"], variance: PerOutput, used: Bool[Array, " c"]
) -> tuple[Float[Array, "s c"], Float[Array, "c c"]]:
    """Gain of `correct`, and the matrix that whitens measured minus predicted: what it makes of each output alone."""
    gain, _, whitening, _, _ = correct(P, C, jnp.eye(len(C)), variance, used)
    return gain, whitening


def predicted_covariance(transition: Square, P: Square, density: PerState, dt: Any) -> Square:
    """Covariance (s, s) of the state one sample later, with white noise of spectral `density` (s,)."""
    ahead = transition @ P @ transition.T + discrete_noise(transition, density, dt)
    return 0.5 * (ahead + ahead.T)


# --- The filter of a segment, and of all.


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
    flown: SegmentTrajectories, prepared: Prepared, start_deviation: PerState, R: PerOutput
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
    F: PerState,
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
        y, C = value_and_slope(lambda x: outputs_at(system, x, now, names), x)
        correction, P_estimate, e, S, used = correct(P, C, z - y, variance)
        estimate = x + correction
        step = lambda x: advance(system, x, now, then, rows.dt, substeps)  # noqa: E731
        ahead, transition = value_and_slope(step, estimate)
        density = F**2 + system.noise_density(estimate, now)
        sample = Filtered(x, P, estimate, P_estimate, transition, e / scale, S / scale**2, used)
        return (ahead, predicted_covariance(transition, P_estimate, density, rows.dt)), keep(sample)

    by_sample = (rows.now, rows.then, rows.measured, rows.variance, rows.scale)
    return jax.lax.scan(one_sample, (rows.begin, rows.covariance), by_sample)[1]


def filter_segments(
    flown: SegmentTrajectories,
    theta: Theta,
    start_deviation: PerState,
    F: PerState,
    R: PerOutput,
    keep: Callable[[Filtered], Any] = lambda sample: sample,
) -> Any:
    """Every segment by the extended Kalman filter, from its measured initial state; `R` of attached flow."""
    prepared = prepare(flown, theta)
    each = jax.vmap(lambda rows: kalman_filter(prepared.sensed, rows, F, flown.outputs, flown.substeps, keep))
    return each(filter_inputs(flown, prepared, start_deviation, R))


@eqx.filter_jit
def prediction_errors(flown: SegmentTrajectories, theta: Theta, filtered: Filtered) -> Float[Array, "w n c"]:
    """Measured minus predicted from the samples before, in recorded units; `filtered` is that of `filter_segments`."""
    prepared = prepare(flown, theta)
    outputs = _each_sample(lambda x, u: outputs_at(prepared.sensed, x, u, flown.outputs))
    return (flown.only_inside(prepared.true) - outputs(filtered.predicted, prepared.drives)) / prepared.scale


def neighbour_correlation(filtered: Filtered) -> Float[np.ndarray, " c"]:
    """Correlation of neighbouring innovations by output, over all segments (w, ...); 0 where there are too few."""
    scaled = np.asarray(filtered.innovation / np.sqrt(filtered.variance))
    both = np.asarray(filtered.used[:, 1:] & filtered.used[:, :-1])
    now, after = (np.where(both, e, 0.0) for e in (scaled[:, :-1], scaled[:, 1:]))
    power = np.sqrt(np.sum(now**2, axis=(0, 1)) * np.sum(after**2, axis=(0, 1)))
    return np.sum(now * after, axis=(0, 1)) / np.where(power > 0.0, power, 1.0)


def log_density_terms(e: PerOutput, S: PerOutput, used: Bool[Array, " c"]) -> Float[Array, ""]:
    """Log density of one sample's innovations `e` of variance `S`."""
    return -0.5 * jnp.sum(jnp.where(used, jnp.log(2.0 * jnp.pi * S) + e**2 / S, 0.0))


def log_likelihood(filtered: Filtered) -> Float[Array, ""]:
    """Log density of all measured samples, each given those before it."""
    return jnp.sum(jax.vmap(log_density_terms)(filtered.innovation, filtered.variance, filtered.used))


def smooth(filtered: Filtered) -> tuple[Float[Array, "n s"], Float[Array, "n s s"]]:
    """Smoothed states and their covariances (Rauch, Tung and Striebel)."""

    def back(carry, row):
        x, P = carry
        estimate, covariance, transition, predicted, ahead = row
        gain = jnp.linalg.solve(ahead, transition @ covariance).T
        x = estimate + gain @ (x - predicted)
        P = covariance + gain @ (P - ahead) @ gain.T
        return (x, P), (x, P)

    last = (filtered.state[-1], filtered.covariance[-1])
    rows = tuple(y[:-1] for y in (filtered.state, filtered.covariance, filtered.transition))
    rows = (*rows, filtered.predicted[1:], filtered.predicted_covariance[1:])
    _, (x, P) = jax.lax.scan(back, last, rows, reverse=True)
    return jnp.concatenate([x, last[0][None]]), jnp.concatenate([P, last[1][None]])


# --- Log likelihood of the innovations, with a fast gradient for samplers.


def innovations_density(
    flown: SegmentTrajectories, theta: Theta, start_deviation: PerState, F: PerState, R: PerOutput
) -> Float[Array, ""]:
    """Log likelihood of `filter_segments`, and its gradient; `flown` is `nameless`, to share compiled programs."""
    return _density((theta, F, R), flown, start_deviation)


@eqx.filter_custom_vjp
def _density(point: NoisePoint, flown: SegmentTrajectories, start_deviation: PerState) -> Float[Array, ""]:
    theta, F, R = point
    terms = lambda sample: log_density_terms(sample.innovation, sample.variance, sample.used)  # noqa: E731
    return jnp.sum(filter_segments(flown, theta, start_deviation, F, R, terms))


@_density.def_fwd
def _forward(_perturbed: Any, point: NoisePoint, flown: SegmentTrajectories, start_deviation: PerState):
    return jax.value_and_grad(_density_along)(point, flown, start_deviation)


@_density.def_bwd
def _backward(slope: NoisePoint, cotangent: Array, *_: Any):
    return jax.tree.map(lambda g: cotangent * g, slope)


def _density_along(point: NoisePoint, flown: SegmentTrajectories, start_deviation: PerState) -> Float[Array, ""]:
    # Reverse differentiation of a filter stores all intermediate values of every sample. Here the filter runs once.
    # Outputs, motion and their first and second derivatives by the state are then computed for all samples at once
    # along its path, so that the loop over the samples, and its reverse, contains only products of small matrices.
    # The filter linearised along the path is exact to first order in the change of the path with the parameters: so
    # are value and gradient, while the path itself is not differentiated.
    theta, F, R = point
    still = jax.lax.stop_gradient(point)
    path = filter_segments(
        flown, still[0], start_deviation, *still[1:], lambda sample: (sample.predicted, sample.state)
    )
    before, after = jax.lax.stop_gradient(path)
    prepared = prepare(flown, theta)
    rows = filter_inputs(flown, prepared, start_deviation, R)
    by_sample = (
        _derivatives_along(prepared.sensed, rows, flown, before, after),
        before,
        after,
        rows.variance,
        rows.scale,
    )

    def of_segment(rows: FilterInputs, by_sample: Any) -> Array:
        @jax.checkpoint  # the reverse pass computes each step again: storing costs more
        def one_sample(carry, row):
            x, P, total = carry
            ((residual, matrix, matrix_slope), (ahead, transition, transition_slope), density), *row = row
            before, after, variance, scale = row
            dx = x - before
            residual, matrix = residual - jax.lax.stop_gradient(matrix) @ dx, matrix + matrix_slope @ dx
            correction, P, e, S, used = correct(P, matrix, residual, variance)
            dx = x + correction - after
            ahead, transition = ahead + jax.lax.stop_gradient(transition) @ dx, transition + transition_slope @ dx
            P = predicted_covariance(transition, P, F**2 + density[0] + density[1] @ dx, rows.dt)
            return (ahead, P, total + log_density_terms(e / scale, S / scale**2, used)), None

        return jax.lax.scan(one_sample, (rows.begin, rows.covariance, jnp.zeros(())), by_sample)[0][2]

    return jnp.sum(jax.vmap(of_segment)(rows, by_sample))


def _derivatives_along(system: System, rows: FilterInputs, flown: SegmentTrajectories, before: Array, after: Array):
    """Measured minus predicted outputs `before` a correction, the next state and the noise density `after` it; with
    their derivatives by the state and, of outputs and motion, the second ones."""
    dt = jnp.broadcast_to(rows.dt[:, None], before.shape[:2])

    def functions(system: System) -> tuple[Callable[[Array], Array], ...]:
        outputs = _each_sample(lambda x, u: outputs_at(system, x, u, flown.outputs))
        motion = _each_sample(lambda x, now, then, dt: advance(system, x, now, then, dt, flown.substeps))
        density = _each_sample(system.noise_density)
        return (
            lambda x: outputs(x, rows.now),
            lambda x: motion(x, rows.now, rows.then, dt),
            lambda x: density(x, rows.now),
        )

    def by_state(f: Callable[[Array], Array], x: States) -> tuple[Array, Array]:
        along = lambda e: jax.jvp(f, (x,), (jnp.broadcast_to(e, x.shape),))  # noqa: E731
        return jax.vmap(along, out_axes=(None, -1))(jnp.eye(x.shape[-1]))

    outputs_of, motion_of, density_of = functions(system)
    (y, matrix), moved = by_state(outputs_of, before), by_state(motion_of, after)
    outputs_of, motion_of, density_held = functions(jax.lax.stop_gradient(system))
    second = lambda f, x: by_state(lambda x: by_state(f, x)[1], x)[1]  # noqa: E731
    slopes = second(outputs_of, before), second(motion_of, after), by_state(density_held, after)[1]
    matrix_slope, transition_slope, density_slope = jax.lax.stop_gradient(slopes)
    return (
        (rows.measured - y, matrix, matrix_slope), (*moved, transition_slope), (density_of(after), density_slope),
    )  # fmt: skip


# --- Innovations of the linearised filter, and their derivatives by process and measurement noise.
# Products of small matrices along a path whose motion is linearised already.


class Disturbances(NamedTuple):
    """Noise of linearised segments."""

    density: States  # spectral, by state
    variance: Float[Array, "w n c"]  # of the outputs
    begin: Float[Array, "w s s"]  # covariance of the initial state
    decay: States  # 1/s, of states that are random processes


def disturbances_along(
    flown: SegmentTrajectories, theta: Theta, path: States, start_deviation: PerState, F: PerState, R: PerOutput
) -> Disturbances:
    """The noise of `filter_segments` at the states of `path`."""
    prepared = prepare(flown, theta)
    each = jax.vmap(jax.vmap(lambda x, u: (prepared.sensed.noise_density(x, u), prepared.sensed.decay(x, u))))
    density, decay = each(path, prepared.drives)
    noise = prepared.noise_variance(R, flown.noise_growth)
    begin = prepared.initial_covariance(prepared.initial_states, start_deviation)
    return Disturbances(F**2 + density, noise, begin, decay)


def linear_innovations(
    lin: LinearisedFilter, noise: Disturbances, dt: Float[Array, " w"]
) -> tuple[Float[Array, "w n c m"], Float[Array, "w n c"]]:
    """Innovations, their derivatives in d directions at constant gains; variances. Missing: 0 and 1. Recorded units."""
    innovations, S = jax.vmap(_one_segment)(lin, noise, dt)
    e, slopes = innovations[..., :1], innovations[..., 1:]
    slopes = slopes - e * lin.scale_drive / lin.scale[..., None]
    used = jnp.isfinite(lin.residual)
    S = jnp.where(used, S / lin.scale**2, 1.0)
    return jnp.concatenate([e, slopes], axis=-1) / lin.scale[..., None], S


def _one_segment(lin: LinearisedFilter, noise: Disturbances, dt: Any):
    s = lin.before.shape[-1]
    identity = jnp.eye(s)

    def one_sample(carry, row):
        mean, P = carry  # (s, 1 + d): the predicted state and its derivatives
        before, after, ahead, Phi, drive, residual, C, direct, density, variance, decay = row
        used_now = jnp.isfinite(residual)
        deviation = mean.at[:, 0].add(-before)
        e = jnp.concatenate([jnp.where(used_now, residual, 0.0)[:, None], -direct], axis=1) - C @ deviation
        correction, P, e, S, _ = correct(P, C, e, variance, used_now)
        autonomous, decayed = decay > 0.0, jnp.exp(-decay * dt)
        Phi = jnp.where((identity > 0.0) & autonomous, jnp.diag(decayed), Phi)
        ahead = jnp.where(autonomous, decayed * after, ahead)
        mean = Phi @ (mean + correction).at[:, 0].add(-after)
        mean = mean + jnp.concatenate([ahead[:, None], drive], axis=1)
        return (mean, predicted_covariance(Phi, P, density, dt)), (e, S)

    begin = jnp.concatenate([lin.begin[:, None], lin.begin_drive], axis=1)
    rows = (lin.before, lin.after, lin.ahead, lin.transition, lin.drive, lin.residual, lin.matrix, lin.direct)
    rows = (*rows, noise.density, noise.variance, noise.decay)
    return jax.lax.scan(one_sample, (begin, noise.begin), rows)[1]


def noise_derivatives(
    lin: LinearisedFilter, noise: Disturbances, slopes: Disturbances, dt: Float[Array, " w"]
) -> tuple[Float[Array, "w n c m"], Float[Array, "w n c m"]]:
    """Derivatives of innovations and variances by the noise in m directions, along a held path; recorded units."""
    de, dS = jax.vmap(_slopes_of_segment)(lin, noise, slopes, dt)
    used = jnp.isfinite(lin.residual)[..., None]
    unit = lin.scale[..., None]
    return jnp.where(used, de / unit, 0.0), jnp.where(used, dS / unit**2, 0.0)


def _slopes_of_segment(lin: LinearisedFilter, noise: Disturbances, slopes: Disturbances, dt: Any):
    """The derivative of `_one_segment` in closed form; directions are the last axis of every product. Forward
    differentiation has separate small products for each direction and takes twice as long."""
    s, m = lin.before.shape[-1], slopes.begin.shape[-1]

    def one_sample(carry, row):
        mean, P, dmean, dP = carry
        before, after, ahead, Phi, residual, C, (density, variance, decay), towards = row
        used_now = jnp.isfinite(residual)
        e = jnp.where(used_now, residual, 0.0) - C @ (mean - before)

        def one(carry, output):
            correction, P, dmean, dP = carry
            h, y, r, used, dr = output
            y, dy = y - h @ correction, -(h @ dmean)
            Ph, dPh = P @ h, jnp.sum(dP * h[:, None], axis=1)
            S, dS = h @ Ph + r, h @ dPh + dr
            K = jnp.where(used, Ph / S, 0.0)
            dK = jnp.where(used, (dPh - K[:, None] * dS) / S, 0.0)
            dP = dP - dK[:, None] * Ph[:, None] - K[:, None, None] * dPh
            after = (correction + K * y, P - jnp.outer(K, Ph), dmean + dK * y + K[:, None] * dy, dP)
            return after, (dy, dS)

        rows = (C, e, variance, used_now, towards.variance)
        (correction, P, dmean, dP), innovations = jax.lax.scan(one, (jnp.zeros(s), P, dmean, dP), rows, unroll=True)
        autonomous, decayed = decay > 0.0, jnp.exp(-decay * dt)
        dkept = jnp.where(autonomous, -dt * decayed, 0.0)[:, None] * towards.decay
        Phi = jnp.where((jnp.eye(s) > 0.0) & autonomous, jnp.diag(decayed), Phi)
        ahead = jnp.where(autonomous, decayed * after, ahead)
        estimate = mean + correction
        dmean = Phi @ dmean + dkept * estimate[:, None]
        turned = P @ Phi.T
        dP = (Phi @ dP.reshape(s, s * m)).reshape(s, s, m)
        dP = jnp.moveaxis(dP, 1, 0).reshape(s, s * m)
        dP = (Phi @ dP).reshape(s, s, m)  # its first two axes are the other way round, and it is symmetric
        side = dkept[:, None] * turned[:, :, None]
        dP = dP + side + jnp.moveaxis(side, 0, 1) + discrete_noise_slopes(Phi, dkept, density, towards.density, dt)
        P = Phi @ turned + discrete_noise(Phi, density, dt)
        return (Phi @ (estimate - after) + ahead, 0.5 * (P + P.T), dmean, dP), innovations

    begin = (lin.begin, noise.begin, jnp.zeros((s, m)), slopes.begin)
    rows = (lin.before, lin.after, lin.ahead, lin.transition, lin.residual, lin.matrix)
    rows = (*rows, (noise.density, noise.variance, noise.decay), slopes._replace(begin=jnp.zeros(len(lin.before))))
    return jax.lax.scan(one_sample, begin, rows)[1]


# --- Filter linearised along its own path: derivatives of all samples at once, then products of small matrices.
# The extended Kalman filter runs sample by sample. Along its path the motion is linear in small changes of state and
# parameters, and the filter of the linearised system has the same innovations. It gives the effect of changes of
# parameters, process noise and measurement noise in a fraction of the time.


class LinearisedFilter(NamedTuple):
    """Segments linearised along a path, with derivatives in d directions of the parameters."""

    before: States  # the correction: outputs are linearised here,
    after: States  # and the motion here
    ahead: States  # one sample after `after`
    transition: Float[Array, "w n s s"]
    drive: Float[Array, "w n s d"]
    residual: Float[Array, "w n c"]  # measured minus outputs at `before`, NaN where missing
    matrix: Float[Array, "w n c s"]
    direct: Float[Array, "w n c d"]
    begin: Float[Array, "w s"]
    begin_drive: Float[Array, "w s d"]
    scale: Float[Array, "w n c"]  # derivative of the corrected outputs by the recorded ones
    scale_drive: Float[Array, "w n c d"]


class StateDerivatives(NamedTuple):
    """Derivatives by the state: of the outputs before a correction, and of what follows it until the next sample."""

    matrix: Float[Array, "w n c s"]
    transition: Float[Array, "w n s s"]  # of the next state
    points: Float[Array, "m w n s"]  # states at the m Runge-Kutta stages,
    motion: Float[Array, "m w n s s"]  # and the derivatives of the motion there
    ahead: States  # the next state


def state_derivatives(flown: SegmentTrajectories, theta: Theta, before: States, after: States) -> StateDerivatives:
    """Derivatives by the state of all samples at once, at parameters `theta`."""
    prepared = prepare(flown, theta)
    unit = jnp.eye(before.shape[-1])
    then = later(prepared.drives, flown.held)
    points, ahead = stage_points(prepared.sensed, after, prepared.drives, then, jnp.asarray(flown.dt), flown.substeps)
    now = _at_stages(flown, prepared.drives)

    def slopes(f):
        return lambda x, u: jax.vmap(jax.linearize(lambda x: f(prepared.sensed, x, u), x)[1], out_axes=-1)(unit)

    matrix = _each_sample(slopes(partial(outputs_at, names=flown.outputs)))(before, prepared.drives)
    rates = jax.lax.map(lambda row: _each_sample(slopes(_rate))(*row), (points, now))
    transition = linear_step(rates, jnp.zeros_like(rates), jnp.broadcast_to(unit, rates.shape[1:]), _step(flown))
    return StateDerivatives(matrix, transition, points, rates, ahead)


def linearise(
    flown: SegmentTrajectories,
    theta: Theta,
    before: States,
    after: States,
    directions: Float[Array, "d k"],
    known: StateDerivatives | None = None,
) -> LinearisedFilter:
    """Linearise outputs at the states `before`, the motion at those `after`; `known`: derivatives by the state."""
    known = known or state_derivatives(flown, theta, before, after)
    at = prepare(flown, theta)
    dynamic, static = eqx.partition(at.sensed, eqx.is_inexact_array)

    def by_parameters(theta):
        prepared = prepare(flown, theta)
        numbers = eqx.filter(prepared.sensed, eqx.is_inexact_array)
        return flown.only_inside(prepared.true), prepared.initial_states, prepared.scale, numbers, prepared.drives

    (true, begin, scale, *_), (true_drive, begin_drive, scale_drive, of_system, of_drives) = jax.vmap(
        lambda t: jax.jvp(by_parameters, (theta,), (t,)), out_axes=(None, -1)
    )(directions)

    def drives(f):
        """Derivatives of f at a state in all directions, by the system's numbers and the inputs."""

        def along(x, u, du):
            slope = jax.linearize(lambda own, u: f(eqx.combine(own, static), x, u), dynamic, u)[1]
            return jax.vmap(slope, -1, -1)(of_system, du)

        return _each_sample(along)

    outputs = partial(outputs_at, names=flown.outputs)
    direct = drives(outputs)(before, at.drives, of_drives)
    stages = (_at_stages(flown, y) for y in (at.drives, of_drives))
    rates = jax.lax.map(lambda row: drives(_rate)(*row), (known.points, *stages))
    drive = linear_step(known.motion, rates, jnp.zeros(rates.shape[1:]), _step(flown))
    modelled = _each_sample(partial(outputs, at.sensed))(before, at.drives)
    finite = lambda y: jnp.where(jnp.isfinite(y), y, 0.0)  # noqa: E731
    matrix, direct = finite(known.matrix), finite(direct - true_drive)
    rows = (before, after, known.ahead, known.transition, drive, true - modelled, matrix, direct)
    return LinearisedFilter(*rows, begin, begin_drive, scale, scale_drive)


def _step(flown: SegmentTrajectories) -> Float[Array, "w 1 1 1"]:
    return (jnp.asarray(flown.dt) / flown.substeps)[:, None, None, None]


def _rate(system: System, x: Array, u: Row) -> Array:
    return motion(system, x, u)[0]


def _at_stages(flown: SegmentTrajectories, drives: dict[str, Array]) -> dict[str, Array]:
    then = later(drives, flown.held, axis=1)
    return jax.vmap(lambda share: between(drives, then, share))(stage_table(flown.substeps)[0])


# --- An observer: the filter with its gains held while parameters vary.


class Observer(NamedTuple):
    """Gains of each sample; `whitening` makes the innovations of the outputs of a sample uncorrelated."""

    gain: Float[Array, "w n s c"]
    whitening: Float[Array, "w n c c"]


@compiled_at(0)
def observer_of(flown: SegmentTrajectories, theta: Theta, R: PerOutput, filtered: Filtered) -> Observer:
    """The gains of `filter_segments` at `theta` and `R`, to be held while parameters vary; `filtered` is its result."""
    prepared = prepare(flown, theta)

    def at_sample(x, P, u, noise, used):
        C = value_and_slope(lambda x: outputs_at(prepared.sensed, x, u, flown.outputs), x)[1]
        return Observer(*gains(P, C, noise, used))

    noise = prepared.noise_variance(R, flown.noise_growth)
    return _each_sample(at_sample)(
        filtered.predicted, filtered.predicted_covariance, prepared.drives, noise, filtered.used
    )


class Observed(NamedTuple):
    """Innovations (w, n, c), SI, and the states (w, n, s) before and after each sample's correction."""

    innovation: Float[Array, "w n c"]
    before: States
    after: States


def run_observer(flown: SegmentTrajectories, theta: Theta, by: Observer) -> Observed:
    """Innovations of every segment by an observer with given gains."""
    prepared = prepare(flown, theta)

    def predict(begin, now, then, true, gain, dt):
        def one_sample(x, rows):
            now, then, z, K = rows
            e = z - outputs_at(prepared.sensed, x, now, flown.outputs)
            e = jnp.where(jnp.isfinite(z), e, 0.0)
            estimate = x + K @ e
            return advance(prepared.sensed, estimate, now, then, dt, flown.substeps), Observed(e, x, estimate)

        return jax.lax.scan(one_sample, begin, (now, then, true, gain))[1]

    now, then = prepared.drives, later(prepared.drives, flown.held)
    rows = (prepared.initial_states, now, then, flown.only_inside(prepared.true), by.gain, jnp.asarray(flown.dt))
    return jax.vmap(predict)(*rows)


def observer_derivatives(lin: LinearisedFilter, by: Observer) -> Float[Array, "w n c d"]:
    """Derivatives of the innovations of an observer in the d directions of `lin`, linearised along its path."""
    rows = (lin.transition, lin.drive, lin.matrix, lin.direct, jnp.isfinite(lin.residual), by.gain)
    return jax.vmap(_observed)(lin.begin_drive, *rows)


def _observed(begin, *rows):
    def one_sample(dx, row):
        Phi, drive, C, direct, used, K = row
        de = jnp.where(used[:, None], -direct - C @ dx, 0.0)
        return Phi @ (dx + K @ de) + drive, de

    return jax.lax.scan(one_sample, begin, rows)[1]


def derivatives_by_input(
    flown: SegmentTrajectories,
    theta: Theta,
    before: States,
    known: StateDerivatives,
    direction: dict[str, Float[Array, ""]],
) -> tuple[Float[Array, "w n s 2"], Float[Array, "w n c"]]:
    """In this direction of inputs: derivatives of the next state of `known` by their values now and a sample later, and
    of the outputs at the states `before`."""
    prepared = prepare(flown, theta)
    now = _at_stages(flown, prepared.drives)

    def slope(f):
        def of_input(x, u):
            given_inputs = {name: u[name] for name in direction}
            return jax.jvp(lambda given: f(prepared.sensed, x, u | given), (given_inputs,), (direction,))[1]

        return _each_sample(of_input)

    direct = slope(partial(outputs_at, names=flown.outputs))(before, prepared.drives)
    rates = jax.lax.map(lambda row: slope(_rate)(*row), (known.points, now))
    share = stage_table(flown.substeps)[0] * (not flown.held)
    both = jnp.stack([1.0 - share, share], axis=-1)[:, None, None, None]
    ahead = linear_step(known.motion, rates[..., None] * both, jnp.zeros((*before.shape, 2)), _step(flown))
    return ahead, jnp.where(jnp.isfinite(direct), direct, 0.0)


def input_innovations(
    flown: SegmentTrajectories,
    theta: Theta,
    known: StateDerivatives,
    by_input: tuple[Array, Array],
    by: Observer,
    before: Float[Array, "w n d"],
    after: Float[Array, "w n d"],
) -> Float[Array, "w n c d"]:
    """Changes of an observer's innovations by d histories along a direction, before and after corrections."""
    then = jnp.concatenate([before[:, 1:], before[:, -1:]], axis=1)
    ahead, direct = by_input
    drive = ahead[..., :1] * after[:, :, None] + ahead[..., 1:] * then[:, :, None]
    direct = direct[..., None] * before[:, :, None]
    matrix = jnp.where(jnp.isfinite(known.matrix), known.matrix, 0.0)
    true = flown.only_inside(prepare(flown, theta).true)
    begin = jnp.zeros((len(flown.index), known.matrix.shape[-1], before.shape[-1]))
    return jax.vmap(_observed)(begin, known.transition, drive, matrix, direct, jnp.isfinite(true), by.gain)
