"""The report of a run as one self-contained HTML page: what stands on it, and how it gets to disk.

A page is a tree of plain blocks, so that what is said is separate from how it looks. Everything is escaped by Jinja2;
the only text that is not is the package's own style, script and plotting library. Nothing is fetched from a network.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup, escape

from bayes_aero import __version__
from bayes_aero.atomic_write import write_whole
from bayes_aero.errors import failure

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
class Table:
    """Rows of text under headings (of numbers: `page_table`); the first cell of a row is its heading. `groups` span
    several headings each.

    `words` are the columns that hold text (left-aligned) beside the first. `links` are relative addresses that the
    first cells lead to, one a row, empty for none.
    """

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    groups: tuple[tuple[str, int], ...] = ()
    words: tuple[int, ...] = ()
    note: str = ""
    links: tuple[str, ...] = ()
    kind: str = field(default="table", init=False)

    def lean(self) -> Table:
        """Without the columns that are empty in every row."""
        kept = [i for i in range(len(self.head)) if any(row[i] for row in self.rows)]
        return replace(
            self,
            head=tuple(self.head[i] for i in kept),
            rows=tuple(tuple(row[i] for i in kept) for row in self.rows),
            words=tuple(new for new, i in enumerate(kept) if i in self.words),
        )

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
    """A static figure: `source` is a data URI, `alt` says in words and numbers what it shows.

    `width` and `height` in pixels of the picture, `natural` its width on a screen at which its text has nominal size.
    `narrow` is the same figure drawn for a phone, a data URI; empty where there is none.
    """

    source: str
    alt: str
    caption: str
    width: int
    height: int
    natural: int
    narrow: str = ""
    kind: str = field(default="picture", init=False)


@dataclass(frozen=True)
class Plot:
    """An interactive figure: what Bokeh needs to draw it, a legend (label, colour, style) and words as for a
    picture."""

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


Block = Text | Points | Facts | Table | Picture | Plot | Fold


@dataclass(frozen=True)
class Section:
    """A heading with its blocks; `key` is its anchor."""

    key: str
    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Page:
    """A report: doubts of the records, if any; a verdict in one sentence, one picture, then sections."""

    title: str
    subtitle: str
    verdict: str
    lead: tuple[Block, ...]
    sections: tuple[Section, ...]
    doubts: tuple[Block, ...] = ()


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


def render(page: Page) -> str:
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
    return environment.get_template("page.html").render(
        page=page,
        library=_library() if plots else "",
        plots=Markup(_script_json([plot.item for plot in plots])),
        number=lambda plot: numbers[id(plot)],
        version=__version__,
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )


def write_page(page: Page, path: Path) -> Path:
    """Write the page whole or not at all."""
    return write_whole(render(page), path)


def put_page(make: Callable[[], Page], folder: Path, name: str = "report.html") -> tuple[str, ...]:
    """Write the page `name` into `folder`; parts that cannot be made are left out.

    Returns:
        A sentence on each failure: of the page, or of sections that say on it why they are not there.
    """
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


def _script_json(content: Any) -> str:
    """JSON that cannot end the script element around it."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=True)
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def _library() -> Markup:
    """BokehJS without widgets, tables and MathJax, which would be fetched."""
    from bokeh.resources import Resources

    return Markup("\n".join(Resources(mode="inline", components=["bokeh"]).js_raw))
