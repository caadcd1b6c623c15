"""What a model is fitted to: conditioned signals and coefficients; their noise, and the log-density under it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_aero.arrays import AnyArray
from bayes_aero.effect import MARKS, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.reading import at_common_rate
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights, Forming
from bayes_aero.model.records import despiked as despiked  # for those that observe
from bayes_aero.model.records import join as join
from bayes_aero.parameter import Parameter, Prior, from_unbounded, to_unbounded
from bayes_aero.physics.aircraft import NAMES, Aircraft, required_of
from bayes_aero.physics.coefficients import alike_joined, condition_joined, stacked_coefficients
from bayes_aero.physics.filters import FILTER_STEP, recurrence
from bayes_aero.processes import compiled_at

# --- Plain classes that are pytrees of compiled programs.


def _register(kind: type, static: Collection[str] = ()) -> None:
    names = [field.name for field in fields(kind) if field.name not in static]

    def parts(whole: Any) -> tuple[list[tuple[Any, Any]], tuple[Any, ...]]:
        leaves = [(jax.tree_util.GetAttrKey(name), getattr(whole, name)) for name in names]
        return leaves, tuple(getattr(whole, name) for name in static)

    def whole(fixed: tuple[Any, ...], leaves: Any) -> Any:
        """Without the constructor's checks, because JAX replaces numbers by tracers."""
        made = object.__new__(kind)
        for name, part in zip((*names, *static), (*leaves, *fixed), strict=True):
            object.__setattr__(made, name, part)
        return made

    jax.tree_util.register_pytree_with_keys(kind, parts, whole)


_register(Aircraft)
_register(Flights, ("lengths", "names", "held"))


def response_scales(
    model: Model, values: Mapping[str, Any], channels: Mapping[str, AnyArray], aircraft: Aircraft, names: Sequence[str]
) -> dict[str, AnyArray]:
    """Derivative of each corrected channel of `names` with respect to the recorded channel."""
    # One channel at a time: the influence of other channels (pitch rate on the vane's angle) does not count. Only the
    # effects that correct a channel are traced again for it.
    in_time = model.in_time(values, channels, aircraft)
    errors = [e for e in model.acting if e.stage is Stage.CHANNEL]
    corrects = [e.increments(values, in_time, aircraft, in_time).keys() for e in errors]

    def corrected(name, series):
        makers = [e for e, channel_names in zip(errors, corrects, strict=True) if name in channel_names]
        for delays, others in ((True, channels), (False, in_time)):
            signals = {**others, name: series}
            made = [e.increments(values, signals, aircraft, signals)[name] for e in makers if e.delays is delays]
            series = sum(made, series)
        return series

    series_by_name = {name: channels[name] for name in names if name in channels}
    return {name: jax.jvp(partial(corrected, name), (x,), (jnp.ones_like(x),))[1] for name, x in series_by_name.items()}


# --- What a model is fitted to: conditioned signals and measured coefficients of one or more manoeuvres.

STEADY = ', or state it under [constants] (p = "0 deg/s", r = "0 deg/s") if the wings were level throughout'


class Observations(eqx.Module):
    """Samples of all manoeuvres laid end to end."""

    signals: dict[str, AnyArray]
    measured: Float[AnyArray, "n c"]  # the named `coefficients`
    # Manoeuvres are independent: filtered one by one, lags and coloured noise start again where `start` is true.
    start: Bool[AnyArray, " n"]
    manoeuvre: Int[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]
    aircraft: Aircraft
    names: tuple[str, ...] = eqx.field(static=True)
    coefficients: tuple[str, ...] = eqx.field(static=True, default=NAMES)

    @property
    def n(self) -> int:
        return self.measured.shape[0]

    @property
    def dt(self) -> float:
        return float(np.median(np.asarray(self.signals["dt"])))

    @property
    def nameless(self) -> Observations:
        """The same without names, on which no number depends: compiled programs then serve records of any name."""
        return replace(self, names=())

    def subset(self, index: Int[np.ndarray, " m"]) -> Observations:
        """The samples `index`, in time order; one whose predecessor was left out starts a new stretch."""
        # No lag and no noise correlation is carried over a hole.
        index = np.sort(np.asarray(index))
        begins = np.asarray(self.start)[index] | np.concatenate([[True], np.diff(index) > 1])
        return replace(
            self,
            signals={k: v[index] for k, v in self.signals.items()} | {"start": begins},
            measured=self.measured[index],
            start=begins,
            manoeuvre=self.manoeuvre[index],
            time=self.time[index],
        )

    def restarted(self, start: Bool[np.ndarray, " n"]) -> Observations:
        """The same samples with other marks of where lags and coloured noise start again."""
        return eqx.tree_at(lambda o: (o.start, o.signals["start"]), self, (start, start))

    def thinned(self, step: int = FILTER_STEP) -> Observations:
        """Every `step`-th sample of each stretch, as a record of that lower rate (`dt` grows accordingly)."""
        begins = np.flatnonzero(np.asarray(self.start))
        ends = np.append(begins[1:], self.n)
        index = np.concatenate([np.arange(begin, end, step) for begin, end in zip(begins, ends, strict=True)])
        fewer = self.subset(index).restarted(np.asarray(self.start)[index])
        return eqx.tree_at(lambda o: o.signals["dt"], fewer, step * fewer.signals["dt"])

    def only(self, manoeuvre: int) -> Observations:
        return self.subset(np.flatnonzero(self.manoeuvre == manoeuvre))

    def with_measured(self, measured: Float[AnyArray, "n c"]) -> Observations:
        return eqx.tree_at(lambda o: o.measured, self, measured)


def observe(
    records: Sequence[FlightRecord], card: Card, model: Model, forming: Forming = Forming.MATCHED
) -> Observations:
    """Reconstruct the coefficients of every record, one a manoeuvre, and lay the manoeuvres end to end."""
    # Effects that act on the record or the aircraft itself are applied at the values the model fixes for them.
    forming = Forming(forming)
    if forming is Forming.MATCHED and records:
        records = at_common_rate(records)
    values = dict(model.fixed)
    for effect in model.effects:
        free = [p.name for p in effect.parameters if p.name not in values]
        if effect.stage <= Stage.AIRCRAFT and free:
            raise InputError(
                f"effect {effect.name} changes the record or the aircraft itself, so {', '.join(free)} cannot be "
                "fitted to the coefficients; fix it on the card, or use bayes-aero diagnose to estimate it"
            )
    aircraft = model.actual_aircraft(values, card.aircraft)

    def remedy(need: str) -> str:
        return f"{need}, which the model needs; map it on the card{STEADY if need in ('p', 'r') else ''}"

    required = dict.fromkeys((*required_of(model.axes), *model.channels))
    flights = join(records, card, [need for need in required if need != "alpha_dot"], remedy)
    recorded = {key: flights.channels[key] for key in flights.recorded}
    marks_by_name = {key: flights.channels[key] for key in MARKS}
    signals, measured = jax.device_get(_formed(model, forming, values, recorded, marks_by_name, aircraft))
    return Observations(
        signals=dict(sorted((signals | {key: marks_by_name[key] for key in ("dt", "start")}).items())),
        measured=measured,
        start=marks_by_name["start"],
        manoeuvre=flights.manoeuvre,
        time=flights.time,
        aircraft=aircraft,
        names=flights.names,
        coefficients=model.coefficients,
    )


@compiled_at(0)
def _formed(
    model: Model,
    forming: Forming,
    values: Mapping[str, Any],
    recorded: Mapping[str, AnyArray],
    marks_by_name: Mapping[str, AnyArray],
    aircraft: Aircraft,
) -> tuple[dict[str, AnyArray], Float[AnyArray, "n c"]]:
    true = model.corrected(values, {**recorded, **marks_by_name}, aircraft)
    channels, ends = {key: true[key] for key in recorded}, [marks_by_name[key] for key in ("dt", "first", "last")]
    if forming is Forming.MATCHED:
        signals = alike_joined(channels, aircraft.accelerometer, *ends)
    else:
        signals = condition_joined(channels, *ends)
    return signals, stacked_coefficients(signals, aircraft, model.coefficients)


# --- Noise of the measured coefficients: white, first-order autoregressive, with buffet.


class Colour(StrEnum):
    """Assumed distribution of the residuals of one coefficient."""

    WHITE = "white"  # independent, one variance
    AR1 = "ar1"  # r[k] = rho r[k-1] + e[k], stationary within a manoeuvre
    BUFFET_AR1 = "buffet-ar1"  # the same, its standard deviation growing as 1 + buffet (1 - X)


DEFAULT = Colour.BUFFET_AR1  # near the stall a steep model also amplifies the noise of the vane
Series = Float[AnyArray, " n"]


@dataclass(frozen=True)
class Noise:
    """A noise model of `coefficients`: `sigma_*` (stationary sd, attached flow), `rho_*`, `buffet_*`."""

    colour: Colour
    coefficients: tuple[str, ...] = NAMES

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        sigma = Prior("lognormal", 0.02, 1.0, "a factor of 7 either way with 95 %; our choice")
        rho = Prior("uniform", -1.0, 2.0, "flat over the stationary range; our choice")
        buffet = Prior("halfnormal", 0.0, 3.0, "buffet up to several times the attached-flow noise; our choice")
        rows = [("sigma", 0.02, "stationary deviation of the {} residual", sigma, (0.0, jnp.inf))]
        if self.colour is not Colour.WHITE:
            rows.append(("rho", 0.5, "lag-1 correlation of the {} residual", rho, (-1.0, 1.0)))
        if self.colour is Colour.BUFFET_AR1:
            rows.append(("buffet", 0.5, "growth of the {} noise with 1 - X", buffet, (0.0, jnp.inf)))
        return tuple(
            Parameter(f"{kind}_{name}", "1", 0.0, start, text.format(name), prior, bounds)
            for kind, start, text, prior, bounds in rows
            for name in self.coefficients
        )

    def innovation(
        self, name: str, values: Mapping[str, Any], residual: Series, X: Series, start: Bool[AnyArray, " n"]
    ) -> tuple[Series, Series]:
        """Innovations of one coefficient over their standard deviation, and the logarithm of the latter."""
        # `residual` is measured minus modelled. At `start` the innovation is the residual itself with the stationary
        # standard deviation, so that manoeuvres are independent and the density is exact.
        sigma, rho, buffet = (values.get(f"{kind}_{name}", 0.0) for kind in ("sigma", "rho", "buffet"))
        growth = 1.0 + buffet * (1.0 - X)
        residual = residual / growth
        before = jnp.where(start, 0.0, rho) * jnp.concatenate([jnp.zeros(1), residual[:-1]])
        sd = sigma * jnp.where(start, 1.0, jnp.sqrt(1.0 - rho**2))
        return (residual - before) / sd, jnp.log(sd) + jnp.log(growth)

    def simulate(
        self, values: Mapping[str, Any], white: Float[AnyArray, "n c"], X: Series, start: Bool[AnyArray, " n"]
    ) -> Float[AnyArray, "n c"]:
        """Residuals of all coefficients from standard normal numbers: the inverse of `innovation`."""
        each = [[values.get(f"{kind}_{n}", 0.0) for n in self.coefficients] for kind in ("sigma", "rho", "buffet")]
        (sigma, rho, buffet), first = (jnp.stack(list(map(jnp.asarray, row))) for row in each), start[:, None]
        drive = white * sigma * jnp.where(first, 1.0, jnp.sqrt(1.0 - rho**2))
        residual = recurrence(jnp.where(first, 0.0, jnp.broadcast_to(rho, drive.shape)), drive)
        return residual * (1.0 + buffet * (1.0 - X)[:, None])


# --- A log-density: likelihood and priors of named parameters, on the scale of the data and on the whole real line.


class LogDensity(eqx.Module):
    """Log-density for samplers: vectors `x` are in SI, `u` is the same point mapped onto the whole real line."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, in the order of `x`."""

    @property
    @abstractmethod
    def noise_label(self) -> str:
        """The assumed noise, in a word."""

    @abstractmethod
    def log_likelihood(self, x: Float[AnyArray, " k"]) -> Float[AnyArray, ""]:
        """Log-density of the data at `x`."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def size(self) -> int:
        return len(self.parameters)

    def log_prior(self, x: Float[AnyArray, " k"]) -> Float[AnyArray, ""]:
        """Log of the product of the parameters' priors. Truncation by bounds is not normalised: a constant."""
        return sum((p.prior.log_density(x[i]) for i, p in enumerate(self.parameters)), start=jnp.zeros(()))

    def __call__(self, u: Float[AnyArray, " k"]) -> Float[AnyArray, ""]:
        """Log-density of `u`: likelihood, prior, and the Jacobian of the map from `u` to `x`."""
        x, log_slope = self._bounded(u)
        return self.log_likelihood(x) + self.log_prior(x) + jnp.sum(log_slope)

    def constrain(self, u: Float[AnyArray, " k"]) -> Float[AnyArray, " k"]:
        return self._bounded(u)[0]

    def unconstrain(self, x: Float[AnyArray, " k"]) -> Float[AnyArray, " k"]:
        return jnp.stack([to_unbounded(p, x[i]) for i, p in enumerate(self.parameters)])

    def sample_prior(self, rng: np.random.Generator, size: int) -> Float[np.ndarray, "size k"]:
        columns = []
        for p in self.parameters:
            draws = np.empty(0)
            while draws.size < size:
                more = p.prior.sample(rng, 4 * size)
                draws = np.concatenate([draws, more[(more > p.bounds[0]) & (more < p.bounds[1])]])
            columns.append(draws[:size])
        return np.stack(columns, axis=1)

    def _bounded(self, u: Float[AnyArray, " k"]) -> tuple[Float[AnyArray, " k"], Float[AnyArray, " k"]]:
        pairs = [from_unbounded(p, u[i]) for i, p in enumerate(self.parameters)]
        return jnp.stack([x for x, _ in pairs]), jnp.stack([slope for _, slope in pairs])


class Density(LogDensity):
    """Posterior log-density of the free model parameters and the noise parameters."""

    # Vectors `x` hold model parameters first, then noise (`parameters` gives the order). The observations are array
    # leaves, so that data sets of one size share compiled programs.
    observations: Observations = eqx.field(converter=lambda given: given.nameless)
    model: Model = eqx.field(static=True)
    noise: Noise = eqx.field(static=True)
    bias: Float[AnyArray, " p"] | None = None  # of the free model parameters: coefficients follow x + bias

    @classmethod
    def of(
        cls, observations: Observations, model: Model, noise: Noise, bias: Float[np.ndarray, " p"] | None = None
    ) -> Density:
        """The density of a record under `noise`; coloured noise uses one sample in `FILTER_STEP`."""
        # Cm is formed from a smoothed and differentiated rate. The smoothing correlates neighbouring samples in a way
        # that no short autoregression describes. With every sample the autoregression would fit the smoothness, and the
        # likelihood would weigh only changes from sample to sample, in which filtered and unfiltered signals differ.
        # One sample in `FILTER_STEP` keeps the band that the filter passes, in which the coloured model holds.
        noise_of = replace(noise, coefficients=observations.coefficients)
        return cls(observations if noise.colour is Colour.WHITE else observations.thinned(), model, noise_of, bias)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*self.model.free, *self.noise.parameters)

    @property
    def noise_label(self) -> str:
        return self.noise.colour.value

    def values(self, x: Float[AnyArray, " k"]) -> dict[str, Any]:
        """Values of all parameters, fixed ones too, by name, with the bias that recording noise gives them."""
        if self.bias is not None:
            k = len(self.bias)
            x = jnp.concatenate([x[:k] + self.bias, x[k:]])
        return dict(self.model.fixed) | {name: x[i] for i, name in enumerate(self.names)}

    def predict(self, x: Float[AnyArray, " k"]) -> Float[AnyArray, "n c"]:
        return self._stacked(self._flow(x))

    def pointwise(self, x: Float[AnyArray, " k"]) -> Float[AnyArray, "n c"]:
        """Log-likelihood of every sample and coefficient, given the samples before it in its manoeuvre."""
        return jnp.stack([density for _, density in self._innovations(x)], axis=-1)

    def standardised(self, x: Float[AnyArray, " k"]) -> Float[AnyArray, "n c"]:
        """One-step-ahead innovations over their standard deviation: white, unit variance if the model holds."""
        return jnp.stack([z for z, _ in self._innovations(x)], axis=-1)

    def replicate(self, x: Float[AnyArray, " k"], white: Float[AnyArray, "n c"]) -> Float[AnyArray, "n c"]:
        """Coefficients that the model with its noise would have produced from standard normal `white`."""
        flow = self._flow(x)
        return self._stacked(flow) + self.noise.simulate(self.values(x), white, flow["X"], self.observations.start)

    def log_likelihood(self, x: Float[AnyArray, " k"]) -> Float[AnyArray, ""]:
        """Sum of `pointwise`, taken before the coefficients are put side by side: almost twice as fast."""
        return sum((jnp.sum(density) for _, density in self._innovations(x)), start=jnp.zeros(()))

    def _innovations(self, x: Float[AnyArray, " k"]) -> list[tuple[Series, Series]]:
        """By coefficient: standardised innovations, and their log-densities."""
        o, flow, values = self.observations, self._flow(x), self.values(x)
        residuals = {name: o.measured[:, c] - flow[name] for c, name in enumerate(self.model.coefficients)}
        every = [self.noise.innovation(name, values, r, flow["X"], o.start) for name, r in residuals.items()]
        return [(z, -0.5 * (z**2 + jnp.log(2.0 * jnp.pi)) - log_sd) for z, log_sd in every]

    def _flow(self, x: Float[AnyArray, " k"]) -> Mapping[str, AnyArray]:
        return self.model.flow(self.values(x), self.observations.signals, self.observations.aircraft)

    def _stacked(self, flow: Mapping[str, AnyArray]) -> Float[AnyArray, "n c"]:
        return jnp.stack([flow[name] for name in self.model.coefficients], axis=-1)
