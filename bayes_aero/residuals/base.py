"""Residual models: residuals of a model on a record at given parameters, and their sensitivities."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import block_diag, csr_array

from bayes_aero.arrays import AnyArray, namespace
from bayes_aero.effect import Effect, Stage
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights, cuts_of
from bayes_aero.physics.aircraft import Aircraft, Axis
from bayes_aero.physics.filters import FILTER_STEP, SPENCER, differentiate_joined, smooth
from bayes_aero.physics.kinematics import ANGLES, PATH_NEEDS, RATES, as_symmetric, integral, path_outputs, path_rates
from bayes_aero.processes import side_by_side
from bayes_aero.units import number

DIRECTIONS_PER_CALL = 16
Theta = Float[AnyArray, " k"]
Directions = Float[AnyArray, "d k"]
Residual = Float[AnyArray, "m c"]  # of m blocks and c outputs
Slopes = Float[AnyArray, "d m c"]
Offsets = Float[AnyArray, "m c o"]


class ResidualModel(ABC):
    """Residuals of flights under one model of many effects, as means over m blocks of samples."""

    flights: Flights
    model: Model
    stage: ClassVar[str]  # with what the model is compared
    white: ClassVar[bool] = False  # of a correct model, sample by sample
    averaged: ClassVar[int] = FILTER_STEP  # samples of which each residual is the mean
    kinematic: ClassVar[bool] = False  # the flight path alone: of its errors the coefficients say what they make worse

    def with_channels(self, channels: Mapping[str, AnyArray]) -> ResidualModel:
        """The same model on flights with these channels."""
        flights = replace(self.flights, channels=dict(channels))  # pyright: ignore[reportArgumentType]
        return replace(self, flights=flights)  # pyright: ignore[reportArgumentType]

    @cached_property
    def noise(self) -> dict[str, Float[np.ndarray, " n"]]:
        """A draw of the noise of each recorded channel on which the residuals depend; the same for all models."""
        # Which these are shows where all effects are in.
        rng, channels = np.random.default_rng(1), self.flights.channels
        theta = np.array([np.clip(p.start + p.prior.normal[1] / 10.0, *p.bounds) for p in self.model.free])
        drawn = {n: sd * rng.standard_normal(self.flights.n) for n, sd in self.flights.noise.items() if sd > 0.0}
        each = [channels, *(channels | {name: channels[name] + x} for name, x in drawn.items())]
        whole, *parts = side_by_side(lambda x: self.with_channels(x).residuals(theta, self.outputs), each)
        felt = (not np.array_equal(part, whole) for part in parts)
        return {name: x for (name, x), is_felt in zip(drawn.items(), felt, strict=True) if is_felt}

    @cached_property
    def noisy(self) -> dict[str, ResidualModel]:
        """The same with the `noise` of each channel added to it, made ready once for any parameters."""
        return {
            name: self.with_channels(self.flights.channels | {name: self.flights.channels[name] + x})
            for name, x in self.noise.items()
        }

    @property
    def nameless(self):
        """The same without names of the flights, so that records of any name share compiled programs."""
        return replace(self, flights=self.flights.nameless)  # pyright: ignore[reportArgumentType]

    @property
    @abstractmethod
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""

    @property
    @abstractmethod
    def manoeuvre(self) -> Int[np.ndarray, " m"]:
        """Which manoeuvre each block belongs to."""

    @property
    @abstractmethod
    def seconds(self) -> float:
        """Length of a block, s."""

    @property
    def stretch(self) -> Int[np.ndarray, " m"]:
        """The stretch of each block, in each of which residuals start again; all one where they are stationary."""
        return np.zeros(len(self.manoeuvre), int)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the scatter between stretches; 0 where an autoregression describes the noise."""
        return int(self.stretch.max())

    @property
    def parts(self) -> Int[np.ndarray, " m"]:
        """The part of each block, by which terms are judged as one is left out; all one where the colour tells."""
        return self.stretch

    def separated(self, theta: Theta) -> Float[np.ndarray, " m"]:
        """Separated share of the flow, 1 - X, of each block, with which noise grows."""
        return 1.0 - np.asarray(self.block(self.predict(theta)["X"]))

    def predict(self, theta: Theta) -> dict[str, np.ndarray]:
        """Signals that describe the residuals, by name, at the recorded rate."""
        return {name: np.asarray(x) for name, x in self.evaluate(theta)[1].items()}

    def residuals(self, theta: Theta, outputs: Sequence[str]) -> Residual:
        """Residuals of these outputs at the parameters `theta`."""
        return np.asarray(self.evaluate(theta)[0])[:, [self.outputs.index(name) for name in outputs]]

    def holdout(
        self, folds: Sequence[slice], fitted: Callable[[list[int]], np.ndarray], outputs: Sequence[str]
    ) -> Residual:
        """Residuals of every fold at the parameters `fitted` to the others; zeros between folds."""
        residual = np.zeros((len(self.manoeuvre), len(outputs)))

        def fill(left_out: int) -> None:
            theta = fitted([f for f in range(len(folds)) if f != left_out])
            residual[folds[left_out]] = self.residuals(theta, outputs)[folds[left_out]]

        side_by_side(fill, range(len(folds)))
        return residual

    @abstractmethod
    def block(self, x: Float[AnyArray, "n ..."]) -> Float[AnyArray, "m ..."]:
        """Means over blocks of anything sampled at the recorded rate."""

    @abstractmethod
    def evaluate(self, theta: Theta) -> tuple[Residual, Mapping[str, AnyArray]]:
        """Residuals at the free parameters `theta`, and signals that describe them by name, at the recorded rate."""

    @abstractmethod
    def offsets(self, theta: Theta, outputs: Sequence[str]) -> Offsets:
        """Sensitivities to quantities that are free in every fit and no parameters: initial values of integrals."""

    def slopes(self, theta: Theta, directions: Directions) -> tuple[Residual, Slopes]:
        """Residuals and minus their derivatives in `DIRECTIONS_PER_CALL` directions."""
        raise NotImplementedError  # of those that linearise by all columns at once

    def slopes_at(self, theta: Theta) -> Callable[[Directions], tuple]:
        """`slopes` at these parameters as a function of the directions."""
        return lambda directions: self.slopes(theta, directions)

    def added(self, theta: Theta) -> Any:
        """What residuals make, to first order, of series that are added to the coefficients, at fixed parameters."""
        # `signals` of the flow, X and the marks, each (n,), of which the series are functions; `columns(coefficient,
        # made, outputs, deviation)`: the series as residuals show them (d, t), their columns (d, m, c), and the size of
        # each beside this deviation of the outputs, (d,).
        raise NotImplementedError  # of the flight path, which has no coefficients

    def linearise(
        self, theta: Theta, columns: Int[np.ndarray, " j"] | None = None
    ) -> tuple[Residual, Float[np.ndarray, "m c j"]]:
        """Residuals, measured minus modelled, and minus their derivatives by `columns`."""
        every = np.eye(len(theta))
        return self.along(theta, every if columns is None else every[columns])

    def along(self, theta: Theta, directions: Directions) -> tuple[Residual, Float[np.ndarray, "m c j"]]:
        """Residuals, and minus their derivatives along any directions of the parameters."""
        slopes, size, residual, S = self.slopes_at(theta), DIRECTIONS_PER_CALL, np.empty((0, 0)), np.empty((0, 0, 0))
        count = len(directions)
        for begin in range(0, max(count, 1), size):  # one part alive: all sensitivities are large
            part = np.zeros((size, len(theta)))
            part[: count - begin] = directions[begin : begin + size]
            residual, slope = slopes(part)
            S = S if begin else np.empty((*residual.shape, count))
            S[:, :, begin : begin + size] = np.moveaxis(slope[: count - begin], 0, 2)
        return residual, S


Signals = Mapping[str, Any]
Made = Callable[[Signals], Float[np.ndarray, "d n"]]
"""Functions of the flight: d series of one value for every sample, from its signals."""


class Blockwise(ResidualModel):
    """Means over blocks of `FILTER_STEP` samples: the rate that the smoothing filters pass."""

    @property
    def manoeuvre(self) -> Int[np.ndarray, " m"]:
        return np.repeat(np.arange(len(self.flights.lengths)), [k // FILTER_STEP for k in self.flights.lengths])

    @property
    def seconds(self) -> float:
        return FILTER_STEP * float(np.median(np.asarray(self.flights.channels["dt"])))

    def block(self, x: Float[AnyArray, "n ..."]) -> Float[AnyArray, "m ..."]:
        """Means over blocks, manoeuvre by manoeuvre; the last samples of an incomplete block are left out."""
        begin, parts = 0, []
        for length in self.flights.lengths:
            m = length // FILTER_STEP
            part = x[begin : begin + m * FILTER_STEP]
            parts.append(part.reshape(m, FILTER_STEP, *x.shape[1:]).mean(axis=1))
            begin += length
        return namespace(x).concatenate(parts)

    def offsets(self, theta: Theta, outputs: Sequence[str]) -> Offsets:  # noqa: ARG002
        """A constant for each manoeuvre and flight-path output: the initial value of the integral."""
        own = self.manoeuvre[:, None] == np.arange(self.manoeuvre[-1] + 1)  # m k
        path = np.eye(len(outputs))[:, [c for c, name in enumerate(outputs) if name not in self.model.coefficients]]
        return np.einsum("mk,cp->mckp", own, path).reshape(len(own), len(outputs), -1)


@lru_cache(maxsize=8)
def smoothed_means(lengths: tuple[int, ...]) -> csr_array:
    """The matrix that makes of series of manoeuvres, end to end, the means over blocks of the smoothed series."""
    # It is read off combs, whose teeth are too far apart for two to reach one block.
    parts, apart = [], FILTER_STEP + 2 * len(SPENCER)
    for n in lengths:
        m, combs = n // FILTER_STEP, (np.arange(n) % apart == np.arange(apart)[:, None]).astype(float)
        means = np.stack([smooth(x)[: m * FILTER_STEP].reshape(m, FILTER_STEP).mean(axis=1) for x in combs])
        comb, row = np.nonzero(means)
        tooth = comb + apart * np.rint((FILTER_STEP * row + FILTER_STEP // 2 - comb) / apart).astype(int)
        parts.append(csr_array((means[comb, row], (row, tooth)), shape=(m, n)))
    return csr_array(block_diag(parts))


# --- Windows of output error, between which the scatter tests effects where there are no accelerometers.

WINDOW = 10.0  # s: long enough to integrate model errors, short enough to stay near the record


def too_few_windows(records: Sequence[FlightRecord]) -> str:
    """Why effects cannot be tested by the scatter between windows; empty where they can."""
    if sum(len(cuts_of(record.n, record.dt, WINDOW)) for record in records) > 1:
        return ""
    seconds = records[0].time[-1] - records[0].time[0]
    return (
        f"without accelerometers an effect is tested by the scatter between windows of {WINDOW:g} s, and "
        f"{records[0].name} of {number(seconds)} s is one window; give a second manoeuvre, or one of {2 * WINDOW:g} s"
    )


# --- Flight-path error: recorded minus integrated channels, as a function of the parameters of all sensor errors.
# In NumPy, without JAX, so that a check of records starts fast. Slopes are finite differences, because a flight path is
# nearly linear in the errors of its sensors.

CACHE_SIZE = 256  # stored residuals; a slope needs one for each direction
LEVEL_BANK = np.radians(5.0)  # change of bank below which wings count as level where bank was not recorded
STEP = 1e-6  # of the differences: of a parameter's prior standard deviation, and of a channel's largest value
RECORD_STAGES = (Stage.CHANNEL, Stage.AIRCRAFT)  # stages that change the flight path


def flight_path(flights: Flights) -> tuple[str, ...]:
    """Flight-path outputs of these flights; none where they rolled and the bank angle is unknown."""
    return () if rolled_unseen(flights) else path_outputs(flights.channels)


def rolled_unseen(flights: Flights) -> bool:
    """Whether a roll rate, less its mean, changes a bank angle that was not recorded."""
    if "phi" in flights.channels or "p" not in flights.channels:
        return False
    p, dt = (np.split(np.asarray(flights.channels[n]), np.cumsum(flights.lengths)[:-1]) for n in ("p", "dt"))
    return any(np.ptp(np.cumsum((x - x.mean()) * step)) > LEVEL_BANK for x, step in zip(p, dt, strict=True))


def differences(
    outputs: Sequence[str],
    s: Mapping[str, AnyArray],
    aircraft: Aircraft,
    scales: Mapping[str, AnyArray],
    sines: tuple[AnyArray, ...] | None = None,
) -> Float[AnyArray, "n c"]:
    """Recorded minus integrated flight-path `outputs`, in units of the recorded channels."""
    # Of corrected signals `s` (n,) with `p_dot`, `q_dot`, `r_dot` and the marks of `effect.Stage`, and the corrected
    # constants of the aircraft. `scales`: derivatives of the corrected channels by the recorded ones; 1 where a channel
    # is not named. `sines`: see `path_rates`. Integrals begin at what was recorded first: times a scale that varies,
    # another begin would be no constant.
    rates = path_rates(as_symmetric(s), aircraft, sines)
    grown = {name: s[name] - s[name][s["first"]] for name in outputs}
    residuals = [
        (grown[name] - integral(rates[name], s["dt"], s["start"], s["first"])) / scales.get(name, 1.0)
        for name in outputs
    ]
    return namespace(*residuals).stack(residuals, axis=1)


@dataclass(frozen=True)
class FlightPathError(Blockwise):
    """Residuals of the flight path of `flights` under `model`; only effects of `RECORD_STAGES` change them."""

    flights: Flights
    model: Model
    path: tuple[str, ...]
    stage = "flight path"
    kinematic = True

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.path

    @classmethod
    def of(cls, flights: Flights, model: Model) -> FlightPathError:
        """`flights` under `model`; without outputs where there is no flight path."""
        channels = {name: np.asarray(x) for name, x in as_symmetric(flights.channels).items()}
        return cls(replace(flights, channels=channels), model, flight_path(flights))

    def evaluate(self, theta: Theta) -> tuple[Residual, Mapping[str, AnyArray]]:
        return self._residual(np.asarray(theta)), {}

    def slopes(self, theta: Theta, directions: Directions) -> tuple[Residual, Slopes]:
        theta = np.asarray(theta)
        residual = self._residual(theta)
        slope = np.zeros((len(directions), *residual.shape))
        affected = np.isin(self.model.names, [p.name for e in self._on_record for p in e.parameters])
        spread = np.array([p.prior.normal[1] for p in self.model.free])
        for row, direction in enumerate(np.asarray(directions)):
            if np.any(direction[affected]):
                step = STEP / float(np.max(np.abs(direction) / spread))
                slope[row] = (residual - self._residual(theta + step * direction)) / step
        return residual, slope

    @cached_property
    def _cache(self) -> dict[bytes, Residual]:
        return {}

    def _residual(self, theta: Theta) -> Residual:
        """Residuals at a parameter vector, read only; stored, because searches repeat the same vectors."""
        if (residual := self._cache.get(key := theta.tobytes())) is None:
            residual = self._cache[key] = self._computed(theta)
            while len(self._cache) > CACHE_SIZE:
                self._cache.pop(next(iter(list(self._cache)), b""), None)  # another thread may have taken it out
        return residual

    @cached_property
    def _recorded(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Slopes of the recorded rates, and sine and cosine of the recorded angles."""
        x, ends = self.flights.channels, [self.flights.channels[name] for name in ("dt", "first", "last")]
        sines = {name: (np.sin(x[name]), np.cos(x[name])) for name in ANGLES}
        return {name: differentiate_joined(x[name], *ends) for name in RATES}, sines

    @cached_property
    def _on_record(self) -> tuple[Effect, ...]:
        acting = (e for e in self.model.acting if e.stage in RECORD_STAGES)
        shown = ((e, {*e.example.increments}) for e in acting)  # what it changes, where its example tells
        return tuple(e for e, x in shown if e.stage is Stage.AIRCRAFT or not x or x & {*PATH_NEEDS})

    def _computed(self, theta: Theta) -> Residual:
        f, values = self.flights, self.model.values(theta)
        present = tuple(e for e in self._on_record if not e.absent_in(values))
        model = Model(present, tuple(p for e in present for p in e.parameters), axes=tuple(Axis))
        signals = _as_numpy(model.corrected(values, f.channels, f.aircraft))
        ends, scales, sines = [f.channels[name] for name in ("dt", "first", "last")], {}, []
        same = {name: signals[name] is x for name, x in f.channels.items()}
        for name in RATES:
            x = signals[name]
            signals[f"{name}_dot"] = self._recorded[0][name] if same[name] else differentiate_joined(x, *ends)
        for name in ANGLES:
            sines += self._recorded[1][name] if same[name] else (np.sin(signals[name]), np.cos(signals[name]))
        for name in (name for name in self.outputs if not same[name]):  # derivatives by the recorded channels
            step = STEP * float(np.max(np.abs(f.channels[name])))
            moved = (f.channels | {name: f.channels[name] + by} for by in (step, -step))
            up, down = (_as_numpy(model.corrected(values, x, f.aircraft))[name] for x in moved)
            scales[name] = (up - down) / (2.0 * step)
        aircraft = model.actual_aircraft(values, f.aircraft)
        residual = smoothed_means(f.lengths) @ differences(self.outputs, signals, aircraft, scales, tuple(sines))
        residual.flags.writeable = False
        return residual


def _as_numpy(channels: Mapping[str, Any]) -> dict[str, np.ndarray]:
    return {name: np.asarray(x) for name, x in channels.items()}
