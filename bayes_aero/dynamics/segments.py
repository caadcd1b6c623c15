"""Stretches of flight that are simulated from their own initial state: whole manoeuvres, or windows of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from bayes_aero.dynamics.aircraft.effect_system import POINTS
from bayes_aero.dynamics.flight import Dynamics
from bayes_aero.dynamics.late_outputs import LateOutputs
from bayes_aero.dynamics.system import System, Trajectory, integrate
from bayes_aero.errors import InputError
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.joined_records import cuts_of
from bayes_aero.physics.filters import advance

BEGIN = 0.5  # s over which the measured initial state is read off a straight line


class SegmentTrajectories(eqx.Module):
    """Segments of flights, a row each, filled up to one length with their last sample; `inside` marks the real ones.

    `noise_growth` is how many times an output's noise is that of attached flow at each sample; one where it is steady.
    `fixed`: each segment begins at its first sample, but for states that are given here (SI), one value for all or one
    for each segment; None: its initial state is the measured one (see `simulate`) and a departure that is fitted.
    Inputs are linear between samples, or `held`.
    """

    flights: Flights
    index: Int[np.ndarray, "w n"]
    inside: Bool[np.ndarray, "w n"]
    dt: Float[np.ndarray, " w"]
    noise_growth: Float[np.ndarray, "w n c"]
    dynamics: Dynamics = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    begin: int = eqx.field(static=True, default=2)  # samples from which the measured initial state is read
    substeps: int = eqx.field(static=True, default=1)
    fixed: tuple[tuple[str, float | tuple[float, ...]], ...] | None = eqx.field(static=True, default=None)
    held: bool = eqx.field(static=True, default=False)

    @property
    def nameless(self) -> SegmentTrajectories:
        """The same of flights without names; see there."""
        return replace(self, flights=self.flights.nameless)

    @property
    def manoeuvre(self) -> Int[np.ndarray, " w"]:
        """Which manoeuvre each segment belongs to."""
        return self.flights.manoeuvre[self.index[:, 0]]

    @property
    def growth(self) -> list[Float[np.ndarray, "_ c"]]:
        """`noise_growth` of the real samples, by segment."""
        return [self.noise_growth[k][real] for k, real in enumerate(self.inside)]

    def part(self, rows: Sequence[int] | Int[np.ndarray, " r"]) -> SegmentTrajectories:
        """Some of the segments, in the order of `rows`."""
        index, inside, dt, noise_growth = (
            x[np.asarray(rows)] for x in (self.index, self.inside, self.dt, self.noise_growth)
        )
        fixed = self.fixed
        if fixed is not None:
            fixed = tuple((n, tuple(x[int(r)] for r in rows) if isinstance(x, tuple) else x) for n, x in fixed)
        return replace(self, index=index, inside=inside, dt=dt, noise_growth=noise_growth, fixed=fixed)


class Simulated(NamedTuple):
    """Trajectories (w, n, ...), what was recorded, residuals by output, referred to the record, and where it began.

    Recorded minus residual is what the instruments would have shown of the simulated flight.
    """

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
    manoeuvres: Sequence[int] | None = None,
    substeps: int = 1,
    fixed: Mapping[str, float | Sequence[float]] | None = None,
    held: bool = False,
) -> SegmentTrajectories:
    """Cut `manoeuvres` (default: all) into windows of about `window` s (default: whole manoeuvres).

    `outputs` are compared with the simulation; default: all recorded ones that the dynamics make. `fixed`, `held`: see
    `SegmentTrajectories`.
    """
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
            there = ", ".join(n for n in dynamics.start if n not in POINTS)
            raise InputError(f"the initial state has {name}, which is no state of the model; there are {there}")
    rows, dts = [], []
    for number in range(len(flights.lengths)) if manoeuvres is None else manoeuvres:
        own = np.flatnonzero(flights.manoeuvre == number)
        dt = float(flights.channels["dt"][own[0]])
        cuts = cuts_of(len(own), dt, window)
        rows += [own[a:b] for a, b in zip(cuts, [*cuts[1:], len(own)], strict=True)]
        dts += [dt] * len(cuts)
    longest = max(len(row) for row in rows)
    index = np.stack([np.append(row, np.full(longest - len(row), row[-1])) for row in rows])
    inside = np.stack([np.arange(longest) < len(row) for row in rows])
    begin = max(2, min(round(BEGIN / float(np.median(dts))) + 1, int(inside.sum(axis=1).min())))
    steady = np.ones((*index.shape, len(chosen)))
    given = None if fixed is None else tuple(sorted((n, _plain(x, len(rows))) for n, x in fixed.items()))
    return SegmentTrajectories(
        flights, index, inside, np.array(dts), steady, dynamics, chosen, begin, substeps, given, held
    )


def _plain(given: float | Sequence[float], count: int) -> float | tuple[float, ...]:
    """A fixed state, or one for each of the segments, hashable."""
    if isinstance(given, float | int):
        return float(given)
    if len(given) != count:
        raise InputError(f"{len(given)} initial values are given for {count} segments; give one, or one for each")
    return tuple(map(float, given))


class Prepared(NamedTuple):
    """What a simulation of the segments needs at one theta: initial states (w, b), inputs, outputs made true, as they
    were recorded, and how much a unit of each became by that (w, n, c).

    `true` still has the delays of recorders: what is shown of the flight is delayed, not the record. Interpolation
    averages noise, so that a record would have less of it at half a sample than at none, and a fit would prefer such a
    delay. `sensed` is the system with late outputs, for a filter.
    """

    system: System
    sensed: System
    begin: Float[Array, "w b"]
    drives: dict[str, Float[Array, "w n"]]
    true: Float[Array, "w n c"]
    measured: Float[Array, "w n c"]
    scale: Float[Array, "w n c"]


def prepared(flown: SegmentTrajectories, theta: Float[Array, " k"]) -> Prepared:
    """The system at `theta`, and the record as it makes it true."""
    dynamics, flights = flown.dynamics, flown.flights
    values = dynamics.values(theta)
    channels = dynamics.corrected(values, flights.channels, flights.aircraft)
    system = dynamics.system(values, flights.aircraft)
    drives = {name: x[flown.index] for name, x in dynamics.drives(values, channels, flights).items()}
    begin = _measured_start(flown, channels)
    late = dynamics.delays(flown.outputs)
    sensed = LateOutputs(system, {name: values[p] for name, p in late.items()}) if late else system
    if late:
        values = values | dict.fromkeys(late.values(), 0.0)
        channels = dynamics.corrected(values, flights.channels, flights.aircraft)
    true = jnp.stack([channels[name][flown.index] for name in flown.outputs], axis=2)
    measured = jnp.stack([flights.channels[name][flown.index] for name in flown.outputs], axis=2)
    scales = dynamics.scales(values, flights)
    scale = jnp.stack(
        [scales[n][flown.index] if n in scales else jnp.ones(flown.index.shape) for n in flown.outputs], axis=2
    )
    return Prepared(system, sensed, begin, drives, true, measured, scale)


def simulate(flown: SegmentTrajectories, theta: Float[Array, " k"], departure: Float[Array, "w b"]) -> Simulated:
    """Fly every segment from its initial state, the measured or the fixed one, plus `departure`."""
    ready = prepared(flown, theta)

    def fly(start, away, inputs, dt):
        first = {name: x[0] for name, x in inputs.items()}
        wanted = (*flown.outputs, *flown.dynamics.unmeasured)
        begin = ready.system.settled(start, first) + away
        state = ready.system.begun(begin)
        return integrate(ready.system, state, inputs, dt, flown.substeps, wanted, held=flown.held), begin

    trajectory, begin = jax.vmap(fly)(ready.begin, departure, ready.drives, jnp.asarray(flown.dt))
    modelled = jnp.stack([trajectory.outputs[name] for name in flown.outputs], axis=2)
    residual = (ready.true - modelled) / ready.scale
    if isinstance(ready.sensed, LateOutputs):
        residual = _late(flown, ready.sensed.delays, ready.measured, residual)
    return Simulated(trajectory, ready.measured, jnp.where(flown.inside[:, :, None], residual, 0.0), begin)


def _late(
    flown: SegmentTrajectories,
    delays: Mapping[str, Any],
    measured: Float[Array, "w n c"],
    residual: Float[Array, "w n c"],
) -> Float[Array, "w n c"]:
    """Residuals where recorders are late: what is shown of the flight without delay is shifted."""
    last, dt = jnp.asarray(flown.inside.sum(axis=1) - 1), jnp.asarray(flown.dt)
    for c, name in enumerate(flown.outputs):
        if name in delays:
            shown = measured[:, :, c] - residual[:, :, c]
            shifted = jax.vmap(_delayed, (0, None, 0, 0))(shown, delays[name], dt, last)
            residual = residual.at[:, :, c].set(measured[:, :, c] - shifted)
    return residual


def _delayed(x: Float[Array, " n"], seconds: Any, dt: Any, last: Any) -> Float[Array, " n"]:
    """x(t - seconds) of one segment."""
    every = jnp.zeros(len(x), int)
    return advance(x, -jnp.asarray(seconds), every + dt, every, every + last)


def _measured_start(flown: SegmentTrajectories, channels) -> Float[Array, "w b"]:
    """Value at the first sample of a straight line through the first half second; zero where nothing was recorded.

    A fixed initial state is the given one, and the first sample itself where none is given.
    """
    if flown.fixed is not None:
        given, here = dict(flown.fixed), flown.index[:, 0]
        nothing = jnp.zeros(len(here))
        own = [channels[n][here] if n in channels else nothing for n in flown.dynamics.start]
        named = zip(flown.dynamics.start, own, strict=True)
        return jnp.stack([nothing + np.array(given[n]) if n in given else x for n, x in named], axis=1)
    count = flown.begin
    t = np.arange(count) - (count - 1) / 2.0
    weight = jnp.asarray(1.0 / count + (t[0] * t) / np.sum(t**2))
    here = flown.index[:, :count]
    nothing = jnp.zeros(len(here))
    return jnp.stack([channels[n][here] @ weight if n in channels else nothing for n in flown.dynamics.start], axis=1)
