"""Residual models: residuals of a model on a record at given parameters, and their sensitivities."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.arrays import AnyArray, namespace
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.joined_records import Flights, cuts_of
from bayes_aero.model.model import Model
from bayes_aero.physics.filters import FILTER_STEP
from bayes_aero.units import number

DIRECTIONS_PER_CALL = 16


class ResidualModel(ABC):
    """Residuals of flights under one model of many effects, as means over m blocks of samples.

    An implementation is a dataclass (with JAX an `equinox.Module`) with the fields `flights` and `model`.
    """

    flights: Flights
    model: Model

    def with_channels(self, channels: Mapping[str, AnyArray]) -> ResidualModel:
        """The same model on flights with these channels."""
        flights = replace(self.flights, channels=dict(channels))  # pyright: ignore[reportArgumentType]
        return replace(self, flights=flights)  # pyright: ignore[reportArgumentType]

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
    def stretch(self) -> Int[np.ndarray, " m"] | None:
        """The stretch of each block, where residuals start again in every stretch and are not stationary; else None."""
        return None

    @property
    def jackknife_blocks(self) -> Int[np.ndarray, " m"] | None:
        """The part of the flights of each block, where terms are judged by how far they move when a part is left out;
        None where the residual's colour tells."""
        return self.stretch

    @property
    def averaged(self) -> int:
        """Samples of which each residual is the mean."""
        return FILTER_STEP

    @abstractmethod
    def block(self, x: Float[AnyArray, "n ..."]) -> Float[AnyArray, "m ..."]:
        """Means over blocks of anything sampled at the recorded rate."""

    @abstractmethod
    def evaluate(self, theta: Float[AnyArray, " k"]) -> tuple[Float[AnyArray, "m c"], Mapping[str, AnyArray]]:
        """Residuals at the free parameters `theta`, and signals that describe them by name, at the recorded rate."""

    @abstractmethod
    def offsets(self, theta: Float[np.ndarray, " k"], outputs: Sequence[str]) -> Float[np.ndarray, "m c o"]:
        """Sensitivities to quantities that are free in every fit and no parameters: initial values of integrals."""

    @abstractmethod
    def slopes(
        self, theta: Float[np.ndarray, " k"], directions: Float[np.ndarray, "d k"]
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "d m c"]]:
        """Residuals and minus their derivatives in `DIRECTIONS_PER_CALL` directions."""

    def slopes_at(self, theta: Float[np.ndarray, " k"]) -> Callable[[Float[np.ndarray, "d k"]], tuple]:
        """`slopes` at these parameters as a function of the directions."""
        return lambda directions: self.slopes(theta, directions)

    def separate_sets(self, columns: Int[np.ndarray, " j"]) -> list[Int[np.ndarray, " i"]]:
        """Indices of `columns` in sets of equal cost, each of which is computed by itself."""
        return [np.arange(len(columns))]

    def linearise(
        self, theta: Float[np.ndarray, " k"], columns: Int[np.ndarray, " j"] | None = None
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "m c j"]]:
        """Residuals (measured minus modelled) and minus their derivative, so that new = old - S (theta' - theta).

        Args:
            theta: free parameters, (k,).
            columns: indices of the parameters of S, (j,); default: all. `DIRECTIONS_PER_CALL` of them are computed at a
                time, so that any choice uses one compiled function.
        """
        indices = np.arange(len(theta)) if columns is None else np.asarray(columns)
        residual, S, slopes = None, None, self.slopes_at(theta)
        size = DIRECTIONS_PER_CALL
        places = [part[i : i + size] for part in self.separate_sets(indices) for i in range(0, len(part), size)]
        for place in places or [np.arange(0)]:
            directions = np.zeros((size, len(theta)))
            directions[np.arange(len(place)), indices[place]] = 1.0
            residual, slope = slopes(directions)
            S = np.empty((*residual.shape, len(indices))) if S is None else S
            S[:, :, place] = np.moveaxis(slope[: len(place)], 0, 2)
        assert residual is not None
        assert S is not None
        return residual, S


class Blockwise(ResidualModel):
    """Means over blocks of `FILTER_STEP` samples: the rate that the smoothing filters pass."""

    @property
    def manoeuvre(self) -> Int[np.ndarray, " m"]:
        """Which manoeuvre each block belongs to."""
        return np.repeat(np.arange(len(self.flights.lengths)), [k // FILTER_STEP for k in self.flights.lengths])

    @property
    def seconds(self) -> float:
        """Length of a block, s."""
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

    def offsets(self, theta: Float[np.ndarray, " k"], outputs: Sequence[str]) -> Float[np.ndarray, "m c o"]:  # noqa: ARG002
        """A constant for each manoeuvre and flight-path output: the initial value of the integral."""
        manoeuvre = self.manoeuvre
        path = [c for c, name in enumerate(outputs) if name not in self.model.coefficients]
        S = np.zeros((len(manoeuvre), len(outputs), (int(manoeuvre[-1]) + 1) * len(path)))
        for place, (k, c) in enumerate((k, c) for k in range(int(manoeuvre[-1]) + 1) for c in path):
            S[manoeuvre == k, c, place] = 1.0
        return S


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
