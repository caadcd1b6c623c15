"""Do the stretches of a flight agree about an error of a sensor, and what do the causes leave of the residuals?

Gusts are in the vane and in the airspeed, and what integrates them wanders off as slowly as an error of a sensor would
make it: no autoregression tells the two apart over a record of a minute or two. In short stretches, each from where it
began, little has wandered, and how far they disagree says how far an estimate can be trusted, whatever the colour.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.screening.accuracy import sizes
from bayes_aero.diagnosis.screening.autocorrelation import NoiseReport
from bayes_aero.diagnosis.screening.parameter_fit import largest_p_value, refitted
from bayes_aero.diagnosis.screening.regression import Fit, inverse, partialled
from bayes_aero.diagnosis.screening.screening import screen
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.forward_selection import Extension, Step, removed, worth
from bayes_aero.inference.covariance import cluster_covariance


class Blocks:
    """Residuals and sensitivities of a fit, less each stretch's own mean: where it began is free."""

    def __init__(self, state: SelectionState, fit: Fit) -> None:
        self.state, self.number = state, _numbers(state)
        inside = self.number >= 0
        self._inside, self._own = inside, self.number[inside]
        self.left = self._centred(state.left(fit))
        self.weight = 1.0 / np.maximum(np.mean(self.left**2, axis=0), 1e-300)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the disagreement."""
        return int(self._own.max())

    def _centred(self, x: np.ndarray) -> np.ndarray:
        """(m, ...) to the blocks inside stretches, (i, ...)."""
        x = x[self._inside]
        sums = np.zeros((self._own.max() + 1, *x.shape[1:]))
        np.add.at(sums, self._own, x)
        count = np.bincount(self._own).reshape(-1, *[1] * (x.ndim - 1))
        return x - (sums / count)[self._own]

    def judge(self, effect: str) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]] | None:
        """What the stretches add to an effect's parameters, the other additions free, and its covariance from how far
        they disagree; None where the effect moves nothing here."""
        state = self.state
        own = state.full.own_columns(effect)
        others = np.setdiff1d(state.columns([e for e in state.active if e != effect]), [*own, *state.offsets])
        S, B = (self._centred(state.scaled[:, :, columns]) for columns in (own, others))
        if not np.all(np.any(S != 0.0, axis=(0, 1))):
            return None
        both = partialled(np.concatenate([S, self.left[:, :, None]], axis=2), B, self.weight)
        S, left = both[:, :, :-1], both[:, :, -1]
        bread = inverse(np.einsum("mci,c,mcj->ij", S, self.weight, S, optimize=True))
        step = bread @ np.einsum("mci,c,mc->i", S, self.weight, left, optimize=True)
        rows = np.einsum("mci,c,mc->mi", S, self.weight, left - S @ step, optimize=True)
        return step, bread @ cluster_covariance(rows, self._own) @ bread

    def p_value(self, effect: str) -> float:
        """Of an addition: the chance that stretches which disagree as they do show as much of it.

        Bonferroni over all candidates, for it is the best of them.
        """
        judged = self.judge(effect)
        if judged is None:
            return 1.0
        away = self.state.departure[self.state.full.own_columns(effect)]
        return largest_p_value(away + judged[0], judged[1], self.freedom, len(self.state.blocks))


def _numbers(state: SelectionState) -> Int[np.ndarray, " m"]:
    """The stretch of each block, -1 between folds."""
    seconds, number = state.responses.seconds, np.full(len(state.residual), -1)
    total = seconds * sum(fold.stop - fold.start for fold in state.folds)
    wanted, begin = min(state.settings.block, total / state.settings.fewest_blocks), 0
    for fold in state.folds:
        length = fold.stop - fold.start
        parts = max(1, int(length * seconds / wanted + 0.5))
        number[fold] = begin + np.arange(length) * parts // length
        begin += parts
    return number


def consistent_across_blocks(state: SelectionState, fit: Fit) -> tuple[SelectionState, Fit]:
    """The state without additions that the stretches do not bear out, the least first."""
    while state.active:
        judged = Blocks(state, fit)
        chances = {effect: judged.p_value(effect) for effect in state.active}
        worst = max(chances, key=lambda effect: chances[effect])
        if chances[worst] <= state.settings.block_false_alarm_rate:
            break
        state, fit = refitted(removed(state, worst))
    return state, fit


def widened(found: Extension, state: SelectionState, fit: Fit) -> Extension:
    """The extension that ended in `state`, deviations no smaller than the stretches' disagreement makes them. The last
    election is held anew."""
    judged = Blocks(state, fit)
    told = dict(found.sizes) if state is found.state else sizes(state, fit)
    for effect in state.active:
        pair = judged.judge(effect)
        if pair is not None:
            wide = np.sqrt(np.diag(pair[1]))
            names = state.full.parameters_of(effect)
            told |= {n: replace(told[n], sd=max(told[n].sd, float(x))) for n, x in zip(names, wide, strict=True)}
    last = screen(state, fit, seed=0, nulls=False)
    candidate_scores = []
    for standing in last.candidate_scores:
        pair = judged.judge(standing.effect) if standing.value is None else None
        wide = np.zeros(len(standing.sd)) if pair is None else np.sqrt(np.diag(pair[1]))
        candidate_scores.append(replace(standing, sd=tuple(np.maximum(standing.sd, wide))))
    closing = Step(None, float("nan"), replace(last, candidate_scores=tuple(candidate_scores)), float("nan"))
    causes, minor = worth(state, fit, told)
    steps = (*found.steps, closing)
    return replace(found, state=state, fit=fit, steps=steps, sizes=told, causes=causes, minor=minor)


# --- Where the model is wrong: residuals of each coefficient by what was recorded, their colour, size and
# composition.

BINS = 12
LEAST = 1e-3  # of the residual's size, that a deviation counts as at least: a simulation at rest has none


@dataclass(frozen=True)
class TheilParts:
    """Theil's inequality coefficient and the shares of bias, variance and covariance in the mean square error.

    Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 11; the shares add up to one.
    """

    theil: float
    bias: float
    variance: float
    covariance: float


def theil_parts(measured: Float[np.ndarray, " n"], modelled: Float[np.ndarray, " n"]) -> TheilParts:
    """U = rms(z - y)/(rms z + rms y); shares (mean z - mean y)^2, (sd z - sd y)^2, 2(1 - r) sd z sd y of the MSE."""
    z, y = np.asarray(measured), np.asarray(modelled)
    mse = float(np.mean((z - y) ** 2))
    if mse == 0.0:
        return TheilParts(0.0, 0.0, 0.0, 0.0)
    sz, sy = z.std(), y.std()
    covariance = float(np.mean((z - z.mean()) * (y - y.mean())))
    theil = np.sqrt(mse) / (np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(y**2)))
    parts = ((z.mean() - y.mean()) ** 2, (sz - sy) ** 2, 2.0 * (sz * sy - covariance))
    return TheilParts(float(theil), *(float(part / mse) for part in parts))


@dataclass(frozen=True)
class Profile:
    """Mean residual of a coefficient in bins of equal count of a channel, and the deviation of each mean."""

    channel: str
    centre: Float[np.ndarray, " b"]
    mean: Float[np.ndarray, " b"]
    deviation: Float[np.ndarray, " b"]


def details(state: SelectionState) -> Mapping[str, np.ndarray]:
    """Signals, X, measured, modelled and residual coefficients at the recorded rate."""
    return {key: np.asarray(value) for key, value in state.responses.evaluate(state.theta)[1].items()}


def profiles(
    residual: Float[np.ndarray, " n"], channels: Mapping[str, np.ndarray], variance_inflation: float
) -> list[Profile]:
    """How the residual depends on each channel, the clearest first."""
    found, bins = [], max(1, min(BINS, len(residual) // 2))  # of two blocks at least, that they have a deviation
    for name, x in channels.items():
        if np.ptp(x) <= 1e-9 * max(1.0, float(np.abs(x).max())):
            continue
        parts = np.array_split(np.argsort(x, kind="stable"), bins)
        mean = np.array([residual[p].mean() for p in parts])
        sd = np.array([residual[p].std() * np.sqrt(variance_inflation / len(p)) for p in parts])
        found.append(Profile(name, np.array([x[p].mean() for p in parts]), mean, sd))
    least = max(LEAST * float(np.sqrt(np.mean(residual**2))), 1e-300)
    return sorted(found, key=lambda p: -float(np.sum((p.mean / np.maximum(p.deviation, least)) ** 2)))


def noise_report(extension: Extension, outliers: Mapping[str, int]) -> NoiseReport:
    """Colour, size, growth and outliers of what the extended model leaves."""
    state = extension.state
    names = state.responses.model.coefficients
    full = details(state)["residual"][:, : len(names)]
    blocks, manoeuvre = np.asarray(state.responses.block(full)), state.responses.manoeuvre
    lag1 = {}
    for c, name in enumerate(names):
        pieces = [r - r.mean() for r in (blocks[manoeuvre == k, c] for k in range(int(manoeuvre[-1]) + 1))]
        lag1[name] = float(sum(np.sum(r[1:] * r[:-1]) for r in pieces) / sum(np.sum(r**2) for r in pieces))
    deviation = {name: float(full[:, c].std()) for c, name in enumerate(names)}
    noise_growth = {name: float(state.noise_growth[:, c].max()) for c, name in enumerate(names)}
    return NoiseReport(lag1, deviation, noise_growth, dict(outliers))
