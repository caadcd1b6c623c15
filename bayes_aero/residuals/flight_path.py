"""What the flight path leaves of recorded channels, as a function of the parameters of every error of a sensor.

In NumPy, without JAX: a check of records takes no longer than its libraries take to load. Slopes are differences, for a
path is all but linear in the errors of its sensors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_aero.arrays import Array, namespace
from bayes_aero.effect import Effect, Stage
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.joined_records import Joined, Recorded
from bayes_aero.model.model import Model
from bayes_aero.physics.filters import differentiate_joined, smooth_joined
from bayes_aero.physics.flightpath import ANGLES, as_symmetric, integral, path_outputs, path_rates
from bayes_aero.physics.kinematics import RATES
from bayes_aero.residuals.base import Blockwise

KEPT = 256  # residuals that are kept; a slope needs one for each direction
LEVEL = np.radians(5.0)  # of bank: wings that move less count as level where bank was not recorded
STEP = 1e-6  # of a parameter's prior deviation, and of a channel's largest value: differences are as good as slopes
ON_RECORD = (Stage.CHANNEL, Stage.AIRCRAFT)  # stages that the flight path feels


def flight_path(flights: Recorded) -> tuple[str, ...]:
    """Flight-path outputs of these flights: none where they rolled and nobody knows how far."""
    return () if rolled_unseen(flights) else path_outputs(flights.channels)


def rolled_unseen(flights: Recorded) -> bool:
    """Whether the roll rate of some manoeuvre changes a bank angle that was not recorded, a drift apart."""
    if "phi" in flights.channels or "p" not in flights.channels:
        return False
    p, dt = (np.split(np.asarray(flights.channels[n]), np.cumsum(flights.lengths)[:-1]) for n in ("p", "dt"))
    return any(np.ptp(np.cumsum((x - x.mean()) * step)) > LEVEL for x, step in zip(p, dt, strict=True))


def differences(
    outputs: Sequence[str],
    s: Mapping[str, Array],
    aircraft: Aircraft,
    scales: Mapping[str, Array],
    sines: tuple[Array, ...] | None = None,
) -> Float[Array, "n c"]:
    """Recorded minus integrated, in units of the recorded channels.

    Args:
        outputs: flight-path outputs to form.
        s: corrected signals (n,) with `p_dot`, `q_dot`, `r_dot` and the marks of `effect.Stage`.
        aircraft: as it is.
        scales: what a unit of each recorded channel has become by the correction; one where it is not there.
        sines: see `path_rates`.
    """
    rates = path_rates(as_symmetric(s), aircraft, sines)
    left = [
        (s[name] - integral(rates[name], s["dt"], s["start"], s["first"])) / scales.get(name, 1.0) for name in outputs
    ]
    return namespace(*left).stack(left, axis=1)


@dataclass(frozen=True)
class FlightPathError(Blockwise):
    """Residuals of the flight path of `flights` under `model`; effects of later stages do nothing."""

    flights: Joined
    model: Model
    path: tuple[str, ...]

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the flight-path outputs."""
        return self.path

    @classmethod
    def of(cls, flights: Recorded, model: Model) -> FlightPathError:
        """`flights` under `model`; without outputs where there is no flight path."""
        channels = {name: np.asarray(x) for name, x in as_symmetric(flights.channels).items()}
        plain = Joined(channels, flights.aircraft, flights.manoeuvre, flights.time, flights.lengths, flights.names)
        return cls(plain, model, flight_path(flights))

    def evaluate(self, theta: Float[Array, " k"]) -> tuple[Float[np.ndarray, "m c"], Mapping[str, Array]]:
        """Residuals of blocks; nothing explains them but the parameters."""
        return self._residual(np.asarray(theta)), {}

    def slopes(
        self, theta: Float[np.ndarray, " k"], directions: Float[np.ndarray, "d k"]
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "d m c"]]:
        """Residuals and minus their derivatives in these directions."""
        theta = np.asarray(theta)
        residual = self._residual(theta)
        found = np.zeros((len(directions), *residual.shape))
        felt = np.isin(self.model.names, [p.name for e in self._on_record for p in e.parameters])
        spread = np.array([p.prior.normal[1] for p in self.model.free])
        for number, direction in enumerate(np.asarray(directions)):
            if np.any(direction[felt]):
                step = STEP / float(np.max(np.abs(direction) / spread))
                found[number] = (residual - self._residual(theta + step * direction)) / step
        return residual, found

    @cached_property
    def _slopes(self) -> dict[str, Float[np.ndarray, " n"]]:
        """Angular accelerations as recorded."""
        ends = [self.flights.channels[name] for name in ("dt", "first", "last")]
        return {name: differentiate_joined(self.flights.channels[name], *ends) for name in RATES}

    @cached_property
    def _sines(self) -> dict[str, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]]:
        """Sine and cosine of angles as recorded."""
        return {name: (np.sin(self.flights.channels[name]), np.cos(self.flights.channels[name])) for name in ANGLES}

    def _sines_of(self, signals: Mapping[str, np.ndarray]) -> tuple[Float[np.ndarray, " n"], ...]:
        """The same of corrected angles, most of which are as recorded."""
        return tuple(
            x
            for name in ANGLES
            for x in (
                self._sines[name]
                if signals[name] is self.flights.channels[name]
                else (np.sin(signals[name]), np.cos(signals[name]))
            )
        )

    @cached_property
    def _on_record(self) -> tuple[Effect, ...]:
        return tuple(e for e in self.model.acting if e.stage in ON_RECORD)

    @cached_property
    def _kept(self) -> dict[bytes, Float[np.ndarray, "m c"]]:
        """Residuals by parameter vector, the latest last."""
        return {}

    def _residual(self, theta: Float[np.ndarray, " k"]) -> Float[np.ndarray, "m c"]:
        """Residuals at a parameter vector, read only; searches ask for the same ones again and again."""
        key = theta.tobytes()
        found = self._kept.pop(key, None)
        if found is None:
            found = self._evaluated(theta)
            found.flags.writeable = False
        self._kept[key] = found
        while len(self._kept) > KEPT:
            del self._kept[next(iter(self._kept))]
        return found

    def _evaluated(self, theta: Float[np.ndarray, " k"]) -> Float[np.ndarray, "m c"]:
        f, values = self.flights, self.model.values(theta)
        present = tuple(e for e in self._on_record if not e.absent_in(values))
        model = Model(present, tuple(p for e in present for p in e.parameters))
        signals = _plain(model.corrected(values, f.channels, f.aircraft))
        ends = [f.channels[name] for name in ("dt", "first", "last")]
        for name in RATES:
            same = signals[name] is f.channels[name]
            signals[f"{name}_dot"] = self._slopes[name] if same else differentiate_joined(signals[name], *ends)
        scales = self._scales(model, values, signals)
        left = differences(
            self.outputs, signals, model.actual_aircraft(values, f.aircraft), scales, self._sines_of(signals)
        )
        return self.block(np.stack([smooth_joined(x, *ends[1:]) for x in left.T], axis=1))

    def _scales(
        self, model: Model, values: Mapping[str, Any], corrected: Mapping[str, np.ndarray]
    ) -> dict[str, Float[np.ndarray, " n"]]:
        """What a unit of each channel has become that the model corrects."""
        f, found = self.flights, {}
        for name in (name for name in self.outputs if corrected[name] is not f.channels[name]):
            step = STEP * float(np.max(np.abs(f.channels[name])))
            up, down = (
                _plain(model.corrected(values, {**f.channels, name: f.channels[name] + by}, f.aircraft))[name]
                for by in (step, -step)
            )
            found[name] = (up - down) / (2.0 * step)
        return found


def _plain(channels: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """A user's own effects may answer in JAX."""
    return {name: np.asarray(x) for name, x in channels.items()}
