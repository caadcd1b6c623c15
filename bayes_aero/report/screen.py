"""The answer on one screen, in four blocks: the record, the result, the doubts, what to do next. It begins a page, too.

A sentence has one claim and at most 25 words. All else is on the page, and on a terminal with --verbose.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

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
    whole: bool = True  # False: no more than an earlier one has not said

    def changes(self, earlier: Screen) -> Screen:
        """What an earlier one of the same run did not say, in sentences."""
        new = {n: [x for x in getattr(self, n) if x not in getattr(earlier, n)] for n in ("result", "doubts", "next")}
        return Screen([], [x for x in new["result"] if isinstance(x, str)], new["doubts"], new["next"], whole=False)

    def blocks(self, most: int = MOST) -> dict[str, Sequence[str | Table]]:
        """The four by name, with at most so many doubts and actions; of further doubts the number is given."""
        left = len(self.doubts) - most
        more = [sentence("more_doubts", n=left)] if left > 0 else []
        doubts = [*self.doubts[:most], *more] or (["None."] if self.whole else [])
        steps = [step if step.startswith(COMMAND) else ended(step) for step in self.next[:most]]
        return {"Record": self.record, "Result": self.result, "Doubts": doubts, "Next": steps}

    def terminal(self, console: Console, lines: int = LINES) -> rich.Table:
        """The blocks beside their names, with as many rows, doubts and actions as these lines have room for."""
        grids = (self._grid(rows, most) for most in range(MOST, 0, -1) for rows in range(ROWS, 0, -1))
        return next((grid for grid in grids if len(console.render_lines(grid)) <= lines), self._grid(1, 1))

    def _grid(self, rows: int, most: int) -> rich.Table:
        grid = rich.Table.grid(padding=0)
        grid.add_column(width=MARGIN, style="bold")
        grid.add_column(overflow="fold")
        for name, parts in self.blocks(most).items():
            for k, part in enumerate(parts):
                head = name if k == 0 else ""
                if isinstance(part, Table):
                    left = len(part.columns[0].values) - rows
                    columns = [replace(c, values=list(c.values)[:rows]) for c in part.columns]
                    grid.add_row(head, replace(part, columns=columns).text().terminal())
                    if left > 0:
                        grid.add_row("", sentence("more_rows", n=left))
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


def actions(sentences: Iterable[str]) -> list[str]:
    """What the messages among sentences say to do, each once."""
    return list(dict.fromkeys(m.do for m in sentences if isinstance(m, Message) and m.do))
