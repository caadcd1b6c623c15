"""Segments of flight, each simulated from its own initial state: whole manoeuvres, or windows of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from bayes_aero.arrays import AnyArray
from bayes_aero.dynamics.aircraft import POINTS
from bayes_aero.dynamics.flight import Dynamics
from bayes_aero.dynamics.system import LateOutputs, System, Trajectory, integrate
from bayes_aero.errors import InputError
from bayes_aero.model.records import Flights, cuts_of, shared_length
from bayes_aero.physics.filters import advance
from bayes_aero.processes import cores

START_SECONDS = 0.5  # s; the measured initial state is that of a straight line fitted to this time


class SegmentTrajectories(eqx.Module):
    """Segments of flights, one a row, padded to one length with their last sample. `fixed`: each segment starts at its
    first sample, except for the states given here (SI), one value for all segments or one for each; None: the initial
    state is the measured one (see `simulate`) plus a fitted correction. Inputs are linear between samples, or
    `held`."""

    flights: Flights
    index: Int[np.ndarray, "w n"]
    inside: Bool[np.ndarray, "w n"]  # the real samples
    dt: Float[np.ndarray, " w"]
    noise_growth: Float[np.ndarray, "w n c"]  # noise over that in attached flow; 1 where it is constant
    dynamics: Dynamics = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    begin: int = eqx.field(static=True, default=2)  # samples from which the measured initial state is read
    substeps: int = eqx.field(static=True, default=1)
    fixed: tuple[tuple[str, float | tuple[float, ...]], ...] | None = eqx.field(static=True, default=None)
    held: bool = eqx.field(static=True, default=False)

    @property
    def nameless(self) -> SegmentTrajectories:
        """The same for compiled programs, which flights of any names and like length share."""
        of_manoeuvres = self.dynamics.lengths != (1,)  # their parameters have a value for each sample
        return replace(self, flights=self.flights.nameless if of_manoeuvres else self.flights.longer)

    @property
    def manoeuvre(self) -> Int[np.ndarray, " w"]:
        return self.flights.manoeuvre[self.index[:, 0]]

    def only_inside(self, y: Float[Array, "w n c"]) -> Float[Array, "w n c"]:
        """Outputs at the real samples; NaN in the padding."""
        return jnp.where(jnp.asarray(self.inside)[:, :, None], y, jnp.nan)

    @property
    def growth(self) -> list[Float[np.ndarray, "_ c"]]:
        return [self.noise_growth[k][real] for k, real in enumerate(self.inside)]

    def part(self, rows: Sequence[int] | Int[np.ndarray, " r"]) -> SegmentTrajectories:
        some = {name: getattr(self, name)[np.asarray(rows)] for name in ("index", "inside", "dt", "noise_growth")}
        fixed = self.fixed
        if fixed is not None:
            fixed = tuple((n, tuple(x[int(r)] for r in rows) if isinstance(x, tuple) else x) for n, x in fixed)
        return replace(self, fixed=fixed, **some)


class Simulated(NamedTuple):
    """Trajectories (w, n, ...), recorded outputs, residuals in units of the recorded channels, and initial states.
    Recorded minus residual is the simulated output with the model's sensor errors."""

    trajectory: Trajectory
    measured: Float[Array, "w n c"]
    residual: Float[Array, "w n c"]
    begin: Float[Array, "w b"]


def segments(
    flights: Flights,
    dynamics: Dynamics,
    *,
    outputs: Sequence[str] | None = None,
    window: float | None = None,
    substeps: int = 1,
    fixed: Mapping[str, float | Sequence[float]] | None = None,
    held: bool = False,
) -> SegmentTrajectories:
    """Cut all manoeuvres into windows of about `window` s (default: whole ones); `outputs`: default all recorded."""
    recorded = tuple(name for name in dynamics.outputs if name in flights.channels)
    chosen = recorded if outputs is None else tuple(outputs)
    unknown = [name for name in chosen if name not in recorded]
    if unknown or not chosen:
        raise InputError(
            f"the output {unknown[0] if unknown else '(none)'} was not recorded or is not simulated; "
            f"there are {', '.join(recorded) or 'none'}"
        )
    for name in fixed or {}:
        if name not in dynamics.start or name in POINTS:
            states = ", ".join(n for n in dynamics.start if n not in POINTS)
            raise InputError(f"the initial state has {name}, which is no state of the model; there are {states}")
    rows, dts = [], []
    for number, n in enumerate(flights.lengths):
        samples = np.flatnonzero(flights.manoeuvre == number)
        dt = float(np.asarray(flights.channels["dt"])[samples[0]])
        cuts = cuts_of(n, dt, window)
        rows += np.split(samples, cuts[1:])
        dts += [dt] * len(cuts)
    longest = shared_length(max(map(len, rows)))
    index = np.stack([np.append(row, np.full(longest - len(row), row[-1])) for row in rows])
    inside = np.stack([np.arange(longest) < len(row) for row in rows])
    begin = max(2, min(round(START_SECONDS / float(np.median(dts))) + 1, int(inside.sum(axis=1).min())))
    steady = np.ones((*index.shape, len(chosen)))
    given: dict[str, float | tuple[float, ...]] = {}
    for name, x in sorted((fixed or {}).items()):
        if not isinstance(x, float | int) and len(x) != len(rows):
            raise InputError(f"{len(x)} initial values are given for {len(rows)} segments; give one, or one for each")
        given[name] = float(x) if isinstance(x, float | int) else tuple(map(float, x))
    starts = None if fixed is None else tuple(given.items())
    return SegmentTrajectories(
        flights, index, inside, np.array(dts), steady, dynamics, chosen, begin, substeps, starts, held
    )


def rows_by_core(count: int) -> list[Int[np.ndarray, " r"]]:
    """Rows of equal parts of segments, one a core, for XLA runs a scan on one; the last row may be repeated."""
    size = -(-count // min(count, cores()))
    return [np.minimum(np.arange(begin, begin + size), count - 1) for begin in range(0, count, size)]


class Prepared(NamedTuple):
    """Inputs of a simulation of the segments at one theta: system, initial states (w, b), inputs, corrected and
    recorded outputs, and the derivatives `scale` of the corrected outputs by the recorded ones (w, n, c). Delays of
    recorders are not corrected in `true`; the simulated outputs are delayed instead. Interpolating the record would
    average its noise, least at zero delay and most at half a sample, so that a fit would prefer such a delay. `sensed`
    is the system with delayed outputs, for a filter."""

    system: System
    sensed: System
    begin: Float[Array, "w b"]
    drives: dict[str, Float[Array, "w n"]]
    true: Float[Array, "w n c"]
    measured: Float[Array, "w n c"]
    scale: Float[Array, "w n c"]

    @property
    def first_inputs(self) -> dict[str, Float[Array, " w"]]:
        return {name: x[:, 0] for name, x in self.drives.items()}

    @property
    def initial_states(self) -> Float[Array, "w s"]:
        return jax.vmap(self.sensed.complete_start)(self.begin, self.first_inputs)

    def initial_covariance(self, states: Float[Array, "w s"], deviation: Float[Array, " s"]) -> Float[Array, "w s s"]:
        """Covariance of the initial `states`; `deviation`: standard deviations of the measured ones, (s,), SI."""
        return jax.vmap(lambda x, u: self.sensed.start_covariance(x, u, deviation))(states, self.first_inputs)

    def noise_variance(
        self, R: Float[Array, " c"], growth: Float[Array, "w n c"] | Float[np.ndarray, "w n c"]
    ) -> Float[Array, "w n c"]:
        """Variances of the noise of the corrected outputs; `R`: of the recorded outputs in attached flow, (c,)."""
        return R * (self.scale * jnp.asarray(growth)) ** 2


def _measured_start(flown: SegmentTrajectories, channels: Mapping[str, AnyArray]) -> Float[Array, "w b"]:
    """Values at the first sample of a straight line through the first half second; fixed ones as given; else zero."""
    count = 1 if flown.fixed is not None else flown.begin
    rows, given = flown.index[:, :count], dict(flown.fixed or ())
    t = np.arange(count) - (count - 1) / 2.0
    weight = jnp.asarray(1.0 / count + (t[0] * t) / (np.sum(t**2) or 1.0))
    nothing = jnp.zeros(len(rows))

    def begin(name: str) -> Array:
        if name in given:
            return nothing + np.array(given[name])
        return channels[name][rows] @ weight if name in channels else nothing

    return jnp.stack([begin(name) for name in flown.dynamics.start], axis=1)


def prepare(flown: SegmentTrajectories, theta: Float[Array, " k"]) -> Prepared:
    """The system at `theta`, and the record corrected by its sensor errors."""
    dynamics, flights = flown.dynamics, flown.flights
    values = dynamics.values(theta)
    channels = dynamics.corrected(values, flights.channels, flights.aircraft)
    system = dynamics.system(values, flights.aircraft)
    drives = {name: jnp.asarray(x)[flown.index] for name, x in dynamics.drives(values, channels, flights).items()}
    begin = _measured_start(flown, channels)
    late = dynamics.delays(flown.outputs)
    sensed = LateOutputs(system, {name: values[p] for name, p in late.items()}) if late else system
    if late:
        values = values | dict.fromkeys(late.values(), 0.0)
        channels = dynamics.corrected(values, flights.channels, flights.aircraft)
    true = jnp.stack([channels[name][flown.index] for name in flown.outputs], axis=2)
    measured = jnp.stack([flights.channels[name][flown.index] for name in flown.outputs], axis=2)
    scales, unscaled = dynamics.scales(values, flights), jnp.ones(flown.index.shape)
    scale = jnp.stack([scales[n][flown.index] if n in scales else unscaled for n in flown.outputs], axis=2)
    return Prepared(system, sensed, begin, drives, true, measured, scale)


def simulate(flown: SegmentTrajectories, theta: Float[Array, " k"], departure: Float[Array, "w b"]) -> Simulated:
    """Simulate every segment from its initial state, the measured or the fixed one, plus `departure`."""
    prepared = prepare(flown, theta)

    def fly(start, correction, inputs, dt):
        first = {name: x[0] for name, x in inputs.items()}
        names = (*flown.outputs, *flown.dynamics.unmeasured)
        begin = prepared.system.complete_start(start, first) + correction
        state = prepared.system.state_at_start(begin)
        return integrate(prepared.system, state, inputs, dt, flown.substeps, names, held=flown.held), begin

    trajectory, begin = jax.vmap(fly)(prepared.begin, departure, prepared.drives, jnp.asarray(flown.dt))
    modelled = jnp.stack([trajectory.outputs[name] for name in flown.outputs], axis=2)
    residual = (prepared.true - modelled) / prepared.scale
    if isinstance(prepared.sensed, LateOutputs):
        last, dt = jnp.asarray(flown.inside.sum(axis=1) - 1), jnp.asarray(flown.dt)
        every = jnp.zeros(flown.index.shape[1], int)
        late = jax.vmap(lambda x, back, dt, last: advance(x, back, every + dt, every, every + last), (0, None, 0, 0))
        for c, name in enumerate(flown.outputs):  # the simulated outputs are delayed
            if name in prepared.sensed.delays:
                measured, back = prepared.measured[:, :, c], -jnp.asarray(prepared.sensed.delays[name])
                shifted = late(measured - residual[:, :, c], back, dt, last)
                residual = residual.at[:, :, c].set(measured - shifted)
    return Simulated(trajectory, prepared.measured, jnp.where(flown.inside[:, :, None], residual, 0.0), begin)
