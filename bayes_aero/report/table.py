"""One table of numbers: a file has every digit, a page and a terminal what people read."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rich import table as rich
from rich.box import SIMPLE_HEAD
from rich.text import Text

from bayes_aero.atomic_write import write_whole
from bayes_aero.report.phrases import WORDS, bracket, filled, plain_unit, plus_minus
from bayes_aero.units import number

if TYPE_CHECKING:
    import pandas as pd

    from bayes_aero.inference.results import Marginal

NONE = "–"
NORMAL95 = 1.959964
FOLDED = 25  # characters in a line of a column of text
NARROWEST = 12  # of them that it keeps on a terminal, if a word is as long
Form = str | int | Callable[[Any], str]
"""How a value is written: a format specification, how many significant digits, or a function."""
Heads = str | tuple[str, ...] | None


class Estimate(NamedTuple):
    """A parameter by one method: centre, standard deviation and 95 % interval."""

    centre: float
    sd: float
    low: float = math.nan
    high: float = math.nan

    @classmethod
    def normal(cls, centre: float, sd: float) -> Estimate:
        """Interval of a normal distribution."""
        return cls(float(centre), float(sd), float(centre - NORMAL95 * sd), float(centre + NORMAL95 * sd))

    @classmethod
    def of(cls, m: Marginal) -> Estimate:
        return cls(m.mean, m.sd, *m.ci95)


class BeforeAfter(NamedTuple):
    """A number before and after."""

    before: float | None
    after: float | None


@dataclass(frozen=True)
class Column:
    """A column, and where it is shown: an empty or missing name keeps it out.

    `values` are one a row: a number, text, an `Estimate`, a `BeforeAfter`, or None for no value. A list is several
    values: they share a cell for people, and a file has a row for each. Of estimates and changes, a tuple of names
    shows the parts, each in a column of its own; one name shows both in one.
    """

    values: Sequence[Any]
    files: str | tuple[str, ...] = ""  # name in files, and key in JSON
    page: Heads = None  # heading for people, on a page or a terminal
    form: Form = ""  # how people read a value
    group: str = ""  # heading above that
    words: bool = False  # whether it is text that may be folded

    def under(self, heads: Heads) -> Iterator[tuple[str, list[Any]]]:
        if isinstance(heads, str):
            yield heads, list(self.values)
        for part, head in enumerate(heads if isinstance(heads, tuple) else ()):
            if head:
                yield head, [_part(value, part) for value in self.values]


def _part(value: Any, part: int) -> Any:
    if isinstance(value, list):
        return [_part(x, part) for x in value]
    return None if value is None else value[part]


@dataclass(frozen=True)
class Table:
    """Columns of one length, with what is said of them."""

    columns: Sequence[Column]
    title: str = ""
    note: str = ""  # explanation for people
    index: int = 1  # how many columns of a file name the row
    below: Sequence[str] = ()  # for people each row stands below this name, if there are several names

    def _filed(self) -> dict[str, list[Any]]:
        return {name: values for c in self.columns for name, values in c.under(c.files) if name}

    def records(self) -> list[dict[str, Any]]:
        """Rows by the names of a file, as JSON has them."""
        filed = self._filed()
        return [dict(zip(filed, row, strict=True)) for row in zip(*filed.values(), strict=True)]

    def frame(self) -> pd.DataFrame:
        """The table of a file: numbers with every digit, NaN for none."""
        import pandas as pd

        filed = {name: [math.nan if x is None else x for x in values] for name, values in self._filed().items()}
        frame, names = pd.DataFrame(filed), list(filed)
        several = [name for name in names if any(isinstance(x, list) for x in filed[name])]
        frame = frame.explode(several).infer_objects() if several else frame
        return frame.set_index(names[: self.index]) if self.index else frame

    def text(self) -> TextTable:
        """The columns that have a heading for people, every cell as text."""
        shown = [(head, c, values) for c in self.columns for head, values in c.under(c.page)]
        groups = tuple((group, len(list(some))) for group, some in groupby(c.group for _, c, _ in shown))
        rows = list(zip(*([cell_text(x, c.form) for x in values] for _, c, values in shown), strict=True))
        if len(set(self.below)) > 1:
            first = [k for k, name in enumerate(self.below) if k == 0 or name != self.below[k - 1]]
            for k in reversed(first):
                rows.insert(k, (self.below[k], *[""] * (len(shown) - 1)))
        heads, words = tuple(head for head, *_ in shown), tuple(k for k, (_, c, _) in enumerate(shown) if c.words)
        return TextTable(self.title, heads, tuple(rows), groups if any(g for g, _ in groups) else (), words, self.note)


@dataclass(frozen=True)
class TextTable:
    """Rows of text under headings; the first cell of a row is its heading."""

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

    def terminal(self) -> rich.Table:
        shown = rich.Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
        above = [group for group, span in self.groups or (("", len(self.head)),) for _ in range(span)]
        for k, (head, group) in enumerate(zip(self.head, above, strict=True)):
            left, cells = k == 0 or k in self.words, [row[k] for row in self.rows]
            text = left or any(" " in cell for cell in cells)
            longest = max((len(word) for cell in cells for word in cell.split()), default=0)
            shown.add_column(
                Text(f"{group}\n{head}" if group else head),
                justify="left" if left else "right",
                overflow="fold",
                min_width=min(longest, NARROWEST) if text else longest,
            )
        for row in self.rows:
            shown.add_row(*map(Text, row))
        return shown


def table(key: str, columns: Sequence[Column], /, **values: Any) -> Table:
    """A `Table` whose title and note `words.toml` has, with their values; `index` and `below` are its own."""
    layout = {name: values[name] for name in ("index", "below") if name in values}
    texts: dict[str, Any] = {name: filled(text, **values) for name, text in WORDS["tables"][key].items()}
    return Table(columns, **layout, **texts)


def cell_text(value: Any, form: Form) -> str:
    """A value as people read it, a dash where there is none; several of them with semicolons."""
    if isinstance(value, list):
        return "; ".join(cell_text(element, form) for element in value)
    if isinstance(value, BeforeAfter):
        return " → ".join(cell_text(part, form) for part in value)
    size = value.centre if isinstance(value, Estimate) else value
    if size is None or size == "" or (isinstance(size, float) and not math.isfinite(size)):
        return NONE
    if callable(form):
        return form(value)
    if isinstance(value, Estimate):
        return plus_minus(value.centre, value.sd)
    return number(value, form) if isinstance(form, int) else format(value, re.sub(r"^(\+?)(?=\.)", r"\1z", form))


def with_error(e: Estimate) -> str:
    """An estimate ± its standard error; a dash where that is not finite."""
    return plus_minus(e.centre, e.sd) if math.isfinite(e.sd) else NONE


def columns_of(rows: Sequence[Any]) -> Callable[..., Column]:
    """What makes a `Column` of a function, which gets the value of a row, and the other arguments of `Column`."""
    return lambda get, *heads, **how: Column([get(row) for row in rows], *heads, **how)


def parameter_columns(names: Sequence[str], units: Sequence[str]) -> list[Column]:
    """Parameters with their units, which people read behind the names."""
    both = [f"{name} {bracket(plain_unit(unit))}" for name, unit in zip(names, units, strict=True)]
    return [Column(names, "parameter"), Column(units, "unit"), Column(both, page="parameter")]


def write_csv(table: Table, path: Path) -> Path:
    """Write a table, whole or not at all; floats keep every digit."""
    return write_whole(table.frame().to_csv(lineterminator="\n"), path)
