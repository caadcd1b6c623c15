"""A system that can be flown: states, their motion, and what is measured; and its integration at the sample time."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

Row = Mapping[str, Any]
"""Inputs or outputs at one instant, by name."""

FAR = 1e6  # a state beyond it is no flight, whatever the system


class System(eqx.Module):
    """States (s,), named by `states`; `motion` gives their time derivative (s,) and the outputs at one instant."""

    @property
    @abstractmethod
    def states(self) -> tuple[str, ...]:
        """Names of the states, in the order of the state vector."""

    @property
    def envelope(self) -> Mapping[str, tuple[float, float]]:
        """States that must stay within bounds; beyond them a simulation stops."""
        return {}

    @abstractmethod
    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """Derivative of the state and the outputs (states among them), from the state and the inputs."""

    def settled(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:  # noqa: ARG002
        """The state in which a manoeuvre begins, given what was measured; states without a sensor are filled in."""
        return x


class Trajectory(NamedTuple):
    """States (n, s), outputs by name (n,), and whether each sample was reached inside the envelope (n,).

    From the sample where it leaves the envelope on, the state is held where it was: finite, and wrong on purpose.
    """

    states: Float[Array, "n s"]
    outputs: dict[str, Float[Array, " n"]]
    inside: Bool[Array, " n"]


def integrate(
    system: System, start: Float[Array, " s"], inputs: Mapping[str, Float[Array, " n"]], dt: Any, substeps: int = 1
) -> Trajectory:
    """Fourth-order Runge-Kutta at the sample time `dt` (s), or `substeps` times finer; inputs linear between samples.

    Fixed steps suffice for flight: the largest eigenvalue is some 7 /s. A fast state (the lag of the separation point)
    needs `substeps`.
    """
    bounds = [system.envelope.get(name, (-FAR, FAR)) for name in system.states]
    lower, upper = (jnp.array([b[i] for b in bounds]) for i in (0, 1))
    h = dt / substeps

    def advance(x, now, change, share):
        """One step from `share` of the sample time on."""

        def at(extra):
            return {name: now[name] + (share + extra / substeps) * change[name] for name in now}

        k1, outputs = system.motion(x, at(0.0))
        middle = at(0.5)
        k2, _ = system.motion(x + 0.5 * h * k1, middle)
        k3, _ = system.motion(x + 0.5 * h * k2, middle)
        k4, _ = system.motion(x + h * k3, at(1.0))
        return x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4), outputs

    def step(carry, rows):
        x, inside = carry
        now, then = rows
        change = {name: then[name] - now[name] for name in now}
        new, outputs = advance(x, now, change, 0.0)
        if substeps > 1:
            new = jax.lax.fori_loop(1, substeps, lambda i, y: advance(y, now, change, i / substeps)[0], new)
        sound = inside & jnp.all(jnp.isfinite(new)) & jnp.all((new >= lower) & (new <= upper))
        return (jnp.where(sound, new, x), sound), (x, outputs, inside)

    now = {name: jnp.asarray(x) for name, x in inputs.items()}
    then = {name: jnp.concatenate([x[1:], x[-1:]]) for name, x in now.items()}
    begin = jnp.all(jnp.isfinite(start))
    _, (states, outputs, inside) = jax.lax.scan(step, (start, begin), (now, then))
    return Trajectory(states, outputs, inside)
