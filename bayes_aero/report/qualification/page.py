"""The page that an evaluator signs or refuses: verdicts, strips, tests, extrapolation, and the rule."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.qualification.result import Kind, Qualification, Strip
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.page import Block, Facts, Fold, Page, Plot, Points, Table, Text, filled, section
from bayes_aero.report.html.page_table import page_table
from bayes_aero.report.html.parts import MOST_SHOWN, bullets, doubts, histories, provenance_blocks
from bayes_aero.report.html.plots import LOW, Line, Panel
from bayes_aero.report.qualification.further import further_sentences, further_table
from bayes_aero.report.qualification.tables import SHOWN, outside_table, test_table, verdict_table
from bayes_aero.report.qualification.text import DEFINITION, READ, UNREAD, sentences, verdict_sentence
from bayes_aero.report.text.phrases import axis_label, for_people

BLANK = "\u00a0" * 30
FLIGHTS = "#56B4E9"


@dataclass(frozen=True)
class QualificationContext:
    """What the page needs beside the qualification."""

    card: Card
    source: Mapping[str, Any]


def qualification_page(found: Qualification, context: QualificationContext) -> Page:
    """The page; its first screen is what is signed."""
    return Page(
        title=f"Qualification: {context.card.title}",
        subtitle="Probability that the simulation stays inside its tolerances",
        verdict=verdict_sentence(found),
        lead=(
            *doubts(found.health, found.consistency, corrects=False),
            page_table(verdict_table(found)),
            *bullets(sentences(found)),
            _signature(),
        ),
        sections=filled(
            section("further", "What would decide the rest", lambda: _further(found)),
            section("strips", "Strips", lambda: _strips(found)),
            section("tests", "Every test", lambda: (page_table(test_table(found)),)),
            section("region", "Extrapolation", lambda: _region(found)),
            section("counted", "What is counted", lambda: _counted(found)),
            section("rule", "The rule, and what of it was read", lambda: _rule(found)),
            section("provenance", "Provenance", lambda: _provenance(context.source)),
        ),
    )


def _signature() -> Table:
    """Lines for the evaluator."""
    return Table(
        "Decision of the evaluator",
        ("", "name", "signature", "date"),
        (("☐ accepted", BLANK, BLANK, BLANK), ("☐ refused, because", BLANK, BLANK, BLANK)),
        words=(1, 2, 3),
    )


def _strips(found: Qualification) -> tuple[Block, ...]:
    flown = [s for s in found.strips if s.kind is not Kind.NEXT]
    following = [s for s in found.strips if s.kind is Kind.NEXT]
    shown = flown[:MOST_SHOWN]
    more = (Text(f"The first {len(shown)} of {len(flown)} manoeuvres are shown."),) if len(flown) > len(shown) else ()
    text = (
        "Grey: the tolerance about the simulation with the estimates. Blue: the central 95 % of flights at each "
        "instant, with all that is counted. A test is passed where the flight stays in the grey band throughout; the "
        "record is black."
    )
    hidden = tuple(_strip(s, found, f"next-{k}") for k, s in enumerate(following[:MOST_SHOWN]))
    return (
        Text(text),
        *more,
        *(_strip(s, found, f"flown-{k}") for k, s in enumerate(shown)),
        *((Fold("The same manoeuvres on the next flight", hidden),) if hidden else ()),
    )


def _strip(strip: Strip, found: Qualification, key: str) -> Plot:
    """A panel for each output with a tolerance."""
    panels = []
    for output, (tolerance, _) in found.tolerances.items():
        unit = STANDARD_CHANNELS[output].unit
        factor = for_people(unit)[1]
        simulated, measured, low, high = (
            factor * x[output] for x in (strip.simulated, strip.measured, strip.low, strip.high)
        )
        lines = [
            Line("simulation", COLOURS["after"], simulated),
            Line("record", COLOURS["measured"], measured, width=1.0),
        ]
        lines += [Line(f"flights, {end}", FLIGHTS, x, width=0.6) for end, x in (("2.5 %", low), ("97.5 %", high))]
        if strip.kind is Kind.NEXT:
            lines[1] = Line("record of the manoeuvre", COLOURS["prior"], measured, width=1.0)
        panels.append(
            Panel(axis_label(output, unit), tuple(lines), shade=((2, 3),), band=factor * tolerance, height=LOW)
        )
    legend = (
        ("simulation", COLOURS["after"], "solid"),
        (lines[1].label, lines[1].colour, "solid"),
        ("95 % of flights", FLIGHTS, "area"),
        ("tolerance", "#999999", "area"),
    )
    what = "Simulation with its tolerance, record and central 95 % of flights"
    name = f"{strip.manoeuvre}, {SHOWN[strip.kind]}"
    return histories(name, f"time-{key}", strip.time, panels, legend, what)


def _further(found: Qualification) -> tuple[Block, ...]:
    table = (page_table(further_table(found.further)),) if found.further is not None and found.further.points else ()
    return (*bullets(further_sentences(found.further)), *table)


def _region(found: Qualification) -> tuple[Block, ...]:
    if not found.outside:
        return bullets([s for s in sentences(found) if "flown region" in s])
    return (page_table(outside_table(found)),)


def _counted(found: Qualification) -> tuple[Block, ...]:
    return (
        Text(DEFINITION),
        Facts(tuple((name.capitalize(), text) for name, text in found.origins.items())),
        Points(
            (
                f"{found.draws} flights are drawn for every test.",
                "Gusts and parameters, if the errors of the records hold them, are taken out of the errors of the "
                "structure by their mean squares.",
                "The errors of different outputs are drawn independently: a test of one output is a probability, all "
                "outputs together are not.",
            )
        ),
        *bullets(found.notes),
    )


def _rule(found: Qualification) -> tuple[Block, ...]:
    sources = tuple((name, source) for name, (_, source) in found.tolerances.items())
    return (
        Text("Read:"),
        Points(READ),
        Text("Not read, or not of the rule:"),
        Points(UNREAD),
        Fold("Origin of the tolerances", (Facts(sources),)),
    )


def _provenance(source: Mapping[str, Any]) -> tuple[Block, ...]:
    return (Fold("Inputs, versions and the command that repeat the run", provenance_blocks(source)),)
