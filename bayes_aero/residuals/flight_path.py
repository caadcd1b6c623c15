"""Flight-path error: recorded minus integrated channels, as a function of the parameters of all sensor errors.

In NumPy, without JAX, so that a check of records starts fast. Slopes are finite differences, because a flight path is
nearly linear in the errors of its sensors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_aero.arrays import AnyArray, namespace
from bayes_aero.effect import Effect, Stage
from bayes_aero.model.joined_records import Flights
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import Aircraft, Axis
from bayes_aero.physics.filters import differentiate_joined, smooth_joined
from bayes_aero.physics.kinematics import ANGLES, RATES, as_symmetric, integral, path_outputs, path_rates
from bayes_aero.residuals.base import Blockwise

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

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the flight-path outputs."""
        return self.path

    @classmethod
    def of(cls, flights: Flights, model: Model) -> FlightPathError:
        """`flights` under `model`; without outputs where there is no flight path."""
        channels = {name: np.asarray(x) for name, x in as_symmetric(flights.channels).items()}
        return cls(replace(flights, channels=channels), model, flight_path(flights))

    def evaluate(self, theta: Float[AnyArray, " k"]) -> tuple[Float[np.ndarray, "m c"], Mapping[str, AnyArray]]:
        """Residuals of blocks; there are no further signals."""
        return self._residual(np.asarray(theta)), {}

    def slopes(
        self, theta: Float[np.ndarray, " k"], directions: Float[np.ndarray, "d k"]
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "d m c"]]:
        """Residuals and minus their derivatives in these directions."""
        theta = np.asarray(theta)
        residual = self._residual(theta)
        slope = np.zeros((len(directions), *residual.shape))
        affected = np.isin(self.model.names, [p.name for e in self._on_record for p in e.parameters])
        spread = np.array([p.prior.normal[1] for p in self.model.free])
        for number, direction in enumerate(np.asarray(directions)):
            if np.any(direction[affected]):
                step = STEP / float(np.max(np.abs(direction) / spread))
                slope[number] = (residual - self._residual(theta + step * direction)) / step
        return residual, slope

    @cached_property
    def _cache(self) -> dict[bytes, Float[np.ndarray, "m c"]]:
        """Residuals by parameter vector, the latest last."""
        return {}

    @cached_property
    def _recorded_slopes(self) -> dict[str, Float[np.ndarray, " n"]]:
        """Angular accelerations as recorded."""
        ends = [self.flights.channels[name] for name in ("dt", "first", "last")]
        return {name: differentiate_joined(self.flights.channels[name], *ends) for name in RATES}

    @cached_property
    def _sines(self) -> dict[str, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]]:
        """Sine and cosine of angles as recorded."""
        return {name: (np.sin(self.flights.channels[name]), np.cos(self.flights.channels[name])) for name in ANGLES}

    @cached_property
    def _on_record(self) -> tuple[Effect, ...]:
        return tuple(e for e in self.model.acting if e.stage in RECORD_STAGES)

    def _residual(self, theta: Float[np.ndarray, " k"]) -> Float[np.ndarray, "m c"]:
        """Residuals at a parameter vector, read only; stored, because searches repeat the same vectors."""
        key = theta.tobytes()
        residual = self._cache.pop(key, None)
        if residual is not None:
            self._cache[key] = residual
            return residual
        f, values = self.flights, self.model.values(theta)
        present = tuple(e for e in self._on_record if not e.absent_in(values))
        model = Model(present, tuple(p for e in present for p in e.parameters), axes=tuple(Axis))
        signals = _as_numpy(model.corrected(values, f.channels, f.aircraft))
        ends, scales, sines = [f.channels[name] for name in ("dt", "first", "last")], {}, []
        same = {name: signals[name] is x for name, x in f.channels.items()}
        for name in RATES:
            own = self._recorded_slopes[name] if same[name] else differentiate_joined(signals[name], *ends)
            signals[f"{name}_dot"] = own
        for name in ANGLES:
            sines += self._sines[name] if same[name] else (np.sin(signals[name]), np.cos(signals[name]))
        for name in (name for name in self.outputs if not same[name]):  # derivatives by the recorded channels
            step = STEP * float(np.max(np.abs(f.channels[name])))
            up, down = (
                _as_numpy(model.corrected(values, {**f.channels, name: f.channels[name] + by}, f.aircraft))[name]
                for by in (step, -step)
            )
            scales[name] = (up - down) / (2.0 * step)
        aircraft = model.actual_aircraft(values, f.aircraft)
        residuals = differences(self.outputs, signals, aircraft, scales, tuple(sines))
        residual = self.block(np.stack([smooth_joined(x, *ends[1:]) for x in residuals.T], axis=1))
        residual.flags.writeable = False
        self._cache[key] = residual
        while len(self._cache) > CACHE_SIZE:
            del self._cache[next(iter(self._cache))]
        return residual


def _as_numpy(channels: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """NumPy arrays; a user's own effects may return JAX arrays."""
    return {name: np.asarray(x) for name, x in channels.items()}
