"""The job of `bayes-aero fly`: parameters fitted to trajectories by output error; numbers are on disk first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayes_aero.diagnosis.consistency import in_gusts
from bayes_aero.diagnosis.trajectories.motion import motion_of
from bayes_aero.diagnosis.trajectories.results import FITTED
from bayes_aero.diagnosis.trajectories.trajectories import fit_disagreements, still_apart
from bayes_aero.dynamics.flight import DERIVED
from bayes_aero.dynamics.output_channels import OF_AXIS
from bayes_aero.errors import attempted
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import only_following
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.io.fly_json import RESULTS, Flight, fly_results
from bayes_aero.jobs.io.output_folder import writable
from bayes_aero.jobs.io.time_histories import flights, put_histories
from bayes_aero.jobs.options import FlyOptions, keywords
from bayes_aero.jobs.provenance import provenance, write_json
from bayes_aero.jobs.steps.flights import (
    check_band,
    coefficient_fit,
    flown_dynamics,
    output_error_fit,
    process_noise,
    setting_of,
    with_posterior,
)
from bayes_aero.jobs.steps.record_checks import record_checks, usable_for
from bayes_aero.model.joined_records import on_recorded_axes
from bayes_aero.progress import Progress
from bayes_aero.report.figures.every_figure import draw_all
from bayes_aero.report.figures.posterior import one_step_quantiles, pair_of
from bayes_aero.report.figures.time_histories import fly_figures, gusts
from bayes_aero.report.frequency import FREQUENCY_FIGURES, frequency_sentences
from bayes_aero.report.html.page import put_page
from bayes_aero.report.motion import motion_sentences
from bayes_aero.report.pages.fly import FlyContext, fly_page
from bayes_aero.report.style import MOST_MANOEUVRES
from bayes_aero.report.tables.fly import gust_table, parameter_table, posterior_table
from bayes_aero.report.tables.table import write_csv
from bayes_aero.report.text.fly import (
    disagreement_sentences,
    fly_sentences,
    gust_sentences,
    process_noise_sentences,
    settled_sentences,
)

DISTURBED = {"gusts": gusts, "one_step": one_step_quantiles}


@keywords(FlyOptions)
def fly(
    records: Sequence[FlightRecord],
    card: Card,
    options: FlyOptions = FlyOptions(),
    *,
    out: Path | None = None,
    progress: Progress | None = None,
) -> Flight:
    """Fit the card's model to the trajectories of the records (output error), as `bayes-aero fly` does.

    A model of effects starts from the card's values and, if coefficients can be formed, also from their fit.

    Args:
        records: flights, fitted jointly.
        card: one with a model of effects or a linear one.
        options: the settings; instead of them their names may be given, e.g. `fly(records, card, windows=5.0)`.
        out: a folder for trajectories.json, parameters.csv, histories.nc, figures and report.html; None writes nothing.
        progress: called with a stage and the share of it that is done.

    Returns:
        The fit (`flown.fit` has estimates, standard errors and `det_R`) with its findings. SI and radians.

    Raises:
        InputError: the records cannot be simulated with the card, or a setting is unknown.

    Source:
        Jategaonkar, Flight Vehicle System Identification, 2nd ed. 2015, ch. 4.
    """
    setting = setting_of(options, card)
    check_band(options.frequency, records, card, flown=True)
    card, left_out = on_recorded_axes(card, records, OF_AXIS, DERIVED)
    flights, dynamics, notes = flown_dynamics(records, card, setting.outputs or (), path=options.flight_path)
    if out is not None:
        writable(out)
    if progress:
        progress("do the sensors agree?", 0.0)
    checks, asked = record_checks(records, card, options.seed, out), options.process_noise is None
    gusts = in_gusts(records, card, options.seed) if asked and checks.consistency.recorded else {}
    options = replace(options, process_noise=True) if gusts else options
    coefficients, failed = coefficient_fit(records, card, options, out, progress)
    flown = output_error_fit(flights, dynamics, card, coefficients, options, progress)
    flown = replace(flown, following=only_following(checks.health))
    apart = () if coefficients is None else fit_disagreements(coefficients, flown)
    disputed = asked and not gusts and bool(apart)
    options = replace(options, process_noise=bool(options.process_noise) or disputed)
    chosen = {} if setting.outputs is None else {"outputs": list(setting.outputs)}
    source = provenance(card, records, options.seed, options.settings | chosen, options)
    (beside, sample), more = process_noise(flown, options, card, out, progress)
    notes = [*left_out, *notes, *(said for fit in flown.frequency for said in frequency_sentences(fit))]
    if options.process_noise and not flown.converged:
        notes.append("Process noise was not fitted, because output error did not converge.")
    moves, unmoved = attempted("Modes of motion were not found", lambda: motion_of(flown, beside), None, out)
    hindered = usable_for(records, card).get("diagnose", "")
    said = (
        *gust_sentences(gusts, beside),
        *settled_sentences(apart, beside, still_apart(apart, beside), asked=disputed),
        *(() if beside is None else process_noise_sentences(beside, flown)),
        *fly_sentences(flown, hindered, disturbed=bool(options.process_noise)),
        *disagreement_sentences(apart, hindered),
        *motion_sentences(moves),
    )
    failed = (*checks.failures, *failed, *more, *unmoved)
    found = Flight(flown, said, tuple(notes), checks.health, checks.consistency, failed, apart, beside, motion=moves)
    files = None if out is None else FlightFiles(out, card, records, source)
    if sample is not None:
        found = with_posterior(found, sample, card, out, files.put if files else lambda _: None)
    return found if files is None else files.write(found, figures=options.figures, progress=progress)


class FlightFiles:
    """What a fit to trajectories writes into `out`: numbers first, then what shows them."""

    def __init__(self, out: Path, card: Card, records: Sequence[FlightRecord], source: dict[str, Any]) -> None:
        self.out, self.card, self.records, self.source = out, card, records, source

    def put(self, found: Flight) -> None:
        """Tables, a file of each sampler and trajectories.json; posteriors of an earlier run go."""
        out = self.out
        write_csv(parameter_table(found.flown), out / "parameters.csv")
        if found.process_noise is not None and found.process_noise.histories:
            write_csv(gust_table(found.process_noise), out / "gusts.csv")
        for name in ("posterior_nuts.nc", "posterior_emcee.nc", "posterior.csv"):
            (out / name).unlink(missing_ok=True)
        for engine, posterior in found.posteriors.items():
            posterior.save(out / f"posterior_{engine}.nc")
        if found.posteriors:
            write_csv(posterior_table(found.posteriors), out / "posterior.csv")
        self._noted(found)

    def _noted(self, found: Flight, said: Sequence[str] = (), failures: Sequence[str] = ()) -> Flight:
        """trajectories.json, with what could not be drawn or shown after the numbers."""
        found = replace(found, notes=(*found.notes, *said), failures=(*found.failures, *failures))
        write_json(fly_results(found, self.card, self.records, self.source), self.out / RESULTS)
        return found

    def write(self, found: Flight, *, figures: bool, progress: Progress | None) -> Flight:
        """Everything; the fit with what could not be made."""
        self.put(found)
        together = [replace(path, split=FITTED) for path in found.flown.paths]  # first values and fit side by side
        failed = put_histories(lambda: flights(together, found.flown.units), self.out)
        drawn: list[Path] = []
        if figures:
            every: list[tuple[Any, Any]] = [(fly_figures(found.flown) | FREQUENCY_FIGURES, found.flown)]
            every += [] if found.process_noise is None else [(DISTURBED, found.process_noise)]
            every += [({"pair": pair_of}, found.posteriors)] if found.posteriors else []
            for number, (drawings, shown) in enumerate(every):
                paths, more = draw_all(drawings, shown, self.out / "figures", None if number else progress)
                drawn, failed = [*drawn, *paths], (*failed, *more)
        many = figures and len(self.records) > MOST_MANOEUVRES
        said = [f"Figures are drawn for up to {MOST_MANOEUVRES} manoeuvres."] if many else []
        found = self._noted(found, said, failed) if said or failed else found
        if progress:
            progress("report", 0.95)
        context = FlyContext(
            self.card,
            self.records,
            self.source,
            found.sentences,
            found.notes,
            {path.stem: path for path in drawn},
            found.consistency,
            found.failures,
            found.health,
            found.process_noise,
            found.posteriors,
            found.motion,
        )
        failed = put_page(lambda: fly_page(found.flown, context), self.out)
        return self._noted(found, (), failed) if failed else found
