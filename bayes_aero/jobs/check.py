"""What records are worth before anything is fitted: channels, sampling, what they can test, whether sensors agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.diagnosis.consistency import KnownErrors, errors_of_path, screen_sensor_errors
from bayes_aero.diagnosis.result import CheckReport, SensorCheck
from bayes_aero.errors import InputError
from bayes_aero.flight.agreement import Agreement
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.reading.inspection import RecordReport, inspect_record
from bayes_aero.flight.reading.read_record import manoeuvres
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.io.consistency_json import consistency_results, health_results
from bayes_aero.jobs.io.output_folder import writable
from bayes_aero.jobs.provenance import provenance, write_json
from bayes_aero.jobs.steps.record_checks import available, record_checks, usable_for
from bayes_aero.model.derived_channels import with_sums
from bayes_aero.model.joined_records import joined, on_recorded_axes
from bayes_aero.model.model import Model, own_effects
from bayes_aero.progress import Progress

SCHEMA = "bayes_aero/check/1"


def check_records(
    paths: Sequence[Path],
    card: Card,
    *,
    resample: float | None = None,
    split: bool = False,
    sensors: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
) -> CheckReport:
    """Look at every record, then at what all of them together allow; no aerodynamics is fitted."""
    looked = []
    paths = manoeuvres(paths, card.channels, segments=card.segments, split=split)
    for number, path in enumerate(paths):
        if progress:
            progress(f"reading {path.name}", number / len(paths))
        looked.append(_within_tables(inspect_record(path, card, resample=resample), card))
    sound = [r.record for r in looked if r.record is not None]
    whole = len(sound) == len(looked)
    used, left_out = on_recorded_axes(card, sound) if whole else (card, ())
    uses, not_testable = (usable_for(sound, used), _not_testable(sound, used)) if whole else ({}, {})
    why = "not asked for" if not sensors else "a record is not usable" if len(sound) < len(looked) else ""
    if not why and progress:
        progress("do the sensors agree?", 0.5)
    known, sought, sensors_found = (None, "", SensorCheck(why, {}, {})) if why else _sensors(sound, card, seed)
    checks = record_checks(sound, card, seed, known=known, seek=False, left_out=why)
    agreement = replace(checks.consistency, unsought=sought)
    return CheckReport(
        card, tuple(looked), uses, not_testable, sensors_found, agreement, checks.health, left_out, checks.failures
    )


def _within_tables(report: RecordReport, card: Card) -> RecordReport:
    """The report, with a problem more if the record leaves a table of the card."""
    if report.record is None or not card.tables:
        return report
    try:
        with_sums(report.record, card)
    except InputError as reason:
        return replace(report, problems=(*report.problems, str(reason)), record=None)
    return report


def _not_testable(records: Sequence[FlightRecord], card: Card) -> dict[str, str]:
    """Why an effect of the catalogue cannot be tested in the records, by effect."""
    if card.linear is not None or "alpha" not in available(records, card):
        return {}
    own = tuple(own_effects(card.effect_files).values())
    return dict(candidate_model(Model.from_card(card), joined(records, card, ()), own).not_testable)


def _sensors(records: Sequence[FlightRecord], card: Card, seed: int) -> tuple[KnownErrors | None, str, SensorCheck]:
    """The errors that a selection along the flight path names, or why it could not look for them."""
    try:
        found = screen_sensor_errors(list(records), card, seed=seed)
    except InputError as reason:
        return None, str(reason), SensorCheck(str(reason), {}, {})
    known = errors_of_path(found)
    before = np.sqrt(np.mean((found.base.left(found.base_fit) * found.base.noise_growth) ** 2, axis=0))
    after = np.sqrt(np.mean((found.state.left(found.fit) * found.state.noise_growth) ** 2, axis=0))
    rms = {n: (float(a), float(b)) for n, a, b in zip(found.state.outputs, before, after, strict=True)}
    return known, "", SensorCheck("", {n: dict(error) for n, error in known.errors.items()}, rms)


def check_results(report: CheckReport) -> dict[str, Any]:
    """The report as plain data."""
    records = []
    for r in report.records:
        about = asdict(replace(r, record=None))
        del about["record"]
        records.append(about | {"sha256": None if r.record is None else r.record.sha256, "usable": not r.problems})
    return {
        "schema": SCHEMA,
        "usable": report.usable,
        "card": {"name": report.card.name, "title": report.card.title, "sha256": report.card.sha256},
        "constants": dict(report.card.constants),
        "derived": list(report.card.derived),
        "tables": {name: [axis.channel for axis in table.axes] for name, table in report.card.tables.items()},
        "sums": {name: list(parts) for name, parts in report.card.sums.items()},
        "consistency": consistency_results(report.consistency),
        "records": records,
        "uses": {name: {"possible": not why, "why_not": why or None} for name, why in report.uses.items()},
        "axes_left_out": list(report.left_out),
        "not_testable": report.not_testable,
        "cautions": list(report.cautions),
        "health": health_results(report.health),
        "sensors": {
            "checked": not report.sensors.note,
            "why_not": report.sensors.note or None,
            "agree": _agree(report),
            "errors": report.sensors.errors,
            "rms": {n: {"before": a, "after": b} for n, (a, b) in report.sensors.rms.items()},
        },
    }


def _agree(report: CheckReport) -> bool | None:
    """Whether the sensors agree within their noise; None where that was not checked."""
    return None if report.consistency.agreement is Agreement.NOT_CHECKED else not report.consistency.disagrees


def write_check(report: CheckReport, out: Path, seed: int = 0) -> tuple[str, ...]:
    """Write check.json and report.html into `out`; a sentence on what of the page cannot be made."""
    from bayes_aero.report.html.page import put_page  # heavy, and most checks write nothing
    from bayes_aero.report.pages.check import check_page

    writable(out)
    write_json(check_results(report), out / "check.json")
    source = provenance(report.card, [r.record for r in report.records if r.record is not None], seed, {})
    return put_page(lambda: check_page(report, source), out)
