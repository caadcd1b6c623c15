"""What simulations say, in a table and in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from bayes_aero.criticism.trajectory import Estimates, Trajectories
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.tolerances import TOLERANCES
from bayes_aero.inference.output_error import OutputErrorStatus
from bayes_aero.report.phrases import SYMBOLS, for_people, several, short, size_text

MODELS = ("card", "extended")
STOPPED = "stopped before the optimum, so that its errors may be larger than they need be"
TAIL = 6  # characters of a manoeuvre's name


def trajectory_table(flown: Trajectories) -> Table:
    """Root mean square error of every output: fitted jointly and unseen, card's model → extended model."""
    table = Table(
        title="Error of the simulated trajectory (RMS), card's model → extended model",
        caption=" ".join(
            [
                "Fitted: to all, initial states too. Unseen: fitted without it, flown from its measured initial state.",
                *_status("The card's model", flown.card),
                *_status("The extended model", flown.extended),
            ]
        ),
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
        show_edge=False,
    )
    table.add_column("manoeuvre")
    table.add_column("")
    for name in flown.outputs:
        unit, _ = for_people(STANDARD_CHANNELS[name].unit)
        table.add_column(f"{SYMBOLS.get(name, name)} [{unit}]", justify="right")
    for split in ("fitted", "unseen"):
        for name in dict.fromkeys(p.manoeuvre for p in flown.paths if p.split == split):
            cells = []
            for output in flown.outputs:
                _, factor = for_people(STANDARD_CHANNELS[output].unit)
                pair = [flown.path(name, model, split) for model in MODELS]
                cells.append(" → ".join("-" if p is None else short(factor * p.errors[output].rms) for p in pair))
            table.add_row(_tail(name), split, *cells)
    return table


def simulation_gain(flown: Trajectories) -> str:
    """What the extension does to the simulation of flights that were not fitted, all of them together; empty if it
    changes nothing or one of the models cannot fly them. A fit that has failed is told with it."""
    if not all(p.inside for p in flown.paths if p.split == "unseen"):
        return ""
    told = []
    for output in flown.outputs:
        rms = {m: [p.errors[output].rms for p in flown.paths if (p.model, p.split) == (m, "unseen")] for m in MODELS}
        if not all(rms.values()) or not np.isfinite([x for values in rms.values() for x in values]).all():
            return ""
        unit, factor = for_people(STANDARD_CHANNELS[output].unit)
        before, after = (short(factor * float(np.sqrt(np.mean(np.square(rms[m]))))) for m in MODELS)
        if before != after:
            told.append(f"{SYMBOLS.get(output, output)} from {before} to {after} {unit}")
    if not told:
        return ""
    failed = [*_status("The card's model", flown.card), *_status("The extended model", flown.extended)]
    besides = [f"{flown.lag.effect} besides in the model"] if flown.lag is not None and flown.lag.kept else []
    besides += [f"{several(flown.out)} not in it"] if flown.out else []
    model = f", {several(besides)}," if besides else ""
    where = "Flown through the recorded inputs on flights that were not fitted"
    said = f"{where}, the error (RMS){model} goes: {several(told)}."
    return " ".join([said, *failed])


def _tail(name: str) -> str:
    """What tells records apart is mostly the end of their names, and a terminal has little room."""
    return name if len(name) <= TAIL + 1 else f"…{name[-TAIL:]}"


def trajectory_sentences(flown: Trajectories) -> list[str]:
    """How the fits ended, what was held, and how often the tolerances are kept."""
    said = [*_status("The card's model", flown.card), *_status("The extended model", flown.extended)]
    said += [*lag_sentences(flown), *cause_sentences(flown)]
    for name, held in flown.held.items():
        if held:
            verb = "it keeps its value" if len(held) == 1 else "they keep their values"
            said.append(
                f"Without {name} the other flights say next to nothing of {several(held)}; "
                f"{verb} of the joint fit there."
            )
    if flown.extended.held:
        said.append(f"The trajectories say next to nothing of {several(flown.extended.held)}; the prior holds.")
    return said + _tolerance_sentences(flown)


def _tolerance_sentences(flown: Trajectories) -> list[str]:
    """How much of the unseen flights is within tolerance: one sentence for all of them, the worst flight named."""
    unseen = [p for p in flown.paths if (p.model, p.split) == ("extended", "unseen")]
    outside = [p.manoeuvre for p in unseen if not p.inside]
    leaves = "leaves" if len(outside) == 1 else "leave"
    said = [f"Flown unseen, {several(outside)} {leaves} the flight envelope."] if outside else []
    inside = [p for p in unseen if p.inside]
    told = []
    for output in flown.outputs:
        shares = {p.manoeuvre: p.errors[output].within for p in inside if p.errors[output].within is not None}
        if not shares:
            continue
        worst = min(shares, key=lambda name: shares[name])
        where = f" (least, {worst})" if len(shares) > 1 and shares[worst] < max(shares.values()) else ""
        told.append(f"{SYMBOLS.get(output, output)} {shares[worst]:.0%}{where}")
    if told:
        what = "all flights stay" if len(inside) > 1 else f"{inside[0].manoeuvre} stays"
        said.append(
            f"Flown unseen, {what} within tolerance for at least this share of the time: {', '.join(told)}. "
            f"{tolerance_origin({n: e.tolerance for n, e in inside[0].errors.items() if e.tolerance is not None})}"
        )
    return said


def tolerance_origin(bands: Mapping[str, float]) -> str:
    """Whose tolerances these are; `bands` by output, SI."""
    if all(name in TOLERANCES and value == TOLERANCES[name].value for name, value in bands.items()):
        return (
            "The card states no tolerances; these are those of a flight simulator's qualification (14 CFR Part 60). "
            "[tolerances] of the card replaces them."
        )
    return "The tolerances are the card's."


def lag_sentences(flown: Trajectories) -> list[str]:
    """What trajectories say of a lag that coefficients leave open."""
    lag = flown.lag
    if lag is None:
        return []
    elpd, elpd_se = lag.unseen
    if not lag.kept:
        asked = f", unseen flight {elpd:+.0f} ± {elpd_se:.0f}" if math.isfinite(elpd) else ""
        gained = f"log density {lag.gain:+.1f}{asked}" if math.isfinite(lag.gain) else "its fit did not settle"
        why = "find less of it than is worth a name" if lag.slight else "do not want it"
        return [f"Coefficients leave {lag.effect} open, and trajectories {why} ({gained})."]
    names = [p.name for p in CATALOGUE[lag.effect].parameters]
    after = flown.extended
    sizes = [f"{n} {size_text(after.values[n], flown.deviation[n], after.units[n])}" for n in names]
    instead = f" in place of {several(lag.instead)}" if lag.instead else ""
    return [
        f"Flown, the extended model has {lag.effect} too{instead}: {several(sizes)}. Coefficients alone leave it open; "
        f"the trajectories gain log density {lag.gain:.0f} by it, unseen flight {elpd:.0f} ± {elpd_se:.0f}."
    ]


def cause_sentences(flown: Trajectories) -> list[str]:
    """Which of the causes that the coefficients confirm unseen flight misses, and by how much."""
    missed, kept, said = flown.asked.missed, flown.asked.kept, []
    if flown.out:
        gains = [f"{e} ({missed[e][0]:+.0f} ± {missed[e][1]:.0f} in log density)" for e in flown.out]
        them, they_are = ("it", "it is") if len(gains) == 1 else ("them", "they are")
        said.append(
            f"Flown, the extended model is without {several(gains)}: the coefficients confirm {them}, but unseen "
            f"flight does not miss {them} beyond chance when {they_are} taken out."
        )
    if kept:
        finite = [e for e in kept if math.isfinite(missed[e][0])]  # without the others the flight leaves its envelope
        least = min(finite, key=lambda e: missed[e][0] / missed[e][1], default=None)
        told = f" (least {least}, by {missed[least][0]:.0f} ± {missed[least][1]:.0f} in log density)" if least else ""
        said.append(f"Unseen flight misses {several(kept)}{told}.")
    return said


def _status(who: str, fit: Estimates) -> list[str]:
    """How the fit of one model ended, where it did not converge: what that does to the errors beside it."""
    if fit.status is OutputErrorStatus.CONVERGED:
        return []
    names = f" ({several(fit.at_bound)})" if fit.at_bound else ""
    said = STOPPED if fit.status is OutputErrorStatus.NOT_CONVERGED else fit.status.value
    return [f"{who}, fitted to the trajectories: {said}{names}."]
