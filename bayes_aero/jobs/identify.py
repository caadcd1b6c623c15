"""The main job: records in, parameters with uncertainty out, every finished stage on disk before the next begins."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from bayes_aero.diagnosis.result import SimulatedManoeuvre
from bayes_aero.diagnosis.trajectories import fly_given
from bayes_aero.flight.card import Card
from bayes_aero.flight.reading import rate_notes
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.frequency import coefficients_in_band
from bayes_aero.inference.gp import Training, validate
from bayes_aero.inference.mle import (
    MAX_SEPARATE_FITS,
    filter_mismatch_notes,
    fit_each_manoeuvre,
    fit_mle,
    stall_of_run,
    without_noise_bias,
)
from bayes_aero.inference.pooled import check_manoeuvres, next_flight
from bayes_aero.inference.results import Identification, NextFlight, Posterior
from bayes_aero.inference.sampling import (
    PosteriorMode,
    density_start,
    other_modes,
    pit_of,
    prior_sensitivity,
    sample_ensemble,
    sample_nuts,
    search_modes,
)
from bayes_aero.jobs.check import record_checks, repaired
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.jobs.results import identified, put_histories, results, save_gp, write_identification
from bayes_aero.jobs.store import Growing, older_files, provenance, remove_older, writable, write_json
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Colour, Density, Noise, despiked, join, observe
from bayes_aero.model.records import Forming, on_recorded_axes
from bayes_aero.physics.aircraft import FLIGHT
from bayes_aero.processes import blas_threads
from bayes_aero.progress import Progress, quiet
from bayes_aero.report.figures.every_figure import FIGURES, draw_all
from bayes_aero.report.page import put_page
from bayes_aero.report.pages.estimates import frequency_sentences, leaning_sentences, verdict
from bayes_aero.report.pages.identification import identification_page
from bayes_aero.report.style import MOST_MANOEUVRES
from bayes_aero.residuals.equation_error import Band, lines_in

OLDER = (
    *(f"posterior_{key}.nc" for key in ("emcee", "nuts", "white")), "gpr.nc", "validation.csv", "next_flight.csv",
    "next_flight.nc", "report.html", *(f"figures/{name}.png" for name in FIGURES),
)  # fmt: skip


def identify(
    records: Sequence[FlightRecord],
    card: Card,
    options: IdentifyOptions = IdentifyOptions(),
    *,
    out: Path | None = None,
    truth: Mapping[str, float] | None = None,
    progress: Progress = quiet,
) -> Identification:
    """As `bayes-aero identify` does; with `out` every stage is written as it ends. `truth`: of simulated records."""
    job = IdentificationJob(records, card, options, out=out, progress=progress)
    job.fit(truth)
    if options.frequency is not None:
        job.fit_in_band(options.frequency)
    if options.next_flight:
        job.pool()
    if out is not None:  # they are for the page and the file alone
        job.fly(out)
    if options.sample:
        job.sample()
    if options.gp:
        job.train_gp()
    # CLmax and its angle from the first posterior that converged.
    job.keep(stall=job.stage("stall", "Stall left out", lambda: stall_of_run(job.result)))
    if out is not None:
        job.show(out)
        remove_older(job.older)
    return job.result


class IdentificationJob(Growing[Identification]):
    def __init__(
        self,
        records: Sequence[FlightRecord],
        card: Card,
        options: IdentifyOptions,
        *,
        model: Model | None = None,
        out: Path | None = None,
        progress: Progress = quiet,
    ) -> None:
        if options.frequency is not None:
            for record in records:  # refuses a band in which it has no frequency
                lines_in(options.frequency, record.n, record.dt, record.name)
        if options.next_flight:
            check_manoeuvres(len(records))
        card, self.left_out = on_recorded_axes(card, records) if model is None else (card, ())
        self.options, self.progress = options, progress
        self.model = model or Model.from_card(card)
        self.repaired, self.spikes = repaired(records)
        self.observations = observe(self.repaired, card, self.model, Forming(options.coefficients))
        self.seconds: dict[str, float] = {}
        self.flown: tuple[SimulatedManoeuvre, ...] = ()
        super().__init__(card, records, out, provenance(card, records, options.seed, options.settings, options))
        if out is not None:
            writable(out)
            self.older = older_files(out, OLDER)

    def write(self, out: Path) -> None:
        write_identification(self.result, out)
        write_json(results(self.result, verdict(self.result), self.source, self.flown), out / "results.json")

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Tell when a stage begins and ends, and keep how long it took."""
        self.progress(stage, 0.0)
        began = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - began
        self.progress(stage, 1.0)

    def stage(self, name: str, left_out: str, do: Callable[[], Any], *, bad: str = "") -> Any:
        """What a stage returns, or None where it fails, with a note; for bad input by the form of a note `bad`."""
        with self.timed(name):
            return self.attempt(left_out, do, bad=bad)

    @blas_threads(0)
    def fit(self, truth: Mapping[str, float] | None = None, **checks: Any) -> None:
        """Maximum likelihood, of all manoeuvres and of each alone; the sensors are compared before."""
        model, observations, seed = self.model, self.observations, self.options.seed
        forming, many = Forming(self.options.coefficients), len(self.records)
        matched = forming is Forming.MATCHED
        with self.timed("do the sensors agree?"):
            checked = record_checks(self.records, self.card, seed, self.out, **checks)
        notes = []
        if many > MAX_SEPARATE_FITS:
            notes.append(f"{many} manoeuvres are fitted jointly; beyond {MAX_SEPARATE_FITS} none is fitted by itself.")
        if many > MOST_MANOEUVRES:
            notes.append(f"Figures with a panel for each manoeuvre are drawn for up to {MOST_MANOEUVRES} of them.")
        with self.timed("mle"):
            raw = fit_mle(model, observations, seed=seed)
            self.result = Identification(
                self.card,
                model,
                tuple(self.records),
                observations,
                Colour(self.options.noise),
                raw,
                {},
                {},
                notes=(*self.left_out, *self.spikes, *(rate_notes(self.records) if matched else ()), *notes),
                **vars(checked),  # failures, health, consistency
                truth=truth,
                seconds=self.seconds,
                forming=forming,
            )
            if matched:
                what = "The bias from sensor noise was not subtracted from the estimates"
                correct = partial(without_noise_bias, raw, self.repaired, self.card, model, seed=seed)
                self.result = replace(self.result, mle=self.attempt(what, correct, raw))
            each = partial(fit_each_manoeuvre, model, observations, seed=seed)
            alone = self.attempt("Manoeuvres were not fitted alone", each, {})
            preparation = () if matched else filter_mismatch_notes(self.repaired, self.card, model, raw)
        self.keep(alone=alone, preparation=preparation)

    def fit_in_band(self, band: Band) -> None:
        with self.timed("frequency domain"):
            seed = self.options.seed
            in_band = coefficients_in_band(self.repaired, self.card, self.model, self.result.mle, band, seed=seed)
        self.keep(frequency_sentences(in_band), frequency=in_band)

    def pool(self) -> None:
        do = partial(pooled_manoeuvres, self.result, self.repaired, seed=self.options.seed, progress=self.progress)
        pooled = self.stage("next flight", "The next flight was left out", do, bad="{}: {}.")
        if pooled is not None and self.out is not None:
            pooled.save(self.out / "next_flight.nc")
        self.keep(next_flight=pooled)

    def fly(self, out: Path) -> None:
        """Simulate the fitted model from measured initial states with the recorded inputs, where there are all."""
        values = dict(zip(self.result.mle.names, map(float, self.result.mle.estimate), strict=True))
        bands = {name: tolerance.value for name, tolerance in self.card.tolerances.items()}

        def flown() -> tuple[SimulatedManoeuvre, ...]:
            return fly_given(despiked(join(self.records, self.card, FLIGHT))[0], self.model, values, bands)

        self.flown = self.stage("flights", "The identified model was not flown", flown, bad="{}: {}") or ()
        self.keep((), put_histories(lambda: identified(self.result), out))

    @blas_threads(0)
    def sample(self) -> None:
        options = {"seed": self.options.seed, "progress": self.progress, "modes": {}}
        for key, colour, engine in posterior_plan(Colour(self.options.noise)):
            left_out = f"The posterior by {key} under {colour.value} noise was not sampled"
            do = partial(sampled, self.result, key, colour, engine, **options)
            if (sampling := self.stage(key, left_out, do)) is not None:
                if self.out is not None:
                    sampling[0].save(self.out / f"posterior_{key}.nc")
                self.keep(sampling[1], posteriors=self.result.posteriors | {key: sampling[0]})

    def train_gp(self) -> None:
        training = Training(self.options.split, self.options.seed)
        arguments = (self.model, self.observations, self.result.mle, self.card.gp_inputs, training, self.progress)
        report = self.stage("gp", "Gaussian process left out", partial(validate, *arguments), bad="{}: {}")
        if report is not None and self.out is not None:
            save_gp(report, self.out / "gpr.nc")
        self.keep(() if report is None else report.left_out, gp=report)

    def show(self, out: Path) -> None:
        options, drawn = self.options, []
        if options.figures:
            with self.timed("figures"):
                left_out = "The probability integral transform was left out"
                self.keep(pit=self.attempt(left_out, partial(pit_of, self.result)))
                drawn, failed = draw_all(FIGURES, self.result, out / "figures", self.progress)
            self.keep((), failed)
        if options.page:
            shown = (self.source, {p.stem: p for p in drawn}, self.flown)
            with self.timed("report"):
                self.fail(put_page(lambda: identification_page(self.result, *shown), out))


def sampled(
    run: Identification,
    key: str,
    colour: Colour,
    engine: Any,
    *,
    seed: int,
    progress: Progress = quiet,
    modes: dict[Colour, PosteriorMode] | None = None,
) -> tuple[Posterior, tuple[str, ...]]:
    """A posterior and notes on it; `modes` keeps what was sought, for the next engine."""
    density = Density.of(run.observations, run.model, Noise(colour), run.mle.bias)
    modes = {} if modes is None else modes
    if colour not in modes:
        modes[colour] = search_modes(density, density_start(density, run.mle), run.observations.n, seed=seed)
    mode = modes[colour]
    posterior = engine(density, mode, seed=seed, progress=progress)
    notes = other_modes(mode, f"{key}, {colour.value} noise")
    if run.mle.conflicts and key == "emcee":
        notes += leaning_sentences(prior_sensitivity(density, posterior), run.mle.conflicts)
    return posterior, notes


def posterior_plan(noise: Colour) -> list[tuple[str, Colour, Any]]:
    plan = [("emcee", noise, sample_ensemble), ("nuts", noise, sample_nuts)]
    return plan if noise is Colour.WHITE else [*plan, ("white", Colour.WHITE, sample_ensemble)]


def pooled_manoeuvres(
    run: Identification, without_spikes: Sequence[FlightRecord], *, seed: int = 0, progress: Progress = quiet
) -> NextFlight:
    """Pool the manoeuvres of a run, without the bias of sensor noise; `without_spikes` are its records as fitted."""
    alone = run.alone
    if run.forming is Forming.MATCHED:  # the joint fit, beside which they stand, has no such bias either
        alone = {
            name: without_noise_bias(fit, [record], run.card, run.model, seed=seed)
            for (name, fit), record in zip(alone.items(), without_spikes, strict=True)
        }
    return next_flight(run.model, run.observations, alone, seed=seed, progress=progress)
