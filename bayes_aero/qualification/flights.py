"""Flights of one manoeuvre that might have been: with other parameters, and through gusts."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bayes_aero.dynamics.segments import SegmentTrajectories, prepare
from bayes_aero.dynamics.simulated.in_gusts import through_gusts
from bayes_aero.inference.likelihood.disturbed import disturbed
from bayes_aero.inference.likelihood.output_error import trajectories
from bayes_aero.inference.threads import cores


def errors(
    flown: SegmentTrajectories, theta: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "w n c"], Float[np.ndarray, "w n"], Bool[np.ndarray, " w"]]:
    """Recorded minus simulated from the measured initial states, SI.

    Returns:
        Errors; the separated share of the flow (0 without a separation point); whether each manoeuvre stays inside the
        envelope.
    """
    still = jnp.zeros((len(flown.index), len(flown.dynamics.start)))
    found = trajectories(flown, jnp.asarray(theta), still)
    X = found.trajectory.outputs.get("X")
    separated = np.zeros(flown.index.shape) if X is None else np.clip(1.0 - np.asarray(X), 0.0, 1.0)
    sound = np.all(np.asarray(found.trajectory.inside) | ~flown.inside, axis=1)
    return np.asarray(found.residual), separated, sound


def spread(
    alone: SegmentTrajectories, theta: Float[np.ndarray, " k"], draws: Float[np.ndarray, "m k"]
) -> Float[np.ndarray, "m n c"]:
    """Flights of one manoeuvre with drawn parameters minus the simulation at `theta`, SI.

    Infinite from the sample at which a flight leaves the envelope.
    """
    still = jnp.zeros((1, len(alone.dynamics.start)))

    def residual(one: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n c"]:
        found = trajectories(alone, jnp.asarray(one), still)
        sound = np.asarray(found.trajectory.inside[0])[:, None]
        made = np.asarray(found.residual[0])
        return np.where(sound & np.isfinite(made), made, -np.inf)

    centre = residual(theta)
    with ThreadPoolExecutor(cores()) as pool:
        return np.stack([centre - one for one in pool.map(residual, draws)])


def gust_spread(
    alone: SegmentTrajectories,
    draws: Float[np.ndarray, "m k"],
    gusts: Mapping[str, float],
    rng: np.random.Generator,
) -> Float[np.ndarray, "m n c"]:
    """What gusts add to flights of one manoeuvre with drawn parameters, SI.

    A flight begins in gusts of their own distribution, with the measured flow at vane and pitot tube.

    Args:
        alone: the manoeuvre.
        draws: parameters of its dynamics.
        gusts: intensities and lengths by parameter name; the other gusts are calm.
        rng: of the gusts.
    """
    gusty = disturbed(alone)
    free = gusty.dynamics.free
    calm = {p.name: p.start for p in free if p.name in gusty.dynamics.disturbance_parameters}
    calm |= {p.name: 0.0 for p in free if p.name in calm and p.neutral == 0.0}
    n, s = alone.index.shape[1], len(gusty.dynamics.states)

    def one(job: tuple[Float[np.ndarray, " k"], np.ndarray]) -> Float[np.ndarray, "n c"]:
        known = calm | dict(zip(alone.dynamics.names, job[0], strict=True)) | dict(gusts)
        theta = jnp.asarray([known[p.name] for p in free])
        return np.asarray(_added(gusty.nameless, theta, jnp.asarray(job[1])))

    with ThreadPoolExecutor(cores()) as pool:
        return np.stack(list(pool.map(one, ((d, rng.standard_normal((n + 1, s))) for d in draws))))


@eqx.filter_jit
def _added(gusty: SegmentTrajectories, theta: Float[Array, " k"], white: Float[Array, "m s"]) -> Float[Array, "n c"]:
    """A flight through gusts minus the same in calm air, in the units of the record."""
    prepared = prepare(gusty, theta)
    states = prepared.initial_states
    covariance = prepared.initial_covariance(states, jnp.zeros(states.shape[1]))[0]
    size, vectors = jnp.linalg.eigh(covariance)
    begin = states[0] + vectors @ (jnp.sqrt(jnp.maximum(size, 0.0)) * white[0])
    inputs = {name: x[0] for name, x in prepared.drives.items()}

    def fly(start, noise):
        system = prepared.system
        return through_gusts(system, start, inputs, gusty.dt[0], noise, gusty.outputs, gusty.substeps)

    made, sound = jax.vmap(fly)(jnp.stack([begin, states[0]]), jnp.stack([white[1:], jnp.zeros_like(white[1:])]))
    return jnp.where(jnp.all(sound, axis=0)[:, None], (made[0] - made[1]) / prepared.scale[0], jnp.inf)
