"""What an interrupted diagnosis of the same records had finished: the same command takes it up."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayes_aero.diagnosis.result import Cause
from bayes_aero.diagnosis.trajectories.results import Trajectories
from bayes_aero.flight.card.card import Card
from bayes_aero.jobs.io.time_histories import HISTORIES, read_histories
from bayes_aero.jobs.io.trajectories_json import trajectories_of
from bayes_aero.jobs.provenance.provenance import write_json

MARK, RESULTS = ".unfinished.json", "diagnosis.json"
RESTS_ON = "rests_on"
"""Under this name provenance, histories.nc and the mark hold the digest of all that the numbers rest on."""


@dataclass(frozen=True)
class Earlier:
    """Stages that are on disk; empty ones are still to be done."""

    test_points: Mapping[str, Any]
    trajectories: Trajectories | None


NOTHING = Earlier({}, None)


class ResumeStore:
    """A folder whose run has not ended, marked with what its numbers rest on; without a folder nothing is kept."""

    def __init__(self, folder: Path | None, digest: str) -> None:
        self.folder, self._digest = folder, digest

    def earlier(self, card: Card, causes: Sequence[Cause], *, test_points: bool, trajectories: bool) -> Earlier:
        """What a run from the very same beginning, that found the same causes, has left: what is wanted and sound."""
        if self.folder is None:
            return NOTHING
        try:
            mark, told = (json.loads((self.folder / n).read_text(encoding="utf-8")) for n in (MARK, RESULTS))
            found = [(c["stage"], c["name"], c["confirmed"]) for c in told["causes"]]
            same = {mark[RESTS_ON], told["provenance"][RESTS_ON]} == {self._digest}
            if not same or found != [(c.stage, c.name, c.confirmed) for c in causes]:
                return NOTHING
            points = dict(told["test_points"]) if test_points else {}
            flown = None
            if trajectories and told["trajectories"]:
                histories = read_histories(self.folder / HISTORIES, self._digest)
                flown = trajectories_of(told["trajectories"], histories, card)
        except Exception:  # however it is damaged, it is not what was written: all is done again
            return NOTHING
        return Earlier(points, flown)

    def begin(self) -> None:
        """From now on what is in the folder is this run's."""
        if self.folder is not None:
            write_json({RESTS_ON: self._digest}, self.folder / MARK)

    def end(self) -> None:
        """All is there: the same command would do all of it again."""
        if self.folder is not None:
            (self.folder / MARK).unlink(missing_ok=True)


def digest(rests_on: Mapping[str, Any]) -> str:
    """SHA-256 of all that the numbers of a run rest on."""
    return hashlib.sha256(json.dumps(rests_on, sort_keys=True, default=str).encode()).hexdigest()
