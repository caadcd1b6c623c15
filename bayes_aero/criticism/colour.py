"""The colour of residuals: an autoregression per output, the uncertainty it leaves, and noise records made from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.inference.autoregression import Driven, autoregression, impulse, stationary

RUN_IN = 400  # blocks simulated and thrown away before a noise record begins


@dataclass(frozen=True)
class Colour:
    """r[t] = sum phi_i r[t-i] + e[t], per output; `sigma` (c,) is the deviation of e, `phi` (c, ORDER).

    `ready` is the response to a single innovation, where it was computed already.
    """

    phi: Float[np.ndarray, "c p"]
    sigma: Float[np.ndarray, " c"]
    ready: Float[np.ndarray, "c t"] | None = field(default=None, repr=False, compare=False)

    def response(self, n: int) -> Float[np.ndarray, "c n"]:
        """What becomes of an innovation of one in each output: the first n blocks."""
        enough = self.ready is not None and self.ready.shape[1] >= n
        return self.ready[:, :n] if enough else impulse(self.phi, n)  # pyright: ignore[reportOptionalSubscript]

    def simulate(self, count: int, folds: Sequence[slice], m: int, rng: np.random.Generator) -> np.ndarray:
        """`count` noise records (count, m, c); each fold begins anew, blocks outside the folds are zero."""
        out = np.zeros((count, m, len(self.sigma)))
        for fold in folds:
            length = fold.stop - fold.start
            white = rng.standard_normal((count, length + RUN_IN, len(self.sigma))) * self.sigma
            noise = Driven(np.moveaxis(white, 2, 1)).after(self.response(length + RUN_IN))
            out[:, fold] = np.moveaxis(noise[:, :, RUN_IN:], 1, 2)
        return out

    def meat(
        self, S: Float[np.ndarray, "m c k"], variance: Float[np.ndarray, " c"], folds: Sequence[slice]
    ) -> Float[np.ndarray, "k k"]:
        """sum_ij S_i' R^-1 Rvv(i-j) R^-1 S_j under this colour: the middle of the corrected covariance.

        S filtered backwards by the autoregression gives it as a plain product. Source: as `inference.coloured`.
        """
        total = np.zeros((S.shape[2], S.shape[2]))
        for piece in _pieces(S, variance, folds):
            shaped = self._shaped(piece)
            total[np.ix_(piece.used, piece.used)] += shaped @ shaped.T
        return total

    def _shaped(self, piece: _Piece) -> Float[np.ndarray, "u t"]:
        c = piece.output
        return self.sigma[c] * piece.driven.after(self.response(piece.driven.length)[c])


@dataclass(frozen=True)
class _Piece:
    """Columns of one fold and output that are not all zero, divided by the output's variance, the last block first."""

    output: int
    used: Int[np.ndarray, " u"]
    driven: Driven


def _pieces(S: np.ndarray, variance: np.ndarray, folds: Sequence[slice]) -> list[_Piece]:
    found = []
    for fold in folds:
        for c in range(S.shape[1]):
            part = S[fold, c]
            used = np.flatnonzero(np.any(part != 0.0, axis=0))
            found.append(_Piece(c, used, Driven(np.ascontiguousarray(part[::-1, used].T) / variance[c])))
    return found


class Middle:
    """`Colour.meat` of many sets of columns, each by itself, made ready once for one colour after another."""

    def __init__(
        self, S: Float[np.ndarray, "m c k"], variance: np.ndarray, folds: Sequence[slice], places: Sequence[np.ndarray]
    ) -> None:
        self.width = S.shape[2]
        self.pieces = _pieces(S, variance, folds)
        self.places = places
        self._found = [[_among(place, piece.used) for place in places] for piece in self.pieces]

    def under(self, colour: Colour, wide: Sequence[int]) -> tuple[Float[np.ndarray, " k"], list[np.ndarray]]:
        """The diagonal over all columns, and the whole of the sets numbered `wide`."""
        diagonal = np.zeros(self.width)
        whole = [np.zeros((len(self.places[j]), len(self.places[j]))) for j in wide]
        for piece, found in zip(self.pieces, self._found, strict=True):
            shaped = colour._shaped(piece)
            diagonal[piece.used] += np.einsum("ut,ut->u", shaped, shaped)
            for total, j in zip(whole, wide, strict=True):
                here, at = found[j]
                rows = shaped[at]
                total[here] += rows @ rows.T
        return diagonal, whole


def _among(
    place: Int[np.ndarray, " w"], used: Int[np.ndarray, " u"]
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Where in a set's covariance the columns stand that are used, and where these are among the used ones."""
    here = np.flatnonzero(np.isin(place, used))
    return np.ix_(here, here), np.searchsorted(used, place[here])


def colour_of(residual: Float[np.ndarray, "m c"], folds: Sequence[slice]) -> Colour:
    """Least-squares autoregression of each output's residual within folds, its roots kept inside `ROOT`."""
    return colours_of(residual[None], folds)[0]


def colours_of(residuals: Float[np.ndarray, "r m c"], folds: Sequence[slice]) -> list[Colour]:
    """`colour_of` of r records at once."""
    each = [
        autoregression([np.ascontiguousarray(residuals[:, fold, c]) for fold in folds])
        for c in range(residuals.shape[2])
    ]
    phi, sigma = (np.stack(parts, axis=1) for parts in zip(*each, strict=True))
    longest = max(fold.stop - fold.start for fold in folds)
    ready = impulse(phi, longest)  # of all at once: one by one it takes longer than all that follows
    return [Colour(*parts) for parts in zip(phi, sigma, ready, strict=True)]


def unbiased(colour: Colour, again: Sequence[Colour]) -> Colour:
    """The colour corrected for what re-estimation on simulated noise does to it (Kilian 1998): slow noise looks faster.

    Coefficients are shifted by their mean bias, their roots drawn inside `ROOT`; sigma is divided by its mean ratio.
    """
    shift = colour.phi - np.mean([c.phi for c in again], axis=0)
    phi = stationary(colour.phi + shift)
    ratio = np.mean([c.sigma for c in again], axis=0) / colour.sigma
    ready = None if colour.ready is None else impulse(phi, colour.ready.shape[1])
    return Colour(phi, colour.sigma / ratio, ready)
