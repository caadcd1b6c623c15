"""The main job: records in, parameters with uncertainty out, every finished stage on disk before the next begins."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from bayes_aero.diagnosis.flights import fly_given
from bayes_aero.diagnosis.trajectory_result import SimulatedManoeuvre
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card import Card
from bayes_aero.flight.reading import rate_notes
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.calibration import pit_of, prior_sensitivity, stall_of_run
from bayes_aero.inference.ensemble import density_start, other_modes, sample_ensemble, search_modes
from bayes_aero.inference.frequency import coefficients_in_band
from bayes_aero.inference.mle import MAX_SEPARATE_FITS, fit_each_manoeuvre, fit_mle, without_noise_bias
from bayes_aero.inference.nuts import sample_nuts
from bayes_aero.inference.pooled import check_manoeuvres, next_flight
from bayes_aero.inference.results import Identification, NextFlight, Posterior
from bayes_aero.inference.validation import Training, filter_mismatch_notes, validate
from bayes_aero.jobs.io.identification_json import IdentificationFiles
from bayes_aero.jobs.io.time_histories import identified, put_histories
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.jobs.provenance import provenance
from bayes_aero.jobs.steps.record_checks import record_checks, repaired
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Density, Noise
from bayes_aero.model.observations import Forming, despiked, join, observe
from bayes_aero.model.records import on_recorded_axes
from bayes_aero.physics.aircraft import FLIGHT
from bayes_aero.progress import Progress
from bayes_aero.report.figures.every_figure import FIGURES, draw_all
from bayes_aero.report.html.page import put_page
from bayes_aero.report.pages.estimates import frequency_sentences, leaning_sentences
from bayes_aero.report.pages.identification import identification_page
from bayes_aero.report.style import MOST_MANOEUVRES
from bayes_aero.residuals.equation_error import Band, lines_in


def identify(
    records: Sequence[FlightRecord],
    card: Card,
    options: IdentifyOptions = IdentifyOptions(),
    *,
    out: Path | None = None,
    truth: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> Identification:
    """Fit, sample and compare, as `bayes-aero identify` does; with `out` every stage is written as it ends.

    `truth` has the parameters that simulated records were flown with: they are shown beside the estimates.
    """
    job = _Job(records, card, options, out, progress)
    job.fit(truth)
    if options.frequency is not None:
        job.fit_in_band(options.frequency)
    if options.next_flight:
        job.pool()
    if out is not None:  # they are for the page and the file alone
        job.fly()
    if options.sample:
        job.sample()
    if options.gp:
        job.train_gp()
    # CLmax and its angle from the first posterior that converged.
    job.add(stall=job.stage("stall", "Stall left out", lambda: stall_of_run(job.run)))
    job.show()
    return job.run


class _Job:
    """An identification in work: every step adds to `run`, and puts on disk what it has found."""

    run: Identification

    def __init__(
        self,
        records: Sequence[FlightRecord],
        card: Card,
        options: IdentifyOptions,
        out: Path | None,
        progress: Progress | None,
    ) -> None:
        if options.frequency is not None:
            for record in records:  # refuses a band in which it has no frequency
                lines_in(options.frequency, record.n, record.dt, record.name)
        if options.next_flight:
            check_manoeuvres(len(records))
        card, self.left_out = on_recorded_axes(card, records)
        self.records, self.card, self.options, self.out, self.progress = records, card, options, out, progress
        self.model = Model.from_card(card)
        self.repaired, self.spikes = repaired(records)
        self.observations = observe(self.repaired, card, self.model, Forming(options.coefficients))
        self.seconds: dict[str, float] = {}
        self.files = IdentificationFiles(out, provenance(card, records, options.seed, options.settings, options))

    def attempt(self, what: str, do: Callable[[], Any], otherwise: Any) -> tuple[Any, tuple[str, ...]]:
        """What `do` returns or, if it fails unexpectedly, `otherwise` and the reason."""
        return attempted(what, do, otherwise, self.out, own=bool(self.card.effect_files))

    def add(self, notes: Sequence[str] = (), failures: Sequence[str] = (), **changes: Any) -> None:
        """Put more into the run."""
        run = self.run
        self.run = replace(run, notes=(*run.notes, *notes), failures=(*run.failures, *failures), **changes)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Tell when a stage begins and ends, and keep how long it took."""
        if self.progress:
            self.progress(stage, 0.0)
        began = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - began
        if self.progress:
            self.progress(stage, 1.0)

    def stage(self, name: str, left_out: str, do: Callable[[], Any], *, bad: str = "") -> Any:
        """What a stage returns, or None where it fails, with a note; for bad input by the form of a note `bad`."""
        with self.timed(name):
            try:
                found, failed = self.attempt(left_out, do, None)
            except InputError as error:
                if not bad:
                    raise
                found, failed = None, ()
                self.add((bad.format(left_out, error),))
        self.add((), failed)
        return found

    def fit(self, truth: Mapping[str, float] | None) -> None:
        """Maximum likelihood, of all manoeuvres and of each alone; the sensors are compared before."""
        model, observations, seed = self.model, self.observations, self.options.seed
        forming = Forming(self.options.coefficients)
        with self.timed("do the sensors agree?"):
            checks = record_checks(self.records, self.card, seed, self.out)
            failures = checks.failures
        matched = forming is Forming.MATCHED
        with self.timed("mle"):
            mle = raw = fit_mle(model, observations, seed=seed)
            if matched:
                mle, failed = self.attempt(
                    "The bias from sensor noise was not subtracted from the estimates",
                    lambda: without_noise_bias(raw, self.repaired, self.card, model, seed=seed),
                    raw,
                )
                failures += failed
            alone, failed = self.attempt(
                "Manoeuvres were not fitted alone", lambda: fit_each_manoeuvre(model, observations, seed=seed), {}
            )
            failures += failed
            preparation = () if matched else filter_mismatch_notes(self.repaired, self.card, model, mle)
        rates, many = rate_notes(self.records) if matched else (), len(self.records)
        said = []
        if many > MAX_SEPARATE_FITS:
            said.append(f"{many} manoeuvres are fitted jointly; beyond {MAX_SEPARATE_FITS} none is fitted by itself.")
        if many > MOST_MANOEUVRES:
            said.append(f"Figures with a panel for each manoeuvre are drawn for up to {MOST_MANOEUVRES} of them.")
        self.run = Identification(
            self.card,
            model,
            tuple(self.records),
            observations,
            Colour(self.options.noise),
            mle,
            alone,
            {},
            notes=(*self.left_out, *self.spikes, *rates, *said),
            failures=failures,
            health=checks.health,
            preparation=preparation,
            consistency=checks.consistency,
            truth=truth,
            seconds=self.seconds,
            forming=forming,
        )
        self.files.stage(self.run)

    def fit_in_band(self, band: Band) -> None:
        """The same parameters in the frequency domain."""
        with self.timed("frequency domain"):
            seed = self.options.seed
            found = coefficients_in_band(self.repaired, self.card, self.model, self.run.mle, band, seed=seed)
        self.add(frequency_sentences(found), frequency=found)
        self.files.stage(self.run)

    def pool(self) -> None:
        """Partial pooling of the manoeuvres, and the next flight."""
        do = partial(pooled_manoeuvres, self.run, self.repaired, seed=self.options.seed, progress=self.progress)
        self.add(next_flight=self.stage("next flight", "The next flight was left out", do, bad="{}: {}."))
        self.files.stage(self.run)

    def fly(self) -> None:
        """Simulate the fitted model from measured initial states with the recorded inputs, where there are all."""
        assert self.out is not None
        values = dict(zip(self.run.mle.names, map(float, self.run.mle.estimate), strict=True))
        bands = {name: tolerance.value for name, tolerance in self.card.tolerances.items()}

        def flown() -> tuple[SimulatedManoeuvre, ...]:
            return fly_given(despiked(join(self.records, self.card, FLIGHT))[0], self.model, values, bands)

        self.files.flown = self.stage("flights", "The identified model was not flown", flown, bad="{}: {}") or ()
        self.add((), put_histories(lambda: identified(self.run), self.out))
        self.files.stage(self.run)

    def sample(self) -> None:
        """The posteriors, one after the other."""
        for key, colour, engine in posterior_plan(Colour(self.options.noise)):
            left_out = f"The posterior by {key} under {colour.value} noise was not sampled"
            found = self.stage(key, left_out, partial(self.posterior, key, colour, engine))
            if found is not None:
                self.add(found[1], posteriors=self.run.posteriors | {key: found[0]})
                self.files.stage(self.run, posterior_name=key)

    def posterior(self, key: str, colour: Colour, engine: Any) -> tuple[Posterior, tuple[str, ...]]:
        """A posterior, with what is said of its other modes and of the priors that it leans on."""
        run, seed = self.run, self.options.seed
        density = Density.of(run.observations, run.model, Noise(colour), run.mle.bias)
        mode = search_modes(density, density_start(density, run.mle), run.observations.n, seed=seed)
        found = engine(density, mode, seed=seed, progress=self.progress)
        told = other_modes(mode, f"{key}, {colour.value} noise")
        if run.mle.conflicts and key == "emcee":
            told += leaning_sentences(prior_sensitivity(density, found), run.mle.conflicts)
        return found, told

    def train_gp(self) -> None:
        """Gaussian processes beside maximum likelihood; too many samples for the exact process are a note."""
        training = Training(self.options.split, self.options.seed)
        asked = (self.model, self.observations, self.run.mle, self.card.gp_inputs, training, self.progress)
        report = self.stage("gp", "Gaussian process left out", partial(validate, *asked), bad="{}: {}")
        self.add(() if report is None else report.left_out, gp=report)
        self.files.stage(self.run, gp_done=True)

    def show(self) -> None:
        """Figures and the page; then nothing is left of earlier runs."""
        options, out, drawn = self.options, self.out, []
        if options.figures and out is not None:
            with self.timed("figures"):
                left_out = "The probability integral transform was left out"
                pit, failed = self.attempt(left_out, partial(pit_of, self.run), None)
                self.add((), failed, pit=pit)
                drawn, failed = draw_all(FIGURES, self.run, out / "figures", self.progress)
            self.add((), failed)
        self.files.stage(self.run)
        if options.page and out is not None:
            shown = (self.files.source, {p.stem: p for p in drawn}, self.files.flown)
            with self.timed("report"):
                failed = put_page(lambda: identification_page(self.run, *shown), out)
            if failed:
                self.add((), failed)
                self.files.stage(self.run)
        self.files.remove_older(self.run, page=options.page, figures=options.figures)


def posterior_plan(noise: Colour) -> list[tuple[str, Colour, Any]]:
    """Which posteriors are sampled, under which noise model and by which engine."""
    plan = [("emcee", noise, sample_ensemble), ("nuts", noise, sample_nuts)]
    return plan if noise is Colour.WHITE else [*plan, ("white", Colour.WHITE, sample_ensemble)]


# --- Several manoeuvres of an identification: what they say of the next flight.


def pooled_manoeuvres(
    run: Identification, without_spikes: Sequence[FlightRecord], *, seed: int = 0, progress: Progress | None = None
) -> NextFlight:
    """Pool the manoeuvres of a run, without the bias of sensor noise; `without_spikes` are its records as fitted."""
    alone = run.alone
    if run.forming is Forming.MATCHED:  # the joint fit, beside which they stand, has no such bias either
        alone = {
            name: without_noise_bias(fit, [record], run.card, run.model, seed=seed)
            for (name, fit), record in zip(alone.items(), without_spikes, strict=True)
        }
    return next_flight(run.model, run.observations, alone, seed=seed, progress=progress)
