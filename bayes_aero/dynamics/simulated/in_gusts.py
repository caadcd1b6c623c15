"""Flights through random gusts: a system whose states include gusts, driven by their white noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from bayes_aero.dynamics.system import System, advance


def through_gusts(
    system: System,
    start: Float[Array, " s"],
    inputs: Mapping[str, Float[Array, " n"]],
    dt: Any,
    white: Float[Array, "n s"],
    outputs: Sequence[str],
    substeps: int = 1,
) -> tuple[Float[Array, "n c"], Bool[Array, " n"]]:
    """Outputs of one flight, and whether each sample was reached inside the envelope.

    A random process of decay rate a and spectral density q gains the variance q (1 - exp(-2 a dt)) / (2 a) in a sample,
    so that its own distribution is exact; within the sample the other states see its mean.

    Args:
        system: with gusts among its states.
        start: initial state, (s,).
        inputs: by name, (n,).
        dt: sample time, s.
        white: independent standard normal numbers, (n, s).
        outputs: c names.
        substeps: integration steps a sample.
    """
    bounds = [system.envelope.get(name, (-jnp.inf, jnp.inf)) for name in system.states]
    lower, upper = (jnp.array([b[i] for b in bounds]) for i in (0, 1))
    then = {name: jnp.append(x[1:], x[-1]) for name, x in inputs.items()}

    def one_sample(x, row):
        now, later, noise = row
        rate = 2.0 * system.decay(x, now)
        gained = system.noise_density(x, now) * jnp.where(rate > 0.0, -jnp.expm1(-rate * dt) / rate, dt)
        found = system.motion(x, now)[1]
        found |= {name: x[i] for i, name in enumerate(system.states) if name in system.state_outputs}
        sound = jnp.all(jnp.isfinite(x)) & jnp.all((x >= lower) & (x <= upper))
        after = advance(system, x, now, later, dt, substeps) + jnp.sqrt(gained) * noise
        return after, (jnp.stack([found[name] for name in outputs]), sound)

    _, (made, sound) = jax.lax.scan(one_sample, start, (dict(inputs), then, white))
    return made, jnp.cumsum(~sound) == 0
