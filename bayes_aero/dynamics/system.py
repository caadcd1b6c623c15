"""A dynamic system: states, their derivatives, outputs; and its integration at the sample time."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from bayes_aero.dynamics.tangent import between, later, motion, stage_table, tangent_flight

Row = Mapping[str, Any]
"""Inputs or outputs at one instant, by name."""

STATE_LIMIT = 1e6  # of states without an envelope: beyond it the simulation has diverged


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

    @property
    def state_outputs(self) -> tuple[str, ...]:
        """States that are outputs themselves."""
        return self.states

    @property
    def start(self) -> tuple[str, ...]:
        """Names of the quantities that give the initial state: the states, as far as sensors measure them."""
        return self.states

    def state_at_start(self, start: Float[Array, " b"]) -> Float[Array, " s"]:
        """The state vector of an initial state given in the quantities of `start`."""
        return start

    @abstractmethod
    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """Derivative of the state, and outputs by name, from state and inputs; `state_outputs` may be left out."""

    def complete_start(self, x: Float[Array, " b"], u: Row) -> Float[Array, " b"]:  # noqa: ARG002
        """The initial state in the quantities of `start`, with states without a sensor filled in."""
        return x

    def noise_density(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:  # noqa: ARG002
        """Spectral density of the white noise that drives each state, (s,): unit of the state squared, per second."""
        return jnp.zeros_like(x)

    def decay(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:  # noqa: ARG002
        """Decay rate (s,), 1/s, of states that are random processes; 0 for the others."""
        return jnp.zeros_like(x)

    def start_covariance(self, x: Float[Array, " s"], u: Row, deviation: Float[Array, " s"]) -> Float[Array, "s s"]:  # noqa: ARG002
        """Covariance of the initial state; `deviation` (s,): standard deviations of its measured part."""
        return jnp.diag(jnp.square(deviation))


class Trajectory(NamedTuple):
    """States (n, s), outputs by name (n,), and whether each sample was reached inside the envelope (n,).

    From the sample at which the simulation leaves the envelope, the last state inside is held, so that all values are
    finite.
    """

    states: Float[Array, "n s"]
    outputs: dict[str, Float[Array, " n"]]
    inside: Bool[Array, " n"]


def integrate(
    system: System,
    start: Float[Array, " s"],
    inputs: Mapping[str, Float[Array, " n"]],
    dt: Any,
    substeps: int = 1,
    outputs: Sequence[str] | None = None,
    *,
    held: bool = False,
) -> Trajectory:
    """Fourth-order Runge-Kutta at the sample time `dt` (s), or `substeps` times finer; inputs linear between samples.

    Inputs that are `held` keep each sample's value until the next one (zero-order hold). Fixed steps suffice for
    flight, where the largest eigenvalue is about 7 /s. A fast state (the lag of the separation point) needs `substeps`.
    `outputs` are those to return (default: all). Only forward derivatives are defined, by system, start and inputs.
    """
    now = {name: jnp.asarray(x) for name, x in inputs.items()}
    every = jax.eval_shape(lambda x, u: motion(system, x, u), start, {name: x[0] for name, x in now.items()})[1]
    chosen = tuple(every if outputs is None else outputs)
    return Trajectory(*_flight(system, start, now, dt=jnp.asarray(dt), substeps=substeps, outputs=chosen, held=held))


def advance(system: System, x: Any, now: Row, then: Row, dt: Any, substeps: int) -> Array:
    """The state a sample later."""
    return _stages(system, x, now, then, dt, substeps, lambda _: None)[0]


def step(system: System, x: Any, now: Row, then: Row, dt: Any) -> tuple[Array, dict[str, Any]]:
    """The state a sample later, and the outputs now."""
    after, found = _stages(system, x, now, then, dt, 1, lambda outputs: outputs)
    return after, {name: y[0] for name, y in found.items()}


def _stages(system: System, x: Any, now: Row, then: Row, dt: Any, substeps: int, read: Any) -> tuple[Array, Any]:
    """The state one sample later, and `read` of the outputs at every stage.

    The stages are a loop, so that the motion is compiled only once.
    """
    h = dt / substeps

    def one_sample(carry, stage):
        begin, gathered, point = carry
        share, ahead, weight, last = stage
        k, outputs = motion(system, point, between(now, then, share))
        gathered = gathered + weight * k
        begin = jnp.where(last, begin + h / 6.0 * gathered, begin)
        ahead = jnp.where(last, 0.0, ahead)
        return (begin, jnp.where(last, 0.0, gathered), begin + ahead * h * k), read(outputs)

    (after, _, _), found = jax.lax.scan(one_sample, (x, jnp.zeros_like(x), x), stage_table(substeps))
    return after, found


@eqx.filter_custom_jvp
def _flight(system, start, inputs, *, dt, substeps, outputs, held):
    """The states are computed sample by sample; then envelope and outputs for all samples at once."""
    bounds = [system.envelope.get(name, (-STATE_LIMIT, STATE_LIMIT)) for name in system.states]
    lower, upper = (jnp.array([b[i] for b in bounds]) for i in (0, 1))

    def one_sample(x, rows):
        now, then = rows
        return advance(system, x, now, then, dt, substeps), x

    _, x = jax.lax.scan(one_sample, start, (inputs, later(inputs, held)))
    sound = jnp.all(jnp.isfinite(x), axis=1)
    sound &= jnp.all((x >= lower) & (x <= upper), axis=1) | (jnp.arange(len(x)) == 0)
    inside = jnp.cumsum(~sound) == 0
    last = x[jnp.maximum(jnp.sum(inside) - 1, 0)]
    x = jnp.where(inside[:, None], x, last)
    found = jax.vmap(lambda x, u: motion(system, x, u)[1])(x, inputs)
    found |= {name: x[:, i] for i, name in enumerate(system.states) if name in system.state_outputs}
    return x, {name: found[name] for name in outputs}, inside


@_flight.def_jvp
def _flight_jvp(primals, tangents, *, dt, substeps, outputs, held):
    system, start, inputs = primals
    t_system, t_start, t_inputs = tangents
    flown = _flight(system, start, inputs, dt=dt, substeps=substeps, outputs=outputs, held=held)
    t_inputs = {name: t for name, t in t_inputs.items() if t is not None}
    t_start = jnp.zeros_like(start) if t_start is None else t_start
    row = jax.tree.map(lambda y: y[None], (flown[0], flown[2], inputs, dt))
    tangents = jax.tree.map(lambda y: y[None], (t_start, t_inputs))
    along = tangent_flight(substeps, outputs, held)
    dx, found = jax.tree.map(lambda y: y[0], along(system, *row, t_system, *tangents))
    return flown, (dx, found, None)
