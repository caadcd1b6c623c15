"""Which manoeuvre would tell an ambiguity set apart: standard inputs flown in the simulator, and what they would say.

Each manoeuvre is flown from the present parameters without noise, and counted together with the present records. On
its record every effect of the set has a sensitivity; the active parameters are projected out of it, as in an election.
Two effects are told apart by what one does that the best imitation by the other, and by the active parameters, cannot
follow. The noise is that which the present model leaves, with its colour. Source of the idea: Klein and Morelli,
*Aircraft System Identification*, 2006, ch. 9 (design of inputs from the information matrix).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from bayes_aero.diagnosis.design.information import Information, Pair, columns_of, noise_of, signals_of
from bayes_aero.diagnosis.design.standard import Standard, of_records, on_record, standard
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.settings import ENOUGH
from bayes_aero.effect import Effect
from bayes_aero.errors import InputError

NOT_BY_HAND = ("multisine",)  # a manoeuvre that needs a computer at the controls is ranked and not proposed


@dataclass(frozen=True)
class Separation:
    """What one manoeuvre, with the present records, says of a set.

    `correlation` of each pair's sensitivities on the manoeuvre alone, active parameters projected out. `deviations`,
    for each ordered pair (one, other): by how many standard deviations the first, at the least size worth modelling,
    differs from its best imitation by the other. `weakest` is the smallest of them.
    """

    manoeuvre: str
    correlation: Mapping[Pair, float]
    deviations: Mapping[Pair, float]

    @property
    def weakest(self) -> float:
        """Deviations by which the closest pair differs."""
        return min(self.deviations.values())


@dataclass(frozen=True)
class Design:
    """Every manoeuvre that could be flown, the most telling first; `refused` says why the others could not.

    `present` are the deviations of the records alone. `status` names the manoeuvre that would separate the set, or
    says that none of the list would.
    """

    effects: tuple[str, ...]
    manoeuvres: tuple[Separation, ...]
    refused: Mapping[str, str]
    present: float
    status: str

    @property
    def best(self) -> str | None:
        """The most telling manoeuvre, if it tells enough."""
        first = self.manoeuvres[0] if self.manoeuvres else None
        return first.manoeuvre if first is not None and first.weakest >= ENOUGH else None


def separating(
    state: SelectionState,
    effects: Sequence[str],
    *,
    amplitude: float = 1.0,
    sizes: Mapping[str, float] | None = None,
    flights: Standard | None = None,
) -> Design:
    """Rank the standard manoeuvres by how well each tells `effects` apart when it is added to the present records.

    `effects` are candidates of the state, in or not; `sizes` replaces parameters' least sizes worth modelling.
    `flights` are the manoeuvres, if they were flown for this set and others (default: flown here with `amplitude`).
    """
    chosen = candidates_of(state, effects)
    names = tuple(e.name for e in chosen)
    if flights is None:
        flights = standard(state, names, amplitude=amplitude)
    noise, worth = noise_of(state), worth_of(chosen, sizes)
    records = of_records(state, chosen, noise)
    present, own = records.information(), signals_of(records.state, chosen, worth)
    found = []
    for name, record in flights.flown.items():
        if name in NOT_BY_HAND:
            continue
        there = on_record(state, flights.model, record, flights.theta, chosen, noise)
        told, columns = there.information(), {e.name: tuple(columns_of(there.state, e)) for e in chosen}
        found.append(Separation(name, _correlations(told, columns), (present + told).deviations(own)))
    found.sort(key=lambda s: -s.weakest)
    before = min(present.deviations(own).values())
    return Design(names, tuple(found), flights.refused, before, _words(names, found))


def candidates_of(state: SelectionState, effects: Sequence[str]) -> list[Effect]:
    """The effects of an ambiguity set; `InputError` if it is none."""
    chosen = [_candidate(state, name) for name in dict.fromkeys(effects)]
    if len(chosen) < 2:
        raise InputError("an ambiguity set has at least two effects")
    return chosen


def worth_of(chosen: Sequence[Effect], sizes: Mapping[str, float] | None) -> dict[str, float]:
    """The size of each parameter at which effects are told apart: the least worth modelling, or that in `sizes`."""
    return {p: least for e in chosen for p, (least, _) in e.sizes.items()} | dict(sizes or {})


def _correlations(told: Information, columns: Mapping[str, Sequence[str]]) -> dict[Pair, float]:
    """The largest of each pair's columns, after all that belongs to no effect of the set."""
    members = {label for own in columns.values() for label in own}
    base = [label for label in told.labels if label not in members]
    return {
        (a, b): max((told.correlation(x, y, base) for x in columns[a] for y in columns[b]), key=abs)
        for a, b in combinations(columns, 2)
    }


def _words(names: Sequence[str], found: Sequence[Separation]) -> str:
    listed = ", ".join(names)
    if not found:
        return f"none of the standard manoeuvres can be simulated from this state, so there is no answer for {listed}"
    best, called = found[0], found[0].manoeuvre.replace("_", " ")
    if best.weakest >= ENOUGH:
        return f"{called} would separate {listed}: they differ by {best.weakest:.1f} standard deviations"
    return (
        f"no standard manoeuvre by itself separates {listed}; the best, {called}, gives {best.weakest:.1f} deviations"
    )


def _candidate(state: SelectionState, name: str) -> Effect:
    found = next((e for e in state.full.model.effects if e.name == name and e.parameters), None)
    if found is None:
        raise InputError(f"effect {name} is none that this record can test; choose among the candidates of the state")
    return found
