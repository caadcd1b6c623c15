"""Four predictors on data that none of them was fitted to: card's model, Gaussian process, extended model, and both.

Every predictor is fitted on all folds but one and scored on that one, at the same blocks of about 5 Hz. The fourth adds
to the extended model a Gaussian process of what that model leaves on the fitted folds: the discrepancy of M. C. Kennedy
and A. O'Hagan, Bayesian calibration of computer models, J. R. Stat. Soc. B 63, 2001, its parts fitted one after the
other. How far it is believed is told in `discrepancy`.

All densities here treat the residuals of neighbouring blocks as independent. They are not: a difference of `elpd` is
worth as many times less as the colour multiplies variances (`SelectionState.variance_inflation`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved, optimum
from bayes_aero.diagnosis.selection.cross_validation import split_name
from bayes_aero.diagnosis.selection.discrepancy import Processes
from bayes_aero.errors import InputError
from bayes_aero.inference.scores import score
from bayes_aero.inference.threads import blas_threads
from bayes_aero.physics.coefficients import NAMES
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
    extended: SelectionState, inputs: Sequence[str], *, seed: int = 0, progress: Progress | None = None
) -> Comparison:
    """All four predictors of a state of the coefficients; the card's model is the state with nothing added.

    `inputs` are the card's for Gaussian processes.
    Raises `InputError` for a state of the flight path or an input that was not recorded.
    """
    if extended.outputs != NAMES:
        raise InputError("predictors are compared on the coefficients, not on the flight path")
    card = moved(extended, _bare(extended), ())
    signals = _blocks(card, card.theta)
    measured = signals["measured"]
    for name in inputs:
        if name not in signals:
            raise InputError(f"the Gaussian process needs the signal {name}; map it on the card or change [gp] inputs")
    inside = np.zeros(len(measured), bool)
    for fold in extended.folds:
        inside[fold] = True
    order = list(Predictor)
    card_at, gp_at, extended_at, both_at = (order.index(p) for p in Predictor)
    shape = (len(order), *measured.shape)
    mean, sd = np.full(shape, np.nan), np.full(shape, np.nan)
    trust = np.ones((len(order), len(extended.folds), len(NAMES)))
    refused: dict[tuple[int, int], str] = {}
    processes = {at: [Processes(extended, name, seed) for name in NAMES] for at in (gp_at, both_at)}
    X = np.stack([signals[name] for name in inputs], axis=1)
    for number, fold in enumerate(extended.folds):
        others = [f for f in range(len(extended.folds)) if f != number]
        train = _training(extended, others)
        _, residual, variance = _fitted(card, others, train)
        mean[card_at, fold], sd[card_at, fold] = (
            measured[fold] - residual[fold],
            np.sqrt(variance) * card.noise_growth[fold],
        )
        theta, residual, variance = _fitted(extended, others, train)
        mean[extended_at, fold] = measured[fold] - residual[fold]
        sd[extended_at, fold] = np.sqrt(variance) * extended.noise_growth[fold]
        known = _blocks(extended, theta)
        Z = np.stack([known[name] for name in dict.fromkeys((*inputs, *BEYOND)) if name in known], axis=1)
        for at, columns, target in ((gp_at, X, measured), (both_at, Z, residual)):
            for c in range(len(NAMES)):
                if progress:
                    progress("predictors", (number + (at == both_at) / 2 + c / (2 * len(NAMES))) / len(extended.folds))
                one = processes[at][c]
                predict = one.discrepancy if at == both_at else one.smooth
                found = predict(columns, target[:, c], train, fold)
                if found.refused is not None:
                    refused.setdefault((at, c), f"refused on {_label(extended, number)}: {found.refused}")
                mean[at, fold, c] = found.mean + (mean[extended_at, fold, c] if at == both_at else 0.0)
                sd[at, fold, c], trust[at, number, c] = found.sd, found.trust
    labels = tuple(_label(extended, k) for k in range(len(extended.folds)))
    fitted = f"each of {', '.join(labels)} predicted from fits to the others"
    predictions = {
        predictor: {
            name: Prediction(
                status=refused.get((at, c), fitted),
                scores=None if (at, c) in refused else _scored(measured, mean[at], sd[at], inside, c),
                mean=mean[at, :, c],
                sd=sd[at, :, c],
                trust=tuple(trust[at, :, c].tolist()),
            )
            for c, name in enumerate(NAMES)
        }
        for at, predictor in enumerate(order)
    }
    return Comparison(split_name(extended), labels, inside, measured, predictions)


def _bare(state: SelectionState) -> Float[np.ndarray, " k"]:
    """Parameters with every effect that is not on the card at neutral, corrections of sensors too."""
    theta = state.theta.copy()
    for effect in state.full.model.effects:
        names = [name for name in state.full.parameters_of(effect.name) if name in state.full.model.names]
        if effect.name not in state.full.base:
            theta[state.full.columns(names)] = [state.full.neutral[name] for name in names]
    return theta


def _blocks(state: SelectionState, theta: Float[np.ndarray, " k"]) -> dict[str, np.ndarray]:
    """Signals, X and measured coefficients at parameters `theta`, averaged over blocks."""
    known = state.responses.evaluate(jnp.asarray(theta))[1]
    return {key: np.asarray(state.responses.block(x * 1.0)) for key, x in known.items() if jnp.ndim(x)}


def _training(state: SelectionState, others: Sequence[int]) -> Bool[np.ndarray, " m"]:
    train = np.zeros(len(state.residual), bool)
    for f in others:
        train[state.folds[f]] = True
    return train


def _fitted(
    state: SelectionState, others: Sequence[int], train: Bool[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "m c"], Float[np.ndarray, " c"]]:
    """Parameters fitted to the other folds, the residual of everything, and the variance of what they leave there."""
    theta = optimum(state, others, state.settings.hold_out_steps)
    keep = [state.responses.outputs.index(name) for name in state.outputs]
    residual = np.asarray(state.responses.evaluate(jnp.asarray(theta))[0])[:, keep]
    return theta, residual, np.mean((residual / state.noise_growth)[train] ** 2, axis=0)


def _scored(
    measured: Float[np.ndarray, "m c"],
    mean: Float[np.ndarray, "m c"],
    sd: Float[np.ndarray, "m c"],
    inside: Bool[np.ndarray, " m"],
    c: int,
) -> HoldoutErrors:
    z, y, s = measured[inside, c], mean[inside, c], sd[inside, c]
    found = score(z, y)
    standard = (z - y) / s
    density = -0.5 * (standard**2 + np.log(2.0 * np.pi * s**2))
    covered = float(np.mean(np.abs(standard) <= 1.959964))
    return HoldoutErrors(found.r, found.rmse, found.r2, found.theil, covered, float(density.sum()))


def _label(state: SelectionState, fold: int) -> str:
    """Name of the manoeuvre left out, or the seconds of a single one."""
    if split_name(state) == "manoeuvre":
        return state.responses.flights.names[fold]
    seconds, part = state.responses.seconds, state.folds[fold]
    return f"{part.start * seconds:.0f}-{part.stop * seconds:.0f} s"
