"""The colour of residuals: an autoregression per output, the uncertainty it leaves, and noise records made from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

ORDER = 3  # of the autoregression at the blocks' rate of about 5 Hz; our choice
ROOT = 0.995  # largest root: a memory of 40 s
RUN_IN = 400  # blocks simulated and thrown away before a noise record begins


@dataclass(frozen=True)
class Colour:
    """r[t] = sum phi_i r[t-i] + e[t], per output; `sigma` (c,) is the deviation of e, `phi` (c, ORDER)."""

    phi: Float[np.ndarray, "c p"]
    sigma: Float[np.ndarray, " c"]

    def simulate(self, count: int, folds: Sequence[slice], m: int, rng: np.random.Generator) -> np.ndarray:
        """`count` noise records (count, m, c); each fold begins anew, blocks outside the folds are zero."""
        out = np.zeros((count, m, len(self.sigma)))
        for fold in folds:
            length = fold.stop - fold.start
            white = rng.standard_normal((count, length + RUN_IN, len(self.sigma))) * self.sigma
            for c, phi in enumerate(self.phi):
                noise = np.asarray(lfilter([1.0], np.append(1.0, -phi), white[:, :, c], axis=1))
                out[:, fold, c] = noise[:, RUN_IN:]
        return out

    def meat(
        self, S: Float[np.ndarray, "m c k"], variance: Float[np.ndarray, " c"], folds: Sequence[slice]
    ) -> Float[np.ndarray, "k k"]:
        """sum_ij S_i' R^-1 Rvv(i-j) R^-1 S_j under this colour: the middle of the corrected covariance.

        S filtered backwards by the autoregression gives it as a plain product. Source: as `inference.coloured`.
        """
        total = np.zeros((S.shape[2], S.shape[2]))
        for fold in folds:
            for c, phi in enumerate(self.phi):
                back = S[fold, c][::-1] * (self.sigma[c] / variance[c])
                used = np.flatnonzero(np.any(back != 0.0, axis=0))
                shaped = np.asarray(lfilter([1.0], np.append(1.0, -phi), back[:, used], axis=0))
                total[np.ix_(used, used)] += shaped.T @ shaped
        return total


def colour_of(residual: Float[np.ndarray, "m c"], folds: Sequence[slice]) -> Colour:
    """Least-squares autoregression of each output's residual within folds, its roots kept inside `ROOT`."""
    phi, sigma = [], []
    for c in range(residual.shape[1]):
        rows = np.concatenate([_past(residual[fold, c]) for fold in folds])
        now, past = rows[:, 0], rows[:, 1:]
        ridge = 1e-9 * np.trace(past.T @ past) + 1e-300
        found = _stationary(np.linalg.solve(past.T @ past + ridge * np.eye(ORDER), past.T @ now))
        phi.append(found)
        sigma.append(np.sqrt(np.mean((now - past @ found) ** 2)))
    return Colour(np.array(phi), np.array(sigma))


def _past(r: np.ndarray) -> np.ndarray:
    return np.stack([r[ORDER - i : len(r) - i] for i in range(ORDER + 1)], axis=1)


def _stationary(phi: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
    roots = np.roots(np.append(1.0, -phi))
    size = np.abs(roots)
    return -np.real(np.poly(np.where(size > ROOT, roots * ROOT / np.maximum(size, 1e-300), roots)))[1:]


def unbiased(colour: Colour, again: Sequence[Colour]) -> Colour:
    """The colour corrected for what re-estimation on simulated noise does to it (Kilian 1998): slow noise looks faster.

    Coefficients are shifted by their mean bias, their roots drawn inside `ROOT`; sigma is divided by its mean ratio.
    """
    shift = colour.phi - np.mean([c.phi for c in again], axis=0)
    phi = np.array([_stationary(p + s) for p, s in zip(colour.phi, shift, strict=True)])
    ratio = np.mean([c.sigma for c in again], axis=0) / colour.sigma
    return Colour(phi, colour.sigma / ratio)
