"""The page that an evaluator signs or refuses: verdicts, strips, tests, extrapolation, and the rule."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.qualification import result
from bayes_aero.qualification.result import FlightKind, Qualification, Strip, Test, ToleranceVerdict
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.design import order_sentence, point_columns
from bayes_aero.report.html import page as html
from bayes_aero.report.html.page import Block, Fold, HtmlTable, Text, bullets, page_table, section
from bayes_aero.report.html.plots import LOW, Line, Panel
from bayes_aero.report.tables.table import Column, Table, columns_of
from bayes_aero.report.text.phrases import WORDS, amounts, for_people, several, symbol
from bayes_aero.units import number

BLANK = "\u00a0" * 30
FLIGHTS = "#56B4E9"


def qualification_page(found: Qualification, card: Card, source: Mapping[str, Any]) -> html.Report:
    """The page; its first screen is what is signed. `source` is its provenance."""
    signature = HtmlTable(
        "Decision of the evaluator",
        ("", "name", "signature", "date"),
        (("☐ accepted", BLANK, BLANK, BLANK), ("☐ refused, because", BLANK, BLANK, BLANK)),
        words=(1, 2, 3),
    )

    def further() -> tuple[Block, ...]:
        tables = [further_table(found.further)] if found.further is not None and found.further.points else []
        return (*bullets(further_sentences(found.further)), *map(page_table, tables))

    said = WORDS["qualification"]
    origins = tuple((name.capitalize(), text) for name, text in found.origins.items())
    tolerances = tuple((name, source) for name, (_, source) in found.tolerances.items())
    draws = f"{found.draws} flights are drawn for every test."
    counted = Text(said["definition"]), html.Facts(origins), html.Points((draws, *said["counting"]))
    read, unread = html.Points(tuple(said["read"])), html.Points(tuple(said["unread"]))
    sources = Fold("Origin of the tolerances", (html.Facts(tolerances),))
    rule = (Text("Read:"), read, Text("Not read, or not of the rule:"), unread, sources)
    return html.Report(
        title=f"Qualification: {card.title}",
        subtitle="Probability that the simulation stays inside its tolerances",
        verdict=verdict_sentence(found),
        lead=(
            *html.doubts(found.health, found.consistency, corrects=False),
            page_table(verdict_table(found)),
            *bullets(sentences(found)),
            signature,
        ),
        sections=html.filled(
            section("further", "What would decide the rest", further),
            section("strips", "Strips", lambda: _strips(found)),
            section("tests", "Every test", lambda: (page_table(test_table(found)),)),
            section(
                "region",
                "Extrapolation",
                lambda: (page_table(outside_table(found)),) if found.outside else bullets(region_sentences(found)),
            ),
            section("counted", "What is counted", lambda: (*counted, *bullets(found.notes))),
            section("rule", "The rule, and what of it was read", lambda: rule),
            html.provenance_section(source),
        ),
    )


def _strips(found: Qualification) -> tuple[Block, ...]:
    flown = [s for s in found.strips if s.kind is not FlightKind.NEXT]
    following = [s for s in found.strips if s.kind is FlightKind.NEXT]
    shown, more = flown[: html.MOST_SHOWN], html.first([s.manoeuvre for s in flown])[1]
    text = WORDS["paragraphs"]["strips"]
    hidden = tuple(_strip(s, found, f"next-{k}") for k, s in enumerate(following[: html.MOST_SHOWN]))
    return (
        Text(text),
        *more,
        *(_strip(s, found, f"flown-{k}") for k, s in enumerate(shown)),
        *((Fold("The same manoeuvres on the next flight", hidden),) if hidden else ()),
    )


def _strip(strip: Strip, found: Qualification, key: str) -> html.Plot:
    """A panel for each output with a tolerance."""
    panels, record, colour = [], "record", COLOURS["measured"]
    if strip.kind is FlightKind.NEXT:
        record, colour = "record of the manoeuvre", COLOURS["prior"]
    for output, (tolerance, _) in found.tolerances.items():
        unit, factor = for_people(STANDARD_CHANNELS[output].unit)
        lines = (
            Line("simulation", COLOURS["after"], factor * strip.simulated[output]),
            Line(record, colour, factor * strip.measured[output], width=1.0),
            Line("flights, 2.5 %", FLIGHTS, factor * strip.low[output], width=0.6),
            Line("flights, 97.5 %", FLIGHTS, factor * strip.high[output], width=0.6),
        )
        panels.append(Panel(symbol(output), unit, lines, shade=((2, 3),), band=factor * tolerance, height=LOW))
    legend = (
        ("simulation", COLOURS["after"], "solid"),
        (record, colour, "solid"),
        ("95 % of flights", FLIGHTS, "area"),
        ("tolerance", "#999999", "area"),
    )
    what = "Simulation with its tolerance, record and central 95 % of flights"
    name = f"{strip.manoeuvre}, {SHOWN[strip.kind]}"
    return html.histories(name, f"time-{key}", strip.time, panels, legend, what)


# --- Flights that would decide undecided tolerances: a table, and what it says.

MOST = 6  # tests that are named in a sentence


def further_table(found: result.Further) -> Table:
    """A row for each test point, in the order of flying."""
    columns = point_columns([asdict(p) for p in found.points])
    decidable = [(k, test) for k, test in enumerate(found.tests) if test.decidable]
    for k, test in decidable:
        head = _label(test).replace(" of ", "\n", 1)
        columns.append(Column([p.expected[k] for p in found.points], page=head, form=".2f", group="then probability"))
    return Table(columns, "Test points that would decide tolerances, in the order of flying", WORDS["notes"]["further"])


def further_sentences(found: result.Further | None) -> tuple[str, ...]:
    """What to fly, and which tests no flight decides."""
    if found is None:
        return ()
    if found.why_not:
        return (f"No test points for the undecided tolerances: {found.why_not}.",)
    said = []
    open_ = [t for t in found.tests if not t.decidable]
    if found.points:
        last = found.points[-1].expected
        said.append(order_sentence([asdict(p) for p in found.points]))
        chances = [
            f"{_label(t)} {x:.2f} (now {t.present:.2f})" for t, x in zip(found.tests, last, strict=True) if t.decidable
        ]
        said.append(f"Expected probabilities to pass with these points: {several(chances[:MOST])}.")
    elif len(open_) < len(found.tests):
        said.append("No standard manoeuvre inside the envelope narrows the undecided tests enough to be worth flying.")
    if open_:
        listed = several(map(_label, open_[:MOST]))
        more = f" and {len(open_) - MOST} more" if len(open_) > MOST else ""
        said.append(
            f"Undecided even if the parameters were known: {listed}{more}. Errors of the model's structure or gusts "
            "leave them open, not parameters: improve the model (diagnose)."
        )
    return tuple(said)


def _label(test: result.OpenTolerance) -> str:
    """Output, manoeuvre, and whether it is flown on the next flight."""
    ahead = " on the next flight" if test.kind is FlightKind.NEXT else ""
    return f"{symbol(test.output)} of {test.manoeuvre}{ahead}"


# --- Tables of a qualification: a verdict for each tolerance, every test, and where the flown region is left.

SHOWN = {FlightKind.AGAIN: "fitted, flown again", FlightKind.TEST: "not fitted", FlightKind.NEXT: "next flight"}
NEGLIGIBLE = 1e-3  # of an excess, in the units of people
COUNTED = ("parameters", "structure", "gusts")


def band(output: str, tolerance: float) -> str:
    """An output with its band in the units of people."""
    unit, factor = for_people(STANDARD_CHANNELS[output].unit)
    return f"{symbol(output)} ± {number(factor * tolerance)} {unit}"


def chance_text(chance: result.Chance | None) -> str:
    """0.873 ± 0.017, and what Monte Carlo cannot resolve as a bound."""
    if chance is None:
        return "–"
    if chance.value in (0.0, 1.0):
        return f"{'<' if chance.value == 0.0 else '>'} {abs(chance.value - 3.0 * chance.error):.3f}"
    return f"{chance.value:z.3f} ± {chance.error:.3f}"


def verdict_table(found: Qualification) -> Table:
    """A row for each tolerance."""
    rows = list(found.tolerances)
    column = columns_of(rows)

    def least(kind: FlightKind):
        of = {output: [t.chance for t in found.of(output) if t.kind is kind] for output in rows}
        return lambda output: chance_text(min(of[output], key=lambda chance: chance.value, default=None))

    def records(output: str) -> str:
        beside = [t.recorded for t in found.of(output) if t.recorded is not None]
        return f"{sum(one.passed for one in beside)} of {len(beside)}"

    new = any(test.kind is FlightKind.TEST for test in found.tests)
    columns = [
        column(lambda n: band(n, found.tolerances[n][0]), "", "tolerance", "tolerance"),
        column(lambda n: found.verdict(n).value, "", "verdict", "verdict"),
        column(records, "", "records\ninside", "records inside"),
        column(least(FlightKind.AGAIN), "", "fitted,\nflown again", "again"),
        *([column(least(FlightKind.TEST), "", "not fitted", "not fitted")] if new else []),
        column(least(FlightKind.NEXT), "", "next flight", "next flight"),
    ]
    note = WORDS["notes"]["qualification_verdict"]
    return Table(columns, "ToleranceVerdict for each tolerance", note, terminal_note=note)


def test_table(found: Qualification) -> Table:
    """A row for each manoeuvre and output."""
    rows = list(found.tests)
    column = columns_of(rows)
    away = {one.manoeuvre for one in found.outside if one.motion in ("recorded", "simulated")}

    def part(name: str):
        return lambda t: chance_text(t.chances.get(name))

    def largest(test: Test) -> str:
        if test.recorded is None:
            return "–"
        return "".join(amounts(STANDARD_CHANNELS[test.output].unit, test.recorded.largest))

    record = "record beside simulation"
    columns = [
        column(lambda t: t.kind.value, "kind"),
        column(lambda t: t.manoeuvre, "manoeuvre"),
        column(lambda t: t.output, "output"),
        column(lambda t: band(t.output, t.tolerance), "", "tolerance"),
        column(lambda t: t.tolerance, "tolerance"),
        column(largest, "", "largest", group=record),
        column(lambda t: t.recorded and t.recorded.largest, "record_largest"),
        column(lambda t: t.recorded and t.recorded.within, "record_within", "time inside", form=".0%", group=record),
        *[column(part(n), "", n, group="probability, counting also") for n in COUNTED],
        *[column(lambda t, n=n: t.chances[n].value if n in t.chances else None, f"probability_{n}") for n in COUNTED],
        column(lambda t: t.chance.value, "probability"),
        column(lambda t: t.chance.error, "standard_error"),
        column(lambda t: t.within, "expected_within", "time inside,\nexpected", form=".0%"),
        column(lambda t: t.chance.verdict.value, "verdict", "verdict"),
        column(lambda t: "yes" if t.manoeuvre in away else "no", "extrapolation", "extra-\npolation"),
    ]
    note = WORDS["notes"]["qualification_tests"]
    below = [f"{t.manoeuvre}, {SHOWN[t.kind]}" for t in rows]
    return Table(columns, "Every test", note, index=3, below=below)


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


def excess(one: result.Outside) -> str:
    """By channel, in the units of people; what is less than a thousandth of a unit is left out."""
    parts = []
    for name, x in one.excess.items():
        unit, factor = for_people(STANDARD_CHANNELS[name].unit)
        if abs(factor * x) >= NEGLIGIBLE:
            parts.append(f"{symbol(name)} {factor * x:+.2g} {'' if unit == '1' else unit}".strip())
    return ", ".join(parts)


# --- What a qualification says.

WHOLE = {
    ToleranceVerdict.PASSES: ("Passes", "The model qualifies: it passes every tolerance."),
    ToleranceVerdict.UNDECIDED: ("Undecided", "It is not decided whether the model qualifies."),
    ToleranceVerdict.FAILS: ("Fails", "The model does not qualify."),
}


def verdict_sentence(found: Qualification) -> str:
    """The model's verdict, and the tolerances that decide it."""
    by = {v: [n for n in found.tolerances if found.verdict(n) is v] for v in ToleranceVerdict}
    listed = [
        f"{WHOLE[v][0]}: {several(band(n, found.tolerances[n][0]) for n in names)}" for v, names in by.items() if names
    ]
    return f"{WHOLE[found.whole][1]} {'. '.join(listed)}."


def sentences(found: Qualification) -> tuple[str, ...]:
    """Weakest tests, agreement of the probabilities with the records, and extrapolation."""
    said = []
    for kind, words in (
        (FlightKind.AGAIN, "fitted manoeuvre flown again"),
        (FlightKind.TEST, "manoeuvre that was not fitted"),
    ):
        if tests := [t for t in found.tests if t.kind is kind]:
            expected = sum(t.chance.value for t in tests)
            passed = sum(t.recorded is not None and t.recorded.passed for t in tests)
            said.append(
                f"{len(tests)} tests of a {words}: {expected:.1f} are expected to pass, {passed} of the records do."
            )
    if following := [t for t in found.tests if t.kind is FlightKind.NEXT]:
        least = min(following, key=lambda t: t.chance.value)
        said.append(
            f"On the next flight {band(least.output, least.tolerance)} is the weakest, in {least.manoeuvre}: "
            f"probability {chance_text(least.chance)}."
        )
    return (*said, *region_sentences(found))


def region_sentences(found: Qualification) -> list[str]:
    """Where manoeuvres leave the flown region."""
    said = [
        f"Extrapolation: {one.manoeuvre}, as {one.motion}, is outside the flown region in {one.share:.0%} of the "
        f"samples, farthest by {one.distance:.2f} of half the flown ranges at {one.time:.1f} s ({excess(one)})."
        for one in found.outside
    ] or [f"No manoeuvre leaves the flown region of {several(found.channels)}."]
    if found.unjudged:
        said.append(f"Not recorded, so not part of the flown region: {several(found.unjudged)}.")
    return said
