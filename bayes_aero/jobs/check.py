"""What records are worth before anything is fitted: channels, sampling, what they can test, whether sensors agree."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_aero.diagnosis.consistency import KnownErrors, consistency, errors_of_path, screen_sensor_errors
from bayes_aero.diagnosis.result import CheckReport, SensorCheck
from bayes_aero.diagnosis.selection_state import candidate_model, too_short
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import Agreement, Consistency, HealthFinding
from bayes_aero.flight.health.channel import channel_health
from bayes_aero.flight.reading import RecordReport, inspect_record, manoeuvres
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.documents import ConsistencyPart
from bayes_aero.jobs.store import picked, provenance, writable, write_json
from bayes_aero.model.model import Model, own_effects
from bayes_aero.model.records import despiked_records, join, on_recorded_axes, with_sums
from bayes_aero.physics.aircraft import needed_channels, required_of
from bayes_aero.physics.filters import FILTER_STEP
from bayes_aero.progress import Progress, quiet
from bayes_aero.report.phrases import several
from bayes_aero.residuals.base import too_few_windows

if TYPE_CHECKING:
    from bayes_aero.report.page import Report


@dataclass(frozen=True)
class RecordChecks:
    """Faults of channels and records given twice, whether the sensors agree, and a sentence if that check failed."""

    health: tuple[HealthFinding, ...]
    consistency: Consistency
    failures: tuple[str, ...] = ()

    @contextmanager
    def behind(self) -> Iterator[None]:
        """Bad input that is found later is reported with the faults that may be behind it."""
        try:
            yield
        except InputError as reason:
            faults = [finding.sentence for finding in self.health if finding.grave]
            raise InputError(". ".join([*faults, str(reason)])) from None


def record_checks(
    records: Sequence[FlightRecord],
    card: Card,
    seed: int,
    out: Path | None = None,
    *,
    progress: Progress = quiet,
    left_out: str = "",
    **options: Any,
) -> RecordChecks:
    """`left_out`: why the sensors are not compared, if so; `options`: of `consistency`, on errors of sensors."""
    progress("do the sensors agree?", 0.0)
    agreement, failures = attempted(
        "Whether the sensors agree was not checked",
        lambda: Consistency(left_out) if left_out else consistency(records, card, seed=seed, **options),
        Consistency("the check failed"),
        out,
    )
    return RecordChecks(channel_health(records, card), agreement, failures)


def repaired(records: Sequence[FlightRecord]) -> tuple[list[FlightRecord], tuple[str, ...]]:
    without, count = despiked_records(records)
    return without, spike_notes(count)


def spike_notes(count: Mapping[str, int]) -> tuple[str, ...]:
    counts = several(f"{number} of {name}" for name, number in count.items())
    return (f"Isolated spikes were replaced by the median of their neighbours: {counts}.",) if count else ()


# --- What records allow, told before anything is fitted: which command can use them, and why another one cannot.


def usable_for(records: Sequence[FlightRecord], card: Card) -> dict[str, str]:
    """Why each command that the card serves cannot use the records, by command; empty where it can."""
    have = available(records, card)
    if card.linear is not None:
        return {"fly": _lacks([n for n in (*card.linear.states, *card.linear.inputs) if n not in have])}
    channels = [n for n in Model.from_card(card).channels if n != "alpha_dot"]  # which is formed
    missing = [n for n in dict.fromkeys((*required_of(card.axes), *channels)) if n not in have]
    flown = [n for n in dict.fromkeys((*needed_channels(card.axes), *channels)) if n not in have]
    uses = {"identify": _lacks(missing), "diagnose": _lacks(missing), "fly": _lacks(flown)}
    if missing and not flown:
        uses["diagnose"] = too_few_windows(records)
        uses["diagnose by coefficients"] = _lacks(missing)
    if len(records) == 1 and not uses["diagnose"]:
        uses["diagnose"] = too_short(records[0].n // FILTER_STEP * FILTER_STEP * records[0].dt)
    return uses


def available(records: Sequence[FlightRecord], card: Card) -> set[str]:
    """Channels that every record has, by itself or by what the card states."""
    return set.intersection(*(set(with_sums(record, card)) for record in records))


def _lacks(missing: Sequence[str]) -> str:
    them = "it" if len(missing) == 1 else "them"
    return f"no channel {', '.join(missing)}: map {them}, or state a constant" if missing else ""


# --- The command.


def check_records(
    paths: Sequence[Path],
    card: Card,
    *,
    resample: float | None = None,
    split: bool = False,
    sensors: bool = True,
    seed: int = 0,
    progress: Progress = quiet,
) -> CheckReport:
    """Look at every record, then at what all of them together allow; no aerodynamics is fitted."""
    reports: list[RecordReport] = []
    paths = manoeuvres(paths, card.channels, segments=card.segments, split=split)
    for number, path in enumerate(paths):
        progress(f"reading {path.name}", number / len(paths))
        report = inspect_record(path, card, resample=resample)
        try:
            if report.record is not None and card.tables:
                with_sums(report.record, card)
        except InputError as reason:  # the record leaves a table of the card
            report = replace(report, problems=(*report.problems, str(reason)), record=None)
        reports.append(report)
    sound = [r.record for r in reports if r.record is not None]
    whole = len(sound) == len(reports)
    used, left_out = on_recorded_axes(card, sound) if whole else (card, ())
    uses = usable_for(sound, used) if whole else {}
    not_testable: dict[str, str] = {}
    if whole and used.linear is None and "alpha" in available(sound, used):
        effects = tuple(own_effects(used.effect_files).values())
        not_testable = dict(candidate_model(Model.from_card(used), join(sound, used, ()), effects).not_testable)
    why = "not asked for" if not sensors else "" if whole else "a record is not usable"
    if not why:
        progress("do the sensors agree?", 0.5)
    errors, sought, check = (None, "", SensorCheck(why, {}, {})) if why else errors_of_sensors(sound, card, seed)
    checks = record_checks(sound, card, seed, errors=errors, seek=False, left_out=why)
    found = replace(checks.consistency, unsought=sought), checks.health, left_out, checks.failures
    return CheckReport(card, tuple(reports), uses, not_testable, check, *found)


def errors_of_sensors(
    records: Sequence[FlightRecord], card: Card, seed: int
) -> tuple[KnownErrors | None, str, SensorCheck]:
    """The errors that a selection along the flight path names, or why it could not look for them."""
    try:
        extension = screen_sensor_errors(list(records), card, seed=seed)
    except InputError as reason:
        return None, str(reason), SensorCheck(str(reason), {}, {})
    path_errors = errors_of_path(extension)
    before = np.sqrt(np.mean((extension.base.left() * extension.base.noise_growth) ** 2, axis=0))
    after = np.sqrt(np.mean((extension.state.left() * extension.state.noise_growth) ** 2, axis=0))
    rms = {n: (float(a), float(b)) for n, a, b in zip(extension.state.outputs, before, after, strict=True)}
    return path_errors, "", SensorCheck("", {n: dict(error) for n, error in path_errors.errors.items()}, rms)


def check_results(report: CheckReport) -> dict[str, Any]:
    records, card, sensors = [], report.card, report.sensors
    for r in report.records:
        about = asdict(replace(r, record=None))
        del about["record"]
        records.append(about | {"sha256": None if r.record is None else r.record.sha256, "usable": not r.problems})
    unchecked = report.consistency.agreement is Agreement.NOT_CHECKED
    return {
        "schema": "bayes_aero/check/1",
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
    from bayes_aero.report.page import put_page  # heavy, and most checks write nothing

    writable(out)
    write_json(check_results(report), out / "check.json")
    return put_page(lambda: page_of_check(report, seed), out)


def page_of_check(report: CheckReport, seed: int) -> Report:
    from bayes_aero.report.pages.check import check_page

    sound = [r.record for r in report.records if r.record is not None]
    return check_page(report, provenance(report.card, sound, seed, {}))
