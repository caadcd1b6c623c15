"""The report of a run as one self-contained HTML page: what stands on it, and how it gets to disk.

A page is a tree of plain blocks, so that what is said is separate from how it looks. Everything is escaped by Jinja2;
the only text that is not is the package's own style, script and plotting library. Nothing is fetched from a network.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup, escape

from bayes_aero import __version__
from bayes_aero.atomic_write import write_whole
from bayes_aero.errors import failure
from bayes_aero.flight.card import Card, channel_units
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import Agreement, Consistency, HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.parameter import Parameter
from bayes_aero.physics.aircraft import Axis
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.plots import LOW, MOST, TIME, Line, Over, Panel, linked
from bayes_aero.report.tables.table import Table, cell_text
from bayes_aero.report.text.check import among_text, consistency_sentences, not_told_apart
from bayes_aero.report.text.phrases import WORDS, bracket, channel_axis, for_people, plain_unit, several, symbol
from bayes_aero.units import number

ACROSS = 150  # characters in a row of a table from which paper is turned
HALF = 56  # characters in a row that fit in half a sheet
SHEET = 40  # lines of a table that surely fit on a sheet
FOLDED = 25  # characters in a line of a column of text


@dataclass(frozen=True)
class Text:
    """A paragraph; `tone` is plain, lead or warning."""

    text: str
    tone: str = "plain"
    kind: str = field(default="text", init=False)


@dataclass(frozen=True)
class Unmade(Text):
    """Replacement of a section that could not be made; `failure` is a sentence on the reason."""

    failure: str = ""


@dataclass(frozen=True)
class Points:
    """Sentences, one a bullet."""

    items: tuple[str, ...]
    kind: str = field(default="points", init=False)


@dataclass(frozen=True)
class Facts:
    """Name and value, one a line."""

    items: tuple[tuple[str, str], ...]
    kind: str = field(default="facts", init=False)


@dataclass(frozen=True)
class HtmlTable:
    """Rows of text under headings (of numbers: `page_table`); the first cell of a row is its heading."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    groups: tuple[tuple[str, int], ...] = ()  # with the number of headings that each spans
    words: tuple[int, ...] = ()  # columns that hold text (left-aligned) beside the first
    note: str = ""
    links: tuple[str, ...] = ()  # relative addresses that the first cells lead to, one a row, empty for none
    kind: str = field(default="table", init=False)

    def lean(self) -> HtmlTable:
        """Without the columns that are empty in every row."""
        kept = [i for i in range(len(self.head)) if any(row[i] for row in self.rows)]
        head, *rows = (tuple(row[i] for i in kept) for row in (self.head, *self.rows))
        words = tuple(new for new, i in enumerate(kept) if i in self.words)
        return replace(self, head=head, rows=tuple(rows), words=words)

    def _widths(self) -> list[int]:
        """Characters in the longest line of each column."""
        columns = zip(*self.rows, strict=True) if self.rows else ()
        return [max(len(line) for cell in column for line in cell.split("\n")) for column in columns]

    @property
    def across(self) -> int:
        """Characters in a row, with room between columns; text can be folded."""
        widths = [min(width, FOLDED) if i in self.words else width for i, width in enumerate(self._widths())]
        return sum(widths) + 2 * len(widths)

    @property
    def broad(self) -> bool:
        """Whether it needs a landscape sheet when printed."""
        return self.across > ACROSS

    @property
    def slim(self) -> bool:
        """Whether another table fits beside it when printed."""
        widths = self._widths()
        lines = sum(max(cell.count("\n") + 1 for cell in row) for row in self.rows)
        return sum(widths) + 2 * len(widths) <= HALF and lines <= SHEET


@dataclass(frozen=True)
class Picture:
    """A static figure."""

    source: str  # a data URI
    alt: str  # says in words and numbers what it shows
    caption: str
    width: int  # pixels of the picture
    height: int
    natural: int  # its width on a screen at which its text has nominal size
    kind: str = field(default="picture", init=False)


@dataclass(frozen=True)
class Plot:
    """An interactive figure: what Bokeh needs to draw it, a legend (label, colour, style), words as for a picture."""

    item: Mapping[str, Any]
    legend: tuple[tuple[str, str, str], ...]
    alt: str
    caption: str
    title: str = ""
    kind: str = field(default="plot", init=False)


@dataclass(frozen=True)
class Fold:
    """Blocks behind a line that opens them."""

    title: str
    blocks: tuple[Block, ...]
    kind: str = field(default="fold", init=False)


Block = Text | Points | Facts | HtmlTable | Picture | Plot | Fold


@dataclass(frozen=True)
class Section:
    """A heading with its blocks; `key` is its anchor."""

    key: str
    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Report:
    """A report: doubts of the records, if any; a verdict in one sentence, one picture, then sections."""

    title: str
    subtitle: str
    verdict: str
    lead: tuple[Block, ...]
    sections: tuple[Section, ...]
    doubts: tuple[Block, ...] = ()


@dataclass(frozen=True)
class PageContext:
    """What a page shows beside a result: card, records, provenance, figures by stem, and what was noted of the run."""

    card: Card
    records: Sequence[FlightRecord]
    source: Mapping[str, Any]
    figures: Mapping[str, Path] = field(default_factory=dict)
    notes: Sequence[str] = ()  # parts that were left out, with the reason
    consistency: Consistency | None = None
    failures: Sequence[str] = ()  # parts that failed unexpectedly
    health: Sequence[HealthFinding] = ()  # faults of channels


def section(key: str, title: str, make: Callable[[], Iterable[Block]]) -> Section:
    """A section with the blocks of `make`; if that fails, the section states the reason."""
    try:
        return Section(key, title, tuple(make()))
    except Exception as reason:  # the other sections are made; this one states the reason
        message = failure(f"The part {title!r} of the page was not made", reason)
        return Section(key, title, (Unmade(message, "warning", failure=message),))


def filled(*sections: Section) -> tuple[Section, ...]:
    """The sections that are not empty."""
    return tuple(section for section in sections if section.blocks)


def render(page: Report) -> str:
    """The page as HTML."""
    environment = Environment(
        loader=PackageLoader("bayes_aero.report", "templates"),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    plots = [*_plots(page.lead), *(plot for section in page.sections for plot in _plots(section.blocks))]
    environment.filters["breakable"] = _breakable
    numbers = {id(plot): number for number, plot in enumerate(plots)}
    data = json.dumps([plot.item for plot in plots], separators=(",", ":"), allow_nan=True)
    for sign in "<>&\u2028\u2029":  # so that it cannot end the script element around it
        data = data.replace(sign, f"\\u{ord(sign):04x}")
    library = Markup("")
    if plots:  # BokehJS without widgets, tables and MathJax, which would be fetched
        from bokeh.resources import Resources

        library = Markup("\n".join(Resources(mode="inline", components=["bokeh", "bokeh-api"]).js_raw))
    return environment.get_template("page.html").render(
        page=page,
        library=library,
        plots=Markup(data),
        number=lambda plot: numbers[id(plot)],
        version=__version__,
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )


def write_page(page: Report, path: Path) -> Path:
    """Write the page whole or not at all."""
    return write_whole(render(page), path)


def put_page(make: Callable[[], Report], folder: Path, name: str = "report.html") -> tuple[str, ...]:
    """Write the page `name` into `folder`; a sentence on each failure, of the page or of sections that say it there."""
    try:
        page = make()
        write_page(page, folder / name)
    except Exception as reason:  # the numbers are on disk already; whatever it is, they stand
        return (failure(f"{name} was not written", reason, folder),)
    blocks = (block for section in page.sections for block in section.blocks)
    return tuple(block.failure for block in blocks if isinstance(block, Unmade))


def _breakable(name: str) -> Markup:
    """A name that may be broken behind its underscores, a path (no unit) behind its slashes, too."""
    broken = escape(name).replace("_", Markup("_<wbr>"))
    return broken.replace("/", Markup("/<wbr>")) if name.count("/") > 1 else broken


def _plots(blocks: Iterable[Block]) -> Iterable[Plot]:
    for block in blocks:
        if isinstance(block, Plot):
            yield block
        elif isinstance(block, Fold):
            yield from _plots(block.blocks)


# --- Common parts of pages: the records at a glance, and the provenance.

GLANCE = ("airspeed", "alpha", "altitude", "elevator", "q")
LATERAL_GLANCE = (
    "airspeed", "alpha", "beta", "altitude", "elevator", "aileron", "aileron_right", "rudder", "p", "q", "r",
)  # fmt: skip
MEASURED = ("measured", COLOURS["measured"], "solid")  # in legends
NOT_DRAWN = Text("Static pictures were not drawn in this run; tables and interactive figures are complete.")
MOST_SHOWN = 6  # manoeuvres whose time histories are on the page: each costs a browser a second on a phone


def at_a_glance(records: Sequence[FlightRecord], card: Card) -> tuple[Block, ...]:
    """Manoeuvres and recorded channels: the main ones are those of most flights, or of a linear card's rows."""
    names = LATERAL_GLANCE if Axis.LATERAL in card.axes else GLANCE
    units = {name: STANDARD_CHANNELS[name].unit for name in names}
    if (rows := card.linear) is not None:
        units = {name: channel_units(card)[name] for name in (*rows.states, *rows.outputs, *rows.inputs)}
    shown = [name for name in units if any(record.has(name) for record in records)]
    words = {n: n if symbol(n) == n else f"{n} {symbol(n)}" for n in shown}
    words |= {"p": "roll rate p", "q": "pitch rate q", "r": "yaw rate r", "aileron_right": "right aileron"}
    heads = [f"{words[name]}\n{bracket(for_people(units[name])[0])}" for name in shown]
    lines = []
    for record in records:
        seconds, ranges = record.time[-1] - record.time[0], (_range(record, name, units[name]) for name in shown)
        what = (f"{seconds:.1f}", str(record.n), f"{1.0 / record.dt:.4g}", str(len(record.channels)))
        lines.append((record.name, *what, *ranges))
    channels = sorted({name for record in records for name in record.channels})
    described = dict.fromkeys(channels, "a channel of the card's own")
    for name in (name for name in channels if name in STANDARD_CHANNELS):
        channel = STANDARD_CHANNELS[name]
        described[name] = f"{channel.description} [{plain_unit(for_people(channel.unit)[0])}]"
    total = sum(float(record.time[-1] - record.time[0]) for record in records)
    many = f"{len(records)} manoeuvres" if len(records) > 1 else "One manoeuvre"
    return (
        Text(f"{many}, {total:.0f} s in all. Aircraft and model: {card.title} (card “{card.name}”)."),
        HtmlTable(
            "Records: smallest to largest value of the main channels",
            ("record", "duration\n[s]", "samples", "rate\n[Hz]", "channels", *heads),
            tuple(lines),
        ),
        Fold("Channels and signs", (Facts(tuple(described.items())), Text(conventions(card)))),
    )


def records_section(records: Sequence[FlightRecord], card: Card, health: Sequence[HealthFinding]) -> Section:
    """`at_a_glance`, and faults of channels that no result uses; the other faults are in `doubts`."""
    minor = [f"{finding.sentence}." for finding in health if not finding.grave]
    return section("records", "The records at a glance", lambda: (*bullets(minor), *at_a_glance(records, card)))


def doubts(
    health: Sequence[HealthFinding], agreement: Consistency | None, *, corrects: bool, failures: Sequence[str] = ()
) -> tuple[Text, ...]:
    """First part of a page: failed parts of the job, disagreement of the sensors, and faulty channels."""
    faults = (Text(f"{finding.sentence}.", "warning") for finding in health if finding.grave)
    failed = (Text(sentence, "warning") for sentence in failures)
    return (*failed, *consistency_lead(agreement, corrects=corrects), *faults)


def consistency_lead(found: Consistency | None, *, corrects: bool) -> tuple[Text, ...]:
    """Disagreement of the sensors, or why it could not be checked."""
    if found is None or found.agreement is Agreement.AGREE:
        return ()
    answer = consistency_sentences(found, corrects=corrects)[0]
    return (Text(answer, "warning") if found.disagrees else Text(answer),)


MODEL_CONVENTIONS: str = WORDS["conventions"]["model"]


def conventions(card: Card) -> str:
    """Axes and signs of the card's model."""
    said = WORDS["conventions"]
    if card.linear is not None:
        return said["linear"]
    return f"{said['model']} {said['lateral']}" if Axis.LATERAL in card.axes else said["model"]


def _range(record: FlightRecord, name: str, unit: str) -> str:
    if not record.has(name):
        return "–"
    factor = for_people(unit)[1]
    low, high = (factor * float(f(record[name])) for f in (np.min, np.max))
    places = 0 if abs(high) >= 1000.0 else 1
    return f"{low:.{places}f} to {high:.{places}f}"


def symbols(
    parameters: Iterable[Parameter], names: Iterable[str], said: str = MODEL_CONVENTIONS, *, degrees: bool = False
) -> Fold:
    """Meaning of each parameter, and the conventions; `degrees` where the page shows angles in degrees."""
    known = {p.name: p for p in parameters}
    units = {name: for_people(p.unit)[0] if degrees else p.unit for name, p in known.items()}
    facts = [(f"{n} [{plain_unit(units[n])}]", known[n].description) for n in names if n in known]
    return Fold("What the parameters mean", (Facts(tuple(facts)), Text(said)))


def first(names: Sequence[str]) -> tuple[Sequence[str], tuple[Block, ...]]:
    """The manoeuvres whose time histories are shown, and the sentence that says so where there are more."""
    if len(names) <= MOST_SHOWN:
        return names, ()
    return names[:MOST_SHOWN], (Text(f"The first {MOST_SHOWN} of {len(names)} manoeuvres are shown."),)


def context_panels(channels: Mapping[str, np.ndarray]) -> list[Panel]:
    """Low panels of measured channels (SI), below those of outputs."""
    panels = []
    for name, values in channels.items():
        shown, unit, factor = channel_axis(name)
        panels.append(Panel(shown, unit, (Line("measured", COLOURS["measured"], factor * values),), height=LOW))
    return panels


def histories(
    name: str,
    key: str,
    time: np.ndarray,
    panels: Sequence[Panel],
    legend: tuple[tuple[str, str, str], ...],
    what: str,
    over: Over = TIME,
) -> Plot:
    """One manoeuvre's panels; `what` begins the words that describe them."""
    firsts = [(panel.label, panel.lines[0].values) for panel in panels]
    spans = "; ".join(f"{x} from {number(float(np.nanmin(y)))} to {number(float(np.nanmax(y)))}" for x, y in firsts)
    labels = several(label for label, _ in firsts)
    alt = f"{what} of {name} over {time[-1] - time[0]:.0f} {over.unit}: {labels}. Measured: {spans}."
    thinned = "thinned so that every peak stays (least and largest value of each stretch)"
    caption = f"Drawn from {len(time)} samples, {thinned}." if len(time) > MOST else ""
    return Plot(linked(time - time[0], panels, key, over), legend, alt, caption, name)


def provenance_blocks(source: Mapping[str, Any], notes: Sequence[str] = (), seconds: Mapping[str, float] | None = None):
    """Inputs, versions and the command, which reproduce the run."""
    inputs = tuple((i["name"], i["source"], i["sha256"] or "–") for i in source.get("inputs", ()))
    inputs += tuple((str(c["name"]), "card", str(c["sha256"])) for c in (source.get("card"),) if c)
    inputs += tuple((f["name"], "effects", f["sha256"]) for f in source.get("effect_files", ()))
    facts = [
        ("Command", str(source.get("command", "–"))),
        *([("Seed", str(source["seed"]))] if "seed" in source else []),
        *((str(k).replace("_", " "), str(v)) for k, v in dict(source.get("settings", {})).items()),
        ("Written", str(source.get("written", "–"))),
        *((str(k), str(v)) for k, v in dict(source.get("platform", {})).items()),
    ]
    blocks: list[Block] = [Text(note, "warning") for note in notes]
    blocks += [
        Facts(tuple(facts)),
        *([HtmlTable("Inputs", ("name", "file", "SHA-256"), inputs, words=(1, 2))] if inputs else []),
        Fold("Versions", (Facts(tuple((k, str(v)) for k, v in dict(source.get("versions", {})).items())),)),
    ]
    if seconds:
        spent = several(f"{stage} {number(float(s), 2)} s" for stage, s in seconds.items())
        blocks.append(Text(f"Time spent: {spent}."))
    return tuple(blocks)


def provenance_section(source: Mapping[str, Any]) -> Section:
    """The same, folded."""
    title = "Inputs, versions and the command that repeat the run"
    return section("provenance", "Provenance", lambda: (Fold(title, provenance_blocks(source)),))


def bullets(items: Iterable[str]) -> tuple[Block, ...]:
    """A list, or nothing."""
    given = tuple(items)
    return (Points(given),) if given else ()


# --- Folded lists, the glossary, and tables of numbers.


def not_testable_list(reasons: Mapping[str, str]) -> tuple[Fold, ...]:
    """Every effect that is not testable, by reason, folded."""
    if not reasons:
        return ()
    listed: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        listed.setdefault(reason, []).append(name)
    rows = tuple((reason, ", ".join(names)) for reason, names in listed.items())
    table = HtmlTable("Effects that are not testable on this record", ("reason", "effects"), rows, words=(1,))
    return (Fold(f"The {len(reasons)} effects that are not testable", (table,)),)


def open_list(found: Consistency) -> tuple[Fold, ...]:
    """Each error that others imitate, which those are, and how well it is known with them possible."""
    alike = not_told_apart(found)
    if not alike:
        return ()
    rows = tuple((e.name, several(e.imitators), f"± {among_text(e)}") for e in alike)
    title = "Errors of sensors and winds that others imitate along this flight path"
    head = ("error", "not distinguishable from", "standard error\nif those are possible")
    table = HtmlTable(title, head, rows, words=(1,))
    return (Fold(f"The {len(alike)} errors that are not testable along this flight path", (table,)),)


def terms(table: str) -> Fold:
    """A glossary of `words.toml` behind a line that opens it."""
    return Fold("Terms used here", (Facts(tuple(WORDS[table].items())),))


# --- A table of numbers as a page shows it.


def page_table(table: Table) -> HtmlTable:
    """The columns that have a heading on a page, every cell as text."""
    shown = [(head, c, values) for c in table.columns for head, values in c.under(c.page)]
    groups = tuple((group, len(list(some))) for group, some in groupby(c.group for _, c, _ in shown))
    rows = list(zip(*([cell_text(x, c.form) for x in values] for _, c, values in shown), strict=True))
    if len(set(table.below)) > 1:
        first = [k for k, name in enumerate(table.below) if k == 0 or name != table.below[k - 1]]
        for k in reversed(first):
            rows.insert(k, (table.below[k], *[""] * (len(shown) - 1)))
    return HtmlTable(
        table.title,
        tuple(head for head, *_ in shown),
        tuple(rows),
        groups if any(group for group, _ in groups) else (),
        tuple(k for k, (_, c, _) in enumerate(shown) if c.words),
        table.note,
    )


# --- Figures of a run, embedded in the page.

CSS_INCH = 96.0  # pixels of a screen in which a font has its nominal size


class Gallery:
    """The drawn figures by stem, with captions and alternative texts."""

    def __init__(self, paths: Mapping[str, Path], texts: Mapping[str, tuple[str, str]]) -> None:
        self.paths, self.texts = paths, texts

    def __call__(self, *stems: str) -> tuple[Picture, ...]:
        """The pictures of these stems that were drawn."""
        return tuple(picture(self.paths[stem], *self.texts[stem]) for stem in stems if stem in self.paths)


def picture(path: Path, caption: str, alt: str) -> Picture:
    """The PNG file as it is, which `save` made small, with its width on a screen at which text has nominal size."""
    from PIL import Image

    from bayes_aero.report.style import DPI

    content = path.read_bytes()
    with Image.open(io.BytesIO(content)) as opened:
        width, height = opened.size
    source = "data:image/png;base64," + base64.b64encode(content).decode("ascii")
    return Picture(source, alt, caption, width, height, round(CSS_INCH * width / DPI))
