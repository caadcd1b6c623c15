"""Which parameters changed during a flight, when and by how much: a fit in which they drift beside one without.

Likelihood ratio of an intensity at its bound of zero: half of its distribution is at zero, half chi-square (Self and
Liang 1987, JASA 82, 605). With one walk in a record more than half is at zero, so that these p-values are rather too
large than too small (Shephard and Harvey 1990, J. Time Series Analysis 11, 339). Several parameters: Holm 1979.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from bayes_aero.diagnosis.result import COLOURED_INNOVATIONS
from bayes_aero.dynamics.filtering.innovations import neighbour_correlation
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.drifting import DriftFit, Histories, fit_drifting, histories
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorResult

DRIFT_LEVEL = 0.05  # of the tests of all drifting parameters together
SEEN = 2.0  # standard errors from which begin and end differ
SHARES = (0.1, 0.5, 0.9)  # of a change, whose times are told


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


def with_drift(
    flown: SegmentTrajectories,
    still: PredictionErrorResult,
    names: Sequence[str],
    *,
    priors: bool = True,
) -> Drift:
    """Fit with parameters `names` drifting, beside the fit `still` without; see `fit_drifting`."""
    found = fit_drifting(flown, still, names, priors=priors)
    fit, path = found.fit, histories(found)
    p = holm(np.array([at_bound(float(r)) for r in found.ratios]))
    units = {parameter.name: parameter.unit for parameter in found.flown.dynamics.free}
    parts = _parts(found.flown)
    told = {
        name: Drifted(
            units[name],
            (float(found.intensity[i, 0]), float(found.intensity[i, 1])),
            float(found.ratios[i]),
            float(p[i]),
            {manoeuvre: _change(path, k, real, i, time) for manoeuvre, (k, real, time) in parts.items()},
        )
        for i, name in enumerate(names)
    }
    shown = tuple(DriftHistory(m, time, _values(path, k, real, found)) for m, (k, real, time) in parts.items())
    estimates = {n: (float(x), float(s)) for n, x, s in zip(fit.names, fit.estimate, fit.sd, strict=True)}
    alike = neighbour_correlation(fit.found)
    correlation = dict(zip(fit.outputs, map(float, alike), strict=True))
    return Drift(found.usable, found.ratio, at_bound(found.ratio, len(names)), told, estimates, correlation, shown)


def at_bound(ratio: float, m: int = 1) -> float:
    """P-value of the likelihood ratio of `m` independent intensities at zero: each is zero or not, with even odds."""
    if ratio <= 0.0:
        return 1.0
    return float(sum(math.comb(m, i) * 0.5**m * chi2.sf(ratio, i) for i in range(1, m + 1)))


def holm(p: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """P-values of `m` tests together: the smallest counts m times, the next m - 1 times."""
    order = np.argsort(p)
    together = np.empty(len(p))
    together[order] = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    return np.minimum(together, 1.0)


def _parts(flown: SegmentTrajectories) -> dict[str, tuple[int, np.ndarray, np.ndarray]]:
    """By manoeuvre its segment, which samples are real, and their time from the first."""
    found = {}
    for k, number in enumerate(flown.manoeuvre):
        time = np.asarray(flown.flights.time)[flown.index[k][flown.inside[k]]]
        found[flown.flights.names[int(number)]] = (k, flown.inside[k], time - time[0])
    return found


def _values(path: Histories, k: int, real: np.ndarray, found: DriftFit) -> dict[str, tuple[np.ndarray, ...]]:
    shown = (path.value, path.value_sd, path.drift_sd)
    return {n: tuple(x[k, real, i] for x in shown) for i, n in enumerate(found.drifting)}


def _change(path: Histories, k: int, real: np.ndarray, i: int, time: Float[np.ndarray, " n"]) -> DriftChange:
    drift, sd = path.drift[k, real, i], path.drift_sd[k, real, i]
    far = int(np.argmax(np.abs(drift)))
    done = drift / drift[-1] if drift[-1] != 0.0 else np.ones_like(drift)
    low, half, high = SHARES
    middle = int(np.argmax(done >= half))
    begun = int(np.max(np.flatnonzero(done[: middle + 1] < low), initial=0))  # the last before it
    over = middle + int(np.argmax(done[middle:] >= high))
    size, farthest = ((float(drift[j]), float(sd[j])) for j in (-1, far))
    return DriftChange(size, farthest, float(time[far]), (float(time[begun]), float(time[middle]), float(time[over])))
