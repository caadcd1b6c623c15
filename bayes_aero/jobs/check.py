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
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import Agreement
from bayes_aero.flight.reading import RecordReport, inspect_record, manoeuvres
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.io.documents import ConsistencyPart
from bayes_aero.jobs.io.result_file import writable
from bayes_aero.jobs.provenance import picked, provenance, write_json
from bayes_aero.jobs.steps.record_checks import available, record_checks, usable_for
from bayes_aero.model.model import Model, own_effects
from bayes_aero.model.records import joined, on_recorded_axes, with_sums
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
    looked: list[RecordReport] = []
    paths = manoeuvres(paths, card.channels, segments=card.segments, split=split)
    for number, path in enumerate(paths):
        if progress:
            progress(f"reading {path.name}", number / len(paths))
        report = inspect_record(path, card, resample=resample)
        try:
            if report.record is not None and card.tables:
                with_sums(report.record, card)
        except InputError as reason:  # the record leaves a table of the card
            report = replace(report, problems=(*report.problems, str(reason)), record=None)
        looked.append(report)
    sound = [r.record for r in looked if r.record is not None]
    whole = len(sound) == len(looked)
    used, left_out = on_recorded_axes(card, sound) if whole else (card, ())
    uses = usable_for(sound, used) if whole else {}
    not_testable: dict[str, str] = {}
    if whole and used.linear is None and "alpha" in available(sound, used):
        own = tuple(own_effects(used.effect_files).values())
        not_testable = dict(candidate_model(Model.from_card(used), joined(sound, used, ()), own).not_testable)
    why = "not asked for" if not sensors else "" if whole else "a record is not usable"
    if not why and progress:
        progress("do the sensors agree?", 0.5)
    known, sought, found = (None, "", SensorCheck(why, {}, {})) if why else errors_of_sensors(sound, card, seed)
    checks = record_checks(sound, card, seed, known=known, seek=False, left_out=why)
    agreement = replace(checks.consistency, unsought=sought)
    return CheckReport(
        card, tuple(looked), uses, not_testable, found, agreement, checks.health, left_out, checks.failures
    )


def errors_of_sensors(
    records: Sequence[FlightRecord], card: Card, seed: int
) -> tuple[KnownErrors | None, str, SensorCheck]:
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
    records, card, sensors = [], report.card, report.sensors
    for r in report.records:
        about = asdict(replace(r, record=None))
        del about["record"]
        records.append(about | {"sha256": None if r.record is None else r.record.sha256, "usable": not r.problems})
    unchecked = report.consistency.agreement is Agreement.NOT_CHECKED
    return {
        "schema": SCHEMA,
        "usable": report.usable,
        "card": picked(card, "name", "title", "sha256"),
        "constants": card.constants,
        "derived": list(card.derived),
        "tables": {name: [axis.channel for axis in table.axes] for name, table in card.tables.items()},
        "sums": {name: list(parts) for name, parts in card.sums.items()},
        "consistency": ConsistencyPart.of(report.consistency),
        "records": records,
        "uses": {name: {"possible": not why, "why_not": why or None} for name, why in report.uses.items()},
        **picked(report, "axes_left_out=left_out", "not_testable", "cautions", "health"),
        "sensors": {
            "checked": not sensors.note,
            "why_not": sensors.note or None,
            "agree": None if unchecked else not report.consistency.disagrees,  # within their noise
            "errors": sensors.errors,
            "rms": {name: {"before": a, "after": b} for name, (a, b) in sensors.rms.items()},
        },
    }


def write_check(report: CheckReport, out: Path, seed: int = 0) -> tuple[str, ...]:
    """Write check.json and report.html into `out`; a sentence on what of the page cannot be made."""
    from bayes_aero.report.html.page import put_page  # heavy, and most checks write nothing
    from bayes_aero.report.pages.check import check_page

    writable(out)
    write_json(check_results(report), out / "check.json")
    source = provenance(report.card, [r.record for r in report.records if r.record is not None], seed, {})
    return put_page(lambda: check_page(report, source), out)
