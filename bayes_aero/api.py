"""The package from Python: read, compose, fit, sample, diagnose, plot; what the command line does, in a few calls.

    import bayes_aero as ba

    card = ba.read_card("attas")
    records = ba.read(["qst01.asc", "qst02.asc"], card)
    fit = ba.sample(ba.fit(records, card), engine="emcee")
    fit.table()                                # pandas: estimates, bounds, posterior
    ba.plot(fit, "prior_posterior")            # a matplotlib figure
    ba.gpr(fit).validation()                   # regression beside it, scored on data held back in three ways
    ba.diagnose(records, card).table()         # what is missing from the model, and how large it is

Results hold everything in SI and radians; tables say the units.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar, get_args

import pandas as pd
from matplotlib.figure import Figure

from bayes_aero.criticism.consistency import consistency
from bayes_aero.criticism.diagnosis import diagnose as run_diagnosis
from bayes_aero.criticism.settings import DiagnosisSettings
from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card, read_card
from bayes_aero.flight.health import channel_health
from bayes_aero.flight.reading import read_records
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.ensemble import sample_ensemble
from bayes_aero.inference.identification import Identification
from bayes_aero.inference.laplace import density_start, other_modes, search_modes
from bayes_aero.inference.mle import MleResult, fit_alone, fit_mle
from bayes_aero.inference.noise_bias import without_noise_bias
from bayes_aero.inference.nuts import sample_nuts
from bayes_aero.inference.posterior import Posterior
from bayes_aero.inference.splits import SplitKind
from bayes_aero.inference.validation import validate
from bayes_aero.model.density import Density
from bayes_aero.model.model import Model
from bayes_aero.model.noise import DEFAULT as DEFAULT_NOISE
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import Forming, observe
from bayes_aero.report.diagnosed import DiagnosisView, View, view_of
from bayes_aero.report.figures import DIAGNOSIS_FIGURES, FIGURES
from bayes_aero.report.frames_diagnosis import causes_frame, screen_frame
from bayes_aero.report.style import NotDrawn
from bayes_aero.report.tables import parameter_table, validation_table
from bayes_aero.report.unseen import scores_frame
from bayes_aero.report.words import verdict
from bayes_aero.report.words_consistency import consistency_sentences
from bayes_aero.report.words_diagnosis import sentences
from bayes_aero.studies.outlook import predictors
from bayes_aero.studies.repair import repaired

__all__ = ["Diagnosed", "Fit", "diagnose", "fit", "gpr", "plot", "read", "sample"]

Engine = Literal["emcee", "nuts"]
NoiseName = Literal["white", "ar1", "buffet-ar1"]
FormingName = Literal["matched", "published"]
Shown = TypeVar("Shown")
ENGINES = {"emcee": sample_ensemble, "nuts": sample_nuts}


@dataclass(frozen=True)
class Fit:
    """A model fitted to records: maximum likelihood, and the posteriors sampled so far."""

    run: Identification

    @property
    def mle(self) -> MleResult:
        """Estimates, Cramer-Rao and colour-corrected bounds, residual covariance, status."""
        return self.run.mle

    @property
    def posteriors(self) -> Mapping[str, Posterior]:
        """Posteriors by engine (`emcee`, `nuts`; `white` beside a coloured one), each with its ArviZ DataTree."""
        return self.run.posteriors

    @property
    def sentences(self) -> list[str]:
        """Doubts of the records first; then what the numbers say, and where methods disagree."""
        return [*self.doubts, *verdict(self.run)]

    @property
    def doubts(self) -> list[str]:
        """Faulty channels, and sensors that disagree along the flight path; empty for sound records."""
        agreement = self.run.consistency
        disagree = agreement is not None and agreement.disagrees
        answer = consistency_sentences(agreement, corrects=False)[:1] if agreement is not None and disagree else []
        return [*(finding.sentence for finding in self.run.health), *answer]

    def table(self) -> pd.DataFrame:
        """Parameters as rows; estimates, bounds, posteriors, each manoeuvre by itself as columns. SI and radians."""
        return parameter_table(self.run)

    def validation(self) -> pd.DataFrame:
        """Scores of regression (`gpr`) and of maximum likelihood on data held back, by split, fold and coefficient."""
        if self.run.gp is None:
            raise InputError("this fit has no Gaussian processes yet; add them with bayes_aero.gpr(fit)")
        return validation_table(self.run)

    def plot(self, figure: str = "forest") -> Figure:
        """One of the figures of `identify`; `bayes_aero.report.figures.FIGURES` names them."""
        return _drawn(FIGURES, figure, self.run)


@dataclass(frozen=True)
class Diagnosed:
    """What a model gets wrong, the causes found, and what the extended model gains."""

    view: DiagnosisView
    card: Card

    @property
    def verdict(self) -> str:
        """`no_effect`, `explained`, `partly_explained` or `unexplained`."""
        return self.view.diagnosis.verdict.value

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes in the order found."""
        return tuple(cause.name for cause in self.view.diagnosis.causes)

    @property
    def sentences(self) -> list[str]:
        """The verdict, a sentence for each cause, and what else the reader should know."""
        return sentences(self.view)

    def table(self) -> pd.DataFrame:
        """A row for each parameter of each cause: size, interval, probability, gain on unseen data. SI and radians."""
        return causes_frame(self.view)

    @property
    def _coefficients(self) -> View:
        if not isinstance(self.view, View):
            raise InputError("this diagnosis rests on trajectories alone: the records lack what coefficients need")
        return self.view

    def scores(self) -> pd.DataFrame:
        """Card's and extended model on each manoeuvre and coefficient, fitted to it and to the others alone."""
        return scores_frame(self._coefficients)

    def predictors(self) -> pd.DataFrame:
        """Scores on unseen data by predictor and coefficient: card's model, a Gaussian process of the card's `[gp]
        inputs`, the extended model, and that with a Gaussian process of what it leaves. Takes half a minute."""
        table = predictors(self._coefficients.diagnosis, self.card)
        rows = {(p, c): scores or {} for p, row in table.items() for c, scores in row.items()}
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["predictor", "coefficient"])

    def screen(self) -> pd.DataFrame:
        """Every candidate of the catalogue with its score and family-wise p-value."""
        return screen_frame(self.view)

    def plot(self, figure: str = "measured_simulated") -> Figure:
        """One of the figures of `diagnose`; `bayes_aero.report.figures.DIAGNOSIS_FIGURES` names them."""
        return _drawn(DIAGNOSIS_FIGURES, figure, self._coefficients)


def read(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    card: str | Card = "attas",
    *,
    resample: float | None = None,
    split: bool = False,
) -> list[FlightRecord]:
    """Read and check flight records, a manoeuvre each.

    Args:
        paths: files, or parts of them: "flight.csv@12.5:40" in seconds of the file's time.
        card: what the columns are; its `[segments]` name the manoeuvres of a file.
        resample: step in s of an even grid to interpolate onto, for records of uneven or of several rates.
        split: whether gaps in time divide a file into manoeuvres.
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
    seed: int = 0,
) -> Fit:
    """Maximum likelihood (Gauss-Newton) of `model`, by default the card's, to all records jointly and to each alone
    (up to 24 of them).

    `coefficients` are formed from signals all filtered alike (`matched`), or as the published ATTAS ones were, which
    filters the accelerations and not the controls (`published`). Isolated spikes are repaired, the health of channels
    and the agreement of sensors are checked: see `Fit.doubts`.
    """
    if coefficients not in get_args(FormingName):
        known = ", ".join(get_args(FormingName))
        raise InputError(f"there is no way of forming coefficients {coefficients!r}; choose one of {known}")
    card, forming = _card(card), Forming(coefficients)
    model = model or Model.from_card(card)
    without_spikes, spikes = repaired(records)
    observations = observe(without_spikes, card, model, forming)
    joint = fit_mle(model, observations, seed=seed)
    if forming is Forming.MATCHED:
        joint = without_noise_bias(joint, without_spikes, card, model, seed=seed)
    alone = fit_alone(model, observations, seed=seed)
    found = Identification(
        card,
        model,
        tuple(records),
        observations,
        DEFAULT_NOISE,
        joint,
        alone,
        {},
        notes=spikes,
        health=channel_health(records, card),
        consistency=consistency(records, card, seed=seed, seek=False),
        forming=forming,
    )
    return Fit(found)


def sample(fit: Fit, *, engine: Engine = "emcee", noise: NoiseName = "buffet-ar1", seed: int = 0) -> Fit:
    """The same fit with a posterior added, by emcee or by NUTS.

    Posteriors of one fit that stand beside each other have one noise model; only `white` may be added to another one
    (by emcee), as what the usual assumption would have given.
    """
    if engine not in ENGINES:
        raise InputError(f"there is no engine {engine!r}; choose one of {', '.join(ENGINES)}")
    colour, run = Colour(noise), fit.run
    beside = colour is Colour.WHITE and run.noise is not Colour.WHITE and any(k != "white" for k in run.posteriors)
    if run.posteriors and colour is not run.noise and not beside:
        raise InputError(f"this fit has posteriors under {run.noise.value} noise; sample a new fit under {noise}")
    density = Density.of(run.observations, run.model, Noise(colour), run.mle.bias)
    mode = search_modes(density, density_start(density, run.mle), run.observations.n, seed=seed)
    posterior = ENGINES[engine](density, mode, seed=seed)
    posteriors = run.posteriors | {"white" if beside else engine: posterior}
    notes = (*run.notes, *other_modes(mode, f"{engine}, {colour.value} noise"))
    return Fit(replace(run, noise=run.noise if beside else colour, posteriors=posteriors, notes=notes))


def gpr(fit: Fit, *, split: SplitKind = "random", sample: bool = True, approximate: bool = False, seed: int = 0) -> Fit:
    """The same fit with Gaussian processes of CL, CD and Cm beside it, on the card's `[gp] inputs`; takes minutes.

    They are trained on what each split keeps and scored on what it holds back: `random` samples, 4 s blocks (`block`),
    a whole manoeuvre (`manoeuvre`; two records or more). Hyperparameters are taken at their mode, and on the first fold
    of `split`, the one that figures show, sampled as well, unless `sample` is false. `approximate` allows more samples
    than the exact process can take; how far that is from it stands in the status of each coefficient.
    """
    if split not in get_args(SplitKind):
        raise InputError(f"there is no split {split!r}; choose one of {', '.join(get_args(SplitKind))}")
    run = fit.run
    report = validate(
        run.model,
        run.observations,
        run.mle,
        run.card.gp_inputs,
        chosen=split,
        sample=sample,
        approximate=approximate,
        seed=seed,
    )
    return Fit(replace(run, gp=report))


def diagnose(
    records: Sequence[FlightRecord],
    card: str | Card = "attas",
    *,
    model: Model | None = None,
    candidates: Sequence[Effect] = (),
    settings: DiagnosisSettings | None = None,
    seed: int = 0,
    max_effects: int | None = None,
) -> Diagnosed:
    """Find what `model`, by default the card's, gets wrong; `candidates` of one's own stand beside the catalogue's.

    `settings` hold every threshold of the diagnosis; `max_effects` is the one of them that is set most.

    Predictors are not compared, trajectories not flown and no files written; `bayes-aero diagnose` does that.
    """
    settings = settings or DiagnosisSettings()
    if max_effects is not None:
        settings = replace(settings, max_effects=max_effects)
    own = _card(card)
    found = run_diagnosis(records, own, model=model, extra=candidates, settings=settings, seed=seed)
    return Diagnosed(view_of(found), own)


def plot(result: Fit | Diagnosed, figure: str | None = None, *, width: float | None = None) -> Figure:
    """`result.plot(figure)`; without a name each kind of result shows its own first figure.

    `width` in inches scales the figure, its letters keep their size: 10 suits a notebook's column.
    """
    drawn = result.plot() if figure is None else result.plot(figure)
    if width is not None:
        own, height = drawn.get_size_inches()
        drawn.set_size_inches(width, height * width / own)
    return drawn


def _card(card: str | Card) -> Card:
    return card if isinstance(card, Card) else read_card(card)


def _drawn(figures: Mapping[str, Callable[[Shown], Figure]], name: str, shown: Shown) -> Figure:
    if name not in figures:
        raise InputError(f"there is no figure {name!r}; choose one of {', '.join(figures)}")
    try:
        return figures[name](shown)
    except NotDrawn as reason:
        raise InputError(f"the figure {name} has nothing to show: {reason}") from None
