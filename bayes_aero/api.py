"""The Python interface: read, fit, sample, diagnose, plot.

    import bayes_aero as ba

    card = ba.read_card("attas")
    records = ba.read(["qst01.asc", "qst02.asc"], card)
    fit = ba.sample(ba.fit(records, card), engine="emcee")
    fit.table()                                # pandas: estimates, bounds, posterior
    ba.plot(fit, "prior_posterior")            # a matplotlib figure
    ba.gpr(fit).validation()                   # Gaussian processes, scored on three kinds of hold-out data
    ba.diagnose(records, card).table()         # missing effects and their sizes

Results are in SI units and radians; tables state the units.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, cast, get_args

import pandas as pd
from matplotlib.figure import Figure

from bayes_aero.diagnosis.consistency import errors_of_diagnosis
from bayes_aero.diagnosis.diagnose import diagnose as run_diagnosis
from bayes_aero.diagnosis.diagnose import holdout_scores, view_of
from bayes_aero.diagnosis.result import DiagnosisView, View
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card, read_card
from bayes_aero.flight.health import Consistency, HealthFinding
from bayes_aero.flight.reading import check_arrays, read_records, without_bad_options
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.gp import SplitKind, Training, validate
from bayes_aero.inference.pooled import check_manoeuvres
from bayes_aero.inference.results import Identification, MleResult, Posterior
from bayes_aero.inference.sampling import pit_of, sample_ensemble, sample_nuts
from bayes_aero.jobs.check import RecordChecks, record_checks, repaired
from bayes_aero.jobs.identify import IdentificationJob, pooled_manoeuvres, sampled
from bayes_aero.jobs.options import FormingName, IdentifyOptions, NoiseName
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Colour
from bayes_aero.model.records import on_recorded_axes
from bayes_aero.report.figures.every_figure import DIAGNOSIS_FIGURES, FIGURES
from bayes_aero.report.pages.diagnosis import (
    causes_table,
    changes_table,
    scores_frame,
    screen_table,
    sentences,
    terms_table,
)
from bayes_aero.report.pages.estimates import verdict
from bayes_aero.report.pages.identification import next_flight_table, parameter_table, validation_table
from bayes_aero.report.pages.parts import consistency_sentences
from bayes_aero.report.style import NotDrawn

__all__ = ["Diagnosed", "Fit", "diagnose", "fit", "gpr", "next_flight", "plot", "read", "sample"]

Engine = Literal["emcee", "nuts"]
ENGINES = {"emcee": sample_ensemble, "nuts": sample_nuts}
SETTINGS = tuple(f.name for f in fields(DiagnosisSettings))


def read(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    card: str | Card = "attas",
    *,
    resample: float | None = None,
    split: bool = False,
) -> list[FlightRecord]:
    """Read and check flight records, one per manoeuvre.

    Args:
        paths: files, or parts of files: "flight.csv@12.5:40" in s of the file's time.
        card: a `Card`, the name of a shipped one or a path. It maps columns to channels; `[segments]` lists manoeuvres.
        resample: step in s of an even grid for interpolation, for records with uneven or several rates.
        split: whether gaps in time divide a file into manoeuvres.

    Returns:
        Records with channels of shape (n,) in SI and radians.

    Raises:
        InputError: a file cannot be read or a channel is not sound.
    """
    read_as = _card(card)
    files = [paths] if isinstance(paths, str | os.PathLike) else paths
    return read_records(files, read_as.channels, resample=resample, segments=read_as.segments, split=split)


def fit(
    records: Sequence[FlightRecord],
    card: str | Card = "attas",
    *,
    model: Model | None = None,
    coefficients: FormingName = "matched",
    frequency: tuple[float, float] | None = None,
    seed: int = 0,
) -> Fit:
    """Fit a model to CL, CD and Cm by maximum likelihood (Gauss-Newton), to all records jointly and to each alone.

    Isolated spikes are replaced. The health of channels and the agreement of sensors are checked: see `Fit.doubts`.

    Args:
        records: one per manoeuvre; up to 24 of them are also fitted alone.
        card: a `Card`, the name of a shipped one or a path.
        model: default: the card's model.
        coefficients: "matched" applies the same filter to all signals; "published" filters the accelerations but not
            the controls, as the published ATTAS results do.
        frequency: lowest and highest frequency, Hz, of a band in which the parameters are fitted, too: columns of
            `Fit.table`.
        seed: of the random starts.

    Returns:
        The fit; arrays follow `mle.names`, shape (k,), in SI and radians.

    Raises:
        InputError: the records lack a channel that the model needs, or numbers in it, or a setting is unknown.

    Source:
        Jategaonkar, Flight Vehicle System Identification, 2nd ed. 2015, ch. 4; Morelli and Klein, J. Aircraft 34, 1997.
    """
    _choose("way of forming coefficients", coefficients, get_args(FormingName))
    card = _card(card)
    options = IdentifyOptions(coefficients=coefficients, frequency=frequency, seed=seed)
    job = IdentificationJob(_sound(records, card), card, options, model=model)
    job.fit(seek=False)
    if frequency is not None:
        job.fit_in_band(frequency)
    return Fit(job.result)


def sample(fit: Fit, *, engine: Engine = "emcee", noise: NoiseName = "buffet-ar1", seed: int = 0) -> Fit:
    """Sample the posterior of a fit.

    All posteriors of one fit have the same noise model. Only a `white` one (by emcee) may be added for comparison.

    Args:
        fit: of `fit`.
        engine: "emcee" (affine-invariant ensemble) or "nuts" (No-U-Turn sampler).
        noise: noise model of the residuals: "white", "ar1", or "buffet-ar1", which grows as the flow separates.
        seed: of the sampler.

    Returns:
        The same fit with the posterior added.

    Raises:
        InputError: there is no such engine, or the fit has posteriors under another noise model.

    Source:
        Foreman-Mackey et al., PASP 125 (2013) 306; Hoffman and Gelman, JMLR 15 (2014) 1593.
    """
    _choose("engine", engine, ENGINES)
    colour, run = Colour(noise), fit.run
    beside = colour is Colour.WHITE and run.noise is not Colour.WHITE and any(k != "white" for k in run.posteriors)
    if run.posteriors and colour is not run.noise and not beside:
        raise InputError(f"this fit has posteriors under {run.noise.value} noise; sample a new fit under {noise}")
    posterior, notes = sampled(run, "white" if beside else engine, colour, ENGINES[engine], seed=seed)
    posteriors = run.posteriors | {"white" if beside else engine: posterior}
    run = replace(run, noise=run.noise if beside else colour, posteriors=posteriors, notes=(*run.notes, *notes))
    return Fit(replace(run, pit=pit_of(run)))


def next_flight(fit: Fit, *, seed: int = 0) -> Fit:
    """Pool the manoeuvres of a fit: parameters scatter around the aircraft's, and the next flight is one more of them.

    Every manoeuvre enters by a normal approximation, the estimate and the corrected covariance of its own fit. The
    scatter of each parameter has a half-normal prior of half the prior's standard deviation.

    Args:
        fit: of `fit`, to 2 to 24 records.
        seed: of the sampler.

    Returns:
        The same fit with `next_flight()` added: aircraft, scatter, manoeuvres and next flight, in SI and radians.

    Raises:
        InputError: there is one manoeuvre, too many, or fewer than two with a usable fit.

    Source:
        Gelman et al., Bayesian Data Analysis, 3rd ed. 2013, ch. 5.
    """
    check_manoeuvres(len(fit.run.records))
    without_spikes, _ = repaired(fit.run.records)
    return Fit(replace(fit.run, next_flight=pooled_manoeuvres(fit.run, without_spikes, seed=seed)))


def gpr(fit: Fit, *, split: SplitKind = "random", sample: bool = True, seed: int = 0) -> Fit:
    """Train Gaussian processes of CL, CD and Cm on the card's `[gp] inputs` and score them on hold-out data.

    Three splits are computed: `random` samples, 4 s blocks (`block`), a whole manoeuvre (`manoeuvre`; two records or
    more). This takes minutes.

    Args:
        fit: of `fit`.
        split: the split whose first fold figures show.
        sample: whether hyperparameters are also sampled on that fold; elsewhere they are at their mode.
        seed: of the splits and the sampler.

    Returns:
        The same fit with the Gaussian processes added.

    Raises:
        InputError: there is no such split, or there are more samples than an exact process accepts (8000).
    """
    _choose("split", split, get_args(SplitKind))
    run, training = fit.run, Training(split, seed, sample)
    return Fit(replace(run, gp=validate(run.model, run.observations, run.mle, run.card.gp_inputs, training)))


def diagnose(
    records: Sequence[FlightRecord],
    card: str | Card = "attas",
    *,
    model: Model | None = None,
    candidates: Sequence[Effect] = (),
    seed: int = 0,
    process_noise: bool | None = None,
    **settings: Any,
) -> Diagnosed:
    """Find the effects that a model lacks.

    This does not choose test points, simulate trajectories or write files; `bayes-aero diagnose` does. The health of
    channels and the agreement of sensors are checked: see `Diagnosed.doubts`.

    Args:
        records: one per manoeuvre.
        card: a `Card`, the name of a shipped one or a path.
        model: default: the card's model.
        candidates: your own effects, screened in addition to the catalogue.
        seed: of the noise replicates.
        process_noise: True estimates gusts and compares the model with innovations; None: if the records are in gusts.
        settings: thresholds of the diagnosis by name, e.g. `max_effects`, the effects that each stage may add.

    Returns:
        The diagnosis; sizes in SI and radians.

    Raises:
        InputError: the records lack a channel that the model needs, or numbers in it.
    """
    for name in settings:
        _choose("setting", name, SETTINGS)
    card = _card(card)
    records = _sound(records, card)
    if model is None:
        card, _ = on_recorded_axes(card, records)
    chosen = DiagnosisSettings(**settings, process_noise=process_noise)
    diagnosis = run_diagnosis(records, card, model=model, settings=chosen, seed=seed, extra=candidates)
    errors = errors_of_diagnosis(diagnosis) if diagnosis.by_coefficients else None
    return Diagnosed(view_of(diagnosis), card, record_checks(records, card, seed, errors=errors, seek=False))


def _sound(records: Sequence[FlightRecord], card: Card) -> list[FlightRecord]:
    """The records as a file of theirs would be read: without optional channels that are no numbers."""
    sound = [without_bad_options(record, card.channels) for record in records]
    for record in sound:
        check_arrays(record, card.channels)
    return sound


def _card(card: str | Card) -> Card:
    return card if isinstance(card, Card) else read_card(card)


# --- What the Python interface returns: a fit and a diagnosis, with their tables, sentences and figures.


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
        return [*self.run.failures, *_doubts(self.run.health, self.run.consistency, corrects=False)]

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
        """`no_effect`, `explained`, `partly_explained`, `unexplained`, `undecided` or `unreliable`."""
        return self.view.diagnosis.verdict.value

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes in the order of selection."""
        return tuple(cause.name for cause in self.view.diagnosis.causes)

    @property
    def sentences(self) -> list[str]:
        """Doubts about the records, then the verdict, one sentence or two per cause, unexplained structure, what is not
        testable, notes."""
        return [*self.doubts, *sentences(self.view.diagnosis, self.view.trajectories)]

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
    def by_coefficients(self) -> View:
        """What the coefficients say; `InputError` where trajectories alone were compared."""
        if not isinstance(self.view, View):
            raise InputError("this diagnosis rests on trajectories alone: the records lack what coefficients need")
        return self.view

    def scores(self) -> pd.DataFrame:
        """Scores of the card's and the extended model.

        Returns:
            A row per model, data (`fitted` or `hold_out`), manoeuvre and coefficient.
        """
        return scores_frame(holdout_scores(self.by_coefficients))

    def screen(self) -> pd.DataFrame:
        """Every candidate of the catalogue.

        Returns:
            A row per candidate; columns for deviance, score and family-wise p-value.
        """
        return screen_table(self.view.rankings, self.view.diagnosis).frame()


def plot(result: Fit | Diagnosed, figure: str | None = None, *, width: float | None = None) -> Figure:
    """Draw a figure of a result.

    Args:
        result: of `fit` or `diagnose`.
        figure: a name in `FIGURES` or, of a diagnosis, `DIAGNOSIS_FIGURES` of `bayes_aero.report.figures.every_figure`;
            default: "forest" or "measured_simulated".
        width: in inches; the text keeps its size. 10 fits a notebook's column.

    Returns:
        A matplotlib figure.

    Raises:
        InputError: there is no such figure, or it has nothing to show.
    """
    if isinstance(result, Fit):
        figures, shown, name = FIGURES, result.run, figure or "forest"
    else:
        figures, shown, name = DIAGNOSIS_FIGURES, result.by_coefficients, figure or "measured_simulated"
    _choose("figure", name, figures)
    try:
        drawn = cast(Any, figures[name])(shown)
    except NotDrawn as reason:
        raise InputError(f"the figure {name} has nothing to show: {reason}") from None
    if width is not None:
        drawn_width, height = drawn.get_size_inches()
        drawn.set_size_inches(width, height * width / drawn_width)
    return drawn


def _doubts(health: Sequence[HealthFinding], agreement: Consistency | None, *, corrects: bool) -> list[str]:
    doubts = [finding.sentence for finding in health]
    if agreement is not None and agreement.disagrees:
        doubts += consistency_sentences(agreement, corrects=corrects)[:1]
    return doubts


def _choose(what: str, given: str, names: Collection[str]) -> None:
    if given not in names:
        raise InputError(f"there is no {what} {given!r}; choose one of {', '.join(names)}")
