"""Which additions unseen data confirm.

An election asks only that a candidate gains at all on data left out, and adds one after the other. Taken together
some are superfluous, and what is superfluous harms elsewhere: a delay that fits one manoeuvre's noise spoils the
simulation of the next. So additions are taken out again one at a time, the least useful first, as long as unseen data
do not miss them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bayes_aero.criticism.gain import LeftOut, gained, truncated
from bayes_aero.criticism.state import State

MISSED = 1.645  # deviations of its own by which the density of unseen data must fall: one-sided, 5 %
PLAIN = 5.0  # the same to first order, from which nothing is fitted again to see it


@dataclass(frozen=True)
class Confirmation:
    """`kept`: additions that unseen data miss. `missed`: the log density each is missed by, and its deviation."""

    kept: tuple[str, ...]
    missed: Mapping[str, tuple[float, float]]


def confirmation(state: State) -> Confirmation:
    """Each addition in turn, least missed to first order first, is taken out and everything fitted again."""
    kept, missed, waiting = list(state.active), {}, list(state.active)
    whole: LeftOut | None = None
    while waiting:
        near = LeftOut.first_order(state, kept)
        losses = {e: gained(LeftOut.first_order(state, _less(kept, e)), near, state) for e in waiting}
        least = min(waiting, key=lambda e: losses[e][0] - PLAIN * losses[e][1])
        if losses[least][0] > PLAIN * losses[least][1]:
            missed |= losses
            break
        whole = whole or LeftOut.refitted(truncated(state, kept))
        without = LeftOut.refitted(truncated(state, _less(kept, least)))
        missed[least] = gained(without, whole, state)
        if not missed[least][0] > MISSED * missed[least][1]:
            kept, whole = _less(kept, least), without
        waiting.remove(least)
    return Confirmation(tuple(kept), missed)


def _less(effects: Sequence[str], one: str) -> list[str]:
    return [e for e in effects if e != one]
