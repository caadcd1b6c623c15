"""Log likelihood of the innovations alone, with a gradient for samplers: that of `innovations.filtered`.

Differentiated backward, a filter keeps all that it computes at every sample. Here it is followed once; then outputs,
motion and their derivatives by the state are had for all samples at once along its path, those of second order too, and
what goes sample by sample, and backward again, is algebra of small matrices. Value and gradient are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.filtering.kalman import corrected, covariance_ahead, log_terms, outputs_at, seen_at, with_slope
from bayes_aero.dynamics.segments import SegmentTrajectories, prepared
from bayes_aero.dynamics.system import System, advance
from bayes_aero.dynamics.tangent import later


class NoisePoint(NamedTuple):
    """Where the likelihood is asked for: parameters (k,), process noise (s,) as in `filtered`, variances of the
    measurement noise (c,)."""

    theta: Float[Array, " k"]
    F: Float[Array, " s"]
    R: Float[Array, " c"]


class _Path(NamedTuple):
    """States (w, n, s) before and after each sample's correction."""

    before: Float[Array, "w n s"]
    after: Float[Array, "w n s"]


class _Rows(NamedTuple):
    """What the filter needs at a point: the state before the first sample (w, s), its covariance (w, s, s), inputs at
    each sample and at the next one (w, n), outputs, the variances of their noise, and what a unit of each has become by
    correction (w, n, c)."""

    system: System
    begin: Float[Array, "w s"]
    covariance: Float[Array, "w s s"]
    now: dict[str, Array]
    then: dict[str, Array]
    measured: Float[Array, "w n c"]
    variance: Float[Array, "w n c"]
    scale: Float[Array, "w n c"]


class _Local(NamedTuple):
    """By sample: measured minus outputs before the correction, motion and noise after it; with their derivatives by the
    state (`matrix`, `transition`, `growth`), and the derivatives of two of these (`bend`, `turn`)."""

    away: Float[Array, "w n c"]
    matrix: Float[Array, "w n c s"]
    bend: Float[Array, "w n c s s"]
    ahead: Float[Array, "w n s"]
    transition: Float[Array, "w n s s"]
    turn: Float[Array, "w n s s s"]
    density: Float[Array, "w n s"]
    growth: Float[Array, "w n s s"]


def innovations_density(
    flown: SegmentTrajectories, point: NoisePoint, start_deviation: Float[Array, " s"]
) -> Float[Array, ""]:
    """Log likelihood of all segments: the sum of `kalman.log_likelihood` over `innovations.filtered`.

    Args:
        flown: segments of flights, without names (`nameless`) where calls are to share a compiled program.
        point: parameters and noise.
        start_deviation: standard deviation of the measured initial state, (s,), SI.
    """
    return _density(point, flown, start_deviation)


def _value(point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array) -> Array:
    return _followed(point, flown, start_deviation)[0]


_density = eqx.filter_custom_vjp(_value)


@_density.def_fwd
def _ahead(_perturbed: Any, point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array):
    path = _followed(point, flown, start_deviation)[1]
    return jax.value_and_grad(_along)(point, flown, start_deviation, path)


@_density.def_bwd
def _back(slope: NoisePoint, cotangent: Array, *_: Any):
    return jax.tree.map(lambda g: cotangent * g, slope)


def _rows(point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array) -> _Rows:
    ready = prepared(flown, point.theta)
    true = jnp.where(jnp.asarray(flown.inside)[:, :, None], ready.true, jnp.nan)
    first = {name: y[:, 0] for name, y in ready.drives.items()}
    begin = jax.vmap(ready.sensed.settled)(ready.begin, first)
    covariance = jax.vmap(lambda x, u: ready.sensed.start_covariance(x, u, start_deviation))(begin, first)
    variance = point.R * (ready.scale * jnp.asarray(flown.noise_growth)) ** 2
    return _Rows(
        ready.sensed, begin, covariance, ready.drives, later(ready.drives, flown.held), true, variance, ready.scale
    )


def _followed(point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array) -> tuple[Array, _Path]:
    """The log likelihood, and the path of the filter."""
    rows = _rows(point, flown, start_deviation)
    system = rows.system

    def one(begin, covariance, now, then, measured, variance, scale, dt):
        def further(carry, row):
            x, P, total = carry
            now, then, z, variance, scale = row
            y, C = seen_at(system, x, now, flown.outputs)
            moved, P, e, S, used = corrected(P, C, z - y, variance)
            after = x + moved
            step = lambda x: advance(system, x, now, then, dt, flown.substeps)  # noqa: E731
            density = point.F**2 + system.noise_density(after, now)
            ahead, transition = with_slope(step, after)
            P = covariance_ahead(transition, P, density, dt)
            return (ahead, P, total + log_terms(e / scale, S / scale**2, used)), _Path(x, after)

        start = (begin, covariance, jnp.zeros(()))
        (_, _, total), path = jax.lax.scan(further, start, (now, then, measured, variance, scale))
        return total, path

    total, path = jax.vmap(one)(*rows[1:], jnp.asarray(flown.dt))
    return jnp.sum(total), path


def _along(point: NoisePoint, flown: SegmentTrajectories, start_deviation: Array, path: _Path) -> Array:
    """The same log likelihood, to the first order in what the point moves the path by."""
    path = jax.lax.stop_gradient(path)
    rows = _rows(point, flown, start_deviation)
    local = _locally(rows, point.F, flown, path)
    noise = (rows.variance, rows.scale)
    each = jax.vmap(_linear)(rows.begin, rows.covariance, noise, jnp.asarray(flown.dt), path, local)
    return jnp.sum(each)


def _locally(rows: _Rows, F: Array, flown: SegmentTrajectories, path: _Path) -> _Local:
    """All samples at once. Derivatives that follow the path alone do not follow the point."""
    dt = jnp.broadcast_to(jnp.asarray(flown.dt)[:, None], path.before.shape[:2])
    each = lambda f: jax.vmap(jax.vmap(f))  # noqa: E731

    def functions(system: System) -> tuple[Callable[[Array], Array], ...]:
        return (
            lambda x: each(lambda x, u: outputs_at(system, x, u, flown.outputs))(x, rows.now),
            lambda x: each(lambda *y: advance(system, y[0], y[1], y[2], y[3], flown.substeps))(
                x, rows.now, rows.then, dt
            ),
            lambda x: each(system.noise_density)(x, rows.now),
        )

    see, move, drive = functions(rows.system)
    (y, matrix), (ahead, transition) = _by_state(see, path.before), _by_state(move, path.after)
    see, move, still = functions(jax.lax.stop_gradient(rows.system))
    bend = _by_state(lambda x: _by_state(see, x)[1], path.before)[1]
    turn = _by_state(lambda x: _by_state(move, x)[1], path.after)[1]
    bend, turn, growth = jax.lax.stop_gradient((bend, turn, _by_state(still, path.after)[1]))
    return _Local(rows.measured - y, matrix, bend, ahead, transition, turn, F**2 + drive(path.after), growth)


def _by_state(f: Callable[[Array], Array], x: Float[Array, "w n s"]) -> tuple[Array, Array]:
    """f and its derivative by the state of the same sample, the last axis."""
    along = lambda e: jax.jvp(f, (x,), (jnp.broadcast_to(e, x.shape),))  # noqa: E731
    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(x.shape[-1]))


def _linear(begin: Array, covariance: Array, noise: Any, dt: Array, path: _Path, local: _Local) -> Array:
    """Log likelihood of one segment by the filter of the system that is linear along the path.

    Backward, each step is computed again: to keep what it computes would cost more.
    """

    @jax.checkpoint
    def further(carry, row):
        x, P, total = carry
        here, before, after, (variance, scale) = row
        held = jax.lax.stop_gradient(here)
        dx = x - before
        moved, P, e, S, used = corrected(P, here.matrix + here.bend @ dx, here.away - held.matrix @ dx, variance)
        dx = x + moved - after
        P = covariance_ahead(here.transition + here.turn @ dx, P, here.density + here.growth @ dx, dt)
        total = total + log_terms(e / scale, S / scale**2, used)
        return (here.ahead + held.transition @ dx, P, total), None

    start = (begin, covariance, jnp.zeros(()))
    return jax.lax.scan(further, start, (local, path.before, path.after, noise))[0][2]
