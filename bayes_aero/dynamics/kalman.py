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
    MIDDLE,
    Row,
    System,
    advance,
    advance_linearised,
    between,
    later,
    middles,
    motion,
    stage_points,
    step_series,
)
from bayes_aero.processes import Compiled, compiled_at

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
    return dt / 6.0 * sum(weight * (X * density) @ X.T for weight, X in _simpson(transition))


def _simpson(transition: Float[Array, "*n s s"]) -> list[tuple[float, Array]]:
    """Weights of Simpson's rule, and the transitions over a whole sample, half of it, and none."""
    identity = jnp.eye(transition.shape[-1])
    change = transition - identity
    half = identity + 0.5 * change - 0.125 * change @ change
    return [(1.0, transition), (4.0, half), (1.0, identity)]


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
    scale: Float[Array, "*w n c"]  # derivatives of the corrected outputs by the recorded ones
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
        return *advance_linearised(system, x, now, then, rows.dt, substeps), F**2 + system.noise_density(x, now)

    by_sample = (rows.now, rows.then, rows.measured), rows.variance, jnp.isfinite(rows.measured)
    found = jax.lax.scan(_recursion(outputs, motion, rows.dt), (rows.begin, rows.covariance), by_sample)[1]
    return found._replace(innovation=found.innovation / rows.scale, variance=found.variance / rows.scale**2)


def filter_segments(
    flown: SegmentTrajectories, theta: Theta, start_deviation: PerState, F: PerState, R: PerOutput
) -> Filtered:
    """Every segment by the extended Kalman filter, from its measured initial state; `R` of attached flow."""
    prepared = prepare(flown, theta)
    each = jax.vmap(lambda rows: kalman_filter(prepared.sensed, rows, F, flown.outputs, flown.substeps))
    return each(filter_inputs(flown, prepared, start_deviation, R))


@Compiled
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


# --- Derivatives of the innovations along a filtered path, at whose states everything is linear.
# Source: Gupta and Mehra, IEEE Trans. Automatic Control 19 (1974) 774.


class Disturbances(NamedTuple):
    """Noise of linearised segments, or its derivatives in the directions of a further axis."""

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


def scores_along(
    path: Filtered, lin: LinearisedFilter, noise: Disturbances, slopes: Disturbances, dt: Float[Array, " w"]
) -> tuple[Float[Array, " j"], Float[Array, "j j"]]:
    """Gradient of minus the log likelihood and expected information, in the directions of `lin`, in which the gains are
    held, then in those of the noise, `slopes`. By the innovations of all outputs of a sample together."""

    def at_sample(P, C, R, used):
        gain, _, whitening, S = correct(P, C, jnp.eye(len(C)), R, used)
        return gain, whitening / jnp.sqrt(S)[:, None]

    gain, white = _each_sample(at_sample)(path.predicted_covariance, lin.matrix, noise.variance, path.used)
    C, ahead_gain, step = lin.matrix, path.transition @ gain, dt[:, None, None, None]
    e = jnp.where(path.used, lin.residual, 0.0)
    u = jnp.einsum("wnij,wnj->wni", white, e)
    v = jnp.einsum("wnji,wnj->wni", white, u)  # the innovations times their inverse covariance
    decayed = -step * jnp.exp(-step * noise.decay[..., None]) * slopes.decay
    turned = decayed[..., :, None, :] * (path.covariance @ jnp.swapaxes(path.transition, -1, -2))[..., None]
    of_density = sum(weight * _diagonal(X, slopes.density) for weight, X in _simpson(path.transition))
    grown = step[..., None] / 6.0 * of_density + _diagonal(ahead_gain, slopes.variance)
    grown += turned + jnp.swapaxes(turned, 2, 3)
    shifted = decayed * path.state[..., None] - ahead_gain @ (slopes.variance * v[..., None])
    rows = path.transition - ahead_gain @ C, grown, shifted, jnp.einsum("wncs,wnc->wns", C, v)

    def of_noise(carry, row):
        (dx, dP), (A, grown, shifted, w) = carry, row
        ahead = A @ dx + A @ jnp.einsum("ijm,j->im", dP, w) + shifted
        return (ahead, _congruent(A, dP) + grown), carry

    begin = jnp.zeros((*slopes.begin.shape[:2], slopes.begin.shape[-1]))
    of_segment = jax.vmap(lambda dx, dP, rows: jax.lax.scan(of_noise, (dx, dP), rows)[1])
    dx, dP = of_segment(begin, slopes.begin, rows)
    B = _congruent(white @ C, dP) + _diagonal(white, slopes.variance)  # of the whitened innovations' covariance
    de = observer_derivatives(lin, Observer(gain, white)) - e[..., None] * lin.scale_drive / lin.scale[..., None]
    a = white @ jnp.concatenate([de, -C @ dx], axis=-1)
    d, flat, B = de.shape[-1], a.reshape(-1, a.shape[-1]), B.reshape(-1, B.shape[-1])
    without = jnp.eye(u.shape[-1]) - u[..., :, None] * u[..., None, :]
    gradient = (flat.T @ u.ravel()).at[d:].add(0.5 * without.ravel() @ B)
    return gradient, (flat.T @ flat).at[d:, d:].add(0.5 * B.T @ B)


# Sums over few states are written out: XLA makes quicker code of them than of products of thousands of small matrices.


def _congruent(X: Float[Array, "... i s"], P: Float[Array, "... s s m"]) -> Float[Array, "... i i m"]:
    """X P X' of symmetric P in m directions."""
    half = (X @ P.reshape(*P.shape[:-2], -1)).reshape(*X.shape, P.shape[-1])
    terms = (half[..., :, None, j, :] * X[..., None, :, j, None] for j in range(X.shape[-1]))
    return sum(terms, jnp.zeros(()))


def _diagonal(X: Float[Array, "... i c"], d: Float[Array, "... c m"]) -> Float[Array, "... i i m"]:
    """X diag(d) X' in m directions."""
    squares = (X[..., :, None, j] * X[..., None, :, j] for j in range(X.shape[-1]))
    return sum((x[..., None] * d[..., None, None, j, :] for j, x in enumerate(squares)), jnp.zeros(()))


# --- Filter linearised along its own path: derivatives of all samples at once, then products of small matrices.
# The extended Kalman filter runs sample by sample. Along its path the motion is linear in small changes of state and
# parameters, and the filter of the linearised system has the same innovations. It gives the effect of changes of
# parameters, process noise and measurement noise in a fraction of the time.


class LinearisedFilter(NamedTuple):
    """Segments linearised along a path, with derivatives in d directions of the parameters."""

    transition: Float[Array, "w n s s"]
    drive: Float[Array, "w n s d"]
    residual: Float[Array, "w n c"]  # measured minus outputs at `before`, NaN where missing
    matrix: Float[Array, "w n c s"]
    direct: Float[Array, "w n c d"]
    begin_drive: Float[Array, "w s d"]
    scale: Float[Array, "w n c"]  # derivative of the corrected outputs by the recorded ones
    scale_drive: Float[Array, "w n c d"]


class StateDerivatives(NamedTuple):
    """Derivatives by the state: of the outputs before a correction, and of what follows it until the next sample."""

    matrix: Float[Array, "w n c s"]
    transition: Float[Array, "w n s s"]  # of the next state
    points: Float[Array, "m w n s"]  # states in the middle of each of m steps,
    motion: Float[Array, "m w n s s"]  # and the derivatives of the motion there, times the step


def state_derivatives(flown: SegmentTrajectories, theta: Theta, before: States, after: States) -> StateDerivatives:
    """Derivatives by the state of all samples at once, at parameters `theta`."""
    prepared = prepare(flown, theta)
    unit = jnp.eye(before.shape[-1])
    then = later(prepared.drives, flown.held)
    points = stage_points(prepared.sensed, after, prepared.drives, then, jnp.asarray(flown.dt), flown.substeps)[MIDDLE]
    now = _in_the_middle(flown, prepared.drives)

    def slopes(f):
        return lambda x, u: jax.vmap(jax.linearize(lambda x: f(prepared.sensed, x, u), x)[1], out_axes=-1)(unit)

    matrix = _each_sample(slopes(partial(outputs_at, names=flown.outputs)))(before, prepared.drives)
    rates = _step(flown) * jax.lax.map(lambda row: _each_sample(slopes(_rate))(*row), (points, now))
    transition = unit
    for A in rates:
        transition = step_series(A)[0] @ transition
    return StateDerivatives(matrix, transition, points, rates)


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

    (true, _, scale, *_), (true_drive, begin_drive, scale_drive, of_system, of_drives) = jax.vmap(
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
    middle = (_in_the_middle(flown, y) for y in (at.drives, of_drives))
    drive = _driven(known.motion, _step(flown) * jax.lax.map(lambda row: drives(_rate)(*row), (known.points, *middle)))
    modelled = _each_sample(partial(outputs, at.sensed))(before, at.drives)
    finite = lambda y: jnp.where(jnp.isfinite(y), y, 0.0)  # noqa: E731
    matrix, direct = finite(known.matrix), finite(direct - true_drive)
    rows = (known.transition, drive, true - modelled, matrix, direct)
    return LinearisedFilter(*rows, begin_drive, scale, scale_drive)


def _step(flown: SegmentTrajectories) -> Float[Array, "w 1 1 1"]:
    return (jnp.asarray(flown.dt) / flown.substeps)[:, None, None, None]


def _rate(system: System, x: Array, u: Row) -> Array:
    return motion(system, x, u)[0]


def _in_the_middle(flown: SegmentTrajectories, drives: dict[str, Array]) -> dict[str, Array]:
    then = later(drives, flown.held, axis=1)
    return jax.vmap(lambda share: between(drives, then, share))(middles(flown.substeps))


def _driven(motion: Float[Array, "m w n s s"], rates: Float[Array, "m w n s d"]) -> Float[Array, "w n s d"]:
    """What changes `rates` (times the step) of the motion make of the state a sample later."""
    drive = jnp.zeros(rates.shape[1:])
    for A, b in zip(motion, rates, strict=True):
        transition, integral = step_series(A)
        drive = transition @ drive + integral @ b
    return drive


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
    now = _in_the_middle(flown, prepared.drives)

    def slope(f):
        def of_input(x, u):
            given_inputs = {name: u[name] for name in direction}
            return jax.jvp(lambda given: f(prepared.sensed, x, u | given), (given_inputs,), (direction,))[1]

        return _each_sample(of_input)

    direct = slope(partial(outputs_at, names=flown.outputs))(before, prepared.drives)
    rates = _step(flown)[..., 0] * jax.lax.map(lambda row: slope(_rate)(*row), (known.points, now))
    share = middles(flown.substeps) * (not flown.held)
    both = jnp.stack([1.0 - share, share], axis=-1)[:, None, None, None]
    ahead = _driven(known.motion, rates[..., None] * both)
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
