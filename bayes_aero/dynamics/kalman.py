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
    identity = jnp.eye(len(density))
    change = transition - identity
    half = identity + 0.5 * change - 0.125 * change @ change
    whole = (transition * density) @ transition.T + 4.0 * (half * density) @ half.T
    return dt / 6.0 * (whole + identity * density)


def _each_sample(f: Callable[..., Any]) -> Callable[..., Any]:
    return jax.vmap(jax.vmap(f))


def value_and_slope(f: Callable[[Array], Array], x: Float[Array, "*n s"]) -> tuple[Array, Array]:
    """f and its derivative by the state (the last axis) from one evaluation, of one sample or many; of f and its
    `jacfwd` the compiler would evaluate f twice, because it does not merge their loops."""
    along = lambda e: jax.jvp(f, (x,), (jnp.broadcast_to(e, x.shape),))  # noqa: E731
    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(x.shape[-1]))


def correct(
    P: Square, C: Float[Array, "c s"], residual: Float[Array, " c *m"], variance: PerOutput, used: Bool[Array, " c"]
) -> tuple[Array, Array, Array, Array]:
    """Correction of the state (s, *m) by the outputs of one sample, the covariance after it, and the innovations
    (c, *m). `P`: covariance of the predicted state; `C`: derivative of the outputs by it; `residual`: measured minus
    predicted, with its derivatives in further columns; `variance`: of the measurement noise; `used`: which outputs were
    measured. Also returned: the variances of the innovations. The loop over the outputs is unrolled, which is faster
    for so few."""
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
    return correction, P, e, S


def gains(
    P: Square, C: Float[Array, "c s"], variance: PerOutput, used: Bool[Array, " c"]
) -> tuple[Float[Array, "s c"], Float[Array, "c c"]]:
    """Gain of `correct`, and the matrix that whitens measured minus predicted: what it makes of each output alone."""
    gain, _, whitening, _ = correct(P, C, jnp.eye(len(C)), variance, used)
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


def _recursion(outputs: Any, motion: Any, dt: Any) -> Callable[[tuple[Array, Square], Any], Any]:
    """The step of every filter: from the predicted state and its covariance, and a row of data with the variance of its
    noise and which outputs were measured, to those a sample later and `Filtered`. `outputs(x, row)`: measured minus
    predicted, and the derivative of the outputs by the state; `motion(x, row)`: the state a sample later, its
    derivative, and the density of the process noise. States and residuals may have derivatives in further columns."""

    @partial(jax.checkpoint, prevent_cse=False)  # to store each step takes as long or longer, and longer to compile
    def one_sample(predicted, given):
        (x, P), (row, variance, used) = predicted, given
        residual, C = outputs(x, row)
        # Not by the residual: a filter that has diverged would take its own outputs for missing ones.
        correction, P_estimate, e, S = correct(P, C, residual, variance, used)
        ahead, transition, density = motion(x + correction, row)
        sample = Filtered(x, P, x + correction, P_estimate, transition, e, S, used)
        return (ahead, predicted_covariance(transition, P_estimate, density, dt)), sample

    return one_sample


def kalman_filter(
    system: System, rows: FilterInputs, F: PerState, names: tuple[str, ...], substeps: int = 1
) -> Filtered:
    """Filter one segment. `F`: process noise by state in addition to the system's own, unit of the state per square
    root of a second; `names` of the outputs in the order of `rows.measured`. Innovations and their variances are in
    units of the recorded channels. Otherwise a scale error that makes the corrected channels smaller would increase the
    likelihood."""

    def outputs(x, row):
        now, _, z = row
        y, C = value_and_slope(lambda x: outputs_at(system, x, now, names), x)
        return z - y, C

    def motion(x, row):
        now, then, _ = row
        ahead = value_and_slope(lambda x: advance(system, x, now, then, rows.dt, substeps), x)
        return *ahead, F**2 + system.noise_density(x, now)

    by_sample = (rows.now, rows.then, rows.measured), rows.variance, jnp.isfinite(rows.measured)
    found = jax.lax.scan(_recursion(outputs, motion, rows.dt), (rows.begin, rows.covariance), by_sample)[1]
    return _recorded(found, rows.scale)


def _recorded(found: Filtered, scale: Float[Array, "*w n c"]) -> Filtered:
    """The same with innovations in recorded units; `scale`: derivatives of corrected outputs by the recorded ones."""
    return found._replace(innovation=found.innovation / scale, variance=found.variance / scale**2)


def filter_segments(
    flown: SegmentTrajectories, theta: Theta, start_deviation: PerState, F: PerState, R: PerOutput
) -> Filtered:
    """Every segment by the extended Kalman filter, from its measured initial state; `R` of attached flow."""
    prepared = prepare(flown, theta)
    each = jax.vmap(lambda rows: kalman_filter(prepared.sensed, rows, F, flown.outputs, flown.substeps))
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


def log_likelihood(filtered: Filtered) -> Float[Array, ""]:
    """Log density of all measured samples, each given those before it."""
    e, S = filtered.innovation, filtered.variance
    return -0.5 * jnp.sum(jnp.where(filtered.used, jnp.log(2.0 * jnp.pi * S) + e**2 / S, 0.0))


def innovations_density(
    flown: SegmentTrajectories, theta: Theta, start_deviation: PerState, F: PerState, R: PerOutput
) -> Float[Array, ""]:
    """Log likelihood of `filter_segments`; `flown` is `nameless`, to share compiled programs."""
    return log_likelihood(filter_segments(flown, theta, start_deviation, F, R))


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
) -> tuple[Float[Array, "w n c m"], Float[Array, "w n c"], Filtered]:
    """Innovations, their derivatives in d directions at constant gains; variances. Missing: 0 and 1. Recorded units.
    Also the filter, whose states and innovations, SI, have their derivatives in further columns."""

    def of_segment(lin, noise, dt):
        begin = jnp.concatenate([lin.begin[:, None], lin.begin_drive], axis=1), noise.begin
        return jax.lax.scan(_linear_recursion(dt), begin, _by_sample(lin, noise))[1]

    found = jax.vmap(of_segment)(lin, noise, dt)
    e, slopes = found.innovation[..., :1], found.innovation[..., 1:]
    slopes = slopes - e * lin.scale_drive / lin.scale[..., None]
    S = jnp.where(found.used, found.variance / lin.scale**2, 1.0)
    return jnp.concatenate([e, slopes], axis=-1) / lin.scale[..., None], S, found


def _by_sample(lin: LinearisedFilter, noise: Disturbances) -> Any:
    """Rows of a segment for `_linear_recursion`; what is of the initial state is replaced by what is of samples."""
    lin = lin._replace(begin=lin.before, begin_drive=lin.before)
    return (lin, noise._replace(begin=noise.density)), noise.variance, jnp.isfinite(lin.residual)


def _linear_recursion(dt: Any) -> Callable[[tuple[Array, Square], Any], Any]:
    """The step along a path. The motion of states that are random processes is their decay."""

    def outputs(x, row):
        lin, _ = row
        residual = jnp.concatenate([lin.residual[:, None], -lin.direct], axis=1)
        return residual - lin.matrix @ x.at[:, 0].add(-lin.before), lin.matrix

    def motion(x, row):
        lin, noise = row
        autonomous, decayed = noise.decay > 0.0, jnp.exp(-noise.decay * dt)
        Phi = jnp.where((jnp.eye(len(x)) > 0.0) & autonomous, jnp.diag(decayed), lin.transition)
        ahead = jnp.where(autonomous, decayed * lin.after, lin.ahead)
        ahead = jnp.concatenate([ahead[:, None], lin.drive], axis=1)
        return ahead + Phi @ x.at[:, 0].add(-lin.after), Phi, noise.density

    return _recursion(outputs, motion, dt)


def noise_derivatives(
    lin: LinearisedFilter, noise: Disturbances, slopes: Disturbances, dt: Float[Array, " w"], filtered: Filtered
) -> tuple[Float[Array, "w n c m"], Float[Array, "w n c m"]]:
    """Derivatives of innovations and variances by the noise in m directions, along a held path; recorded units.
    `filtered`: of `linear_innovations`. The derivatives of the steps are computed for all samples at once."""
    moved = ("begin_drive", "drive", "direct", "scale_drive")
    lin = lin._replace(**{name: getattr(lin, name)[..., :0] for name in moved})  # without directions of parameters

    def of_segment(lin, noise, slopes, dt, x, P):
        def step(lin, x, P, noise):
            ahead, sample = _linear_recursion(dt)((x, P), ((lin, noise), noise.variance, jnp.isfinite(lin.residual)))
            return ahead, (sample.innovation[:, 0], sample.variance)

        (by_sample, noise), *_ = _by_sample(lin, noise)
        slope = lambda lin, *at: jax.linearize(partial(step, lin), *at)[1]  # noqa: E731
        rows = jax.vmap(slope)(by_sample, x, P, noise), slopes._replace(begin=slopes.density)
        begin = jnp.zeros((*x.shape[1:], slopes.begin.shape[-1])), slopes.begin
        return jax.lax.scan(lambda d, row: jax.vmap(row[0], -1, -1)(*d, row[1]), begin, rows)[1]

    path = filtered.predicted[..., :1], filtered.predicted_covariance
    de, dS = jax.vmap(of_segment)(lin, noise, slopes, dt, *path)
    used, unit = filtered.used[..., None], lin.scale[..., None]
    return jnp.where(used, de / unit, 0.0), jnp.where(used, dS / unit**2, 0.0)


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

    def predict(begin, rows, gain, dt):
        def innovation(x, row):
            now, _, z = row
            return jnp.where(jnp.isfinite(z), z - outputs_at(prepared.sensed, x, now, flown.outputs), 0.0)

        ahead = lambda x, row: advance(prepared.sensed, x, row[0], row[1], dt, flown.substeps)  # noqa: E731
        return _observe(begin, rows, gain, innovation, ahead)

    rows = prepared.drives, later(prepared.drives, flown.held), flown.only_inside(prepared.true)
    return jax.vmap(predict)(prepared.initial_states, rows, by.gain, jnp.asarray(flown.dt))


def _observe(begin: Array, rows: Any, gain: Float[Array, "n s c"], innovation: Any, ahead: Any) -> Observed:
    """An observer of one segment. A row of `rows` belongs to a sample; `innovation(x, row)` gives the innovation of a
    state, `ahead(x, row)` the state a sample later. Directions are the last axis of both where they have any."""

    def one_sample(x, row):
        row, K = row
        e = innovation(x, row)
        return ahead(x + K @ e, row), Observed(e, x, x + K @ e)

    return jax.lax.scan(one_sample, begin, (rows, gain))[1]


def observer_derivatives(lin: LinearisedFilter, by: Observer) -> Float[Array, "w n c d"]:
    """Derivatives of the innovations of an observer in the d directions of `lin`, linearised along its path."""
    rows = (lin.transition, lin.drive, lin.matrix, lin.direct, jnp.isfinite(lin.residual))
    return _linear_observer(lin.begin_drive, rows, by)


def _linear_observer(begin: Float[Array, "w s d"], rows: tuple[Array, ...], by: Observer) -> Float[Array, "w n c d"]:
    """Innovations by transition, drive, matrix and direct effect of each sample, and whether outputs were measured."""

    def innovation(dx, row):
        _, _, C, direct, used = row
        return jnp.where(used[:, None], -direct - C @ dx, 0.0)

    ahead = lambda dx, row: row[0] @ dx + row[1]  # noqa: E731
    observe = lambda begin, rows, gain: _observe(begin, rows, gain, innovation, ahead)  # noqa: E731
    return jax.vmap(observe)(begin, rows, by.gain).innovation


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
    return _linear_observer(begin, (known.transition, drive, matrix, direct, jnp.isfinite(true)), by)
