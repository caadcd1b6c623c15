"""Which additions unseen data confirm.

An election asks only that a candidate gains at all on data left out, and adds one after the other. Taken together
some are superfluous, and what is superfluous harms elsewhere: a delay that fits one manoeuvre's noise spoils the
simulation of the next. So additions are taken out again one at a time, the least useful first, as long as unseen data
do not miss them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.cross_validation import LeftOut, holdout_gain, truncated
from bayes_aero.diagnosis.settings import DEFAULT, DiagnosisSettings


@dataclass(frozen=True)
class Confirmation:
    """`kept`: additions that unseen data miss. `missed`: the log density each is missed by, and its deviation."""

    kept: tuple[str, ...]
    missed: Mapping[str, tuple[float, float]]


T = TypeVar("T")


@runtime_checkable
class Predictions(Protocol[T]):
    """Unseen data as the model with some of its additions predicts them: T is what is left of them."""

    def first_order(self, effects: Sequence[str]) -> T:
        """To first order, in no time."""
        ...

    def refitted(self, effects: Sequence[str]) -> T:
        """Everything fitted again."""
        ...

    def holdout_gain(self, before: T, after: T) -> tuple[float, float]:
        """Log density that `after` has beyond `before`, over the variance inflation, and its deviation."""
        ...


def backward_elimination(
    additions: Sequence[str], unseen: Predictions[T], settings: DiagnosisSettings = DEFAULT
) -> Confirmation:
    """Each addition in turn, least missed to first order first, is taken out and everything fitted again.

    What stays is missed by `settings.hold_out` standard errors of its log density (nats); where all that wait are
    missed by `settings.hold_out_first_order` of them to first order, nothing is fitted again, and that is reported.
    """
    plain = settings.hold_out_first_order
    kept, missed, waiting = list(additions), {}, list(additions)
    whole: T | None = None
    while waiting:
        near = unseen.first_order(kept)
        losses = {e: unseen.holdout_gain(unseen.first_order(_less(kept, e)), near) for e in waiting}
        least = min(waiting, key=lambda e: losses[e][0] - plain * losses[e][1])
        if losses[least][0] > plain * losses[least][1]:
            missed |= losses
            break
        if whole is None:
            whole = unseen.refitted(kept)
        without = unseen.refitted(_less(kept, least))
        missed[least] = unseen.holdout_gain(without, whole)
        if not missed[least][0] > settings.hold_out * missed[least][1]:
            kept, whole = _less(kept, least), without
        waiting.remove(least)
    return Confirmation(tuple(kept), {e: missed[e] for e in additions})


@dataclass(frozen=True)
class _Coefficients:
    """Those of the record, from sensitivities where the state stands or from fits of their own."""

    state: SelectionState

    def first_order(self, effects: Sequence[str]) -> LeftOut:
        return LeftOut.first_order(self.state, effects)

    def refitted(self, effects: Sequence[str]) -> LeftOut:
        return LeftOut.refitted(truncated(self.state, effects))

    def holdout_gain(self, before: LeftOut, after: LeftOut) -> tuple[float, float]:
        return holdout_gain(before, after, self.state)


def confirmation(state: SelectionState) -> Confirmation:
    """What unseen coefficients confirm of all additions of a state."""
    return backward_elimination(state.active, _Coefficients(state), state.settings)


def _less(effects: Sequence[str], one: str) -> list[str]:
    return [e for e in effects if e != one]
