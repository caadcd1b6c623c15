"""The parts of the records that are predicted from the others: manoeuvres, or parts of a single one.

Fits to coefficients leave out these folds: the parameters again (`LeftOut.refitted`), or to first order from
inner products (`Products.without`). Trajectories leave out segments, which are flown from their measured state
(`trajectories.holdout_fits`); Gaussian processes are validated on samples, at random as published, too
(`inference.splits`).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Int

from bayes_aero.diagnosis.settings import DEFAULT, DiagnosisSettings
from bayes_aero.errors import InputError
from bayes_aero.units import number


def too_short(seconds: float, settings: DiagnosisSettings = DEFAULT) -> str:
    """Why a single manoeuvre of so many seconds (of whole blocks) has no folds; empty where it has."""
    shortest = settings.shortest_part * settings.gap
    enough = 2.0 * shortest + 1.0  # whole blocks are less than the record
    if int(seconds / shortest) >= 2:
        return ""
    return (
        f"a single manoeuvre of {number(seconds)} s is too short to be predicted from its own parts; "
        f"give one of {enough:.0f} s at least, or a second one"
    )


def folds_of(
    manoeuvre: Int[np.ndarray, " m"], seconds: float, settings: DiagnosisSettings = DEFAULT
) -> tuple[slice, ...]:
    """Manoeuvres as folds, or contiguous parts of a single one with a gap between them."""
    if manoeuvre[-1] > 0:
        edges = [np.flatnonzero(manoeuvre == k) for k in range(manoeuvre[-1] + 1)]
        return tuple(slice(int(e[0]), int(e[-1]) + 1) for e in edges)
    why = too_short(len(manoeuvre) * seconds, settings)
    if why:
        raise InputError(why)
    parts = min(settings.parts, int(len(manoeuvre) * seconds / (settings.shortest_part * settings.gap)))
    cuts = np.linspace(0, len(manoeuvre), parts + 1).astype(int)
    gap = max(1, round(settings.gap / seconds / 2))
    return tuple(
        slice(int(a) + (gap if a else 0), int(b) - (gap if b < len(manoeuvre) else 0)) for a, b in pairwise(cuts)
    )


def blocks_of(folds: Sequence[slice], m: int) -> Bool[np.ndarray, " m"]:
    """Which of m blocks belong to one of these folds."""
    found = np.zeros(m, bool)
    for fold in folds:
        found[fold] = True
    return found
