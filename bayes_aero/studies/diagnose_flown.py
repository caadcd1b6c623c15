"""The diagnosis of records without accelerometers as a job: trajectories are all there is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from bayes_aero.criticism.diagnosis import judged_on_held_out_flights
from bayes_aero.criticism.finding import Diagnosis
from bayes_aero.criticism.flown import diagnose_flown
from bayes_aero.criticism.flown_tested import with_tested
from bayes_aero.criticism.trajectory import Trajectories
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import HealthFinding, channel_health
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.dynamics import taken_as_zero
from bayes_aero.physics.coefficients import REQUIRED
from bayes_aero.report.diagnosed import rankings_of
from bayes_aero.report.page import put_page
from bayes_aero.report.page_context import PageContext
from bayes_aero.report.page_diagnosis import flown_page
from bayes_aero.report.phrases import several
from bayes_aero.report.words_diagnosis import diagnosis_sentences
from bayes_aero.studies.agree import sensors_agree
from bayes_aero.studies.consistency_results import consistency_results
from bayes_aero.studies.diagnosis_results import (
    SCHEMA,
    cause_results,
    noise_results,
    record_results,
    screen,
    tested_results,
    together_results,
    unknown_results,
)
from bayes_aero.studies.folder import writable
from bayes_aero.studies.health_results import health_results
from bayes_aero.studies.histories import HISTORIES, flights, put_histories
from bayes_aero.studies.outlook import simulations
from bayes_aero.studies.provenance import provenance, write_json
from bayes_aero.studies.trajectory_results import trajectory_results
from bayes_aero.studies.unfinished import MARK

Progress = Callable[[str, float], None]
WHY = (
    "no coefficients can be formed: the diagnosis uses simulated trajectories, and unexplained structure is not sought"
)


def lacking(records: Sequence[FlightRecord], card: Card) -> tuple[str, ...]:
    """Channels that coefficients need and some record does not have."""
    given = {*card.sums, *card.constants, *card.derived, *card.tables}
    return tuple(n for n in REQUIRED if n not in given and any(not record.has(n) for record in records))


@dataclass(frozen=True)
class Flown:
    """What trajectories alone have shown, where coefficients cannot be formed."""

    diagnosis: Diagnosis
    trajectories: Trajectories | None
    sentences: Sequence[str]
    health: Sequence[HealthFinding] = ()
    consistency: Consistency | None = None
    failures: tuple[str, ...] = ()  # parts that failed unexpectedly


def run_flown(
    records: Sequence[FlightRecord],
    card: Card,
    *,
    out: Path | None = None,
    seed: int = 0,
    most: int = 8,
    fly: bool = True,
    progress: Progress | None = None,
) -> Flown:
    """Diagnose from trajectories; `out` gets diagnosis.json, histories.nc and report.html."""
    if out is not None:
        writable(out)
        (out / MARK).unlink(missing_ok=True)  # what another run left here to be taken up is written over
        (out / HISTORIES).unlink(missing_ok=True)
    source = provenance(card, records, seed, {"max_effects": most})
    found = with_tested(diagnose_flown(records, card, seed=seed, most=most, progress=progress), None, records, card)
    note = f"Without {several(lacking(records, card))} {WHY}."
    still = taken_as_zero(found.aerodynamics.state.responses.flights)
    if still:
        note += f" Not recorded, and taken as zero: {several(still)}."
    flown: Trajectories | None = None
    if found.causes and not fly:
        note += " Without trajectories no cause was tested on hold-out flights."
    health = channel_health(records, card)
    checked, failures = sensors_agree(records, card, seed, out)
    failures += found.failures

    def told() -> Flown:
        """All so far, on disk too."""
        one = Flown(found, flown, [*diagnosis_sentences(found, flown), note], health, checked, failures)
        if out is not None:
            write_json(_results(one, card, records, source), out / "diagnosis.json")
        return one

    so_far = told()
    if fly:
        what = "Trajectories were not compared"
        compare = partial(simulations, found, card, records, seed, progress)
        try:
            flown, failed = attempted(what, compare, None, out, own=bool(card.effect_files))
            failures += failed
        except InputError as error:
            note += f" {what}: {error}"
        if flown is not None:
            found = judged_on_held_out_flights(found, flown.asked)
        found = with_tested(found, flown, records, card)
        so_far = told()
    if out is None:
        return so_far
    if flown is not None:
        paths = flown.paths
        failures += put_histories(lambda: flights(paths), out)
    context = PageContext(card, records, source, consistency=checked, failures=failures)
    failures += put_page(lambda: flown_page(found, flown, so_far.sentences, context), out)
    return told() if failures != so_far.failures else so_far


def _results(found: Flown, card: Card, records: Sequence[FlightRecord], source: Mapping[str, Any]) -> dict[str, Any]:
    d, flown = found.diagnosis, found.trajectories
    units = {p.name: p.unit for p in d.aerodynamics.state.field.model.free}
    return {
        "schema": SCHEMA,
        "card": {"name": card.name, "title": card.title},
        "records": record_results(records),
        "consistency": {} if found.consistency is None else consistency_results(found.consistency),
        "verdict": d.verdict.value,
        "tested": tested_results(d.tested),
        "sentences": list(found.sentences),
        "causes": [cause_results(cause) for cause in d.causes],
        "minor": list(d.minor),
        "unexplained": unknown_results(d.unknown),
        "together": together_results(d),
        "noise": noise_results(d.noise),
        "not_testable": dict(d.not_testable),
        "screen": screen(d, rankings_of(d)),
        "split": d.split,
        "base_parameters": {
            name: {"before": a, "after": b, "sd_before": None, "sd_after": sd, "unit": units[name]}
            for name, (a, b, sd) in d.base_moves.items()
        },
        "residuals": {},
        "predictors": {},
        "trajectories": {} if flown is None else trajectory_results(flown, card),
        "health": health_results(found.health),
        "notes": list(d.notes),
        "failures": list(found.failures),
        "provenance": dict(source),
    }
