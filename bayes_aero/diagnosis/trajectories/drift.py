"""Which parameters changed during a flight, when and by how much, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.inference.scores import COLOURED_INNOVATIONS

DRIFT_LEVEL = 0.05  # of the tests of all drifting parameters together
SEEN = 2.0  # standard errors from which begin and end differ


@dataclass(frozen=True)
class DriftChange:
    """Of a parameter over one manoeuvre, SI: `size` from begin to end, `farthest` from the begin, each with its
    standard error; `at`: when it was farthest; `times`: by which a tenth, half and nine tenths of `size` had happened;
    s from the manoeuvre's begin."""

    size: tuple[float, float]
    farthest: tuple[float, float]
    at: float
    times: tuple[float, float, float]

    @property
    def seen(self) -> bool:
        """Whether begin and end differ beyond doubt."""
        return abs(self.size[0]) > SEEN * self.size[1]


@dataclass(frozen=True)
class Drifted:
    """One drifting parameter: unit; intensity, unit per square root of a second, with the standard error of its
    logarithm; likelihood ratio against no drift of it, p-value among all that may drift; what changed, by manoeuvre."""

    unit: str
    intensity: tuple[float, float]
    ratio: float
    p: float
    changes: Mapping[str, DriftChange]


@dataclass(frozen=True)
class DriftHistory:
    """Parameters of one manoeuvre given all of its samples: time in s from its start (n,); of each its value and the
    standard deviations of value and change from the begin, (n,), SI."""

    manoeuvre: str
    time: Float[np.ndarray, " n"]
    values: Mapping[str, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]]


@dataclass(frozen=True)
class Drift:
    """A fit with process noise in which parameters drift, SI.

    Attributes:
        usable: whether it and those that it is compared with converged.
        ratio, p: likelihood ratio against no drift at all, and its p-value.
        parameters: those that drift, by name.
        estimates: all parameters by name, each with its standard error; of those that drift at the begin.
        autocorrelation: of neighbouring innovations by output.
        histories: by manoeuvre.
    """

    usable: bool
    ratio: float
    p: float
    parameters: Mapping[str, Drifted]
    estimates: Mapping[str, tuple[float, float]]
    autocorrelation: Mapping[str, float]
    histories: tuple[DriftHistory, ...]

    @property
    def coloured(self) -> tuple[str, ...]:
        """Outputs whose innovations are not white: then the tests hold no more."""
        return tuple(name for name, r in self.autocorrelation.items() if abs(r) > COLOURED_INNOVATIONS)

    @property
    def changed(self) -> tuple[str, ...]:
        """Parameters that changed; none where nothing can be said."""
        if self.coloured or not self.usable:
            return ()
        return tuple(name for name, found in self.parameters.items() if found.p < DRIFT_LEVEL)
