"""Predictors on data that none of them was fitted to: card's model, Gaussian process, extended model, and both.

Every predictor is fitted on all folds but one and scored on that one, at the same blocks of about 5 Hz. The fourth adds
to the extended model a Gaussian process of what that model leaves on the fitted folds: the discrepancy of M. C. Kennedy
and A. O'Hagan, Bayesian calibration of computer models, J. R. Stat. Soc. B 63, 2001, its parts fitted one after the
other. How far it is believed is told in `discrepancy`.

All densities here treat the residuals of neighbouring blocks as independent. They are not: a difference of `elpd` is
worth as many times less as the variance inflation says (`SelectionState.variance_inflation`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved
from bayes_aero.diagnosis.selection.cross_validation import FoldFit, fold_fits, split_name
from bayes_aero.diagnosis.selection.discrepancy import Processes
from bayes_aero.errors import InputError
from bayes_aero.inference.scores import log_density, score
from bayes_aero.inference.threads import blas_threads
from bayes_aero.progress import Progress

# What the discrepancy sees besides the card's inputs; not alpha-dot, whose fast part holds the accelerometer's noise:
# that is the residual's own, and a process that sees it follows nothing else.
BEYOND = ("X",)


class Predictor(StrEnum):
    """What predicts."""

    CARD = "card"  # the model on the card, all of its parameters fitted
    GP = "gp"  # a Gaussian process of the card's inputs, its hyperparameters at their mode, as in `validation`
    EXTENDED = "extended"  # the card's model with every effect that was found
    DISCREPANCY = "extended_gp"  # the same with a Gaussian process of what it leaves


@dataclass(frozen=True)
class HoldoutErrors:
    """One coefficient on data left out: correlation, root mean square error, R2 and Theil's coefficient.

    `coverage95` is the share inside the central 95 % intervals; `elpd` the sum of log predictive densities over all
    blocks as if they were independent (see the module).
    """

    r: float
    rmse: float
    r2: float
    theil: float
    coverage95: float
    elpd: float


@dataclass(frozen=True)
class Prediction:
    """One predictor of one coefficient: mean and deviation at every block, from fits to the other folds.

    `scores` is None where the predictor was refused; `status` says on what it was fitted, or why it was refused.
    `trust` by fold is what the discrepancy's mean was multiplied by (1 for all others).
    """

    status: str
    scores: HoldoutErrors | None
    mean: Float[np.ndarray, " m"]
    sd: Float[np.ndarray, " m"]
    trust: tuple[float, ...]


@dataclass(frozen=True)
class Comparison:
    """Predictor and coefficient -> prediction. `inside` marks the blocks that are scored; `measured` (m, CL CD Cm)."""

    split: str
    folds: tuple[str, ...]
    inside: Bool[np.ndarray, " m"]
    measured: Float[np.ndarray, "m c"]
    predictions: Mapping[Predictor, Mapping[str, Prediction]]

    @property
    def table(self) -> dict[str, dict[str, HoldoutErrors | None]]:
        """Scores by predictor and coefficient."""
        return {p.value: {c: x.scores for c, x in row.items()} for p, row in self.predictions.items()}


@blas_threads(0)
def compare_states(
    extended: SelectionState,
    inputs: Sequence[str],
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Comparison:
    """All predictors of a state of the coefficients; the card's model is the state with nothing added.

    `inputs` are the card's for Gaussian processes.
    Raises `InputError` for a state of the flight path or an input that was not recorded.
    """
    names = extended.responses.model.coefficients
    if extended.outputs != names:
        raise InputError("predictors are compared on the coefficients, not on the flight path")
    card = moved(extended, extended.full.card_only(extended.theta), ())
    signals = _blocks(card, card.theta)
    measured = signals["measured"]
    for name in inputs:
        if name not in signals:
            raise InputError(f"the Gaussian process needs the signal {name}; map it on the card or change [gp] inputs")
    mean, sd = ({p: np.full(measured.shape, np.nan) for p in Predictor} for _ in range(2))
    trust = {p: np.ones((len(extended.folds), len(names))) for p in Predictor}
    refused: dict[tuple[Predictor, str], str] = {}
    processes = {p: [Processes(extended, name, seed) for name in names] for p in (Predictor.GP, Predictor.DISCREPANCY)}
    X = np.stack([signals[name] for name in inputs], axis=1)
    for number, (plain, ours) in enumerate(zip(fold_fits(card), fold_fits(extended), strict=True)):
        fold, train = ours.fold, ours.train
        for predictor, state, fit in ((Predictor.CARD, card, plain), (Predictor.EXTENDED, extended, ours)):
            mean[predictor][fold], sd[predictor][fold] = _of_fold(state, fit, measured)
        known = _blocks(extended, ours.theta)
        Z = np.stack([known[name] for name in dict.fromkeys((*inputs, *BEYOND)) if name in known], axis=1)
        for predictor, columns, target in ((Predictor.GP, X, measured), (Predictor.DISCREPANCY, Z, ours.residual)):
            beside = predictor is Predictor.DISCREPANCY
            for c, name in enumerate(names):
                if progress:
                    progress("predictors", (number + beside / 2 + c / (2 * len(names))) / len(extended.folds))
                one = processes[predictor][c]
                found = (one.discrepancy if beside else one.smooth)(columns, target[:, c], train, fold)
                if found.refused is not None:
                    refused.setdefault((predictor, name), f"refused on {_label(extended, number)}: {found.refused}")
                mean[predictor][fold, c] = found.mean + (mean[Predictor.EXTENDED][fold, c] if beside else 0.0)
                sd[predictor][fold, c], trust[predictor][number, c] = found.sd, found.trust
    labels = tuple(_label(extended, k) for k in range(len(extended.folds)))
    fitted = f"each of {', '.join(labels)} predicted from fits to the others"
    predictions = {
        p: {
            name: Prediction(
                status=refused.get((p, name), fitted),
                scores=None if (p, name) in refused else _scored(measured, mean[p], sd[p], extended.inside, c),
                mean=mean[p][:, c],
                sd=sd[p][:, c],
                trust=tuple(trust[p][:, c].tolist()),
            )
            for c, name in enumerate(names)
        }
        for p in Predictor
    }
    return Comparison(split_name(extended), labels, extended.inside, measured, predictions)


def _of_fold(
    state: SelectionState, fit: FoldFit, measured: Float[np.ndarray, "m c"]
) -> tuple[Float[np.ndarray, "f c"], Float[np.ndarray, "f c"]]:
    """Mean and deviation of a fold by the fit to the others."""
    variance = np.mean((fit.residual / state.noise_growth)[fit.train] ** 2, axis=0)
    return measured[fit.fold] - fit.residual[fit.fold], np.sqrt(variance) * state.noise_growth[fit.fold]


def _blocks(state: SelectionState, theta: Float[np.ndarray, " k"]) -> dict[str, np.ndarray]:
    """Signals, X and measured coefficients at parameters `theta`, averaged over blocks."""
    known = state.responses.evaluate(jnp.asarray(theta))[1]
    return {key: np.asarray(state.responses.block(x * 1.0)) for key, x in known.items() if jnp.ndim(x)}


def _scored(
    measured: Float[np.ndarray, "m c"],
    mean: Float[np.ndarray, "m c"],
    sd: Float[np.ndarray, "m c"],
    inside: Bool[np.ndarray, " m"],
    c: int,
) -> HoldoutErrors:
    z, y, s = measured[inside, c], mean[inside, c], sd[inside, c]
    found = score(z, y)
    covered = float(np.mean(np.abs(z - y) <= 1.959964 * s))
    return HoldoutErrors(found.r, found.rmse, found.r2, found.theil, covered, float(log_density(z - y, s**2).sum()))


def _label(state: SelectionState, fold: int) -> str:
    """Name of the manoeuvre left out, or the seconds of a single one."""
    if split_name(state) == "manoeuvre":
        return state.responses.flights.names[fold]
    seconds, part = state.responses.seconds, state.folds[fold]
    return f"{part.start * seconds:.0f}-{part.stop * seconds:.0f} s"
