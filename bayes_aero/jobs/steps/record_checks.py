"""What everything that reads records asks of them: are they different flights with sound channels, do sensors agree?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bayes_aero.diagnosis.candidate_set import too_short
from bayes_aero.diagnosis.consistency import KnownErrors, consistency
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import channel_health
from bayes_aero.flight.health.finding import Consistency, HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.records import despiked_records, with_sums
from bayes_aero.physics.aircraft import needed_channels, required_of
from bayes_aero.physics.filters import FILTER_STEP
from bayes_aero.progress import Progress
from bayes_aero.report.phrases import several
from bayes_aero.residuals.base import too_few_windows


@dataclass(frozen=True)
class RecordChecks:
    """Faults of channels and records given twice, whether the sensors agree, and a sentence if that check failed."""

    health: tuple[HealthFinding, ...]
    consistency: Consistency
    failures: tuple[str, ...] = ()

    @contextmanager
    def behind(self) -> Iterator[None]:
        """Bad input that is found later is told with the faults that may be behind it."""
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
    known: KnownErrors | None = None,
    seek: bool = True,
    left_out: str = "",
    progress: Progress | None = None,
) -> RecordChecks:
    """Check records, whichever command reads them; should the comparison of sensors fail, the job goes on without.

    `known`: errors of sensors that a search has found; `seek`: whether to look for errors that explain why sensors
    disagree; `left_out`: why the sensors are not compared, empty where they are.
    """
    if progress:
        progress("do the sensors agree?", 0.0)
    agreement, failures = attempted(
        "Whether the sensors agree was not checked",
        lambda: Consistency(left_out) if left_out else consistency(records, card, seed=seed, seek=seek, known=known),
        Consistency("the check failed"),
        out,
    )
    return RecordChecks(channel_health(records, card), agreement, failures)


# --- The repair of isolated spikes, and the note that every job gives on it.


def repaired(records: Sequence[FlightRecord]) -> tuple[list[FlightRecord], tuple[str, ...]]:
    """The records without isolated spikes, and a note of what was replaced."""
    without, count = despiked_records(records)
    return without, spike_notes(count)


def spike_notes(count: Mapping[str, int]) -> tuple[str, ...]:
    """What was replaced, by channel; nothing where there were no spikes."""
    if not count:
        return ()
    counts = several(f"{number} of {name}" for name, number in count.items())
    return (f"Isolated spikes were replaced by the median of their neighbours: {counts}.",)


# --- What records allow, told before anything is fitted: which command can use them, and why another one cannot.

DERIVED = ("alpha_dot",)  # formed from recorded channels


def usable_for(records: Sequence[FlightRecord], card: Card) -> dict[str, str]:
    """Why each command cannot use the records with the card, by command; empty where it can.

    A command that the card does not serve is left out.
    """
    have = available(records, card)
    if card.linear is not None:
        return {"fly": _lacks([n for n in (*card.linear.states, *card.linear.inputs) if n not in have])}
    asked = [n for n in Model.from_card(card).channels if n not in DERIVED]
    missing = [n for n in dict.fromkeys((*required_of(card.axes), *asked)) if n not in have]
    flown = [n for n in dict.fromkeys((*needed_channels(card.axes), *asked)) if n not in have]
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
    if not missing:
        return ""
    return f"no channel {', '.join(missing)}: map {'it' if len(missing) == 1 else 'them'}, or state a constant"
