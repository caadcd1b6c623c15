"""Which additions unseen data confirm.

An election asks only that a candidate gains at all on data left out, and adds one after the other. Taken together
some are superfluous, and what is superfluous harms elsewhere: a delay that fits one manoeuvre's noise spoils the
simulation of the next. So additions are taken out again one at a time, the least useful first, as long as unseen data
do not miss them, or an output is predicted worse with them than without.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeVar, runtime_checkable

from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.cross_validation import LeftOut, holdout_gain, output_gains, truncated
from bayes_aero.diagnosis.settings import DEFAULT, DiagnosisSettings


@dataclass(frozen=True)
class Confirmation:
    """`kept`: additions that unseen data miss. `missed`: the log density each is missed by, and its deviation.

    `harmed`: of those not kept, outputs that are predicted worse with the addition, with that gain of log density.
    """

    kept: tuple[str, ...]
    missed: Mapping[str, tuple[float, float]]
    harmed: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)


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

    def output_gains(self, before: T, after: T, /) -> Mapping[str, tuple[float, float]]:
        """The same of each output."""
        ...


def backward_elimination(
    additions: Sequence[str], unseen: Predictions[T], settings: DiagnosisSettings = DEFAULT
) -> Confirmation:
    """Each addition in turn, least missed to first order first, is taken out and everything fitted again.

    What stays is missed by `settings.hold_out` standard errors of its log density (nats), and degrades no output
    (see `DiagnosisSettings.degrades`); where all that wait are missed by `settings.hold_out_first_order` of them to
    first order and degrade none, nothing is fitted again, and that is reported.
    """

    def degraded(without: T, whole: T) -> dict[str, tuple[float, float]]:
        return settings.degraded(unseen.output_gains(without, whole))

    plain = settings.hold_out_first_order
    kept, missed, waiting = list(additions), {}, list(additions)
    harmed: dict[str, Mapping[str, tuple[float, float]]] = {}
    whole: T | None = None
    while waiting:
        near, less = unseen.first_order(kept), {e: unseen.first_order(_less(kept, e)) for e in waiting}
        losses = {e: unseen.holdout_gain(less[e], near) for e in waiting}
        harmful = [e for e in waiting if degraded(less[e], near)]
        least = min(harmful or waiting, key=lambda e: losses[e][0] - plain * losses[e][1])
        if not harmful and losses[least][0] > plain * losses[least][1]:
            missed |= losses
            break
        if whole is None:
            whole = unseen.refitted(kept)
        without = unseen.refitted(_less(kept, least))
        missed[least] = unseen.holdout_gain(without, whole)
        worse = degraded(without, whole)
        if worse or not missed[least][0] > settings.hold_out * missed[least][1]:
            kept, whole = _less(kept, least), without
            harmed |= {least: worse} if worse else {}
        waiting.remove(least)
    return Confirmation(tuple(kept), {e: missed[e] for e in additions}, harmed)


@dataclass(frozen=True)
class _Recorded:
    """Outputs of a state, from sensitivities where the state stands or from fits of their own."""

    state: SelectionState

    def first_order(self, effects: Sequence[str]) -> LeftOut:
        return LeftOut.first_order(self.state, effects)

    def refitted(self, effects: Sequence[str]) -> LeftOut:
        return LeftOut.refitted(truncated(self.state, effects))

    def holdout_gain(self, before: LeftOut, after: LeftOut) -> tuple[float, float]:
        return holdout_gain(before, after, self.state)

    def output_gains(self, before: LeftOut, after: LeftOut) -> Mapping[str, tuple[float, float]]:
        return output_gains(before, after, self.state)


def confirmation(state: SelectionState) -> Confirmation:
    """What unseen data confirm of all additions of a state."""
    return backward_elimination(state.active, _Recorded(state), state.settings)


def _less(effects: Sequence[str], one: str) -> list[str]:
    return [e for e in effects if e != one]
