"""What a qualification shows: verdicts, tests, extrapolation, the page to sign; and test points that decide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.page import Facts, Report, fold, section
from bayes_aero.report.pages import parts
from bayes_aero.report.phrases import WORDS, amounts, for_people, sentence, several, symbol, unit_behind
from bayes_aero.report.plots import COLOURS, LOW, Line, Panel
from bayes_aero.report.screen import Screen, actions, claims, doubts_of
from bayes_aero.report.table import NONE, Column, Table, TextTable, columns_of, table
from bayes_aero.units import number

if TYPE_CHECKING:
    from bayes_aero.flight.card import Card
    from bayes_aero.qualification import Chance, Further, OpenTolerance, Outside, Qualification, Strip

RANGES = {
    "alpha": ("deg", parts.DEG, "{:.0f}"), "airspeed": ("m/s", 1.0, "{:.0f}"), "load_factor": ("g", 1.0, "{:.2f}"),
    "altitude_loss": ("m", 1.0, "{:.0f}"),  # of which people read the greatest alone
}  # fmt: skip
"""Unit, factor to it and digits of the ranges that a test point needs."""
MOST = 6  # tests that are named in a sentence


def point_columns(points: Sequence[Mapping[str, Any]]) -> list[Column]:
    """Test points in the order of flying: what is flown, and the ranges that it needs."""
    column = columns_of(points)
    columns = [
        Column(list(range(1, len(points) + 1)), "point", "point", form="d"),
        column(lambda p: str(p["manoeuvre"]).replace("_", " "), "manoeuvre", "manoeuvre"),
        column(lambda p: p["amplitude"], "amplitude", "amplitude\n[standard inputs]", form=".1f"),
        column(lambda p: p["airspeed"], "airspeed", "from airspeed\n[m/s]", form=".0f"),
        column(lambda p: p["altitude"], "altitude", "from altitude\n[m]", form=".0f"),
        column(lambda p: p["seconds"], "seconds", "time\n[s]", form=".0f"),
    ]
    for name, (unit, factor, form) in RANGES.items():
        ranges, shown = [p["excursion"].get(name) for p in points], []
        for pair in ranges:
            low, high = ("", "") if pair is None else (form.format(factor * x) for x in pair)
            greatest = "" if pair is None else form.format(max(factor * pair[1], 0.0))
            shown.append(greatest if name == "altitude_loss" or pair is None else f"{low} to {high}")
        columns.append(Column(shown, "", f"{name.replace('_', ' ')}\n[{unit}]", form=str))
        for k, end in enumerate(("least", "greatest")):
            columns.append(Column([None if x is None else x[k] for x in ranges], f"{name}_{end}"))
    return columns


def points_table(test_points: Mapping[str, Any]) -> Table:
    """A row for each test point, in the order of flying, from `test_points` of diagnosis.json."""
    points = test_points["points"]
    columns = point_columns(points)
    for k, question in enumerate(test_points["questions"]):
        label, key = (between.join(question["effects"]) for between in (" or ", "_or_"))
        values = [p["standard_errors"][k] for p in points]
        columns.append(Column(values, f"standard_errors_{key}", label, form=".1f", group="then apart"))
    return table("points", columns, enough=max(q["enough"] for q in test_points["questions"]))


def _order_sentence(points: Sequence[Mapping[str, Any]]) -> list[str]:
    flown = [sentence("test_point", p=p, manoeuvre=str(p["manoeuvre"]).replace("_", " ")) for p in points]
    return [f"Next test points, in this order: {several(flown)}."] if flown else []


def points_sentences(test_points: Mapping[str, Any]) -> tuple[str, ...]:
    """What to fly next, for each question what it is expected to say, and the envelope."""
    if not test_points:
        return ()
    points = test_points["points"]
    sentences = _order_sentence(points)
    for k, question in enumerate(test_points["questions"]):
        after = points[-1]["standard_errors"][k] if points else question["present"]
        key = "decides" if after >= question["enough"] else "decides_not"
        sentences.append(sentence(key, label=" or ".join(question["effects"]), q=question, after=after))
    return tuple(sentences) if test_points["stated"] else (*sentences, sentence("no_envelope"))


def further_table(further: Further) -> Table:
    columns = point_columns([asdict(p) for p in further.points])
    for k, test in ((k, test) for k, test in enumerate(further.tests) if test.decidable):
        head, expected = _label(test).replace(" of ", "\n", 1), [p.expected[k] for p in further.points]
        columns.append(Column(expected, page=head, form=".2f", group="then probability"))
    return table("further", columns)


def further_sentences(further: Further | None) -> tuple[str, ...]:
    if further is None:
        return ()
    if further.why_not:
        return (f"No test points for the undecided tolerances: {further.why_not}.",)
    undecidable, texts = [_label(t) for t in further.tests if not t.decidable], []
    if further.points:
        both = zip(further.tests, further.points[-1].expected, strict=True)
        chances = [f"{_label(t)} {x:.2f} (now {t.present:.2f})" for t, x in both if t.decidable]
        texts += _order_sentence([asdict(p) for p in further.points])
        texts.append(f"Expected probabilities to pass with these points: {several(chances[:MOST])}.")
    elif len(undecidable) < len(further.tests):
        texts.append(sentence("no_point_helps"))
    return (*texts, *([sentence("structure_open", tests=several(undecidable, MOST))] if undecidable else []))


def _label(test: OpenTolerance) -> str:
    ahead = " on the next flight" if test.kind.name == "NEXT" else ""
    return f"{symbol(test.output)} of {test.manoeuvre}{ahead}"


# --- A verdict for each tolerance, every test, and where the flown region is left.

SHOWN = {"AGAIN": "fitted, flown again", "TEST": "not fitted", "NEXT": "next flight"}
NEGLIGIBLE = 1e-3  # of an excess, in the units of people
COUNTED = ("parameters", "structure", "gusts")
BLANK = "\u00a0" * 30
FLIGHTS, ORIGIN = "#56B4E9", "Origin of the tolerances"


def band(output: str, tolerance: float) -> str:
    """An output with its band in the units of people."""
    unit, factor = for_people(STANDARD_CHANNELS[output].unit)
    return f"{symbol(output)} ± {number(factor * tolerance)} {unit}"


def chance_text(chance: Chance | None) -> str:
    """0.873 ± 0.017, and what Monte Carlo cannot resolve as a bound."""
    if chance is None:
        return NONE
    if chance.value in (0.0, 1.0):
        return f"{'<' if chance.value == 0.0 else '>'} {abs(chance.value - 3.0 * chance.error):.3f}"
    return f"{chance.value:z.3f} ± {chance.error:.3f}"


def verdict_table(q: Qualification) -> Table:
    column = columns_of(list(q.tolerances))

    def least(kind: str, page: str) -> Column:
        def of(output: str) -> str:
            chances = [t.chance for t in q.of(output) if t.kind.name == kind]
            return chance_text(min(chances, key=lambda chance: chance.value, default=None))

        return column(of, "", page)

    def records(output: str) -> str:
        passed = [t.recorded.passed for t in q.of(output) if t.recorded is not None]
        return f"{sum(passed)} of {len(passed)}"

    new = any(test.kind.name == "TEST" for test in q.tests)
    columns = [
        column(lambda n: band(n, q.tolerances[n][0]), "", "tolerance"),
        column(lambda n: q.verdict(n).value, "", "verdict"),
        column(records, "", "records\ninside"),
        least("AGAIN", "fitted,\nflown again"),
        *([least("TEST", "not fitted")] if new else []),
        least("NEXT", "next flight"),
    ]
    return table("verdicts", columns)


def test_table(q: Qualification) -> Table:
    rows = list(q.tests)
    column = columns_of(rows)
    away = {o.manoeuvre for o in q.outside if o.motion in ("recorded", "simulated")}
    largest = [t.recorded and "".join(amounts(STANDARD_CHANNELS[t.output].unit, t.recorded.largest)) for t in rows]
    record, counting = "record beside simulation", "probability, counting also"
    columns = [
        column(lambda t: t.kind.value, "kind"),
        column(lambda t: t.manoeuvre, "manoeuvre"),
        column(lambda t: t.output, "output"),
        column(lambda t: band(t.output, t.tolerance), "", "tolerance"),
        column(lambda t: t.tolerance, "tolerance"),
        Column(largest, "", "largest", group=record),
        column(lambda t: t.recorded and t.recorded.largest, "record_largest"),
        column(lambda t: t.recorded and t.recorded.within, "record_within", "time inside", form=".0%", group=record),
        *(column(lambda t, n=n: chance_text(t.chances.get(n)), "", n, group=counting) for n in COUNTED),
        *[column(lambda t, n=n: t.chances[n].value if n in t.chances else None, f"probability_{n}") for n in COUNTED],
        column(lambda t: t.chance.value, "probability"),
        column(lambda t: t.chance.error, "standard_error"),
        column(lambda t: t.within, "expected_within", "time inside,\nexpected", form=".0%"),
        column(lambda t: t.chance.verdict.value, "verdict", "verdict"),
        column(lambda t: "yes" if t.manoeuvre in away else "no", "extrapolation", "extra-\npolation"),
    ]
    return table("tests", columns, index=3, below=[f"{t.manoeuvre}, {SHOWN[t.kind.name]}" for t in rows])


def _excess(o: Outside) -> str:
    """By channel, in the units of people; what is less than a thousandth of a unit is left out."""
    units = {name: for_people(STANDARD_CHANNELS[name].unit) for name in o.excess}
    sizes = {name: units[name][1] * x for name, x in o.excess.items()}
    shown = {name: x for name, x in sizes.items() if abs(x) >= NEGLIGIBLE}
    return ", ".join(f"{symbol(name)} {x:+.2g}{unit_behind(units[name][0])}" for name, x in shown.items())


def qualification_screen(q: Qualification, result: str = "RESULT", failures: Sequence[str] = ()) -> Screen:
    """The verdict for each tolerance, with the probabilities to pass; `failures`: parts that went wrong."""
    record, mend = parts.record_block((), q.health, q.consistency)
    messages = doubts_of([*sentences(q), *further_sentences(q.further)])
    points = [] if q.further is None else _order_sentence([asdict(p) for p in q.further.points])
    shown = [sentence(f"model_{q.whole.value}"), verdict_table(q)]
    export = [sentence("next_export", result=result)] if q.whole.value == "passes" else []
    return Screen(
        record, shown, [*failures, *claims(messages), *q.notes], [*mend, *points, *actions(messages), *export]
    )


def sentences(q: Qualification) -> tuple[str, ...]:
    """Whether the probabilities agree with the records, and extrapolation."""
    texts = []
    for kind, words in (("AGAIN", "fitted manoeuvre flown again"), ("TEST", "manoeuvre that was not fitted")):
        if tests := [t for t in q.tests if t.kind.name == kind]:
            expected = sum(t.chance.value for t in tests)
            passed = sum(t.recorded is not None and t.recorded.passed for t in tests)
            texts.append(sentence("expected_passes", n=len(tests), words=words, expected=expected, passed=passed))
    return (*texts, *region_sentences(q))


def region_sentences(q: Qualification) -> list[str]:
    texts = [sentence("outside_region", o=o, excess=_excess(o)) for o in q.outside]
    texts = texts or [sentence("inside_region", channels=q.channels)]
    return texts + ([sentence("region_unjudged", channels=q.unjudged)] if q.unjudged else [])


def qualification_page(q: Qualification, card: Card, source: Mapping[str, Any]) -> Report:
    """The page; its first screen is what is signed. `source` is its provenance."""
    lines = (("☐ accepted", BLANK, BLANK, BLANK), ("☐ refused, because", BLANK, BLANK, BLANK))
    signature = TextTable("Decision of the evaluator", ("", "name", "signature", "date"), lines, words=(1, 2, 3))
    words, further = WORDS["qualification"], q.further
    origins = tuple((name.capitalize(), text) for name, text in q.origins.items())
    tolerances = tuple((name, origin) for name, (_, origin) in q.tolerances.items())
    draws = f"{q.draws} flights are drawn for every test."
    counted = (words["definition"], Facts(origins), [draws, *words["counting"]], list(q.notes))
    read = ("Read:", words["read"], "Not read, or not of the rule:", words["unread"])
    what = further_table(further) if further and further.points else None

    about, same = WORDS["paragraphs"]["strips"], "The same manoeuvres on the next flight"

    def strips(*kinds: str) -> list[Any]:
        shown = [s for s in q.strips if s.kind.name in kinds]
        names = [f"{s.manoeuvre}, {SHOWN[s.kind.name]}" for s in shown]
        what = "Simulation with its tolerance, record and central 95 % of flights"
        return parts.flights(names, kinds[0].lower(), what, lambda k, _: (shown[k].time, _strip(shown[k], q)))

    return Report(
        title=f"Qualification: {card.title}",
        subtitle="Probability that the simulation stays inside its tolerances",
        verdict=qualification_screen(q),
        lead=[signature, list(sentences(q))],
        sections=[
            section("further", "What would decide the rest", lambda: (list(further_sentences(further)), what)),
            section("strips", "Strips", lambda: (about, strips("AGAIN", "TEST"), fold(same, strips("NEXT")[1:]))),
            section("tests", "Every test", lambda: test_table(q)),
            section("region", "Extrapolation", lambda: region_sentences(q)),
            section("counted", "What is counted", lambda: counted),
            section("rule", "The rule, and what of it was read", lambda: (read, fold(ORIGIN, Facts(tolerances)))),
            parts.provenance_section(source, folded=True),
        ],
    )


def _strip(strip: Strip, q: Qualification) -> list[Panel]:
    ahead, panels = strip.kind.name == "NEXT", []
    record = "record of the manoeuvre" if ahead else "record"
    for output, (tolerance, _) in q.tolerances.items():
        unit, factor = for_people(STANDARD_CHANNELS[output].unit)
        lines = (
            Line("simulation", COLOURS["after"], factor * strip.simulated[output]),
            Line(record, COLOURS["prior" if ahead else "measured"], factor * strip.measured[output], width=1.0),
            Line("95 % of flights", FLIGHTS, factor * strip.low[output], width=0.6),
            Line("95 % of flights", FLIGHTS, factor * strip.high[output], width=0.6),
        )
        panels.append(Panel(symbol(output), unit, lines, shade=((2, 3),), band=factor * tolerance, height=LOW))
    return panels
