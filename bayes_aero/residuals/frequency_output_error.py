"""Output error of linear cards in the frequency domain, without integration.

Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 7. The form for sampled records is our own: it
has no error of quadrature, and the ends of a record need not be in trim.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import expm
from jaxtyping import Array, Float

from bayes_aero.dynamics.linear import LinearDynamics, LinearSystem
from bayes_aero.flight.card.linear_table import ONE
from bayes_aero.model.joined_channels import Flights
from bayes_aero.residuals.frequency_error import (
    Band,
    LinearFrequencyError,
    lines_in,
    sampling_times,
    transform_rows,
)


class LinearFrequencyOutputError(LinearFrequencyError):
    """Output error of a linear card in a band: recorded minus computed transforms of the outputs.

    With inputs linear between samples, x_{i+1} = P x_i + G u_i + H u_{i+1}. Its transform over the samples but the last
    is (z - P) X = (G + H z) U - z (x_end - x_begin - H (u_end - u_begin)), z = exp(j w dt). So it needs no integration,
    which would diverge for an unstable aircraft, and is exact for any record. The change of the state over a record
    begins with the recorded one; it and a drift of each output are free in every fit.
    """

    changes: Float[np.ndarray, "w s"]  # of the states, by manoeuvre

    @classmethod
    def in_band(cls, flights: Flights, dynamics: LinearDynamics, band: Band) -> LinearFrequencyOutputError:
        """`flights` under `dynamics`, in `band` (Hz). Raises `InputError` where a state was not recorded."""
        LinearFrequencyError.in_band(flights, dynamics, band)
        told = zip(flights.lengths, sampling_times(flights), flights.names, strict=True)
        rows = [transform_rows(lines_in(band, n - 1, dt, name), n - 1, dt) for n, dt, name in told]
        x = np.stack([np.asarray(flights.channels[name]) for name in dynamics.states], axis=1)
        ends = np.cumsum(flights.lengths)
        changes = x[ends - 1] - x[ends - np.array(flights.lengths)]
        return cls(flights, dynamics, tuple(rows), changes)

    @property
    def outputs(self) -> tuple[str, ...]:
        """States, then further outputs."""
        return (*self.states, *self.further)

    def offsets(self, theta: Float[np.ndarray, " k"], outputs: Sequence[str]) -> Float[np.ndarray, "m c o"]:
        """Sensitivities to the change of each state over a manoeuvre, and to a drift of each output."""
        keep = [self.outputs.index(name) for name in outputs]
        s, c = len(self.states), len(keep)
        S = np.zeros((len(self.manoeuvre), c, len(self.rows) * (s + c)))
        begin = 0
        for number, rows in enumerate(self.rows):
            place, first = slice(begin, begin + len(rows)), number * (s + c)
            S[place, :, first : first + s] = np.asarray(_changes(self, jnp.asarray(theta), number))[:, keep]
            drift = rows @ np.linspace(-1.0, 1.0, rows.shape[1])
            S[place, np.arange(c), first + s + np.arange(c)] = drift[:, None]
            begin += len(rows)
        return S

    def moved(self, offsets: Float[np.ndarray, " o"]) -> LinearFrequencyOutputError:
        """The same at other changes of the states."""
        by = offsets.reshape(len(self.rows), -1)[:, : len(self.states)]
        return replace(self, changes=self.changes + by)

    def residual(self, theta: Float[Array, " k"]) -> Float[Array, "m c"]:
        """Recorded minus computed transforms."""
        system, drives = self.system_and_inputs(theta)
        channels, ends = self.flights.channels, np.cumsum([0, *self.flights.lengths])
        recorded = jnp.stack([channels[name] for name in self.outputs], axis=1)
        u = jnp.stack([drives[name] for name in (*system.inputs_read, ONE)], axis=1)
        parts = []
        for number, rows in enumerate(self.rows):
            own = slice(ends[number], ends[number + 1])
            U = _complex(rows @ u[own][:-1]), u[own][-1] - u[own][0]
            modelled = self.transforms(system, theta, number, U, jnp.asarray(self.changes[number]))
            parts.append(rows @ recorded[own][:-1] - jnp.concatenate([modelled.real, modelled.imag]))
        return jnp.concatenate(parts)

    def transforms(
        self,
        system: LinearSystem,
        theta: Float[Array, " k"],
        number: int,
        U: tuple[Array, Array],
        change: Float[Array, " s"],
    ) -> Array:
        """Transforms (f, c) of the outputs of manoeuvre `number`, complex; `U`: of the inputs, and their change."""
        n, s = self.rows[number].shape[1], len(self.states)
        dt = self.flights.channels["dt"][sum(self.flights.lengths[:number])]
        phase = -jnp.angle(_complex(self.rows[number])[:, 1])  # of one sample
        z = jnp.exp(1j * phase)[:, None, None]
        A, B = system.matrix[:s, :s], system.matrix[:s, s:]
        C, D = system.matrix[s:, :s], system.matrix[s:, s:]
        P, G, H = _first_order_hold(A, B, dt)
        end = np.sqrt(2.0 / n) * (change - H @ U[1])
        drive = U[0][..., None]
        X = jnp.linalg.solve(z * jnp.eye(s) - P, (G + H * z) @ drive - z * end[:, None])[..., 0]
        read = X @ C.T + U[0] @ D.T
        values = self.dynamics.values(theta)
        late = {name: values[p] for name, p in self.dynamics.delays(self.outputs).items()}
        found = {name: X[:, i] for i, name in enumerate(self.states)}
        for i, name in enumerate(system.read):
            found[name] = read[:, i] + found.get(name, 0.0)
        delayed = {name: jnp.exp(-1j * phase / dt * late[name]) for name in late}
        return jnp.stack([found[name] * delayed.get(name, 1.0) for name in self.outputs], axis=1)


def _complex(parts: Array | np.ndarray) -> Array:
    """Lines from their real parts, then imaginary parts."""
    parts, half = jnp.asarray(parts), len(parts) // 2
    return parts[:half] + 1j * parts[half:]


def _first_order_hold(A: Float[Array, "s s"], B: Float[Array, "s i"], dt: Array) -> tuple[Array, Array, Array]:
    """P, G and H of x_{i+1} = P x_i + G u_i + H u_{i+1} for x' = A x + B u with u linear between samples."""
    s, i = B.shape
    big = jnp.zeros((s + 2 * i, s + 2 * i))
    big = big.at[:s, :s].set(A * dt).at[:s, s : s + i].set(B * dt).at[s : s + i, s + i :].set(jnp.eye(i))
    step = expm(big)[:s]
    return step[:, :s], step[:, s : s + i] - step[:, s + i :], step[:, s + i :]


@eqx.filter_jit
def _changes(responses: LinearFrequencyOutputError, theta, number: int):
    """Derivatives (m, c, s) of the computed outputs of one manoeuvre by the change of its state."""
    system, _ = responses.system_and_inputs(theta)
    inputs = len(system.inputs_read) + 1
    nothing = jnp.zeros((len(responses.rows[number]) // 2, inputs), complex), jnp.zeros(inputs)

    def parts(change):
        found = responses.transforms(system, theta, number, nothing, change)
        return jnp.concatenate([found.real, found.imag])

    return jax.jacfwd(parts)(jnp.zeros(len(responses.states)))
