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
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from rich.console import Console

from bayes_aero import __version__
from bayes_aero.atomic_write import write_whole
from bayes_aero.errors import failure
from bayes_aero.report.phrases import is_doubtful
from bayes_aero.report.screen import Screen
from bayes_aero.report.table import Table, TextTable


class Text(NamedTuple):
    """A paragraph; `tone` is plain, lead or warning."""

    text: str
    tone: str = "plain"
    failure: str = ""  # in place of a part that could not be made: the reason


class Points(NamedTuple):
    items: tuple[str, ...]


class Facts(NamedTuple):
    items: tuple[tuple[str, str], ...]


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


Block = Text | Points | Facts | TextTable | Picture | Plot | Fold


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
            made.append(part.text())
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


WIDTH, WIDEST = 100, 240  # characters in a line of the text, and in one of a table


def as_text(page: Report) -> str:
    """All that the page says, for a terminal: text and tables; of figures what they show."""
    console = Console(file=io.StringIO(), width=WIDTH, markup=False, highlight=False)
    print_blocks(console, page.lead, WIDEST)
    for section in page.sections:
        console.print(f"\n{section.title}\n{'-' * len(section.title)}")
        print_blocks(console, section.blocks, WIDEST)
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    return "".join(f"{line.rstrip()}\n" for line in lines)


def print_blocks(console: Console, blocks: Iterable[Block], width: int | None = None) -> None:
    """Blocks as text, tables at most `width` wide (None: as the console)."""
    tables = Console(file=console.file, width=width or console.width, quiet=console.quiet)
    for block in blocks:
        match block:
            case Text():
                console.print(f"{'! ' * (block.tone == 'warning')}{block.text}")
            case Points():
                console.print("\n".join(f"• {item}" for item in block.items))
            case Facts():
                console.print("\n".join(f"{name}: {fact}" for name, fact in block.items))
            case TextTable():
                console.print(*([f"\n{block.caption}"] if block.caption else []))
                tables.print(block.terminal())
                console.print(*filter(None, [block.note]))
            case Picture() | Plot():
                console.print(f"[Figure] {block.alt if isinstance(block, Plot) else block.caption}")
            case Fold():
                console.print(f"\n{block.title}")
                print_blocks(console, block.blocks, width)


def put_page(make: Callable[[], Report], folder: Path, name: str = "report.html") -> tuple[str, ...]:
    """Write the page `name` and its text (.txt) into `folder`; a sentence on each failure, of the page or of sections
    that say it there."""
    text = (folder / name).with_suffix(".txt")
    text.unlink(missing_ok=True)  # of an earlier run
    try:
        page = make()
        write_whole(render(page), folder / name)
        write_whole(as_text(page), text)
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
