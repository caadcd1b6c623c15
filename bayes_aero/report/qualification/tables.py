"""Tables of a qualification: a verdict for each tolerance, every test, and where the flown region is left."""

from __future__ import annotations

from collections.abc import Iterable

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.qualification.result import Chance, Kind, Outside, Qualification, Test
from bayes_aero.report.tables.table import Table, columns_of
from bayes_aero.report.text.phrases import SYMBOLS, for_people, number, several, short

SHOWN = {Kind.AGAIN: "fitted, flown again", Kind.TEST: "not fitted", Kind.NEXT: "next flight"}
NEGLIGIBLE = 1e-3  # of an excess, in the units of people
COUNTED = ("parameters", "structure", "gusts")


def band(output: str, tolerance: float) -> str:
    """An output with its band in the units of people."""
    unit, factor = for_people(STANDARD_CHANNELS[output].unit)
    return f"{SYMBOLS.get(output, output)} ± {number(factor * tolerance)} {unit}"


def chance_text(chance: Chance | None) -> str:
    """0.873 ± 0.017, and what Monte Carlo cannot resolve as a bound."""
    if chance is None:
        return "–"
    if chance.value in (0.0, 1.0):
        return f"{'<' if chance.value == 0.0 else '>'} {abs(chance.value - 3.0 * chance.error):.3f}"
    return f"{chance.value:z.3f} ± {chance.error:.3f}"


def weakest(tests: Iterable[Test]) -> Chance | None:
    """The least probability of some tests."""
    return min((test.chance for test in tests), key=lambda chance: chance.value, default=None)


def verdict_table(found: Qualification) -> Table:
    """A row for each tolerance."""
    rows = list(found.tolerances)
    column = columns_of(rows)

    def least(kind: Kind):
        return lambda output: chance_text(weakest(t for t in found.of(output) if t.kind is kind))

    def records(output: str) -> str:
        beside = [t.recorded for t in found.of(output) if t.recorded is not None]
        return f"{sum(one.passed for one in beside)} of {len(beside)}"

    new = any(test.kind is Kind.TEST for test in found.tests)
    columns = [
        column(lambda n: band(n, found.tolerances[n][0]), "", "tolerance", "tolerance"),
        column(lambda n: found.verdict(n).value, "", "verdict", "verdict"),
        column(records, "", "records\ninside", "records inside"),
        column(least(Kind.AGAIN), "", "fitted,\nflown again", "again"),
        *([column(least(Kind.TEST), "", "not fitted", "not fitted")] if new else []),
        column(least(Kind.NEXT), "", "next flight", "next flight"),
    ]
    note = (
        "Probability that a flight stays inside the tolerance about the simulation from start to end, of the weakest "
        "manoeuvre, ± Monte Carlo standard error. Records inside: of the simulation with the estimates, as recorded."
    )
    return Table(columns, "Verdict for each tolerance", note, terminal_note=note)


def test_table(found: Qualification) -> Table:
    """A row for each manoeuvre and output."""
    rows = list(found.tests)
    column = columns_of(rows)
    away = {(one.manoeuvre, one.motion) for one in found.outside}

    def part(name: str):
        return lambda t: chance_text(t.chances.get(name))

    def largest(test: Test) -> str:
        if test.recorded is None:
            return "–"
        unit, factor = for_people(STANDARD_CHANNELS[test.output].unit)
        return f"{short(factor * test.recorded.largest)} {unit}"

    columns = [
        column(lambda t: t.kind.value, "kind"),
        column(lambda t: t.manoeuvre, "manoeuvre"),
        column(lambda t: t.output, "output"),
        column(lambda t: band(t.output, t.tolerance), "", "tolerance"),
        column(lambda t: t.tolerance, "tolerance"),
        column(largest, "", "largest", group="record beside simulation"),
        column(lambda t: t.recorded and t.recorded.largest, "record_largest"),
        column(
            lambda t: t.recorded and t.recorded.within,
            "record_within",
            "time inside",
            form=".0%",
            group="record beside simulation",
        ),
        *[column(part(n), "", n, group="probability, counting also") for n in COUNTED],
        *[column(lambda t, n=n: t.chances[n].value if n in t.chances else None, f"probability_{n}") for n in COUNTED],
        column(lambda t: t.chance.value, "probability"),
        column(lambda t: t.chance.error, "standard_error"),
        column(lambda t: t.within, "expected_within", "time inside,\nexpected", form=".0%"),
        column(lambda t: t.chance.verdict.value, "verdict", "verdict"),
        column(lambda t: "yes" if _leaves(t, away) else "no", "extrapolation", "extra-\npolation"),
    ]
    note = (
        "Every column of probabilities counts one thing more: the parameters, then errors of the model's structure and "
        "noise, then gusts. Decided where the probability with all of it lies two Monte Carlo standard errors beyond "
        "0.95 or 0.05. Extrapolation: the manoeuvre leaves the flown region."
    )
    below = [f"{t.manoeuvre}, {SHOWN[t.kind]}" for t in rows]
    return Table(columns, "Every test", note, index=3, below=below)


def _leaves(test: Test, away: set[tuple[str, str]]) -> bool:
    return any((test.manoeuvre, motion) in away for motion in ("recorded", "simulated"))


def outside_table(found: Qualification) -> Table:
    """A row for each motion that leaves the flown region."""
    rows = list(found.outside)
    column = columns_of(rows)
    return Table(
        [
            column(lambda o: o.manoeuvre, "manoeuvre", "manoeuvre"),
            column(lambda o: o.motion, "motion", "motion", words=True),
            column(lambda o: o.share, "share", "samples\noutside", form=".0%"),
            column(lambda o: o.distance, "distance", "farthest", form=".2f"),
            column(lambda o: o.time, "time", "at, s", form=".1f"),
            column(excess, "", "from the nearest flown point", words=True),
        ],
        "Extrapolation: samples outside the flown region",
        f"The flown region is the convex hull of all fitted samples in {several(found.channels)}. Samples count from a "
        "distance of 0.1. Distances are in units of half the flown range of each channel.",
    )


def excess(one: Outside) -> str:
    """By channel, in the units of people; what is less than a thousandth of a unit is left out."""
    parts = []
    for name, x in one.excess.items():
        unit, factor = for_people(STANDARD_CHANNELS[name].unit)
        if abs(factor * x) >= NEGLIGIBLE:
            parts.append(f"{SYMBOLS.get(name, name)} {factor * x:+.2g} {'' if unit == '1' else unit}".strip())
    return ", ".join(parts)
