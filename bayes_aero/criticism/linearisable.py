"""What criticism needs of anything measured and modelled: residuals at parameters, and their sensitivities."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_aero.model.flights import Flights
from bayes_aero.model.model import Model

CHUNK = 16  # directions per call


class Linearisable(eqx.Module):
    """Outputs of flights under one model of many effects, as means over m blocks of samples."""

    flights: eqx.AbstractVar[Flights]
    model: eqx.AbstractVar[Model]

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
        """The stretch of each block, where residuals begin anew with every stretch and no stationary colour holds."""
        return None

    @abstractmethod
    def block(self, x: Float[Array, "n ..."] | Float[np.ndarray, "n ..."]) -> Float[Array, "m ..."]:
        """Means over blocks of anything sampled at the recorded rate."""

    @abstractmethod
    def evaluate(
        self, theta: Float[Array, " k"] | Float[np.ndarray, " k"]
    ) -> tuple[Float[Array, "m c"], Mapping[str, Array]]:
        """Residuals at parameters `theta` (the model's free ones), and what explains them, by name, at full rate."""

    @abstractmethod
    def offsets(self, theta: Float[np.ndarray, " k"], outputs: Sequence[str]) -> Float[np.ndarray, "m c o"]:
        """Sensitivities to what is no parameter and free in every fit: where integrals began."""

    @abstractmethod
    def slopes(
        self, theta: Float[np.ndarray, " k"], directions: Float[np.ndarray, "d k"]
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "d m c"]]:
        """Residuals and minus their derivatives in `CHUNK` directions."""

    def linearise(
        self, theta: Float[np.ndarray, " k"], columns: Int[np.ndarray, " j"] | None = None
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "m c j"]]:
        """Residuals (measured minus modelled) and minus their derivative, so that new = old - S (theta' - theta).

        `columns` chooses parameters (default: all). They are taken `CHUNK` at a time, so any choice runs the one
        compiled function.
        """
        wanted = np.arange(len(theta)) if columns is None else np.asarray(columns)
        residual, parts = None, []
        for begin in range(0, max(1, len(wanted)), CHUNK):
            chosen = wanted[begin : begin + CHUNK]
            directions = np.zeros((CHUNK, len(theta)))
            directions[np.arange(len(chosen)), chosen] = 1.0
            residual, slope = self.slopes(theta, directions)
            parts.append(np.moveaxis(slope[: len(chosen)], 0, 2))
        assert residual is not None
        return residual, np.concatenate(parts, axis=2)
