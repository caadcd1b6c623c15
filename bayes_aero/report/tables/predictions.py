"""What the validation figures draw: measured and predicted coefficients at the chosen split's test points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_aero.inference.identification import Identification, Validation

GAP = 1.0  # s; a line is broken where its neighbouring points are further apart


@dataclass(frozen=True)
class Predicted:
    """One coefficient at `index` (ascending) of the observations; `gp`, `low`, `high` are None without a GP."""

    index: np.ndarray
    measured: np.ndarray
    mle: np.ndarray
    gp: np.ndarray | None = None
    low: np.ndarray | None = None
    high: np.ndarray | None = None

    def of(self, manoeuvre: np.ndarray) -> Predicted:
        """Only the points whose sample is marked in `manoeuvre`, a mask over all samples."""
        keep = manoeuvre[self.index]
        cut = (None if part is None else part[keep] for part in (self.gp, self.low, self.high))
        return Predicted(self.index[keep], self.measured[keep], self.mle[keep], *cut)


def predicted(identification: Identification, coefficient: str) -> Predicted:
    """Predictions at the chosen split's test points (all its folds); without a GP the fit at all samples."""
    if identification.gp is not None:
        return _pooled([fold[coefficient] for fold in identification.gp.splits[identification.gp.chosen]])
    o = identification.observations
    column = o.coefficients.index(coefficient)
    return Predicted(np.arange(o.n), np.asarray(o.measured)[:, column], identification.fitted[:, column])


def _pooled(folds: list[Validation]) -> Predicted:
    index = np.concatenate([v.test for v in folds])
    order = np.argsort(index, kind="stable")
    columns = ("measured", "mle", "gp", "gp_low", "gp_high")
    return Predicted(index[order], *(np.concatenate([getattr(v, c) for v in folds])[order] for c in columns))


def what_is_shown(identification: Identification) -> str:
    """What the predictions were trained on and where they are shown, for titles."""
    if identification.gp is None:
        return "fit to all samples"
    text = {
        "random": "trained on a random 70 % of the samples, shown on the rest",
        "block": "trained on 70 % of the contiguous blocks, shown on the rest",
        "manoeuvre": "each manoeuvre predicted from the others",
    }
    return text.get(identification.gp.chosen, f"{identification.gp.chosen} split, test points")


def broken(time: np.ndarray, *columns: np.ndarray, gap: float = GAP) -> tuple[np.ndarray, ...]:
    """The columns with NaN put in wherever time jumps by more than `gap`, so that a line breaks there."""
    at = np.flatnonzero(np.diff(time) > gap) + 1
    return tuple(np.insert(np.asarray(c, float), at, np.nan) for c in (time, *columns))


def clock(identification: Identification) -> np.ndarray:
    """Time of every sample from the start of its manoeuvre, s."""
    o = identification.observations
    begin = np.array([o.time[o.manoeuvre == m][0] for m in range(len(o.names))])
    return o.time - begin[o.manoeuvre]
