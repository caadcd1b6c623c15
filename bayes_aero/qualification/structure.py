"""Errors of a simulation that parameters do not explain, as random histories: an autoregression and white noise.

A simulation begins in the measured state, so slow errors begin at zero and grow over their memory. Their mean square
over a flight and their autocorrelation are those that flights showed, and they grow as the flow separates as those did.
The size differs from flight to flight, and few flights show few sizes: it is drawn, too.

What of an error repeats when a manoeuvre is flown again (a wrong model repeats, turbulence does not) is not known. The
share of its mean square that repeats is drawn, uniform between none and all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from bayes_aero.inference.covariance import ORDER, autoregression, filtered_noise
from bayes_aero.inference.output_error import SeparatedFlow

BLOCK_SECONDS = 0.2  # s of a mean: the autoregression holds for some 5 samples a second
SHORTEST = 4 * ORDER  # means in a manoeuvre that an autoregression needs
SIZES = 3  # independent values of the size in a manoeuvre's errors, which follow from few directions; our choice


@dataclass(frozen=True)
class Structure:
    """Errors of c outputs that parameters do not explain."""

    phi: Float[np.ndarray, "c p"]  # autoregression of means over `BLOCK_SECONDS`
    innovation: Float[np.ndarray, " c"]  # standard deviation of its innovations in attached flow, SI
    fast: Float[np.ndarray, " c"]  # standard deviation of the white rest, SI
    growth: Float[np.ndarray, " c"]  # how many times the errors grow in fully separated flow, less one
    sizes: int  # how many independent values of their size the errors amount to
    left: Float[np.ndarray, " c"]  # share of the mean square of slow errors that nothing else explains

    @classmethod
    def of(
        cls,
        errors: Float[np.ndarray, "w n c"],
        separated: Float[np.ndarray, "w n"],
        inside: Bool[np.ndarray, "w n"],
        dt: Float[np.ndarray, " w"],
        explained: Float[np.ndarray, " c"],
    ) -> Structure:
        """Of errors (recorded minus simulated, SI) of w manoeuvres, n samples each where `inside`. `separated`: the
        separated share of the flow; `dt`: sample times, s; `explained`: mean squares that something else explains
        (parameters, gusts), SI squared."""
        growth = SeparatedFlow(errors, separated, inside).growths() if np.ptp(separated[inside]) > 0.0 else 0.0
        growth = growth + np.zeros(errors.shape[2])
        sized = errors / (1.0 + growth * separated[:, :, None])
        folds, rests = [], []
        for error, real, step in zip(sized, inside, dt, strict=True):
            means, rest = _means(error[real], step)
            folds.append(means.T)
            rests.append(rest)
        fast = np.sqrt(np.mean(np.concatenate(rests) ** 2, axis=0))
        slow = np.mean(np.concatenate([f.T for f in folds]) ** 2, axis=0)
        long = [f for f in folds if f.shape[1] >= SHORTEST]
        phi = autoregression(long)[0] if long else np.zeros((len(slow), ORDER))
        white = np.mean((fast * (1.0 + growth * separated[inside][:, None])) ** 2, axis=0)
        total = np.maximum(np.mean(errors[inside] ** 2, axis=0) - white, 1e-300)
        left = np.maximum(1.0 - explained / total, 0.0)
        gained = np.array([_mean_square_from_zero(one, [f.shape[1] for f in folds]) for one in phi])
        return cls(phi, np.sqrt(slow * left / gained), fast, growth, SIZES * len(errors), left)

    def draws(
        self,
        count: int,
        separated: Float[np.ndarray, " n"],
        dt: float,
        rng: np.random.Generator,
        own: Float[np.ndarray, "n c"] | None = None,
    ) -> Float[np.ndarray, "m n c"]:
        """`count` histories of the errors of one manoeuvre, SI; of its `own` errors as recorded a part repeats."""
        n, c = len(separated), len(self.innovation)
        block = _block(dt)
        size = np.sqrt(self.sizes / rng.chisquare(self.sizes, (c, count)))
        white = self.innovation[:, None] * size * rng.standard_normal((-(-n // block) + 1, c, count))
        series = filtered_noise(np.broadcast_to(self.phi.T[:, :, None], (ORDER, c, count)), white)
        at = np.arange(n) / block
        low = at.astype(int)
        share = (at - low)[:, None, None]
        slow = series[low] * (1.0 - share) + series[low + 1] * share
        grown = 1.0 + self.growth * separated[:, None]
        found = np.moveaxis(slow, 2, 0) * grown
        if own is not None:
            again = rng.uniform(size=(count, 1, c))
            repeated = (own - _means(own, dt)[1]) * np.sqrt(self.left)
            found = np.sqrt(again) * repeated + np.sqrt(1.0 - again) * found
        return found + self.fast * rng.standard_normal(found.shape) * grown


def _block(dt: float) -> int:
    return max(1, round(BLOCK_SECONDS / dt))


def _means(error: Float[np.ndarray, "n c"], dt: float) -> tuple[Float[np.ndarray, "t c"], Float[np.ndarray, "n c"]]:
    """Means over blocks, and what single samples depart from the line between them."""
    block = _block(dt)
    blocks = max(1, len(error) // block)
    means = np.stack([part.mean(axis=0) for part in np.array_split(error[: blocks * block], blocks)])
    centre = block * np.arange(blocks) + 0.5 * (block - 1)
    at = np.arange(len(error))
    line = np.stack([np.interp(at, centre, column) for column in means.T], axis=1)
    return means, error - line


def _mean_square_from_zero(phi: Float[np.ndarray, " p"], lengths: Sequence[int]) -> float:
    """Mean square of series of these lengths that begin at zero, of unit innovations."""
    A, P, found = np.vstack([phi, np.eye(ORDER - 1, ORDER)]), np.zeros((ORDER, ORDER)), []
    for _ in range(max(lengths)):
        P = A @ P @ A.T
        P[0, 0] += 1.0
        found.append(P[0, 0])
    total = np.cumsum(found)
    return float(sum(total[length - 1] for length in lengths) / sum(lengths))
