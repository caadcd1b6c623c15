"""Joint fit, manoeuvres alone and pooled, scatter between them and next flight: the table, and what it says."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from bayes_aero.inference.identification import Identification
from bayes_aero.inference.posterior.pooled.next_flight_result import NextFlight
from bayes_aero.inference.posterior.posterior import Marginal, PosteriorStatus
from bayes_aero.report.tables.comparison import bounds, ordered, unit_of
from bayes_aero.report.tables.table import Column, Estimate, Table, in_brackets, parameter_columns
from bayes_aero.report.text.phrases import from_to, number, several

ON_TERMINAL, ON_PAGE = 2, 4  # manoeuvres that are shown one by one; a file has all
LITTLE = 0.6  # share of its prior's deviation above which the scatter is called the prior's: our choice
PARTS = ("", "sd", "ci95_low", "ci95_high")
NOTE = (
    "SI units and radians. Parameters of a manoeuvre scatter around the aircraft's; “pooled” is a manoeuvre's value "
    "with what the others say of it. Manoeuvres enter by a normal approximation: the estimate and the corrected "
    "standard errors of their own fit. “Scatter over prior” is the standard deviation of the scatter over that of its "
    "prior: near 1 the records say little of it."
)


def next_flight_table(run: Identification) -> Table:
    """A row for each parameter, SI and radians.

    Raises:
        ValueError: the run has not pooled its manoeuvres.
    """
    found = _of(run)
    names = ordered(found.aircraft, found.parameters)
    few = len(found.manoeuvres) <= ON_TERMINAL
    joint = bounds(run.mle, run.mle.crb_corrected)
    name, unit, both = parameter_columns(names, [unit_of(run, n) for n in names])  # a terminal has the units above
    columns = [
        *(name, replace(unit, terminal=None), both),
        Column([joint[n] for n in names], ("joint", "joint_sd"), "joint", "joint", terminal_form=in_brackets),
    ]
    for m in found.manoeuvres:
        one_by_one = len(found.manoeuvres) <= ON_PAGE
        for kind, values in (("alone", _alone(found, m, names)), ("pooled", _marginals(found.pooled[m], names))):
            heads = kind if one_by_one else None, f"{m}\npooled" if few and kind == "pooled" else None
            columns.append(Column(values, (f"{m}_{kind}", f"{m}_{kind}_sd"), *heads, group=m))
    for key, head, numbers, forms in (
        ("aircraft", "aircraft", found.aircraft, ("", in_brackets)),
        ("scatter", "scatter\n95 %", found.scatter, (_interval, _interval)),
        ("next_flight", "next flight\n95 %", found.following, (_digits, _digits)),
    ):
        files = tuple(f"{key}_{part}".rstrip("_") for part in PARTS)
        columns.append(Column(_marginals(numbers, names), files, head, head.splitlines()[0], *forms))
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
    names = ordered(found.aircraft, found.parameters)
    little = [n for n in names if found.narrowed[n] > LITTLE]
    which = f"all {len(names)} parameters" if len(little) == len(names) else several(little)
    said = [
        f"The next flight: {_widest(run, found)}. Every manoeuvre enters by the normal approximation of its own fit.",
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


def _widest(run: Identification, found: NextFlight) -> str:
    """The parameter whose interval grows most from the joint fit to the next flight."""
    joint = bounds(run.mle, run.mle.crb_corrected)
    growth = {n: (m.ci95[1] - m.ci95[0]) / (joint[n].high - joint[n].low) for n, m in found.following.items()}
    finite = {n: g for n, g in growth.items() if g > 0.0 and g < float("inf")}
    if not finite:
        return "the joint fit has no intervals beside which to put its own"
    name = sorted(finite, key=lambda n: finite[n])[len(finite) // 2]
    numbers = [from_to(e.low, e.high, e.sd) for e in (_estimate(found.following[name]), joint[name])]
    return (
        f"intervals are {finite[name]:.1f} times as wide as those of the joint fit (median over parameters; "
        f"{name} {numbers[0]}, joint fit {numbers[1]})"
    )


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


def _of(run: Identification) -> NextFlight:
    if run.next_flight is None:
        raise ValueError("the manoeuvres of this run are not pooled")
    return run.next_flight


def _estimate(m: Marginal) -> Estimate:
    return Estimate(m.mean, m.sd, *m.ci95)


def _marginals(found: dict[str, Marginal], names: list[str]) -> list[Estimate]:
    return [_estimate(found[n]) for n in names]


def _alone(found: NextFlight, manoeuvre: str, names: list[str]) -> list[Estimate | None]:
    own = found.alone[manoeuvre]
    return [Estimate.normal(*own[n]) if n in own else None for n in names]


def _digits(e: Estimate) -> str:
    return from_to(e.low, e.high, e.sd)


def _interval(e: Estimate) -> str:
    """Of a scatter, whose lower end is near zero."""
    return f"{number(e.low, 2)} to {number(e.high, 2)}"
