"""The answer on one screen, in four blocks: the record, the result, the doubts, what to do next. It begins a page, too.

A sentence has one claim and at most 25 words. All else is on the page, and on a terminal with --verbose.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rich import table as rich
from rich.console import Console
from rich.text import Text

from bayes_aero.report.phrases import WORDS, Message, is_doubtful, sentence
from bayes_aero.report.table import Table

LINES = 28  # beside what a command says before and after
MOST = 3  # doubts, and actions
COMMAND = "bayes-aero "  # begins an action that is one
MARGIN = 9  # columns of the name of a block
ROWS = 14  # of the result's table, at most


@dataclass(frozen=True)
class Screen:
    """What a command answers. `result` is sentences and at most one table; `doubts` begin with the most serious."""

    record: Sequence[str]
    result: Sequence[str | Table]
    doubts: Sequence[str]
    next: Sequence[str]

    def changes(self, earlier: Screen) -> Screen:
        """What of it an earlier one of the same run did not say."""

        def new(name: str) -> list[Any]:
            before = [repr(part) for part in getattr(earlier, name)]
            return [part for part in getattr(self, name) if repr(part) not in before]

        return Screen(new("record"), new("result"), new("doubts"), new("next"))

    def blocks(self) -> Mapping[str, Sequence[str | Table]]:
        """The four by name; of doubts that are left out the number is given."""
        left = len(self.doubts) - MOST
        more = [sentence("more_doubts", n=left)] if left > 0 else []
        doubts = [*self.doubts[:MOST], *more] or (["None."] if self.record else [])  # not of what changed alone
        actions = [action if action.startswith(COMMAND) else ended(action) for action in self.next[:MOST]]
        return {"Record": self.record, "Result": self.result, "Doubts": doubts, "Next": actions}

    def terminal(self, console: Console, lines: int = LINES) -> rich.Table:
        """The blocks beside their names, the table with as many rows as these lines have room for."""
        for rows in range(ROWS, 0, -1):
            grid = self._grid(rows)
            if len(console.render_lines(grid)) <= lines:
                break
        return grid

    def _grid(self, rows: int) -> rich.Table:
        grid = rich.Table.grid(padding=0)
        grid.add_column(width=MARGIN, style="bold")
        grid.add_column(overflow="fold")
        for name, parts in self.blocks().items():
            if not parts:
                continue
            for k, part in enumerate(parts):
                head = name if k == 0 else ""
                if isinstance(part, Table):
                    grid.add_row(head, shortened(part, rows).terminal())
                    continue
                mark = f"{k + 1}. " if name == "Next" else "! " if name == "Doubts" and self.doubts else ""
                grid.add_row(head, Text(mark + apart(part)))
        return grid


def apart(text: str) -> str:
    """What a semicolon joins as sentences of their own."""
    first, *others = text.split("; ")
    return ". ".join([first, *(other[:1].upper() + other[1:] for other in others)])


def ended(text: str) -> str:
    """As a sentence: with a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}"


def shortened(whole: Table, rows: int) -> Table:
    """Its first rows, with the number of the others below."""
    count = len(whole.columns[0].values)
    if count <= rows:
        return whole
    columns = [replace(c, values=list(c.values)[:rows]) for c in whole.columns]
    return replace(whole, columns=columns, terminal_note=sentence("more_rows", n=count - rows))


def doubts_of(sentences: Iterable[str]) -> list[Message]:
    """The doubts and errors among sentences, errors first, then in the order of the table of messages."""
    places = {key: place for place, key in enumerate(WORDS["messages"])}
    messages = [m for m in sentences if isinstance(m, Message) and is_doubtful(m)]
    return sorted(messages, key=lambda m: (m.severity != "error", places[m.key]))


def claims(messages: Iterable[Message]) -> list[str]:
    """Their claims, those of one kind with another subject in one line."""
    kept: dict[str, list[Message]] = {}
    for message in messages:
        kept.setdefault(message.key, []).append(message)
    lines = []
    for same in kept.values():
        more = f" {sentence('more_of_this', n=len(same) - 1)}" if len(same) > 1 else ""
        lines.append(f"{same[0].claim}{more}")
    return lines


def actions(messages: Iterable[Message]) -> list[str]:
    """What the messages say to do, each once."""
    return list(dict.fromkeys(m.do for m in messages if m.do))
