"""Every moment at which a parameter may take another value, all parameters at once, from cumulated products.

The direction of a change is the parameter's sensitivity from that moment on, the free parameters of the model projected
out. Inner products of such directions are differences of sums over time, so a record of minutes costs milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.screening.regression import Fit, inverse
from bayes_aero.diagnosis.screening.selection_state import SelectionState

NOTHING = 1e-9  # of the information of the whole parameter, below which a change of it moves nothing


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
    """Directions of the changes of p parameters (`columns` of the state) over each of n spans."""

    def __init__(self, state: SelectionState, fit: Fit, columns: Int[np.ndarray, " p"], over: Sequence[Span]) -> None:
        self.columns, self.over, self.weight = columns, over, 1.0 / fit.variance
        self._S, self._B = state.scaled[:, :, columns], state.scaled[:, :, fit.columns]
        self._begin, self._end = (np.array([getattr(span, side) for span in over]) for side in ("begin", "end"))
        self._weighed = self._S * self.weight[:, None]
        own = self._summed(np.sum(self._S * self._weighed, axis=1))
        cross = self._summed(np.matmul(np.moveaxis(self._weighed, 1, 2), self._B))
        self._shares = cross @ inverse(fit.normal)  # n p k
        information = own - np.sum(self._shares * cross, axis=2)
        whole = np.sum(self._S * self._weighed, axis=(0, 1))
        self._idle = information <= NOTHING * whole  # what the model can do as well
        self.information = np.where(self._idle, 1.0, information)

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
