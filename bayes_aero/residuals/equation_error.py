"""Equation error: measured minus modelled coefficients and flight path, as a function of the parameters of all effects.

Outputs are the coefficients and, where attitude and altitude were recorded, the flight-path integrals. One compiled
function gives the residuals and their sensitivities to all parameters of all effects, active or not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import expm
from jaxtyping import Array, Float, Int

from bayes_aero.arrays import AnyArray
from bayes_aero.dynamics.flight import LinearDynamics
from bayes_aero.dynamics.system import LinearSystem
from bayes_aero.errors import InputError
from bayes_aero.flight.card import ONE
from bayes_aero.model.model import Model
from bayes_aero.model.observations import response_scales
from bayes_aero.model.records import Flights
from bayes_aero.physics.aircraft import Axis
from bayes_aero.physics.coefficients import LiftRegression, stacked_coefficients
from bayes_aero.physics.filters import FILTER_STEP, differentiate_joined, smooth_joined
from bayes_aero.physics.kinematics import ANGLES, LATERAL, PATH, as_symmetric
from bayes_aero.processes import Compiled, compiled_at
from bayes_aero.residuals import base
from bayes_aero.units import number

DIRECTIONS_AT_ONCE = 4  # most calls need no more, and larger ones are no slower
RESPONSE = ("q", *PATH, *LATERAL)  # measured channels whose own scale an effect may change
LATERAL_RESPONSE = ("p", "r", "ay")  # and those of the lateral axis


class EquationError(base.Blockwise, eqx.Module):
    """Residuals of one set of flights under one model of many effects."""

    # Residuals are averaged over m blocks. They are in units of the recorded response: the residual of a coefficient is
    # multiplied by the ratio of its derivatives by the recorded acceleration, with the card's values over with the
    # effect's. Otherwise an effect that rescales the measurement could improve the fit by shrinking its noise. This is
    # the Jacobian term of the likelihood.
    flights: Flights
    model: Model = eqx.field(static=True)
    measuring: tuple[int, ...] = eqx.field(static=True)  # parameters on which the measured coefficients depend
    path: tuple[str, ...] = eqx.field(static=True)  # flight-path outputs
    stage = "coefficients"

    @classmethod
    def of(cls, flights: Flights, model: Model) -> EquationError:

        def measured(*theta):
            values = dict(model.fixed) | dict(zip(model.names, theta, strict=True))
            corrected = model.corrected(values, flights.channels, flights.aircraft)
            return corrected, model.actual_aircraft(values, flights.aircraft)

        program = jax.make_jaxpr(measured)(*np.ones(len(model.names))).jaxpr
        read = {id(x) for step in program.eqns for x in step.invars} | {id(x) for x in program.outvars}
        measuring = tuple(i for i, x in enumerate(program.invars) if id(x) in read)
        return cls(flights, model, measuring, base.flight_path(flights))

    @property
    def outputs(self) -> tuple[str, ...]:
        return (*self.model.coefficients, *self.path)

    def evaluate(self, theta: base.Theta) -> tuple[base.Residual, dict[str, np.ndarray]]:
        residual, details = _evaluate(self._padded, theta)
        n, m = self.flights.n, len(self.manoeuvre)
        return np.asarray(residual)[:m], {name: np.asarray(x)[:n] for name, x in details.items()}

    def traced(self, theta: base.Theta) -> tuple[base.Residual, dict[str, AnyArray]]:
        """`evaluate` as part of a larger compiled program."""
        return _residuals(_Padded(self, self.flights.regression(), None), theta)

    @cached_property
    def _padded(self) -> _Padded:
        f = self.flights
        padded, regression = f.padded
        begins = np.full(padded.n // FILTER_STEP, padded.n - FILTER_STEP)
        parts = zip(np.cumsum([0, *f.lengths[:-1]]), f.lengths, strict=True)
        first = np.concatenate([b + np.arange(0, k - k % FILTER_STEP, FILTER_STEP) for b, k in parts])
        begins[: len(first)] = first
        return _Padded(replace(self, flights=padded), regression, begins)

    def added(self, theta: base.Theta) -> _AddedToEquations:
        return _AddedToEquations(self, theta)

    def linearise(
        self, theta: base.Theta, columns: Int[np.ndarray, " j"] | None = None
    ) -> tuple[base.Residual, Float[np.ndarray, "m c j"]]:
        every = np.eye(len(theta))
        return self.along(theta, every if columns is None else every[columns])

    def along(self, theta: base.Theta, directions: base.Directions) -> tuple[base.Residual, Float[np.ndarray, "m c j"]]:
        k, m = len(theta), len(self.manoeuvre)
        # Those that change the measured coefficients cost four times those that change only the modelled ones.
        measuring = np.any(directions[:, list(self.measuring)] != 0.0, axis=1)
        sets = [np.flatnonzero(measuring), np.flatnonzero(~measuring)]
        given = np.zeros((2, -(-k // DIRECTIONS_AT_ONCE) * DIRECTIONS_AT_ONCE, k))
        for kind, places in enumerate(sets):
            given[kind, : len(places)] = directions[places]
        residual, *slopes = map(np.asarray, _linearise(self._padded, np.asarray(theta), *given))
        S = np.zeros((m, residual.shape[1], len(directions)))
        for places, slope in zip(sets, slopes, strict=True):
            S[:, : slope.shape[2], places] = np.moveaxis(slope[: len(places), :m], 0, 2)
        return residual[:m], S


class _Padded(NamedTuple):
    """Residuals, the regression of alpha-dot, and the first sample of each block, None where flights are not padded."""

    responses: EquationError
    regression: LiftRegression
    begins: Int[AnyArray, " m"] | None

    def block(self, x: Float[AnyArray, "n ..."]) -> Float[AnyArray, "m ..."]:
        if self.begins is None:
            return self.responses.block(x)
        last = x.shape[0] - FILTER_STEP + 1
        means: Any = sum(x[k : last + k] for k in range(FILTER_STEP)) / FILTER_STEP
        return means.at[self.begins].get(mode="promise_in_bounds")  # a fifth of what is gathered sample by sample


def _corrected(padded: _Padded, values: Mapping[str, Any]):
    """Corrected signals of all flights, the aircraft with its corrected constants, and the factors (n, c) that convert
    residuals of coefficients to units of the recorded response."""
    f, model = padded.responses.flights, padded.responses.model
    s = f.with_slopes(model.corrected(values, f.channels, f.aircraft), padded.regression)
    aircraft, lateral = model.actual_aircraft(values, f.aircraft), Axis.LATERAL in model.axes
    response = tuple(dict.fromkeys((*RESPONSE, *(LATERAL_RESPONSE if lateral else ()))))
    scales = response_scales(model, values, f.channels, f.aircraft, response)
    recorded = f.channels["density"] * jnp.square(f.channels["airspeed"])
    ratio = s["density"] * jnp.square(s["airspeed"]) / recorded
    force = ratio * (f.aircraft.mass / aircraft.mass)
    factors = {"CL": force, "CD": force, "Cm": ratio * (f.aircraft.Iy / aircraft.Iy) / scales["q"]}
    if lateral:
        roll = ratio * (f.aircraft.Ix / aircraft.Ix) / scales["p"]
        yaw = ratio * (f.aircraft.Iz / aircraft.Iz) / scales["r"]
        factors |= {"CY": force / scales["ay"], "Cl": roll, "Cn": yaw}
    return s, aircraft, scales, jnp.stack([factors[name] for name in model.coefficients], axis=-1)


def _modelled(model: Model, values: Mapping[str, Any], s: Mapping[str, Any], aircraft: Any) -> tuple[AnyArray, Array]:
    """Coefficients (n, c) of the model, and the separation point (n,)."""
    flow = model.flow(values, s, aircraft)
    return jnp.stack([flow[name] for name in model.coefficients], axis=-1), flow["X"]


@dataclass(frozen=True)
class _AddedToEquations:
    """Series smoothed and averaged over blocks as the coefficient is; a column is as large as its root mean square."""

    responses: EquationError
    theta: base.Theta

    @cached_property
    def signals(self) -> Mapping[str, np.ndarray]:
        return self.responses.evaluate(self.theta)[1]

    def columns(self, coefficient: str, made: base.Made, outputs: Sequence[str], _deviation: Float[np.ndarray, " c"]):
        series = (base.smoothed_means(self.responses.flights.lengths) @ made(self.signals).T).T
        slopes = np.zeros((*series.shape, len(outputs)))
        slopes[:, :, outputs.index(coefficient)] = series
        return series, slopes, np.sqrt(np.mean(series**2, axis=1))


def _smoothed(flights: Flights, rows: Float[AnyArray, "n c"]) -> Float[AnyArray, "n c"]:
    ends = flights.channels["first"], flights.channels["last"]
    return jax.vmap(lambda x: smooth_joined(x, *ends), in_axes=1, out_axes=1)(rows)


def _residuals(padded: _Padded, theta):
    responses = padded.responses
    f, model = responses.flights, responses.model
    values = model.values(theta)
    signals, aircraft, scales, factors = _corrected(padded, values)
    measured = stacked_coefficients(signals, aircraft, model.coefficients)
    modelled, X = _modelled(model, values, signals, aircraft)
    columns = [(measured - modelled) * factors]
    if responses.path:
        whole = as_symmetric(signals)
        angles = jnp.stack([whole[name] for name in ANGLES], axis=1)  # in a loop, or each use computes them anew
        sines = jax.lax.map(lambda x: jnp.stack([jnp.sin(x), jnp.cos(x)], axis=1).ravel(), angles)
        columns.append(base.differences(responses.path, signals, aircraft, scales, tuple(sines.T)))
    residual = _smoothed(f, jnp.concatenate(columns, axis=1))
    both = _smoothed(f, jnp.concatenate([measured, modelled], axis=1))
    c = len(model.coefficients)
    details = {"X": X, "measured": both[:, :c], "modelled": both[:, c:], "residual": residual}
    return padded.block(residual), {**signals, **details}


_evaluate = Compiled(_residuals)


@compiled_at(1)
def _linearise(padded: _Padded, theta, measuring, flowing):
    """Residuals, slopes in directions that change the measured coefficients, and those of coefficients in others."""
    # One program for both: most of it is the same, and directions of zeros cost nothing.
    residual, slope = jax.linearize(lambda t: _residuals(padded, t)[0], theta)
    whole = _along(lambda d: -slope(d), measuring)
    f, model = padded.responses.flights, padded.responses.model
    signals, aircraft, _, factors = _corrected(padded, model.values(theta))
    _, change = jax.linearize(lambda t: _modelled(model, model.values(t), signals, aircraft)[0] * factors, theta)
    coefficients = _along(lambda d: padded.block(_smoothed(f, change(d))), flowing)
    return residual, whole, coefficients


def _along(slope: Callable[[Array], Array], directions: base.Directions) -> base.Slopes:
    """Slopes in all directions, `DIRECTIONS_AT_ONCE` at a time; groups of zero directions at the end are skipped."""
    groups = directions.reshape(-1, DIRECTIONS_AT_ONCE, directions.shape[1])
    used = jnp.sum(jnp.any(groups != 0.0, axis=(1, 2)))
    shape = jax.eval_shape(slope, directions[0])
    nothing = jnp.zeros((len(groups), DIRECTIONS_AT_ONCE, *shape.shape), shape.dtype)
    slopes = jax.lax.fori_loop(0, used, lambda i, x: x.at[i].set(jax.vmap(slope)(groups[i])), nothing)
    return slopes.reshape(-1, *shape.shape)


# --- Residuals in the frequency domain: finite Fourier transforms over a band, in which bias and drift drop out.
# The residuals of a model are transformed at the multiples of 1/T inside a band; T is the length of a manoeuvre. The
# rows of the transform are scaled so that white noise keeps its variance in the real and in the imaginary part of every
# line. Constants and straight lines over each manoeuvre are taken out before. An equation that holds at every sample
# holds for the sums over samples, too, so no quadrature of the Fourier integral is needed.
# Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 7; Morelli and Grauer, AIAA 2018-0279.

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


class InBand(base.ResidualModel):
    """Transforms take the place of means over blocks: m real and imaginary parts of all lines and manoeuvres."""

    rows: tuple[Float[np.ndarray, "_ _"], ...]  # by manoeuvre

    @property
    def manoeuvre(self) -> Int[np.ndarray, " m"]:
        return np.repeat(np.arange(len(self.rows)), [len(rows) for rows in self.rows])

    @property
    def seconds(self) -> float:
        return float(np.sum(np.asarray(self.flights.channels["dt"]))) / len(self.manoeuvre)

    def block(self, x: Float[AnyArray, "n ..."]) -> Float[AnyArray, "m ..."]:
        ends = np.cumsum(self.flights.lengths)[:-1]
        parts = zip(self.rows, jnp.split(x, ends), strict=True)
        return jnp.concatenate([jnp.tensordot(rows, part[: rows.shape[1]], axes=1) for rows, part in parts])

    def offsets(self, theta: base.Theta, outputs: Sequence[str]) -> base.Offsets:  # noqa: ARG002
        """None: the rows hold no constants."""
        return np.zeros((len(self.manoeuvre), len(outputs), 0))

    def moved(self, offsets: Float[np.ndarray, " o"]) -> InBand:  # noqa: ARG002
        return self


def sampling_times(flights: Flights) -> list[float]:
    dt = np.asarray(flights.channels["dt"])
    return [float(dt[begin]) for begin in np.cumsum([0, *flights.lengths[:-1]])]


def _rows(flights: Flights, band: Band) -> tuple[Float[np.ndarray, "_ _"], ...]:
    manoeuvres = zip(flights.lengths, sampling_times(flights), flights.names, strict=True)
    return tuple(without_trend(transform_rows(lines_in(band, n, dt, name), n, dt)) for n, dt, name in manoeuvres)


class FrequencyError(InBand, EquationError):
    """Equation error of the coefficients in a band."""

    rows: tuple[Float[np.ndarray, "_ _"], ...]

    def added(self, theta: base.Theta) -> _AddedToEquations:
        raise NotImplementedError  # terms are sought in time

    @classmethod
    def in_band(cls, flights: Flights, model: Model, band: Band) -> FrequencyError:
        """`flights` under `model`, in `band` (Hz)."""
        whole = EquationError.of(flights, model)
        return cls(flights, model, whole.measuring, (), _rows(flights, band))

    @cached_property
    def _padded(self) -> _Padded:  # not at all: its rows are as long as the manoeuvres
        return _Padded(self.nameless, self.flights.regression(), None)


_residual = Compiled(lambda responses, theta: responses.residual(theta))


@Compiled
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
        return self.dynamics.states

    @property
    def outputs(self) -> tuple[str, ...]:
        """Derivatives of the states, then further outputs."""
        return (*(f"d{name}/dt" for name in self.states), *self.further)

    def evaluate(self, theta: base.Theta) -> tuple[base.Residual, Mapping[str, AnyArray]]:
        return _residual(self.nameless, np.asarray(theta)), {}

    def slopes(self, theta: base.Theta, directions: base.Directions) -> tuple[base.Residual, base.Slopes]:
        residual, slope = _slopes(self.nameless, np.asarray(theta), directions)
        return np.asarray(residual), -np.asarray(slope)

    def system_and_inputs(self, theta: base.Theta) -> tuple[LinearSystem, dict[str, AnyArray]]:
        """The system at these parameters, and its recorded inputs."""
        values = self.dynamics.values(theta)
        system: Any = self.dynamics.system(values, self.flights.aircraft)
        return system, self.dynamics.drives(values, self.flights.channels, self.flights)

    def residual(self, theta: base.Theta) -> base.Residual:
        system, drives = self.system_and_inputs(theta)
        channels = self.flights.channels
        x = jnp.stack([channels[name] for name in self.states], axis=1)
        rates, outputs = jax.vmap(system.motion)(x, drives)
        ends = [channels[name] for name in ("dt", "first", "last")]
        derivatives = jnp.stack([differentiate_joined(column, *ends) for column in x.T], axis=1)
        more = [(channels[name] - outputs[name])[:, None] for name in self.further]
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
    changes: Float[AnyArray, "w s"]  # of the states, by manoeuvre

    @classmethod
    def in_band(cls, flights: Flights, dynamics: LinearDynamics, band: Band) -> LinearFrequencyOutputError:
        """`flights` under `dynamics`, in `band` (Hz). Raises `InputError` where a state was not recorded."""
        LinearFrequencyError.in_band(flights, dynamics, band)
        manoeuvres = zip(flights.lengths, sampling_times(flights), flights.names, strict=True)
        rows = [transform_rows(lines_in(band, n - 1, dt, name), n - 1, dt) for n, dt, name in manoeuvres]
        x = np.stack([np.asarray(flights.channels[name]) for name in dynamics.states], axis=1)
        ends = np.cumsum(flights.lengths)
        changes = x[ends - 1] - x[ends - np.array(flights.lengths)]
        return cls(flights, dynamics, tuple(rows), changes)

    @property
    def outputs(self) -> tuple[str, ...]:
        return (*self.states, *self.further)

    def offsets(self, theta: base.Theta, outputs: Sequence[str]) -> base.Offsets:
        """Sensitivities to the change of each state over a manoeuvre, and to a drift of each output."""
        keep = [self.outputs.index(name) for name in outputs]
        by_change = -np.asarray(_changes(self.nameless, np.asarray(theta)))[:, keep]  # m c w s
        drift = np.concatenate([rows @ np.linspace(-1.0, 1.0, rows.shape[1]) for rows in self.rows])
        own = self.manoeuvre[:, None] == np.arange(len(self.rows))
        drifts = np.einsum("m,mw,cd->mcwd", drift, own, np.eye(len(keep)))
        return np.concatenate([by_change, drifts], axis=3).reshape(len(drift), len(keep), -1)

    def moved(self, offsets: Float[np.ndarray, " o"]) -> LinearFrequencyOutputError:
        by = offsets.reshape(len(self.rows), -1)[:, : len(self.states)]
        return replace(self, changes=self.changes + by)

    def residual(self, theta: base.Theta) -> base.Residual:
        system, drives = self.system_and_inputs(theta)
        channels, values, s = self.flights.channels, self.dynamics.values(theta), len(self.states)
        recorded = jnp.stack([channels[name] for name in self.outputs], axis=1)
        u = jnp.stack([drives[name] for name in (*system.inputs_read, ONE)], axis=1)
        (A, B), (C, D) = ((rows[:, :s], rows[:, s:]) for rows in (system.matrix[:s], system.matrix[s:]))
        late, i, parts = self.dynamics.delays(self.outputs), B.shape[1], []
        ends = np.cumsum([0, *self.flights.lengths])
        for k, rows in enumerate(self.rows):
            samples, n, dt = slice(ends[k], ends[k + 1]), rows.shape[1], channels["dt"][ends[k]]
            phase = -jnp.angle(_complex(rows)[:, 1])  # of one sample
            z = jnp.exp(1j * phase)[:, None, None]
            big = jnp.zeros((s + 2 * i, s + 2 * i))  # x_{j+1} = P x_j + G u_j + H u_{j+1} for u linear between samples
            big = big.at[:s, :s].set(A * dt).at[:s, s : s + i].set(B * dt).at[s : s + i, s + i :].set(jnp.eye(i))
            step = expm(big)[:s]
            P, G, H = step[:, :s], step[:, s : s + i] - step[:, s + i :], step[:, s + i :]
            U = _complex(rows @ u[samples][:-1])
            end = np.sqrt(2.0 / n) * (jnp.asarray(self.changes)[k] - H @ (u[samples][-1] - u[samples][0]))
            X = jnp.linalg.solve(z * jnp.eye(s) - P, (G + H * z) @ U[..., None] - z * end[:, None])[..., 0]
            signals, read = {name: X[:, j] for j, name in enumerate(self.states)}, X @ C.T + U @ D.T
            signals |= {name: read[:, row] + signals.get(name, 0.0) for row, name in enumerate(system.read)}
            signals |= {name: signals[name] * jnp.exp(-1j * phase / dt * values[p]) for name, p in late.items()}
            modelled = jnp.stack([signals[name] for name in self.outputs], axis=1)
            parts.append(rows @ recorded[samples][:-1] - jnp.concatenate([modelled.real, modelled.imag]))
        return jnp.concatenate(parts)


def _complex(parts: Array | np.ndarray) -> Array:
    """Lines from their real parts, then imaginary parts."""
    parts, half = jnp.asarray(parts), len(parts) // 2
    return parts[:half] + 1j * parts[half:]


@Compiled
def _changes(responses: LinearFrequencyOutputError, theta):
    """Derivatives (m, c, w, s) of the residuals by the changes of the states."""
    moved = lambda x: eqx.tree_at(lambda r: r.changes, responses, x).residual(theta)  # noqa: E731
    return jax.jacfwd(moved)(jnp.asarray(responses.changes))
