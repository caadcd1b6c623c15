"""The report of a run as one self-contained HTML page: what stands on it, and how it gets to disk.

A page is a tree of plain blocks, so that what is said is separate from how it looks. Everything is escaped by Jinja2;
the only text that is not is the package's own style, script and plotting library. Nothing is fetched from a network.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from bayes_aero import __version__
from bayes_aero.atomic_write import write_whole
from bayes_aero.errors import failure
from bayes_aero.report.phrases import is_doubtful
from bayes_aero.report.screen import Screen
from bayes_aero.report.table import Table, cell_text

FOLDED = 25  # characters in a line of a column of text


class Text(NamedTuple):
    """A paragraph; `tone` is plain, lead or warning."""

    text: str
    tone: str = "plain"
    failure: str = ""  # in place of a part that could not be made: the reason


class Points(NamedTuple):
    items: tuple[str, ...]


class Facts(NamedTuple):
    items: tuple[tuple[str, str], ...]


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

    def across(self) -> int:
        """Characters in a row, with room between columns; text can be folded."""
        columns = zip(*self.rows, strict=True) if self.rows else ()
        widths = [max(len(line) for cell in column for line in cell.split("\n")) for column in columns]
        return sum(2 + min(w, FOLDED) if i in self.words else 2 + w for i, w in enumerate(widths))


class Picture(NamedTuple):
    source: str  # a data URI
    caption: str
    width: int  # pixels of the picture
    height: int
    natural: int  # its width on a screen at which its text has nominal size


class Plot(NamedTuple):
    """An interactive figure: what Bokeh needs to draw it, a legend (label, colour, style), and what it shows."""

    item: Mapping[str, Any]
    legend: tuple[tuple[str, str, str], ...]
    alt: str
    caption: str
    title: str = ""


class Fold(NamedTuple):
    title: str
    blocks: tuple[Block, ...]


Block = Text | Points | Facts | HtmlTable | Picture | Plot | Fold


class Section(NamedTuple):
    key: str
    title: str
    blocks: tuple[Block, ...]


@dataclass
class Report:
    """A report: a verdict in one sentence or the answer in four blocks; one picture; then sections."""

    title: str
    subtitle: str
    verdict: str | Screen
    lead: Sequence[Any]
    sections: Sequence[Section]
    screen: Mapping[str, Sequence[Block]] = field(init=False)

    def __post_init__(self) -> None:
        self.lead = blocks(*self.lead)
        answer = self.verdict.blocks() if isinstance(self.verdict, Screen) else {}
        self.screen = {name: blocks(*parts) for name, parts in answer.items() if parts}
        self.sections = [section for section in self.sections if section.blocks]


def blocks(*parts: Any) -> tuple[Block, ...]:
    """Blocks of what a page shows: text, sentences in a list, tables, blocks; what is None or empty is left out."""
    made: list[Block] = []
    for part in parts:
        if isinstance(part, Block):
            made.append(part)
        elif isinstance(part, Table):
            made.append(page_table(part))
        elif isinstance(part, str):
            made += [Text(part, "warning" if is_doubtful(part) else "plain")] if part else []
        elif isinstance(part, list) and part and all(isinstance(item, str) for item in part):
            made.append(Points(tuple(part)))
        elif part is not None:
            made += blocks(*part)
    return tuple(made)


def fold(title: str, *parts: Any) -> Fold | None:
    """`blocks` behind a line that opens them, if there are any."""
    made = blocks(*parts)
    return Fold(title, made) if made else None


def section(key: str, title: str, make: Callable[[], Any]) -> Section:
    """A section with the `blocks` that `make` returns; if that fails, the section states the reason."""
    try:
        return Section(key, title, blocks(make()))
    except Exception as reason:  # the other sections are made; this one states the reason
        message = failure(f"The part {title!r} of the page was not made", reason)
        return Section(key, title, (Text(message, "warning", message),))


def render(page: Report) -> str:
    loader = PackageLoader("bayes_aero.report", "templates")
    env = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    plots = [*_plots(page.lead), *(plot for section in page.sections for plot in _plots(section.blocks))]
    env.filters |= {"breakable": _breakable, "kind": lambda block: type(block).__name__}
    numbers = {id(plot): number for number, plot in enumerate(plots)}
    data = json.dumps([plot.item for plot in plots], separators=(",", ":"), allow_nan=True)
    for sign in "<>&\u2028\u2029":  # so that it cannot end the script element around it
        data = data.replace(sign, f"\\u{ord(sign):04x}")
    library = Markup("")
    if plots:  # BokehJS without widgets, tables and MathJax, which would be fetched
        from bokeh.resources import Resources

        library = Markup("\n".join(Resources(mode="inline", components=["bokeh", "bokeh-api"]).js_raw))
    return env.get_template("page.html").render(
        page=page,
        library=library,
        plots=Markup(data),
        number=lambda plot: numbers[id(plot)],
        version=__version__,
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )


def write_page(page: Report, path: Path) -> Path:
    return write_whole(render(page), path)


def put_page(make: Callable[[], Report], folder: Path, name: str = "report.html") -> tuple[str, ...]:
    """Write the page `name` into `folder`; a sentence on each failure, of the page or of sections that say it there."""
    try:
        page = make()
        write_page(page, folder / name)
    except Exception as reason:  # the numbers are on disk already; whatever it is, they stand
        return (failure(f"{name} was not written", reason, folder),)
    blocks = (block for section in page.sections for block in section.blocks)
    return tuple(block.failure for block in blocks if isinstance(block, Text) and block.failure)


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


class Gallery(NamedTuple):
    paths: Mapping[str, Path]
    captions: Mapping[str, str]

    def __call__(self, *stems: str) -> tuple[Picture, ...]:
        """The pictures of these stems that were drawn."""
        return tuple(picture(self.paths[stem], self.captions[stem]) for stem in stems if stem in self.paths)


def picture(path: Path, caption: str) -> Picture:
    """The PNG file as it is, which `save` made small, with its width on a screen at which text has nominal size."""
    from PIL import Image

    from bayes_aero.report.style import DPI

    content = path.read_bytes()
    with Image.open(io.BytesIO(content)) as opened:
        width, height = opened.size
    source = "data:image/png;base64," + base64.b64encode(content).decode("ascii")
    return Picture(source, caption, width, height, round(96.0 * width / DPI))  # 96 pixels an inch
