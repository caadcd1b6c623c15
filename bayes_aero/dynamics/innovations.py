"""Innovations: measured minus predicted one sample ahead. The state is corrected at each sample.

The gain varies with each sample as in an extended Kalman filter, or is held. Source: Jategaonkar, *Flight Vehicle
System Identification*, 2nd ed. 2015, ch. 5.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics import kalman
from bayes_aero.dynamics.segments import SegmentTrajectories, prepare
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


def filter_segments(
    flown: SegmentTrajectories,
    theta: Float[Array, " k"],
    start_deviation: Float[Array, " s"],
    F: Float[Array, " s"],
    R: Float[Array, " c"],
) -> kalman.Filtered:
    """Every segment by the extended Kalman filter, from its measured initial state; `R` of attached flow."""
    prepared = prepare(flown, theta)
    each = jax.vmap(lambda rows: kalman.kalman_filter(prepared.sensed, rows, F, flown.outputs, flown.substeps))
    return each(kalman.filter_inputs(flown, prepared, start_deviation, R))


@eqx.filter_jit
def prediction_errors(
    flown: SegmentTrajectories, theta: Float[Array, " k"], found: kalman.Filtered
) -> Float[Array, "w n c"]:
    """Measured minus predicted from the samples before, in recorded units; `found` is that of `filter_segments`."""
    prepared = prepare(flown, theta)
    outputs = _each_sample(lambda x, u: kalman.outputs_at(prepared.sensed, x, u, flown.outputs))
    return (flown.only_inside(prepared.true) - outputs(found.predicted, prepared.drives)) / prepared.scale


class Observer(NamedTuple):
    """Gains of each sample; `whitening` makes the innovations of the outputs of a sample uncorrelated."""

    gain: Float[Array, "w n s c"]
    whitening: Float[Array, "w n c c"]


def observer_of(
    flown: SegmentTrajectories, theta: Float[Array, " k"], R: Float[Array, " c"], found: kalman.Filtered
) -> Observer:
    """The gains of `filter_segments` at `theta` and `R`, to be held while parameters vary; `found` is its result."""
    prepared = prepare(flown, theta)

    def one(x, P, u, noise, used):
        C = kalman.linearised_outputs(prepared.sensed, x, u, flown.outputs)[1]
        return Observer(*kalman.gains(P, C, noise, used))

    noise = prepared.noise_variance(R, flown.noise_growth)
    return _each_sample(one)(found.predicted, found.predicted_covariance, prepared.drives, noise, found.used)


class Observed(NamedTuple):
    """Innovations (w, n, c), SI, and the states (w, n, s) before and after each sample's correction."""

    innovation: Float[Array, "w n c"]
    before: Float[Array, "w n s"]
    after: Float[Array, "w n s"]


def run_observer(flown: SegmentTrajectories, theta: Float[Array, " k"], by: Observer) -> Observed:
    """Innovations of every segment by an observer with given gains."""
    prepared = prepare(flown, theta)

    def predict(begin, now, then, true, gain, dt):
        def one_sample(x, rows):
            now, then, z, K = rows
            e = z - kalman.outputs_at(prepared.sensed, x, now, flown.outputs)
            e = jnp.where(jnp.isfinite(z), e, 0.0)
            estimate = x + K @ e
            return advance(prepared.sensed, estimate, now, then, dt, flown.substeps), Observed(e, x, estimate)

        return jax.lax.scan(one_sample, begin, (now, then, true, gain))[1]

    now, then = prepared.drives, later(prepared.drives, flown.held)
    rows = (prepared.initial_states, now, then, flown.only_inside(prepared.true), by.gain, jnp.asarray(flown.dt))
    return jax.vmap(predict)(*rows)


def neighbour_correlation(found: kalman.Filtered) -> Float[np.ndarray, " c"]:
    """Correlation of neighbouring innovations by output, over all segments (w, ...); 0 where there are too few."""
    scaled = np.asarray(found.innovation / np.sqrt(found.variance))
    both = np.asarray(found.used[:, 1:] & found.used[:, :-1])
    one, later_one = (np.where(both, e, 0.0) for e in (scaled[:, :-1], scaled[:, 1:]))
    power = np.sqrt(np.sum(one**2, axis=(0, 1)) * np.sum(later_one**2, axis=(0, 1)))
    return np.sum(one * later_one, axis=(0, 1)) / np.where(power > 0.0, power, 1.0)


# --- Innovations of the linearised filter, and their derivatives by process and measurement noise.
# Products of small matrices along a path whose motion is linearised already. Source: Jazwinski,
# *Stochastic Processes and Filtering Theory*, 1970, ch. 8.


class Disturbances(NamedTuple):
    """Noise of linearised segments."""

    density: Float[Array, "w n s"]  # spectral, by state
    variance: Float[Array, "w n c"]  # of the outputs
    begin: Float[Array, "w s s"]  # covariance of the initial state
    decay: Float[Array, "w n s"]  # 1/s, of states that are random processes


def disturbances_along(
    flown: SegmentTrajectories,
    theta: Float[Array, " k"],
    path: Float[Array, "w n s"],
    start_deviation: Float[Array, " s"],
    F: Float[Array, " s"],
    R: Float[Array, " c"],
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
    found, S = jax.vmap(_one_segment)(lin, noise, dt)
    e, slopes = found[..., :1], found[..., 1:]
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
        correction, P, e, S, _ = kalman.correct(P, C, e, variance, used_now)
        autonomous, decayed = decay > 0.0, jnp.exp(-decay * dt)
        Phi = jnp.where((identity > 0.0) & autonomous, jnp.diag(decayed), Phi)
        ahead = jnp.where(autonomous, decayed * after, ahead)
        mean = Phi @ (mean + correction).at[:, 0].add(-after)
        mean = mean + jnp.concatenate([ahead[:, None], drive], axis=1)
        return (mean, kalman.predicted_covariance(Phi, P, density, dt)), (e, S)

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
        (correction, P, dmean, dP), found = jax.lax.scan(one, (jnp.zeros(s), P, dmean, dP), rows, unroll=True)
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
        dP = (
            dP
            + side
            + jnp.moveaxis(side, 0, 1)
            + kalman.discrete_noise_slopes(Phi, dkept, density, towards.density, dt)
        )
        P = Phi @ turned + kalman.discrete_noise(Phi, density, dt)
        return (Phi @ (estimate - after) + ahead, 0.5 * (P + P.T), dmean, dP), found

    begin = (lin.begin, noise.begin, jnp.zeros((s, m)), slopes.begin)
    rows = (lin.before, lin.after, lin.ahead, lin.transition, lin.residual, lin.matrix)
    rows = (*rows, (noise.density, noise.variance, noise.decay), slopes._replace(begin=jnp.zeros(len(lin.before))))
    return jax.lax.scan(one_sample, begin, rows)[1]


# --- Filter linearised along its own path: derivatives of all samples at once, then products of small matrices.
# The extended Kalman filter runs sample by sample. Along its path the motion is linear in small changes of state and
# parameters, and the filter of the linearised system has the same innovations. It gives the effect of changes of
# parameters, process noise and measurement noise in a fraction of the time. Source: Jazwinski, *Stochastic Processes
# and Filtering Theory*, 1970, ch. 8.


class LinearisedFilter(NamedTuple):
    """Segments linearised along a path, with derivatives in d directions of the parameters."""

    before: Float[Array, "w n s"]  # the correction: outputs are linearised here,
    after: Float[Array, "w n s"]  # and the motion here
    ahead: Float[Array, "w n s"]  # one sample after `after`
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
    ahead: Float[Array, "w n s"]  # the next state


def state_derivatives(
    flown: SegmentTrajectories, theta: Float[Array, " k"], before: Float[Array, "w n s"], after: Float[Array, "w n s"]
) -> StateDerivatives:
    """Derivatives by the state of all samples at once, at parameters `theta`."""
    prepared = prepare(flown, theta)
    unit = jnp.eye(before.shape[-1])
    then = later(prepared.drives, flown.held)
    points, ahead = stage_points(prepared.sensed, after, prepared.drives, then, jnp.asarray(flown.dt), flown.substeps)
    now = _at_stages(flown, prepared.drives)

    def slopes(f):
        return lambda x, u: jax.vmap(jax.linearize(lambda x: f(prepared.sensed, x, u), x)[1], out_axes=-1)(unit)

    matrix = _each_sample(slopes(partial(kalman.outputs_at, names=flown.outputs)))(before, prepared.drives)
    rates = jax.lax.map(lambda row: _each_sample(slopes(_rate))(*row), (points, now))
    transition = linear_step(rates, jnp.zeros_like(rates), jnp.broadcast_to(unit, rates.shape[1:]), _step(flown))
    return StateDerivatives(matrix, transition, points, rates, ahead)


def linearise(
    flown: SegmentTrajectories,
    theta: Float[Array, " k"],
    before: Float[Array, "w n s"],
    after: Float[Array, "w n s"],
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

    outputs = partial(kalman.outputs_at, names=flown.outputs)
    direct = drives(outputs)(before, at.drives, of_drives)
    stages = (_at_stages(flown, y) for y in (at.drives, of_drives))
    rates = jax.lax.map(lambda row: drives(_rate)(*row), (known.points, *stages))
    drive = linear_step(known.motion, rates, jnp.zeros(rates.shape[1:]), _step(flown))
    modelled = _each_sample(partial(outputs, at.sensed))(before, at.drives)
    finite = lambda y: jnp.where(jnp.isfinite(y), y, 0.0)  # noqa: E731
    matrix, direct = finite(known.matrix), finite(direct - true_drive)
    rows = (before, after, known.ahead, known.transition, drive, true - modelled, matrix, direct)
    return LinearisedFilter(*rows, begin, begin_drive, scale, scale_drive)


def _each_sample(f: Callable[..., Any]) -> Callable[..., Any]:
    return jax.vmap(jax.vmap(f))


def _step(flown: SegmentTrajectories) -> Float[Array, "w 1 1 1"]:
    return (jnp.asarray(flown.dt) / flown.substeps)[:, None, None, None]


def _rate(system: System, x: Array, u: Row) -> Array:
    return motion(system, x, u)[0]


def _at_stages(flown: SegmentTrajectories, drives: dict[str, Array]) -> dict[str, Array]:
    first = {name: jnp.moveaxis(x, 1, -1) for name, x in drives.items()}
    then = {name: jnp.moveaxis(x, -1, 1) for name, x in later(first, flown.held).items()}
    return jax.vmap(lambda share: between(drives, then, share))(stage_table(flown.substeps)[0])


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


class InputDerivatives(NamedTuple):
    """In one direction of the inputs: of the next state by their values now and a sample later, of the outputs."""

    ahead: Float[Array, "w n s 2"]
    direct: Float[Array, "w n c"]


def derivatives_by_input(
    flown: SegmentTrajectories,
    theta: Float[Array, " k"],
    before: Float[Array, "w n s"],
    known: StateDerivatives,
    direction: dict[str, Float[Array, ""]],
) -> InputDerivatives:
    """Derivatives in this direction of inputs: of outputs at the states `before`, of the motion of `known`."""
    prepared = prepare(flown, theta)
    now = _at_stages(flown, prepared.drives)

    def slope(f):
        def of_input(x, u):
            given_inputs = {name: u[name] for name in direction}
            return jax.jvp(lambda given: f(prepared.sensed, x, u | given), (given_inputs,), (direction,))[1]

        return _each_sample(of_input)

    direct = slope(partial(kalman.outputs_at, names=flown.outputs))(before, prepared.drives)
    rates = jax.lax.map(lambda row: slope(_rate)(*row), (known.points, now))
    share = stage_table(flown.substeps)[0] * (not flown.held)
    both = jnp.stack([1.0 - share, share], axis=-1)[:, None, None, None]
    ahead = linear_step(known.motion, rates[..., None] * both, jnp.zeros((*before.shape, 2)), _step(flown))
    return InputDerivatives(ahead, jnp.where(jnp.isfinite(direct), direct, 0.0))


def input_innovations(
    flown: SegmentTrajectories,
    theta: Float[Array, " k"],
    known: StateDerivatives,
    own: InputDerivatives,
    by: Observer,
    before: Float[Array, "w n d"],
    after: Float[Array, "w n d"],
) -> Float[Array, "w n c d"]:
    """Changes of an observer's innovations by d histories along a direction, before and after corrections."""
    then = jnp.concatenate([before[:, 1:], before[:, -1:]], axis=1)
    drive = own.ahead[..., :1] * after[:, :, None] + own.ahead[..., 1:] * then[:, :, None]
    direct = own.direct[..., None] * before[:, :, None]
    matrix = jnp.where(jnp.isfinite(known.matrix), known.matrix, 0.0)
    true = flown.only_inside(prepare(flown, theta).true)
    begin = jnp.zeros((len(flown.index), known.matrix.shape[-1], before.shape[-1]))
    return jax.vmap(_observed)(begin, known.transition, drive, matrix, direct, jnp.isfinite(true), by.gain)
