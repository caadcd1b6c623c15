"""Detection by effect: how often each is named against its size, and what is named in its place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

Row = Mapping[str, Any]
"""One line of a study's one.jsonl."""

EDGES = (0.0, 2.0, 4.0, 6.0, 9.0, 15.0, np.inf)  # standard errors of the first election
NOTHING = "(nothing)"


def named(row: Row, name: str) -> bool:
    """Whether an effect is a cause, or stands in one's ambiguity set."""
    return any(c["name"] == name or name in c["ambiguous_with"] for c in row["causes"])


def hidden(row: Row) -> str:
    """The one effect that a record hides."""
    (name,) = row["hidden"]
    return name


def size(row: Row) -> float:
    """Its size in standard errors."""
    return max(row["scores"].values(), default=0.0)


def power(rows: Sequence[Row]) -> dict[str, list[tuple[int, int]]]:
    """By effect: named and all in every class of size."""
    table = {}
    for name in sorted({hidden(r) for r in rows}):
        own = [r for r in rows if hidden(r) == name]
        classes = [[r for r in own if low <= size(r) < high] for low, high in pairwise(EDGES)]
        table[name] = [(sum(named(r, name) for r in here), len(here)) for here in classes]
    return table


def confusion(rows: Sequence[Row], clear: float) -> tuple[list[str], list[str], np.ndarray]:
    """True effects, named ones, and counts: what is named first in each record of at least `clear` standard errors."""
    pairs = Counter((hidden(r), r["causes"][0]["name"] if r["causes"] else NOTHING) for r in rows if size(r) >= clear)
    true = sorted({pair[0] for pair in pairs})
    others = sorted({pair[1] for pair in pairs} - set(true) - {NOTHING})
    first = [*true, *others, NOTHING]
    return true, first, np.array([[pairs[t, f] for f in first] for t in true], int).reshape(len(true), len(first))


def heads() -> list[str]:
    """The classes of size in words."""
    last = len(EDGES) - 2
    return [f"{a:g} to {b:g}" if k < last else f"from {a:g}" for k, (a, b) in enumerate(pairwise(EDGES))]


def print_power(rows: Sequence[Row]) -> None:
    """As a table for benchmarks/README.md."""
    print("| effect | " + " | ".join(heads()) + " |")
    print("|---|" + "---|" * len(heads()))
    for name, classes in power(rows).items():
        print(f"| `{name}` | " + " | ".join(f"{hits}/{of}" if of else "" for hits, of in classes) + " |")


def draw(rows: Sequence[Row], clear: float, path: Path) -> None:
    """Both as one picture: a square for every class of size and effect, and who is named first."""
    table = power(rows)
    share = np.array([[hits / of if of else np.nan for hits, of in classes] for classes in table.values()])
    true, first, counts = confusion(rows, clear)
    figure = Figure(figsize=(15.0, 0.22 * len(table) + 3.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[1.0, 2.4])
    left.imshow(share, cmap="viridis", vmin=0.0, vmax=1.0, aspect="auto")
    left.set_xticks(range(len(heads())), heads(), rotation=40, ha="right")
    left.set_yticks(range(len(table)), list(table))
    left.set_xlabel("size of the hidden effect [standard errors]")
    for i, classes in enumerate(table.values()):
        for j, (hits, of) in enumerate(classes):
            if of:
                left.text(j, i, f"{hits}/{of}", ha="center", va="center", fontsize=7, color="w" if hits < of else "k")
    left.set_title("Named of those flown (blank: none of that size)")
    right.imshow(np.where(counts > 0, 1.0, np.nan), cmap="Blues", vmin=0.0, vmax=2.5, aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        right.text(j, i, str(counts[i, j]), ha="center", va="center", fontsize=7)
    right.set_xticks(range(len(first)), first, rotation=90)
    right.set_yticks(range(len(true)), true)
    right.set_xlabel("named first")
    right.set_ylabel("hidden")
    right.set_title(f"Records of at least {clear:g} standard errors")
    figure.savefig(path, dpi=110)
