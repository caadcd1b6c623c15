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

    def apart(self, columns: Int[np.ndarray, " j"]) -> list[Int[np.ndarray, " i"]]:
        """Places among `columns` in sets that are to be taken by themselves, for one of them may cost less."""
        return [np.arange(len(columns))]

    def linearise(
        self, theta: Float[np.ndarray, " k"], columns: Int[np.ndarray, " j"] | None = None
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "m c j"]]:
        """Residuals (measured minus modelled) and minus their derivative, so that new = old - S (theta' - theta).

        `columns` chooses parameters (default: all). They are taken `CHUNK` at a time, so any choice runs the one
        compiled function.
        """
        wanted = np.arange(len(theta)) if columns is None else np.asarray(columns)
        residual, S = None, None
        places = [part[i : i + CHUNK] for part in self.apart(wanted) for i in range(0, len(part), CHUNK)]
        for place in places or [np.arange(0)]:
            directions = np.zeros((CHUNK, len(theta)))
            directions[np.arange(len(place)), wanted[place]] = 1.0
            residual, slope = self.slopes(theta, directions)
            S = np.empty((*residual.shape, len(wanted))) if S is None else S
            S[:, :, place] = np.moveaxis(slope[: len(place)], 0, 2)
        assert residual is not None
        assert S is not None
        return residual, S
