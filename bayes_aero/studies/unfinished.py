"""What an interrupted diagnosis of the same records had finished: the same command takes it up."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayes_aero.criticism.trajectory import Trajectories
from bayes_aero.flight.card import Card
from bayes_aero.studies.histories import HISTORIES, read_histories
from bayes_aero.studies.provenance import write_json
from bayes_aero.studies.trajectory_results import trajectories_of

MARK, RESULTS = ".unfinished.json", "diagnosis.json"
NOT_AS_WRITTEN = (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError)


@dataclass(frozen=True)
class Earlier:
    """Stages that are on disk; empty ones are still to be done."""

    predictors: Mapping[str, Any]
    separating: Sequence[Mapping[str, Any]]
    trajectories: Trajectories | None


NOTHING = Earlier({}, (), None)


class Unfinished:
    """A folder whose run has not ended, marked with all that its numbers rest on; without a folder nothing is kept."""

    def __init__(self, folder: Path | None, rests_on: Mapping[str, Any]) -> None:
        self.folder = folder
        text = json.dumps(rests_on, sort_keys=True, default=str)
        self._mark = {"rests_on": hashlib.sha256(text.encode()).hexdigest()}

    def earlier(self, card: Card, *, predictors: bool, trajectories: bool) -> Earlier:
        """What a run from the very same beginning has left, as far as it is wanted and sound."""
        if self.folder is None:
            return NOTHING
        try:
            if json.loads((self.folder / MARK).read_text(encoding="utf-8")) != self._mark:
                return NOTHING
            told = json.loads((self.folder / RESULTS).read_text(encoding="utf-8"))
            scores = {name: _scores(row) for name, row in told["predictors"].items()} if predictors else {}
            separating = told["separating"] if predictors else ()
            flown = None
            if trajectories and told["trajectories"]:
                flown = trajectories_of(told["trajectories"], read_histories(self.folder / HISTORIES), card)
        except NOT_AS_WRITTEN:
            return NOTHING
        return Earlier(scores, separating, flown)

    def begin(self) -> None:
        """From now on what is in the folder is this run's."""
        if self.folder is not None:
            write_json(self._mark, self.folder / MARK)

    def end(self) -> None:
        """All is there: the same command would do all of it again."""
        if self.folder is not None:
            (self.folder / MARK).unlink(missing_ok=True)


def _scores(row: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers that do not exist are null in JSON."""
    return {
        c: {key: float("nan") if x is None else x for key, x in scores.items()} if isinstance(scores, dict) else scores
        for c, scores in row.items()
    }
