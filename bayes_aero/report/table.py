"""One table of numbers, from which a terminal, a file and a page (`html.page_table`) show what they have room for."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rich import table as rich
from rich.box import SIMPLE_HEAD
from rich.text import Text

from bayes_aero.atomic_write import write_whole
from bayes_aero.report.phrases import WORDS, bracket, concise, filled, plain_unit, plus_minus
from bayes_aero.units import number

if TYPE_CHECKING:
    import pandas as pd

    from bayes_aero.inference.results import Marginal

NONE = "–"
NORMAL95 = 1.959964
NARROWEST = 12  # letters that a column of words keeps, if a word is as long
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
    page: Heads = None  # heading there
    terminal: str | None = None  # heading there
    form: Form = ""  # how people read a value
    terminal_form: Form = ""  # how it is written on a terminal, if differently there
    group: str = ""  # heading above that on a page
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
    note: str = ""  # explanation on a page
    terminal_title: str | None = None  # if another or (empty) none
    terminal_note: str = ""
    index: int = 1  # how many columns of a file name the row
    below: Sequence[str] = ()  # on a page each row stands below this name, if there are several names
    dense: bool = False  # whether the terminal has one space between columns

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

    def terminal(self) -> rich.Table:
        space = (0, 0 if self.dense else 1, 0, 0)
        title = self.title if self.terminal_title is None else self.terminal_title
        shown = rich.Table(
            title=Text(title) if title else None,
            caption=Text(self.terminal_note) if self.terminal_note else None,
            box=SIMPLE_HEAD,
            padding=space,
            pad_edge=False,
            show_edge=False,
        )
        columns = [c for c in self.columns if c.terminal is not None]
        for k, c in enumerate(columns):
            left = k == 0 or c.words or any(isinstance(x, str) for x in c.values)
            most = 12 if self.dense and not left else None
            spaced = left and any(isinstance(x, str) and " " in x for x in c.values)
            folds = bool(most) or c.words or spaced or any(isinstance(x, BeforeAfter) for x in c.values)
            longest = max((len(word) for x in c.values if isinstance(x, str) for word in x.split()), default=0)
            shown.add_column(
                Text(c.terminal or ""),
                justify="left" if left else "right",
                overflow="fold" if folds else "ellipsis",
                max_width=most,
                min_width=min(longest, NARROWEST) if folds and left else None,
                no_wrap=not folds,
            )
        cells = ([cell_text(x, c.terminal_form or c.form, concise, "\n") for x in c.values] for c in columns)
        for row in zip(*cells, strict=True):
            shown.add_row(*map(Text, row))
        return shown


def table(key: str, columns: Sequence[Column], /, **values: Any) -> Table:
    """A `Table` whose titles and notes `words.toml` has, with their values; `index`, `below`, `dense` are its own."""
    layout = {name: values[name] for name in ("index", "below", "dense") if name in values}
    texts: dict[str, Any] = {name: filled(text, **values) for name, text in WORDS["tables"][key].items()}
    if both := texts.pop("both", ""):
        texts |= {"note": both, "terminal_note": both}
    return Table(columns, **layout, **texts)


def cell_text(value: Any, form: Form, estimate: Callable[[float, float], str] = plus_minus, between: str = "; ") -> str:
    """A value as people read it, a dash where there is none; several of them with `between` between them."""
    if isinstance(value, list):
        return between.join(cell_text(element, form, estimate, between) for element in value)
    if isinstance(value, BeforeAfter):
        return " → ".join(cell_text(part, form) for part in value)
    size = value.centre if isinstance(value, Estimate) else value
    if size is None or (isinstance(size, float) and not math.isfinite(size)):
        return NONE
    if callable(form):
        return form(value)
    if isinstance(value, Estimate):
        return estimate(value.centre, value.sd)
    return number(value, form) if isinstance(form, int) else format(value, re.sub(r"^(\+?)(?=\.)", r"\1z", form))


def with_error(e: Estimate) -> str:
    """An estimate ± its standard error; a dash where that is not finite."""
    return plus_minus(e.centre, e.sd) if math.isfinite(e.sd) else NONE


def in_brackets(e: Estimate) -> str:
    """An estimate with its standard error in units of the last digit, also where a page has no room for ±."""
    return concise(e.centre, e.sd)


def columns_of(rows: Sequence[Any]) -> Callable[..., Column]:
    """What makes a `Column` of a function, which gets the value of a row, and the other arguments of `Column`."""
    return lambda get, *heads, **how: Column([get(row) for row in rows], *heads, **how)


def or_dash(text: str) -> str:
    """Text, and a dash where there is none."""
    return text or NONE


def parameter_columns(names: Sequence[str], units: Sequence[str]) -> list[Column]:
    """Parameters with their units, which stand behind the names on a page."""
    both = [f"{name} {bracket(plain_unit(unit))}" for name, unit in zip(names, units, strict=True)]
    apart = Column(names, "parameter", terminal=""), Column(units, "unit", terminal="unit")
    return [*apart, Column(both, page="parameter")]


def write_csv(table: Table, path: Path) -> Path:
    """Write a table, whole or not at all; floats keep every digit."""
    return write_whole(table.frame().to_csv(lineterminator="\n"), path)
