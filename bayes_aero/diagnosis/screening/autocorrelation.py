"""The colour of residuals: an autoregression per output, the uncertainty it leaves, and noise records made from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.inference.covariance import autoregression, filtered_noise, stationary_coefficients, stationary_series
from bayes_aero.inference.scores import COLOURED_INNOVATIONS

TOGETHER = 10  # colours that columns are filtered for at a time: of more, fresh memory takes longer than arithmetic


@dataclass(frozen=True)
class Autocorrelation:
    """r[t] = sum phi_i r[t-i] + e[t], per output; `sigma` (c,) is the deviation of e, `phi` (c, ORDER)."""

    phi: Float[np.ndarray, "c p"]
    sigma: Float[np.ndarray, " c"]

    def simulate(self, count: int, folds: Sequence[slice], m: int, rng: np.random.Generator) -> np.ndarray:
        """`count` noise records (count, m, c); each fold begins anew, blocks outside the folds are zero."""
        return self.coloured(white_noise(count, folds, len(self.sigma), rng), folds, m)

    def coloured(
        self, white: Float[np.ndarray, "t f r c"], folds: Sequence[slice], m: int
    ) -> Float[np.ndarray, "r m c"]:
        """The noise records that this colour makes of `white_noise`."""
        out = np.zeros((white.shape[2], m, len(self.sigma)))
        if not len(out):
            return out
        noise = stationary_series(self.phi.T[:, None, None, :], self.sigma * white)
        for k, fold in enumerate(folds):
            out[:, fold] = np.moveaxis(noise[: fold.stop - fold.start, k], 0, 1)
        return out

    def meat(
        self, S: Float[np.ndarray, "m c k"], variance: Float[np.ndarray, " c"], folds: Sequence[slice]
    ) -> Float[np.ndarray, "k k"]:
        """sum_ij S_i' R^-1 Rvv(i-j) R^-1 S_j under this colour: the middle of the corrected covariance."""
        # S filtered backwards by the autoregression gives it as a plain product. Source: as `inference.covariance`.
        return Middle(S, variance, folds, [np.arange(S.shape[2])]).under_each([self], [0])[1][0][0]


def white_noise(
    count: int, folds: Sequence[slice], outputs: int, rng: np.random.Generator
) -> Float[np.ndarray, "t f r c"]:
    """Of unit deviation, behind `count` noise records: the folds side by side, for one loop over time."""
    longest = max(fold.stop - fold.start for fold in folds)
    white = np.zeros((longest, len(folds), count, outputs))
    for k, fold in enumerate(folds):
        drawn = rng.standard_normal((count, fold.stop - fold.start, outputs))
        white[: drawn.shape[1], k] = np.moveaxis(drawn, 1, 0)
    return white


class SharedNoise:
    """`white_noise` of one seed, drawn once for what corrects autocorrelations and for what p-values count."""

    def __init__(self, seed: int, folds: Sequence[slice], outputs: int, settings: DiagnosisSettings) -> None:
        self._rng = np.random.default_rng(seed)
        self._of = folds, outputs
        self._counts = settings.correction_replicates, settings.replicates

    @cached_property
    def correction(self) -> Float[np.ndarray, "t f r c"]:
        """Behind the `correction_replicates`."""
        return white_noise(self._counts[0], *self._of, self._rng)

    @cached_property
    def replicates(self) -> Float[np.ndarray, "t f r c"]:
        """Behind the `replicates`, which are drawn after the others."""
        _ = self.correction
        return white_noise(self._counts[1], *self._of, self._rng)


class Middle:
    """`Autocorrelation.meat` of many sets of columns, each by itself, made ready once for many colours.

    The columns of each fold and output, divided by the output's variance, stand side by side, the last block first."""

    def __init__(
        self, S: Float[np.ndarray, "m c k"], variance: np.ndarray, folds: Sequence[slice], places: Sequence[np.ndarray]
    ) -> None:
        self.width = S.shape[2]
        self.places = places
        pieces = [(fold, c) for fold in folds for c in range(S.shape[1])]
        longest = max(fold.stop - fold.start for fold in folds)
        self.used, rows = [], []  # columns of a piece that are not all zero
        for fold, c in pieces:
            part = S[fold, c]
            used = np.flatnonzero(np.any(part != 0.0, axis=0))
            rest = np.zeros((longest - len(part), len(used)))
            self.used.append(used)
            rows.append(np.concatenate([rest, part[::-1, used] / variance[c]]))
        self.rows = np.concatenate(rows, axis=1)
        self.output = np.repeat([c for _, c in pieces], [len(used) for used in self.used])
        self.begin = np.cumsum([0, *(len(used) for used in self.used)])

    def under_each(
        self, colours: Sequence[Autocorrelation], wide: Sequence[int]
    ) -> tuple[Float[np.ndarray, "r k"], list[np.ndarray]]:
        """Under each of r colours, the diagonal over all columns (r, k), and the whole (r, w, w) of sets `wide`."""
        diagonal = np.zeros((len(colours), self.width))
        whole = [np.zeros((len(colours), len(self.places[j]), len(self.places[j]))) for j in wide]
        for first in range(0, len(colours), TOGETHER):
            part = slice(first, first + TOGETHER)
            phi = np.stack([colour.phi[self.output].T for colour in colours[part]], axis=1)
            sigma = np.stack([colour.sigma[self.output] for colour in colours[part]])
            shaped = filtered_noise(phi, sigma * self.rows[:, None, :])  # the columns as each colour filters them
            squares = np.einsum("trn,trn->rn", shaped, shaped)
            for used, begin in zip(self.used, self.begin, strict=False):
                diagonal[part, used] += squares[:, begin : begin + len(used)]
                for total, j in ((total, j) for total, j in zip(whole, wide, strict=True) if len(self.places[j]) > 1):
                    at = np.searchsorted(used, self.places[j])
                    here = np.flatnonzero(np.append(used, -1)[at] == self.places[j])
                    rows = np.moveaxis(shaped[:, :, begin + at[here]], 0, 2)
                    total[part, here[:, None], here] += rows @ np.moveaxis(rows, 1, 2)
        for total, j in zip(whole, wide, strict=True):
            if len(self.places[j]) == 1:
                total[:, 0] = diagonal[:, self.places[j]]
        return diagonal, whole


def autocorrelation_of(residual: Float[np.ndarray, "m c"], folds: Sequence[slice]) -> Autocorrelation:
    """Least-squares autoregression of each output's residual within folds, its roots kept inside `ROOT`."""
    return autocorrelations_of(residual[None], folds)[0]


def autocorrelations_of(residuals: Float[np.ndarray, "r m c"], folds: Sequence[slice]) -> list[Autocorrelation]:
    """`autocorrelation_of` of r records at once."""
    each = [
        autoregression([np.ascontiguousarray(residuals[:, fold, c]) for fold in folds])
        for c in range(residuals.shape[2])
    ]
    phi, sigma = (np.stack(parts, axis=1) for parts in zip(*each, strict=True))
    return [Autocorrelation(p, s) for p, s in zip(phi, sigma, strict=True)]


def unbiased(colour: Autocorrelation, again: Sequence[Autocorrelation]) -> Autocorrelation:
    """The colour corrected for what re-estimation on simulated noise does to it (Kilian 1998): it looks faster."""
    # Coefficients are shifted by their mean bias, their roots drawn inside `ROOT`; sigma is divided by its mean ratio.
    shift = colour.phi - np.mean([c.phi for c in again], axis=0)
    phi = stationary_coefficients(colour.phi + shift)
    ratio = np.mean([c.sigma for c in again], axis=0) / colour.sigma
    return Autocorrelation(phi, colour.sigma / ratio)


def lag1_within(residual: Float[np.ndarray, " n"], manoeuvre: Int[np.ndarray, " n"]) -> float:
    """Correlation of neighbouring samples, within manoeuvres."""
    parts = [r - r.mean() for r in (residual[manoeuvre == k] for k in range(int(manoeuvre[-1]) + 1))]
    return float(sum(np.sum(r[1:] * r[:-1]) for r in parts) / sum(np.sum(r**2) for r in parts))


# --- The noise that a diagnosis leaves: its colour, growth and outliers.

# Lag-1 correlation of means over five samples, our choice from a dozen simulated flights: white noise leaves up to a
# third through the filter, and weak colour (0.5 from sample to sample) little more.
COLOURED = 0.36


@dataclass(frozen=True)
class NoiseReport:
    """Colour, growth with separation and outliers of the residuals, by coefficient."""

    lag1: Mapping[str, float]  # of means over five samples: at the recorded rate the filter makes 0.9 of white noise
    deviation: Mapping[str, float]
    noise_growth: Mapping[str, float]  # noise at full separation over that in attached flow
    outliers: Mapping[str, int]  # repaired samples by channel
    of_innovations: bool = False  # `lag1` is then that of neighbouring samples, which white noise leaves at 0

    @property
    def coloured(self) -> tuple[str, ...]:
        """Outputs whose residuals are correlated beyond what the filters of the reconstruction make."""
        if self.of_innovations:
            return tuple(name for name, r in self.lag1.items() if abs(r) > COLOURED_INNOVATIONS)
        return tuple(name for name, r in self.lag1.items() if r > COLOURED)

    @property
    def labels(self) -> tuple[str, ...]:
        """Which of colored, buffet, outliers are present."""
        found = {
            "colored": bool(self.coloured),
            "buffet": max(self.noise_growth.values()) > 1.5,
            "outliers": sum(self.outliers.values()) > 0,
        }
        return tuple(name for name, there in found.items() if there)
