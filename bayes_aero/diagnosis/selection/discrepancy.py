"""Gaussian processes fitted to some folds and asked about another, and how far they deserve to be believed there.

A process takes coloured noise for a function of its inputs. Two guards against that: a prior of length scales that lets
a sample function bend about once over the flown range (`Priors.quasi_steady`), or, for a process free to be finer, a
trial: its mean counts only as far as it predicts stretches of the fitted folds that it has not seen, by a factor
between 0 and 1, its `trust`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.errors import InputError
from bayes_aero.inference.gp import GPFit, MapStatus, Priors, fit_gp
from bayes_aero.inference.gp.kernel import Scaling
from bayes_aero.inference.gp.optimum import maximise
from bayes_aero.inference.gp.predict import gaussian_parts
from bayes_aero.inference.gp.reduced import ReducedData

STARTS = 3  # of the first fold's search for hyperparameters; the other folds' begin at its optimum
INNER = 12.0  # s, stretches on which a process is tried: longer than the noise's memory
EARNED = 0.3  # trust that a process with free length scales must earn
GRADIENT = 0.5  # nats per unit of log hyperparameter: a search that stopped with more is refused
MOVES = 1e-6  # relative range below which a channel cannot be an input


@dataclass(frozen=True)
class Guess:
    """Mean and deviation at the blocks asked for, the trust put in the process, and the reason if it was refused."""

    mean: Float[np.ndarray, " k"]
    sd: Float[np.ndarray, " k"]
    trust: float = 1.0
    refused: str | None = None


class Processes:
    """Gaussian processes of one output of a state, one for each fold left out."""

    def __init__(self, state: SelectionState, name: str, seed: int) -> None:
        self.state, self.name, self.seed = state, name, seed
        self.column = state.outputs.index(name)
        self.last: dict[Priors, GPFit] = {}

    def smooth(
        self, X: Float[np.ndarray, "m d"], y: Float[np.ndarray, " m"], train: Bool[np.ndarray, " m"], fold: slice
    ) -> Guess:
        """Fit to the blocks marked by `train` and predict those of `fold`, with long length scales and white noise."""
        fit = self._fit(X, y, train, Priors.quasi_steady())
        if isinstance(fit, str):
            return _refusal(fold, fit)
        there = fit.predict(self._inputs(X, train)[fold])
        return Guess(there.mean, there.sd)

    def discrepancy(
        self, X: Float[np.ndarray, "m d"], y: Float[np.ndarray, " m"], train: Bool[np.ndarray, " m"], fold: slice
    ) -> Guess:
        """The same for what a model leaves, its noise growing as the state's: as fine as it earns, else long scales."""
        noise_growth, inputs = self.state.noise_growth[:, self.column], self._inputs(X, train)
        fine = self._fit(X, y, train, Priors())
        if not isinstance(fine, str):
            guard = round(self.state.settings.gap / self.state.responses.seconds)
            trust, noise = trust_of(fine, y[train], noise_growth[train], _stretches(self.state, train), guard)
            if trust >= EARNED:
                there = fine.predict(inputs[fold])
                return Guess(
                    trust * there.mean, np.sqrt(trust**2 * there.latent_sd**2 + noise * noise_growth[fold] ** 2), trust
                )
        fit = self._fit(X, y, train, Priors.quasi_steady())
        if isinstance(fit, str):
            return _refusal(fold, fit)
        there = fit.predict(inputs[fold])
        noise = float(
            np.mean((y / noise_growth)[train] ** 2)
        )  # of the model: how well its own folds are followed is no merit
        return Guess(there.mean, np.sqrt(there.latent_sd**2 + noise * noise_growth[fold] ** 2))

    def _inputs(self, X: Float[np.ndarray, "m d"], train: Bool[np.ndarray, " m"]) -> Float[np.ndarray, "m e"]:
        """Inputs that move in `train`."""
        return X[:, np.ptp(X[train], axis=0) > MOVES * np.maximum(np.abs(X[train]).max(axis=0), 1e-9)]

    def _fit(
        self, X: Float[np.ndarray, "m d"], y: Float[np.ndarray, " m"], train: Bool[np.ndarray, " m"], priors: Priors
    ) -> GPFit | str:
        """The process at the most probable hyperparameters, or why there is none."""
        X, y, last = self._inputs(X, train)[train], y[train], self.last.get(priors)
        names = tuple(f"x{i}" for i in range(X.shape[1]))
        try:
            if last is None or last.input_names != names:
                fit = fit_gp(
                    X,
                    y,
                    input_names=names,
                    output_name=self.name,
                    priors=priors,
                    sample=False,
                    seed=self.seed,
                    starts=STARTS,
                    progress=lambda _: None,
                )
            else:
                scaling, begin = Scaling.of(X, y, names), last.optima[0]
                data = ReducedData.of(scaling.inputs(X), y / scaling.rms)
                found = maximise(begin.u, data, priors, w=begin.theta[: len(names) + 2])
                fit = replace(last, scaling=scaling, data=data, optima=(found,))
        except InputError as error:
            return str(error)
        best = fit.optima[0]
        stopped = fit.map_status is MapStatus.iteration_limit and best.gradient > GRADIENT
        if fit.map_status is MapStatus.not_positive_definite or stopped:
            return fit.map_status.value
        self.last[priors] = fit
        return fit


def _refusal(fold: slice, reason: str) -> Guess:
    nothing = np.full(fold.stop - fold.start, np.nan)
    return Guess(nothing, nothing, refused=reason)


def _white(fit: GPFit) -> float:
    """Variance of a process's white noise, in the output's unit squared."""
    return float(np.exp(2.0 * fit.optima[0].theta[-1]) * fit.scaling.rms**2)


def _stretches(state: SelectionState, train: Bool[np.ndarray, " m"]) -> list[np.ndarray]:
    """Positions among the training blocks of stretches of about `INNER` s, each within one manoeuvre and fold."""
    at = np.flatnonzero(train)
    breaks = (np.diff(at) > 1) | (np.diff(state.responses.manoeuvre[at]) > 0)
    parts = np.split(np.arange(len(at)), np.flatnonzero(breaks) + 1)
    per = max(1, round(INNER / state.responses.seconds))
    return [piece for part in parts for piece in np.array_split(part, max(1, round(len(part) / per)))]


def trust_of(
    fit: GPFit,
    y: Float[np.ndarray, " n"],
    noise_growth: Float[np.ndarray, " n"],
    stretches: Sequence[np.ndarray],
    guard: int,
) -> tuple[float, float]:
    """How far to trust a process, 0 to 1, and the variance of what then remains beyond its own uncertainty.

    That variance is of noise that grows as `noise_growth`. Each stretch is predicted from the others (`guard` blocks on
    either side left out) with the hyperparameters of all; trust is the regression of the output on those predictions,
    lowered by its standard error. Where there is nothing to predict a stretch from (a manoeuvre of some seconds, its
    gaps taken out, is one stretch), nothing is trusted. Other than in a cross-validation nothing is fitted again.
    """
    nothing = 0.0, float(np.mean((y / noise_growth) ** 2))
    if len(stretches) < 2:
        return nothing
    theta, rms = fit.optima[0].theta, fit.scaling.rms
    mean, latent = np.zeros_like(y), np.zeros_like(y)
    for piece in stretches:
        kept = np.ones(len(y), bool)
        kept[max(0, piece[0] - guard) : piece[-1] + 1 + guard] = False
        if not kept.any():
            return nothing
        part = ReducedData(fit.data.x[kept], fit.data.fy[kept])
        mean[piece], latent[piece] = gaussian_parts(theta, part, fit.data.x[piece])
    mean, latent = rms * mean, rms**2 * latent
    cross = np.array([np.sum(mean[p] * y[p]) for p in stretches])
    square = np.array([np.sum(mean[p] ** 2) for p in stretches])
    if square.sum() <= 0.0:
        return nothing
    slope = float(cross.sum() / square.sum())
    error = float(np.sqrt(np.sum((cross - slope * square) ** 2)) / square.sum())  # stretches taken as independent
    trust = float(np.clip(slope - error, 0.0, 1.0))
    left = ((y - trust * mean) ** 2 - trust**2 * latent) / noise_growth**2
    return trust, float(max(np.mean(left), _white(fit) / np.mean(noise_growth**2)))
