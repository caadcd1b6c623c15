"""Every moment at which a parameter may take another value, all parameters at once, from cumulated products.

The direction of a change is the parameter's sensitivity from that moment on, the free parameters of the model projected
out. Inner products of such directions are differences of sums over time, so a record of minutes costs milliseconds.

What a parameter acts through is recorded with noise, which makes its value too small: where a slope is attenuated by
noise alone, the parameter has not changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.screening.regression import Fit, inverse
from bayes_aero.diagnosis.screening.selection_state import TINY, SelectionState

NOTHING = 1e-9  # of the information of the whole parameter, below which a change of it moves nothing
NOISY = 0.5  # share of noise beyond which a value is that of noise


class Span(NamedTuple):
    """Blocks over which a parameter has another value, [begin, end); `manoeuvre` is the number of that of the first."""

    manoeuvre: int
    begin: int
    end: int


def spans(manoeuvre: Int[np.ndarray, " m"], least: int, most: int) -> list[Span]:
    """From a block on, to the end of its manoeuvre or of all later ones; between manoeuvres, from the begin of a later
    one on, or in one of the middle alone.

    `least` blocks at either end of a manoeuvre are not divided; about `most` begins are tried. The records may be of
    one flight, where a change lasts, or of several, where it does not.
    """
    count, m = int(manoeuvre[-1]) + 1, len(manoeuvre)
    found = []
    for k in range(count):
        own = np.flatnonzero(manoeuvre == k)
        first, last = int(own[0]), int(own[-1]) + 1
        begins = [*([first] if k else []), *range(first + least, last - least + 1, -(-m // most))]
        ends = {m} if k == count - 1 else {last, m}
        found += [Span(k, begin, end) for begin in begins for end in sorted(ends)]
    return found


class ChangeScan:
    """Directions of the changes of p parameters (`columns` of the state) over each of n spans.

    `noise` is what recording noise adds to the sensitivities to the p parameters, scaled as those are.
    """

    def __init__(
        self,
        state: SelectionState,
        fit: Fit,
        columns: Int[np.ndarray, " p"],
        over: Sequence[Span],
        noise: Float[np.ndarray, "m c p"],
    ) -> None:
        self.columns, self.over, self.noise, self.weight = columns, over, noise, 1.0 / fit.variance
        self._S, self._B = state.scaled[:, :, columns], state.scaled[:, :, fit.columns]
        self._begin, self._end = (np.array([getattr(span, side) for span in over]) for side in ("begin", "end"))
        self._weighed = self._S * self.weight[:, None]
        own = self._summed(np.sum(self._S * self._weighed, axis=1))
        cross = self._summed(np.matmul(np.moveaxis(self._weighed, 1, 2), self._B))
        self._shares = cross @ inverse(fit.normal)  # n p k
        information = own - np.sum(self._shares * cross, axis=2)
        whole = np.sum(self._S * self._weighed, axis=(0, 1))
        self.noise_shares = self._noise_shares(fit, own, cross)
        noisy = np.any(self.noise_shares > NOISY, axis=0)
        self._idle = noisy | (information <= NOTHING * whole)  # what the model can do as well
        self.information = np.where(self._idle, 1.0, information)

    def _noise_shares(
        self, fit: Fit, own: Float[np.ndarray, "n p"], cross: Float[np.ndarray, "n p k"]
    ) -> Float[np.ndarray, "2 n p"]:
        """Share of noise in what tells the value of each parameter within each span, and in what tells it elsewhere.

        By it least squares makes that value too small. All other parameters have one value, fitted beside both.
        """
        added = np.einsum("mcp,c->mp", self.noise**2, self.weight)
        within = self._summed(added)
        noise = np.stack([within, np.sum(added, axis=0) - within])
        whole = np.sum(self._S * self._weighed, axis=(0, 1))
        shared, found = inverse(fit.normal), np.zeros_like(noise)
        for p, column in enumerate(self.columns):
            at = int(np.flatnonzero(fit.columns == column)[0])
            others = shared - np.outer(shared[:, at], shared[at]) / shared[at, at]  # without the parameter itself
            total = np.einsum("mc,mck->k", self._weighed[:, :, p], self._B)
            inside, outside = cross[:, p], total - cross[:, p]
            a, b = own[:, p] - _form(inside, others, inside), whole[p] - own[:, p] - _form(outside, others, outside)
            c = -_form(inside, others, outside)
            told = np.stack([a - c**2 / np.maximum(b, TINY), b - c**2 / np.maximum(a, TINY)])
            found[:, :, p] = noise[:, :, p] / np.maximum(told, TINY)
        return found

    def _summed(self, x: Float[np.ndarray, "m ..."]) -> Float[np.ndarray, "n ..."]:
        """Sums over each span."""
        total = np.concatenate([np.zeros((1, *x.shape[1:])), np.cumsum(x, axis=0)])
        return total[self._end] - total[self._begin]

    def estimates(self, residual: Float[np.ndarray, "m c"]) -> Float[np.ndarray, "n p"]:
        """First-order estimate of each change; zero where it moves nothing that the model cannot."""
        weighed = residual * self.weight
        beside = self._shares @ np.einsum("mck,mc->k", self._B, weighed)
        right = self._summed(np.einsum("mcp,mc->mp", self._S, weighed)) - beside
        return np.where(self._idle, 0.0, right / self.information)

    def gains(self, estimates: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
        """Deviance that each change takes away, variances held."""
        return estimates**2 * self.information

    def explained(self, span: int, parameter: int, estimate: float) -> Float[np.ndarray, "m c"]:
        """What a change of this size takes away of the residual, scaled as that is."""
        found = -self._B @ self._shares[span, parameter]
        here = slice(self._begin[span], self._end[span])
        found[here] += self._S[here, :, parameter]
        return estimate * found


def _form(
    x: Float[np.ndarray, "n k"], A: Float[np.ndarray, "k k"], y: Float[np.ndarray, "n k"]
) -> Float[np.ndarray, " n"]:
    return np.sum((x @ A) * y, axis=1)
