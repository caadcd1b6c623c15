"""Residuals in the frequency domain: finite Fourier transforms over a band, in which bias and drift drop out.

The residuals of a model are transformed at the multiples of 1/T inside a band; T is the length of a manoeuvre. The rows
of the transform are scaled so that white noise keeps its variance in the real and in the imaginary part of every line.
Constants and straight lines over each manoeuvre are taken out before. An equation that holds at every sample holds for
the sums over samples, too, so no quadrature of the Fourier integral is needed.

Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 7; Morelli and Grauer, AIAA 2018-0279.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import expm
from jaxtyping import Array, Float, Int

from bayes_aero.dynamics.linear import LinearDynamics, LinearSystem
from bayes_aero.errors import InputError
from bayes_aero.flight.card_tables import ONE
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.model import Model
from bayes_aero.physics.filters import differentiate_joined
from bayes_aero.residuals.base import ResidualModel
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.units import number

Band = tuple[float, float]
"""Lowest and highest frequency, Hz."""

ROUNDING = 1e-9  # of the product of a frequency and a time


def lines_in(band: Band, n: int, dt: float, name: str) -> Float[np.ndarray, " f"]:
    """Frequencies in `band` at which a record of `n` samples is transformed: multiples of 1/(n dt), Hz."""
    # `InputError`: the band is empty, goes beyond half the sampling rate, or holds no line of this record.
    low, high, seconds = *band, n * dt
    if not (math.isfinite(high) and 0.0 < low < high):
        raise InputError(f"the band {low:g} to {high:g} Hz is empty; give a low frequency above 0 and a higher one")
    if high >= 0.5 / dt:
        raise InputError(f"the band ends at {high:g} Hz, and {name} shows frequencies below {0.5 / dt:g} Hz only")
    k = np.arange(math.ceil(low * seconds - ROUNDING), math.floor(high * seconds + ROUNDING) + 1)
    if not len(k):
        raise InputError(
            f"the band {low:g} to {high:g} Hz has no frequency of {name}, which lasts {number(seconds)} s; its lines "
            f"are {1.0 / seconds:.2g} Hz apart, so widen the band"
        )
    return k / seconds


def transform_rows(frequencies: Float[np.ndarray, " f"], n: int, dt: float) -> Float[np.ndarray, "r n"]:
    """Rows that transform n samples: real parts of all frequencies, then imaginary parts (r = 2 f)."""
    phase = 2.0 * np.pi * np.outer(frequencies, np.arange(n) * dt)
    return np.sqrt(2.0 / n) * np.concatenate([np.cos(phase), -np.sin(phase)])


def without_trend(rows: Float[np.ndarray, "r n"]) -> Float[np.ndarray, "r n"]:
    """The same rows of a record of which a straight line was taken; white noise keeps its variance in each."""
    line, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, rows.shape[1]), 2))
    for _ in range(2):  # the second time takes what rounding has left, so that constants vanish to the last digit
        rows = rows - (rows @ line) @ line.T
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


class InBand(ResidualModel):
    """Transforms take the place of means over blocks: m real and imaginary parts of all lines and manoeuvres."""

    rows: tuple[Float[np.ndarray, "_ _"], ...]  # by manoeuvre

    @property
    def manoeuvre(self) -> Int[np.ndarray, " m"]:
        """Which manoeuvre each part of a line belongs to."""
        return np.repeat(np.arange(len(self.rows)), [len(rows) for rows in self.rows])

    @property
    def seconds(self) -> float:
        """Recorded time for each residual, s."""
        return float(np.sum(np.asarray(self.flights.channels["dt"]))) / len(self.manoeuvre)

    def block(self, x: Float[Array, "n ..."]) -> Float[Array, "m ..."]:
        """Transforms of anything sampled at the recorded rate."""
        ends = np.cumsum(self.flights.lengths)[:-1]
        parts = zip(self.rows, jnp.split(x, ends), strict=True)
        return jnp.concatenate([jnp.tensordot(rows, part[: rows.shape[1]], axes=1) for rows, part in parts])

    def offsets(self, theta: Float[np.ndarray, " k"], outputs: Sequence[str]) -> Float[np.ndarray, "m c o"]:  # noqa: ARG002
        """None: the rows hold no constants."""
        return np.zeros((len(self.manoeuvre), len(outputs), 0))

    def moved(self, offsets: Float[np.ndarray, " o"]) -> InBand:  # noqa: ARG002
        """The same model at changed offsets, where the sensitivities depend on them."""
        return self


def sampling_times(flights: Flights) -> list[float]:
    """Sampling time of each manoeuvre, s."""
    dt = np.asarray(flights.channels["dt"])
    return [float(dt[begin]) for begin in np.cumsum([0, *flights.lengths[:-1]])]


def _rows(flights: Flights, band: Band) -> tuple[Float[np.ndarray, "_ _"], ...]:
    told = zip(flights.lengths, sampling_times(flights), flights.names, strict=True)
    return tuple(without_trend(transform_rows(lines_in(band, n, dt, name), n, dt)) for n, dt, name in told)


class FrequencyError(InBand, EquationError):
    """Equation error of the coefficients in a band."""

    rows: tuple[Float[np.ndarray, "_ _"], ...]

    @classmethod
    def in_band(cls, flights: Flights, model: Model, band: Band) -> FrequencyError:
        """`flights` under `model`, in `band` (Hz)."""
        whole = EquationError.of(flights, model)
        return cls(flights, model, whole.measuring, (), _rows(flights, band))


_residual = eqx.filter_jit(lambda responses, theta: responses.residual(theta))


@eqx.filter_jit
def _slopes(responses: LinearFrequencyError, theta, directions):
    residual, slope = jax.linearize(responses.residual, theta)
    return residual, jax.vmap(slope)(directions)


class LinearFrequencyError(InBand, eqx.Module):
    """Equation error of a linear card in a band: derivatives of recorded states, and further outputs."""

    # States and inputs of the right-hand sides are the recorded ones.
    flights: Flights
    dynamics: LinearDynamics = eqx.field(static=True)
    rows: tuple[Float[np.ndarray, "_ _"], ...]

    @classmethod
    def in_band(cls, flights: Flights, dynamics: LinearDynamics, band: Band) -> LinearFrequencyError:
        """`flights` under `dynamics`, in `band` (Hz). Raises `InputError` where a state was not recorded."""
        unseen = [name for name in dynamics.states if name not in flights.channels]
        if unseen:
            raise InputError(f"{unseen[0]} was not recorded, and equation error needs every state; leave the band out")
        return cls(flights, dynamics, _rows(flights, band))

    @property
    def further(self) -> tuple[str, ...]:
        """Recorded outputs that are no states."""
        return tuple(n for n in self.dynamics.rows.outputs if n in self.flights.channels and n not in self.states)

    @property
    def states(self) -> tuple[str, ...]:
        """As the card lists them."""
        return self.dynamics.states

    @property
    def outputs(self) -> tuple[str, ...]:
        """Derivatives of the states, then further outputs."""
        return (*(f"d{name}/dt" for name in self.states), *self.further)

    def evaluate(
        self, theta: Float[Array, " k"] | Float[np.ndarray, " k"]
    ) -> tuple[Float[Array, "m c"], Mapping[str, Array]]:
        """Residuals at these parameters."""
        return _residual(self.nameless, jnp.asarray(theta)), {}

    def slopes(
        self, theta: Float[np.ndarray, " k"], directions: Float[np.ndarray, "d k"]
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "d m c"]]:
        """Residuals and minus their derivatives in these directions."""
        residual, slope = _slopes(self.nameless, jnp.asarray(theta), jnp.asarray(directions))
        return np.asarray(residual), -np.asarray(slope)

    def system_and_inputs(self, theta: Float[Array, " k"]) -> tuple[LinearSystem, dict[str, Array]]:
        """The system at these parameters, and its recorded inputs."""
        values = self.dynamics.values(theta)
        system = self.dynamics.system(values, self.flights.aircraft)
        assert isinstance(system, LinearSystem)
        return system, self.dynamics.drives(values, self.flights.channels, self.flights)

    def residual(self, theta: Float[Array, " k"]) -> Float[Array, "m c"]:
        """Transforms of what the equations leave."""
        system, drives = self.system_and_inputs(theta)
        channels = self.flights.channels
        x = jnp.stack([channels[name] for name in self.states], axis=1)
        rates, found = jax.vmap(system.motion)(x, drives)
        ends = [channels[name] for name in ("dt", "first", "last")]
        derivatives = jnp.stack([differentiate_joined(column, *ends) for column in x.T], axis=1)
        more = [(channels[name] - found[name])[:, None] for name in self.further]
        return self.block(jnp.concatenate([derivatives - rates, *more], axis=1))


# --- Output error of linear cards in the frequency domain, without integration.
# Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 7. The form for sampled records is our own:
# it has no error of quadrature, and the ends of a record need not be in trim.


class LinearFrequencyOutputError(LinearFrequencyError):
    """Output error of a linear card in a band: recorded minus computed transforms of the outputs."""

    # With inputs linear between samples, x_{i+1} = P x_i + G u_i + H u_{i+1}. Its transform over the samples but the
    # last is (z - P) X = (G + H z) U - z (x_end - x_begin - H (u_end - u_begin)), z = exp(j w dt). So it needs no
    # integration, which would diverge for an unstable aircraft, and is exact for any record. The change of the state
    # over a record begins with the recorded one; it and a drift of each output are free in every fit.
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
        for k, rows in enumerate(self.rows):
            place, first = slice(begin, begin + len(rows)), k * (s + c)
            S[place, :, first : first + s] = np.asarray(_changes(self, jnp.asarray(theta), k))[:, keep]
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
        for k, rows in enumerate(self.rows):
            own = slice(ends[k], ends[k + 1])
            U = _complex(rows @ u[own][:-1]), u[own][-1] - u[own][0]
            modelled = self.transforms(system, theta, k, U, jnp.asarray(self.changes[k]))
            parts.append(rows @ recorded[own][:-1] - jnp.concatenate([modelled.real, modelled.imag]))
        return jnp.concatenate(parts)

    def transforms(
        self,
        system: LinearSystem,
        theta: Float[Array, " k"],
        k: int,
        U: tuple[Array, Array],
        change: Float[Array, " s"],
    ) -> Array:
        """Transforms (f, c) of the outputs of manoeuvre `k`, complex; `U`: of the inputs, and their change."""
        n, s = self.rows[k].shape[1], len(self.states)
        dt = self.flights.channels["dt"][sum(self.flights.lengths[:k])]
        phase = -jnp.angle(_complex(self.rows[k])[:, 1])  # of one sample
        z = jnp.exp(1j * phase)[:, None, None]
        A, B = system.matrix[:s, :s], system.matrix[:s, s:]
        C, D = system.matrix[s:, :s], system.matrix[s:, s:]
        i = B.shape[1]
        big = jnp.zeros((s + 2 * i, s + 2 * i))  # x_{j+1} = P x_j + G u_j + H u_{j+1} for u linear between samples
        big = big.at[:s, :s].set(A * dt).at[:s, s : s + i].set(B * dt).at[s : s + i, s + i :].set(jnp.eye(i))
        step = expm(big)[:s]
        P, G, H = step[:, :s], step[:, s : s + i] - step[:, s + i :], step[:, s + i :]
        end = np.sqrt(2.0 / n) * (change - H @ U[1])
        drive = U[0][..., None]
        X = jnp.linalg.solve(z * jnp.eye(s) - P, (G + H * z) @ drive - z * end[:, None])[..., 0]
        read = X @ C.T + U[0] @ D.T
        values = self.dynamics.values(theta)
        late = {name: values[p] for name, p in self.dynamics.delays(self.outputs).items()}
        found = {name: X[:, i] for i, name in enumerate(self.states)}
        for row, name in enumerate(system.read):
            found[name] = read[:, row] + found.get(name, 0.0)
        delayed = {name: jnp.exp(-1j * phase / dt * late[name]) for name in late}
        return jnp.stack([found[name] * delayed.get(name, 1.0) for name in self.outputs], axis=1)


def _complex(parts: Array | np.ndarray) -> Array:
    """Lines from their real parts, then imaginary parts."""
    parts, half = jnp.asarray(parts), len(parts) // 2
    return parts[:half] + 1j * parts[half:]


@eqx.filter_jit
def _changes(responses: LinearFrequencyOutputError, theta, k: int):
    """Derivatives (m, c, s) of the computed outputs of one manoeuvre by the change of its state."""
    system, _ = responses.system_and_inputs(theta)
    inputs = len(system.inputs_read) + 1
    nothing = jnp.zeros((len(responses.rows[k]) // 2, inputs), complex), jnp.zeros(inputs)

    def parts(change):
        found = responses.transforms(system, theta, k, nothing, change)
        return jnp.concatenate([found.real, found.imag])

    return jax.jacfwd(parts)(jnp.zeros(len(responses.states)))
