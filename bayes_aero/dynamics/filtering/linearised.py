"""Filter linearised along its own path: derivatives of all samples at once, then products of small matrices.

The extended Kalman filter runs sample by sample. Along its path the motion is linear in small changes of state and
parameters, and the filter of the linearised system has the same innovations. It gives the effect of changes of
parameters, process noise and measurement noise in a fraction of the time. Source: Jazwinski, *Stochastic Processes
and Filtering Theory*, 1970, ch. 8.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.filtering.innovations import Observer, segment_inputs
from bayes_aero.dynamics.filtering.kalman import outputs_at
from bayes_aero.dynamics.segments import Prepared, SegmentTrajectories, prepare
from bayes_aero.dynamics.system import Row, System
from bayes_aero.dynamics.tangent import between, later, motion, stage_points, stage_table


class Linearised(NamedTuple):
    """Segments linearised along a path, with derivatives in d directions of the parameters.

    `before`, `after`: states before and after the correction, at which outputs and motion are linearised; `ahead`: the
    state one sample after `after`; `residual`: measured minus outputs at `before`, NaN where missing; `begin`: initial
    states; `scale`: derivative of the corrected outputs by the recorded ones.
    """

    before: Float[Array, "w n s"]
    after: Float[Array, "w n s"]
    ahead: Float[Array, "w n s"]
    transition: Float[Array, "w n s s"]
    drive: Float[Array, "w n s d"]
    residual: Float[Array, "w n c"]
    matrix: Float[Array, "w n c s"]
    direct: Float[Array, "w n c d"]
    begin: Float[Array, "w s"]
    begin_drive: Float[Array, "w s d"]
    scale: Float[Array, "w n c"]
    scale_drive: Float[Array, "w n c d"]


class StateDerivatives(NamedTuple):
    """Derivatives by the state: of the outputs before a correction, of the next state after it, and of the motion at
    the m Runge-Kutta stages between the samples, with the states there."""

    matrix: Float[Array, "w n c s"]
    transition: Float[Array, "w n s s"]
    points: Float[Array, "m w n s"]
    motion: Float[Array, "m w n s s"]


def state_derivatives(
    flown: SegmentTrajectories, theta: Float[Array, " k"], before: Float[Array, "w n s"], after: Float[Array, "w n s"]
) -> StateDerivatives:
    """Derivatives by the state of all samples at once, at parameters `theta`."""
    prepared = prepare(flown, theta)
    unit = jnp.eye(before.shape[-1])
    points, now = _stages(flown, prepared, after)[0], _at_stages(flown, prepared.drives)

    def slopes(f):
        return lambda x, u: jax.vmap(jax.linearize(lambda x: f(prepared.sensed, x, u), x)[1], out_axes=-1)(unit)

    matrix = _each_sample(slopes(partial(outputs_at, names=flown.outputs)))(before, prepared.drives)
    rates = jax.lax.map(lambda row: _each_sample(slopes(_rate))(*row), (points, now))
    transition = _moved(flown, rates, jnp.zeros_like(rates), jnp.broadcast_to(unit, rates.shape[1:]))
    return StateDerivatives(matrix, transition, points, rates)


def linearise(
    flown: SegmentTrajectories,
    theta: Float[Array, " k"],
    before: Float[Array, "w n s"],
    after: Float[Array, "w n s"],
    directions: Float[Array, "d k"],
    known: StateDerivatives | None = None,
) -> Linearised:
    """Linearise outputs at the states `before` and the motion at the states `after`, at parameters `theta`.

    `known`: the derivatives by the state, where they were computed before.
    """
    known = known or state_derivatives(flown, theta, before, after)
    at = prepare(flown, theta)
    dynamic, static = eqx.partition(at.sensed, eqx.is_inexact_array)

    def by_parameters(theta):
        prepared = prepare(flown, theta)
        *_, true, scale = segment_inputs(flown, prepared)
        own = eqx.filter(prepared.sensed, eqx.is_inexact_array)
        return true, prepared.initial_states, scale, own, prepared.drives

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
    drive = _moved(flown, known.motion, rates, jnp.zeros(rates.shape[1:]))
    modelled = _each_sample(partial(outputs, at.sensed))(before, at.drives)
    finite = lambda y: jnp.where(jnp.isfinite(y), y, 0.0)  # noqa: E731
    return Linearised(
        before,
        after,
        _stages(flown, at, after)[1],
        known.transition,
        drive,
        true - modelled,
        finite(known.matrix),
        finite(direct - true_drive),
        begin,
        begin_drive,
        scale,
        scale_drive,
    )


def _each_sample(f: Callable[..., Array]) -> Callable[..., Array]:
    return jax.vmap(jax.vmap(f))


def _rate(system: System, x: Array, u: Row) -> Array:
    return motion(system, x, u)[0]


def _at_stages(flown: SegmentTrajectories, drives: dict[str, Array]) -> dict[str, Array]:
    """Inputs (w, n, ...) at every Runge-Kutta stage between the samples, (m, w, n, ...)."""
    first = {name: jnp.moveaxis(x, 1, -1) for name, x in drives.items()}
    then = {name: jnp.moveaxis(x, -1, 1) for name, x in later(first, flown.held).items()}
    return jax.vmap(lambda share: between(drives, then, share))(stage_table(flown.substeps)[0])


def _stages(flown: SegmentTrajectories, prepared: Prepared, after: Float[Array, "w n s"]) -> tuple[Array, Array]:
    """States at every Runge-Kutta stage of the way from `after` to the next sample, (m, w, n, s), and there."""
    table, h = stage_table(flown.substeps), (jnp.asarray(flown.dt) / flown.substeps)[:, None, None]
    return stage_points(prepared.sensed, after, _at_stages(flown, prepared.drives), h, table[1:])


def _moved(
    flown: SegmentTrajectories, A: Float[Array, "m w n s s"], b: Float[Array, "m w n s d"], dx: Float[Array, "w n s d"]
) -> Float[Array, "w n s d"]:
    """A small change of the state one sample later, from the derivatives of the motion at every stage."""
    h = (jnp.asarray(flown.dt) / flown.substeps)[:, None, None, None]
    slope = lambda i, x: jnp.sum(A[i][..., None] * x[..., None, :, :], axis=-2) + b[i]  # noqa: E731
    for i in range(0, len(A), 4):
        k1 = slope(i, dx)
        k2 = slope(i + 1, dx + 0.5 * h * k1)
        k3 = slope(i + 2, dx + 0.5 * h * k2)
        dx = dx + h / 6.0 * (k1 + 2.0 * (k2 + k3) + slope(i + 3, dx + h * k3))
    return dx


def observer_derivatives(lin: Linearised, by: Observer) -> Float[Array, "w n c d"]:
    """Derivatives of the innovations of an observer in the d directions of `lin`, linearised along its path."""
    rows = (lin.transition, lin.drive, lin.matrix, lin.direct, jnp.isfinite(lin.residual), by.gain)
    return jax.vmap(_observed)(lin.begin_drive, *rows)


def _observed(begin, *rows):
    """The same in one segment, from the change of its initial state and rows of all samples."""

    def one_sample(dx, row):
        Phi, drive, C, direct, used, K = row
        de = jnp.where(used[:, None], -direct - C @ dx, 0.0)
        return Phi @ (dx + K @ de) + drive, de

    return jax.lax.scan(one_sample, begin, rows)[1]


class InputDerivatives(NamedTuple):
    """Derivatives in one direction of the inputs: of the next state by their values at the sample and at the next one
    (the last axis), of the outputs."""

    ahead: Float[Array, "w n s 2"]
    direct: Float[Array, "w n c"]


def derivatives_by_input(
    flown: SegmentTrajectories,
    theta: Float[Array, " k"],
    before: Float[Array, "w n s"],
    known: StateDerivatives,
    direction: dict[str, Float[Array, ""]],
) -> InputDerivatives:
    """Derivatives in this direction of inputs that are linear between samples, at parameters `theta`.

    `before`: states before each correction, where the outputs are; the motion is that of `known`.
    """
    prepared = prepare(flown, theta)
    now = _at_stages(flown, prepared.drives)

    def slope(f):
        def of_input(x, u):
            own = {name: u[name] for name in direction}
            return jax.jvp(lambda given: f(prepared.sensed, x, u | given), (own,), (direction,))[1]

        return _each_sample(of_input)

    direct = slope(partial(outputs_at, names=flown.outputs))(before, prepared.drives)
    rates = jax.lax.map(lambda row: slope(_rate)(*row), (known.points, now))
    share = stage_table(flown.substeps)[0] * (not flown.held)
    both = jnp.stack([1.0 - share, share], axis=-1)[:, None, None, None]
    ahead = _moved(flown, known.motion, rates[..., None] * both, jnp.zeros((*before.shape, 2)))
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
    """Changes of the innovations of an observer by d histories along a direction, linearised along its path.

    `before`, `after`: the histories at the states before and after each correction. The former act on the outputs; the
    motion to the next sample goes from the latter to the former.
    """
    then = jnp.concatenate([before[:, 1:], before[:, -1:]], axis=1)
    drive = own.ahead[..., :1] * after[:, :, None] + own.ahead[..., 1:] * then[:, :, None]
    direct = own.direct[..., None] * before[:, :, None]
    matrix = jnp.where(jnp.isfinite(known.matrix), known.matrix, 0.0)
    *_, true, _ = segment_inputs(flown, prepare(flown, theta))
    begin = jnp.zeros((len(flown.index), known.matrix.shape[-1], before.shape[-1]))
    return jax.vmap(_observed)(begin, known.transition, drive, matrix, direct, jnp.isfinite(true), by.gain)
