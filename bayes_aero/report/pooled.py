"""Manoeuvres side by side: those that differ by more than their intervals, and the flight not yet flown."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from bayes_aero.inference.results import Identification, NextFlight, PosteriorStatus
from bayes_aero.report.tables import comparison
from bayes_aero.report.tables.table import Column, Estimate, Table, in_brackets, parameter_columns
from bayes_aero.report.text.phrases import WORDS, decimals, from_to, several
from bayes_aero.units import number


def left_out(identification: Identification) -> list[str]:
    """Manoeuvres whose own fit cannot be compared, with the reason."""
    return [
        f"{name} alone: {fit.status.value}; it is left out of the comparison between manoeuvres."
        for name, fit in identification.alone.items()
        if not comparison.usable(fit)
    ]


def between_manoeuvres(identification: Identification, limit: float) -> list[str]:
    """Sentences on differences beyond `limit` standard errors; none if the intervals explain them."""
    names = comparison.ordered(identification.mle.names, identification.mle.parameters)
    compared = [n for n in names if len(comparison.alone(identification, n)) > 1]
    kinds = {"crb": "the Cramér-Rao bound", "crb_corrected": "the corrected bound"}
    for engine in list(comparison.chosen_posteriors(identification))[:1]:
        kinds[engine] = f"the {comparison.noise_label(identification.noise)} posterior's width"
    beyond, counts = {}, []
    for kind, label in kinds.items():
        far = {n: z for n in compared if (z := _largest(identification, n, kind)[0]) > limit}
        listed = several(f"{name} ({z:.1f})" for name, z in far.items()) or "none"
        if len(far) > 6:
            worst = max(far, key=lambda n: far[n])
            listed = f"{len(far)} of {len(compared)} parameters (up to {far[worst]:.0f}, {worst})"
        beyond[label] = far
        counts.append(f"{label}: {listed}")
    if not any(beyond.values()):
        return []
    sentences = [
        f"Fitted alone, manoeuvres differ by more than {limit:.0f} standard errors of the difference, by "
        + "; by ".join(counts)
        + "."
    ]
    wider = [set(found) for label, found in beyond.items() if label != "the Cramér-Rao bound"]
    unexplained = [n for n in compared if wider and any(n in found for found in wider)]
    always = [n for n in compared if wider and all(n in found for found in wider)]
    if unexplained:
        numbers = []
        for name in always or unexplained:
            (_, *pair), single = _largest(identification, name, "crb"), comparison.alone(identification, name)
            values = " and ".join(f"{single[m][0]:.{decimals(single[m][1])}f} from {m}" for m in pair)
            bound = max(single[m][1] for m in pair)
            numbers.append(f"{name} is {values}, with Cramér-Rao standard errors up to {bound:.2g}")
        sentences.append(
            f"No noise model alone explains this: {'; '.join(numbers)}. "
            "The model lacks an effect, the conditions of the manoeuvres differ in a way that it does not contain, or "
            "filters act differently on the measured and the modelled side. The intervals of the joint fit assume one "
            "value for all manoeuvres and cover none of these."
        )
    return sentences


def _largest(identification: Identification, name: str, kind: str) -> tuple[float, str, str]:
    """Largest difference of two manoeuvres in standard errors of the difference, and which two."""
    # manoeuvres were not sampled one by one: their Cramer-Rao deviations times the joint ratio of posterior to bound
    single = comparison.alone(identification, name)
    by_key = {m.key: m.estimates for m in comparison.methods(identification)}
    estimate = by_key[kind].get(name)
    widen = estimate.sd / by_key["crb"][name].sd if estimate else np.nan
    sd = {m: corrected if kind == "crb_corrected" else widen * crb for m, (_, crb, corrected) in single.items()}
    return max((comparison.apart(single[a][0], single[b][0], sd[a], sd[b]), a, b) for a, b in combinations(single, 2))


# --- Joint fit, manoeuvres alone and pooled, scatter between them and next flight: the table, and what it says.

ON_TERMINAL, ON_PAGE = 2, 4  # manoeuvres that are shown one by one; a file has all
LITTLE = 0.6  # share of its prior's deviation above which the scatter is called the prior's: our choice
PARTS = ("", "sd", "ci95_low", "ci95_high")
NOTE = WORDS["notes"]["next_flight"]


def next_flight_table(run: Identification) -> Table:
    """A row for each parameter, SI and radians; ValueError if the run has not pooled its manoeuvres."""
    found = run.next_flight
    if found is None:
        raise ValueError("the manoeuvres of this run are not pooled")
    names = comparison.ordered(found.aircraft, found.parameters)
    few = len(found.manoeuvres) <= ON_TERMINAL
    joint = comparison.bounds(run.mle, run.mle.crb_corrected)
    name, unit, both = parameter_columns(names, [comparison.unit_of(run, n) for n in names])
    columns = [
        *(name, replace(unit, terminal=None), both),  # a terminal has the units above
        Column([joint[n] for n in names], ("joint", "joint_sd"), "joint", "joint", terminal_form=in_brackets),
    ]
    for m in found.manoeuvres:
        one_by_one = len(found.manoeuvres) <= ON_PAGE
        own = found.alone[m]
        single = [Estimate.normal(*own[n]) if n in own else None for n in names]
        for kind, values in (("alone", single), ("pooled", [Estimate.of(found.pooled[m][n]) for n in names])):
            heads = kind if one_by_one else None, f"{m}\npooled" if few and kind == "pooled" else None
            columns.append(Column(values, (f"{m}_{kind}", f"{m}_{kind}_sd"), *heads, group=m))
    for key, head, numbers, forms in (
        ("aircraft", "aircraft", found.aircraft, ("", in_brackets)),
        ("scatter", "scatter\n95 %", found.scatter, (_interval, _interval)),
        ("next_flight", "next flight\n95 %", found.following, (_digits, _digits)),
    ):
        files = tuple(f"{key}_{part}".rstrip("_") for part in PARTS)
        values = [Estimate.of(numbers[n]) for n in names]
        columns.append(Column(values, files, head, head.splitlines()[0], *forms))
    narrowed = [found.narrowed[n] for n in names]
    columns.append(Column(narrowed, "scatter_over_prior", "scatter\nover prior", "over\nprior", form=".2f"))
    note = "In brackets: standard deviation in units of the last digit; scatter and next flight: 95 % intervals."
    return Table(
        columns, "Joint fit, manoeuvres alone and pooled, and the next flight", NOTE, terminal_note=note, dense=True
    )


def next_flight_sentences(run: Identification) -> list[str]:
    """What the pooled manoeuvres say, and how little they can say; nothing where they were not pooled."""
    if run.next_flight is None:
        return []
    found, count = run.next_flight, len(run.next_flight.manoeuvres)
    low, high = found.at_best
    names = comparison.ordered(found.aircraft, found.parameters)
    little = [n for n in names if found.narrowed[n] > LITTLE]
    which = f"all {len(names)} parameters" if len(little) == len(names) else several(little)
    joint = comparison.bounds(run.mle, run.mle.crb_corrected)
    widest = "the joint fit has no intervals beside which to put its own"
    growth = {n: (m.ci95[1] - m.ci95[0]) / (joint[n].high - joint[n].low) for n, m in found.following.items()}
    finite = {n: g for n, g in growth.items() if g > 0.0 and g < float("inf")}
    if finite:  # by how much intervals grow from the joint fit to the next flight
        name = sorted(finite, key=lambda n: finite[n])[len(finite) // 2]
        both = [from_to(e.low, e.high, e.sd) for e in (Estimate.of(found.following[name]), joint[name])]
        widest = (
            f"intervals are {finite[name]:.1f} times as wide as those of the joint fit (median over parameters; "
            f"{name} {both[0]}, joint fit {both[1]})"
        )
    said = [
        f"The next flight: {widest}. Every manoeuvre enters by the normal approximation of its own fit.",
        f"{count} manoeuvres cannot tell the scatter between flights better than this: if each were known exactly, its "
        f"95 % interval would reach from {number(low, 2)} to {number(high, 2)} times the standard deviation of their "
        "estimates.",
    ]
    if little:
        said.append(
            f"The scatter of {which} is mostly its prior (above {LITTLE:.0%} of the prior's standard deviation is "
            "left); more manoeuvres would narrow the intervals of the next flight."
        )
    return [*said, *_doubts(found)]


def _doubts(found: NextFlight) -> Iterator[str]:
    """Parameters and manoeuvres that do not count, and a sampler that has not converged."""
    for n, manoeuvres in found.undetermined.items():
        others = len(found.manoeuvres) - len(manoeuvres)
        rests = f"its value rests on the other {others}" if others > 1 else "its scatter is the prior's"
        yield f"{several(manoeuvres)} do{'es' if len(manoeuvres) == 1 else ''} not determine {n}; {rests}."
    for m, reason in found.left_out.items():
        yield f"{m} is left out of the next flight: {reason}."
    if found.status is not PosteriorStatus.CONVERGED:
        yield f"Scatter between manoeuvres, NUTS: {found.status.value}."


def _digits(e: Estimate) -> str:
    return from_to(e.low, e.high, e.sd)


def _interval(e: Estimate) -> str:
    """Of a scatter, whose lower end is near zero."""
    return f"{number(e.low, 2)} to {number(e.high, 2)}"
