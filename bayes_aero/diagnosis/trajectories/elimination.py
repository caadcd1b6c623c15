"""Which causes flight misses: those without which unseen manoeuvres are flown as well are taken out.

Coefficients confirm a cause where they follow from it directly. Flown, what it gets wrong adds up over a minute, and
what is superfluous harms there first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import finite
from bayes_aero.diagnosis.selection.backward_elimination import Confirmation, backward_elimination
from bayes_aero.diagnosis.settings import DEFAULT, DiagnosisSettings
from bayes_aero.diagnosis.trajectories.holdout_fits import CandidateFit, Noise, holdout_fits, left_out
from bayes_aero.diagnosis.trajectories.log_score import HoldoutScore, holdout_gain, output_gains
from bayes_aero.effect import Effect
from bayes_aero.inference.likelihood.mle import solve
from bayes_aero.inference.likelihood.normal_equations import NormalEquations, Point, segment_equations
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult
from bayes_aero.parameter import departure


@dataclass(frozen=True)
class Elimination:
    """The contender with what flight misses, its fits to all segments but one each, and what each cause is missed by.

    Parameters that are `gone` are held at neutral: those of causes that were taken out.
    """

    contender: CandidateFit
    fits: Sequence[OutputErrorResult]
    confirmation: Confirmation
    gone: frozenset[str] = frozenset()


def eliminate(
    contender: CandidateFit,
    fits: Sequence[OutputErrorResult],
    causes: Sequence[Effect],
    silent: Mapping[int, Mapping[str, float]],
    noise: Noise,
    settings: DiagnosisSettings = DEFAULT,
) -> Elimination:
    """Test every one of `causes` on hold-out flights.

    `fits` are those to all segments but one each, `silent` the parameters held at their joint values there.

    A cause with such parameters is not tested and stays: with a joint value the segment is not held out.
    """
    unheard = {name for held in silent.values() for name in held}
    neutral = {e.name: e.neutral_values for e in causes}
    neutral = {name: values for name, values in neutral.items() if not unheard & set(values)}
    flight = _Flight(contender, neutral, silent, noise, {tuple(neutral): fits})
    if not flight.refitted(tuple(neutral)).inside:  # what cannot be flown is no measure of anything
        return Elimination(contender, fits, Confirmation((), {}))
    found = backward_elimination(tuple(neutral), flight, settings)
    less = flight.without(found.kept)
    gone = frozenset(less.held) - frozenset(contender.held)
    if not gone:
        return Elimination(contender, fits, found)
    fit = contender.fit
    again = fit_output_error(fit.flown, start=fit.estimate, held=less.held, prior_weight=noise.variance_inflation)
    return Elimination(replace(less, fit=again), flight.fits[found.kept], found, gone)


@dataclass(frozen=True)
class _Flight:
    """Segments as a contender with some of its causes flies them, unseen. `fits` are kept by the causes that are in."""

    contender: CandidateFit
    neutral: Mapping[str, Mapping[str, float]]  # parameters of the causes that are asked, by cause
    silent: Mapping[int, Mapping[str, float]]
    noise: Noise
    fits: dict[tuple[str, ...], Sequence[OutputErrorResult]]

    def without(self, effects: Sequence[str]) -> CandidateFit:
        """The contender, of what is asked only `effects` in."""
        gone = {name: finite(x) for name, x in self._gone(effects).items()}
        return replace(self.contender, held={**self.contender.held, **gone})

    def _gone(self, effects: Sequence[str]) -> dict[str, float]:
        """Neutral values of what is asked and not among `effects`."""
        return {name: x for e, values in self.neutral.items() if e not in effects for name, x in values.items()}

    @cached_property
    def equations_at_optimum(self) -> tuple[Point, Point]:
        """The normal equations at the optimum: with the fitted initial states, and with the measured ones."""
        fit = self.contender.fit
        equations, measured = NormalEquations(fit.flown, fit.priors), np.zeros_like(fit.departure)
        return equations.evaluate(fit.estimate, fit.departure), equations.evaluate(fit.estimate, measured)

    def first_order(self, effects: Sequence[str]) -> HoldoutScore:
        """Residuals linear in the parameters where all segments are fitted; parameters at a bound stay there."""
        fit, (fitted, measured) = self.contender.fit, self.equations_at_optimum
        A, g, _ = segment_equations(fitted, fit.priors)
        columns = np.concatenate(measured.products.columns)
        left = []
        for k, inside in enumerate(fit.flown.inside):
            others = np.arange(len(A)) != k
            information = A[others].sum(axis=0) + np.diag(fit.priors.precision)
            gradient = g[others].sum(axis=0) - fit.priors.precision * (fit.estimate - fit.priors.mean)
            step = self._step(effects, k, information, gradient)
            left.append((columns[k, ..., 0] - columns[k, ..., 1 : 1 + len(step)] @ step)[inside])
        return HoldoutScore(tuple(left))

    def _step(self, effects: Sequence[str], k: int, A: Float[np.ndarray, "k k"], g: Float[np.ndarray, " k"]):
        """From the joint optimum to that of all segments but one."""
        fit = self.contender.fit
        held = {**dict.fromkeys(fit.at_bound), **self.silent[k], **self.contender.held, **self._gone(effects)}
        stated = {n: x for n, x in held.items() if x is not None}
        away = {n: -departure(x, stated[n]) for n, x in zip(fit.names, fit.estimate, strict=True) if n in stated}
        step = np.array([away.get(n, 0.0) for n in fit.names])
        moving = np.array([n not in held for n in fit.names])
        step[moving] = solve(A[np.ix_(moving, moving)], (g - A @ step)[moving], 0.0)
        return step

    def refitted(self, effects: Sequence[str]) -> HoldoutScore:
        """Every segment flown by a fit to the others."""
        key, less = tuple(effects), self.without(effects)
        if key not in self.fits:
            self.fits[key] = [fit for _, fit in left_out([less], {less.name: self.silent}, self.noise)]
        paths = holdout_fits(less, self.fits[key], {})
        flown = self.contender.fit.flown
        return HoldoutScore.of(paths, flown.outputs, flown.growth)

    def holdout_gain(self, before: HoldoutScore, after: HoldoutScore) -> tuple[float, float]:
        if not before.inside:  # without it the flight leaves its envelope
            return np.inf, 0.0
        return holdout_gain(before, after, self.noise.variance_inflation)

    def output_gains(self, before: HoldoutScore, after: HoldoutScore) -> Mapping[str, tuple[float, float]]:
        if not before.inside:
            return {}
        return output_gains(self.contender.fit.flown.outputs, before, after, self.noise.variance_inflation)
