"""What the Python interface returns: a fit and a diagnosis, with their tables, sentences and figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import pandas as pd
from matplotlib.figure import Figure

from bayes_aero.diagnosis.view.holdout import holdout_scores
from bayes_aero.diagnosis.view.results import DiagnosisView, View
from bayes_aero.errors import InputError
from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health import HealthFinding
from bayes_aero.inference.identification import Identification
from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.jobs.steps.record_checks import RecordChecks
from bayes_aero.report.figures.every_figure import DIAGNOSIS_FIGURES, FIGURES
from bayes_aero.report.pooled.next_flight import next_flight_table
from bayes_aero.report.style import NotDrawn
from bayes_aero.report.tables.diagnosis_tables import (
    causes_table,
    changes_table,
    scores_frame,
    screen_table,
    terms_table,
)
from bayes_aero.report.tables.run_tables import parameter_table, validation_table
from bayes_aero.report.text.consistency import consistency_sentences
from bayes_aero.report.text.diagnosis import sentences
from bayes_aero.report.text.identification import verdict

Shown = TypeVar("Shown")


@dataclass(frozen=True)
class Fit:
    """A model fitted to records by maximum likelihood, with the posteriors sampled so far."""

    run: Identification

    @property
    def mle(self) -> MleResult:
        """Estimates, Cramer-Rao bounds, bounds corrected for autocorrelation, residual covariance, status."""
        return self.run.mle

    @property
    def posteriors(self) -> Mapping[str, Posterior]:
        """Posteriors by engine (`emcee`, `nuts`; `white` for white noise in addition), each with an ArviZ DataTree."""
        return self.run.posteriors

    @property
    def sentences(self) -> list[str]:
        """Doubts about the records, then the findings and the disagreements between methods, one sentence each."""
        return [*self.doubts, *verdict(self.run)]

    @property
    def doubts(self) -> list[str]:
        """Faulty channels and disagreement of the sensors along the flight path; empty for sound records."""
        return _doubts(self.run.health, self.run.consistency, corrects=False)

    def table(self) -> pd.DataFrame:
        """Parameters in SI and radians.

        Returns:
            A row per parameter; columns for the unit, the estimate, both bounds, each posterior and each manoeuvre.
        """
        return parameter_table(self.run).frame()

    def next_flight(self) -> pd.DataFrame:
        """Manoeuvres alone and pooled, the scatter between them and the parameters of a flight not yet flown.

        Returns:
            A row per parameter, in SI and radians; columns for joint fit, each manoeuvre alone and pooled, aircraft,
            scatter, next flight, and the standard deviation of the scatter over that of its prior.

        Raises:
            InputError: `next_flight` has not been called.
        """
        if self.run.next_flight is None:
            raise InputError("the manoeuvres of this fit are not pooled yet; pool them by bayes_aero.next_flight(fit)")
        return next_flight_table(self.run).frame()

    def validation(self) -> pd.DataFrame:
        """Scores of the Gaussian processes (`gpr`) and of maximum likelihood on hold-out data.

        Returns:
            A row per split, fold and coefficient; columns for the scores of both methods on the same test points.

        Raises:
            InputError: `gpr` has not been called.
        """
        if self.run.gp is None:
            raise InputError("this fit has no Gaussian processes yet; add them with bayes_aero.gpr(fit)")
        return validation_table(self.run).frame()

    def plot(self, figure: str = "forest") -> Figure:
        """Draw a figure of `identify`.

        Args:
            figure: a name in `bayes_aero.report.figures.every_figure.FIGURES`.

        Raises:
            InputError: there is no such figure, or it has nothing to show.
        """
        return _drawn(FIGURES, figure, self.run)


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosis: verdict, causes with their sizes, and the scores of the extended model."""

    view: DiagnosisView
    card: Card
    checks: RecordChecks | None = None

    @property
    def doubts(self) -> list[str]:
        """Faulty channels, a record that was given twice, and disagreement of the sensors; empty for sound records."""
        corrects = self.view.diagnosis.by_coefficients
        return [] if self.checks is None else _doubts(self.checks.health, self.checks.consistency, corrects=corrects)

    @property
    def verdict(self) -> str:
        """`no_effect`, `explained`, `partly_explained`, `unexplained` or `undecided`."""
        return self.view.diagnosis.verdict.value

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes in the order of selection."""
        return tuple(cause.name for cause in self.view.diagnosis.causes)

    @property
    def sentences(self) -> list[str]:
        """Doubts about the records, then the verdict, one sentence or two per cause, unexplained structure, what is not
        testable, notes."""
        return [*self.doubts, *sentences(self.view)]

    def table(self) -> pd.DataFrame:
        """Causes in SI and radians.

        Returns:
            A row per parameter of each cause; columns for size, interval, probability, rivals and hold-out gain.
        """
        return causes_table(self.view.diagnosis).frame()

    def changes(self) -> pd.DataFrame:
        """Parameters of the model that take another value during the records, in SI and radians.

        Returns:
            A row per change; columns for manoeuvre, time in s with its interval, the value before, after and the
            difference with standard errors, p-value, hold-out gain and rivals.
        """
        return changes_table(self.view.diagnosis).frame()

    def terms(self) -> pd.DataFrame:
        """Forms of the structure that no effect of the catalogue explains, in SI and radians.

        Returns:
            A row per term; columns for its coefficient, factor with standard error, share of the variance left,
            hold-out gain, probability, and terms that the records do not tell from it.
        """
        return terms_table(self.view.diagnosis).frame()

    @property
    def _coefficients(self) -> View:
        if not isinstance(self.view, View):
            raise InputError("this diagnosis rests on trajectories alone: the records lack what coefficients need")
        return self.view

    def scores(self) -> pd.DataFrame:
        """Scores of the card's and the extended model.

        Returns:
            A row per model, data (`fitted` or `hold_out`), manoeuvre and coefficient.
        """
        return scores_frame(holdout_scores(self._coefficients))

    def screen(self) -> pd.DataFrame:
        """Every candidate of the catalogue.

        Returns:
            A row per candidate; columns for deviance, score and family-wise p-value.
        """
        return screen_table(self.view.rankings, self.view.diagnosis).frame()

    def plot(self, figure: str = "measured_simulated") -> Figure:
        """Draw a figure of `diagnose`.

        Args:
            figure: a name in `bayes_aero.report.figures.every_figure.DIAGNOSIS_FIGURES`.

        Raises:
            InputError: there is no such figure, or it has nothing to show.
        """
        return _drawn(DIAGNOSIS_FIGURES, figure, self._coefficients)


def plot(result: Fit | Diagnosed, figure: str | None = None, *, width: float | None = None) -> Figure:
    """Draw a figure of a result.

    Args:
        result: of `fit` or `diagnose`.
        figure: its name; default: the first figure of this kind of result.
        width: in inches; the text keeps its size. 10 fits a notebook's column.

    Returns:
        A matplotlib figure.

    Raises:
        InputError: there is no such figure, or it has nothing to show.
    """
    drawn = result.plot() if figure is None else result.plot(figure)
    if width is not None:
        own, height = drawn.get_size_inches()
        drawn.set_size_inches(width, height * width / own)
    return drawn


def _doubts(health: Sequence[HealthFinding], agreement: Consistency | None, *, corrects: bool) -> list[str]:
    disagree = agreement is not None and agreement.disagrees
    answer = consistency_sentences(agreement, corrects=corrects)[:1] if agreement is not None and disagree else []
    return [*(finding.sentence for finding in health), *answer]


def _drawn(figures: Mapping[str, Callable[[Shown], Figure]], name: str, shown: Shown) -> Figure:
    if name not in figures:
        raise InputError(f"there is no figure {name!r}; choose one of {', '.join(figures)}")
    try:
        return figures[name](shown)
    except NotDrawn as reason:
        raise InputError(f"the figure {name} has nothing to show: {reason}") from None
