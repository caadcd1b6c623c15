"""A finished result with its records: what the page shows and what is flown again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.explore.choice import addable
from bayes_aero.explore.linear import LIMITS, linear_groups
from bayes_aero.explore.sliders import Group, groups_of
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.handover.fitted_records import fitted_records
from bayes_aero.jobs.handover.identified_card import card_of
from bayes_aero.jobs.handover.identified_linear import Finished, IdentifiedLinear
from bayes_aero.jobs.handover.identified_result import read_finished, with_process_noise
from bayes_aero.jobs.handover.result_file import read_result, result_file
from bayes_aero.jobs.steps.record_checks import RecordChecks, record_checks
from bayes_aero.report.text.consistency import consistency_sentences


@dataclass(frozen=True)
class Opened:
    """A result of identify, fly or diagnose. SI and radians.

    Attributes:
        folder: of the result.
        command: identify, fly or diagnose.
        identified: the model with its values.
        card: with which the result was made.
        records: flights of the result.
        told: what the result says.
        errors: standard errors by parameter, where the result has them.
        departures: by manoeuvre and state, what was fitted to its measured value at the first sample; empty: the
            initial states are the measured ones.
        checks: of the records.
    """

    folder: Path
    command: str
    identified: Finished
    card: Card
    records: Sequence[FlightRecord]
    told: Mapping[str, Any]
    errors: Mapping[str, float]
    departures: Mapping[str, Mapping[str, float]]
    checks: RecordChecks

    @property
    def doubts(self) -> tuple[str, ...]:
        """What makes the records doubtful, a sentence each; empty for sound ones."""
        answer = consistency_sentences(self.checks.consistency, corrects=False)
        disagree = answer[:1] if self.checks.consistency.disagrees else []
        return (*self.checks.failures, *(f"{f.sentence}." for f in self.checks.health if f.grave), *disagree)

    @property
    def title(self) -> str:
        """The command and the folder."""
        return f"{self.command}: {self.folder}"

    @property
    def linear(self) -> bool:
        """Whether the model is a linear system."""
        return isinstance(self.identified, IdentifiedLinear)

    @property
    def limits(self) -> tuple[str, ...]:
        """Doubts about the records, and a sentence on each thing that the model or the fit has and the page has not."""
        said = [*self.doubts, *([LIMITS] if self.linear else [])]
        if self.command == "fly" and with_process_noise(self.told):
            said.append(
                "The values are those of the fit with process noise. Its gusts and the noise of its states "
                "are not flown here, as the result has no history of that noise: errors are those in still air."
            )
        return tuple(said)

    def groups(self, added: tuple[str, ...] = ()) -> tuple[Group, ...]:
        """The sliders, with those of the effects that are `added`."""
        found = self.identified
        if isinstance(found, IdentifiedLinear):
            return linear_groups(found, self.errors)
        return groups_of(found.model, found.values, self.errors, added)

    def addable(self, channels: Sequence[str]) -> tuple[Effect, ...]:
        """Effects of the catalogue that may be added where these channels are known."""
        found = self.identified
        return () if isinstance(found, IdentifiedLinear) else addable(found.model, channels)


COMMANDS = {"results": "identify", "trajectories": "fly", "diagnosis": "diagnose"}


def open_result(given: str, card: str | None = None, folders: Sequence[Path] = ()) -> Opened:
    """Read a result, its card and its records.

    Args:
        given: folder or file of the result.
        card: the card, where it is not found by itself.
        folders: where the records are, where they are not found by themselves.

    Raises:
        InputError: there is no result, its fit did not converge, or the card or a record has changed or is not found.
    """
    file = result_file(given)
    if file is None:
        raise InputError(f"{given} is a card; give the folder of a result of identify, fly or diagnose")
    told = read_result(file)
    identified, folder, told = read_finished(given, card)
    assert folder is not None
    whose = card_of(told["provenance"], file, card)
    command = COMMANDS[told["schema"].split("/")[1]]
    try:
        records = fitted_records(
            told["provenance"], file, whose, remedy="give its folder with --records", folders=folders
        )
        known = _errors(told, command), _departures(told, command)
    except (KeyError, TypeError, AttributeError, ValueError) as reason:
        if isinstance(reason, InputError):
            raise
        raise InputError(f"{file} is not as bayes-aero wrote it ({reason!r}); run the command again") from None
    checks = record_checks(records, whose, seed=0, seek=False)
    return Opened(folder, command, identified, whose, records, told, *known, checks)


def _errors(told: Mapping[str, Any], command: str) -> dict[str, float]:
    """Standard errors, the residuals' autocorrelation counted."""
    if command == "identify":
        found = {name: p["crb_corrected"] for name, p in told["mle"]["parameters"].items()}
    elif command == "fly":
        found = {name: p["sd_corrected"] for name, p in told["parameters"].items()}
        if with_process_noise(told):
            found |= {name: sd for name, (_, sd) in told["process_noise"]["estimates"].items()}
    else:
        found = {name: move["sd_after"] for name, move in told["base_parameters"].items()}
        found |= {name: p["sd"] for cause in told["causes"] for name, p in cause["parameters"].items()}
    return {name: float(x) for name, x in found.items() if x is not None and x > 0.0}


def _departures(told: Mapping[str, Any], command: str) -> dict[str, dict[str, float]]:
    """Those of output error; the values of a fit with process noise have no fitted initial states."""
    if command != "fly" or with_process_noise(told):
        return {}
    return {
        manoeuvre: {name: float(state["departure"]) for name, state in states.items()}
        for manoeuvre, states in told["initial_states"].items()
    }
