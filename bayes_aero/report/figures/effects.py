"""Number of effects that need each recorded channel."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, housed, panels

KINDS = ("mle", "gpr", "emcee", "nuts", "crb_corrected", "white")  # roles whose colours kinds of effects take, in turn


def needed(found: Sequence[Mapping[str, Any]]) -> dict[str, Counter[str]]:
    """By channel, the effects that need it by kind; the most needed first."""
    counts: dict[str, Counter[str]] = {}
    for effect in found:
        for channel in effect["needs"]:
            counts.setdefault(channel, Counter())[effect["kind"]] += 1
    return dict(sorted(counts.items(), key=lambda item: (-item[1].total(), item[0])))


@housed
def channels_needed(found: Sequence[Mapping[str, Any]]) -> Figure:
    """A bar for each channel, a colour for each kind of effect; `found` as the catalogue describes them."""
    counts = needed(found)
    if not counts:
        raise NotDrawn("no effect needs a channel")
    kinds = [kind for kind, _ in Counter(effect["kind"] for effect in found).most_common()]
    figure, axes = panels(1, 1, (7.2, 0.9 + 0.2 * len(counts)))
    ax = axes[0, 0]
    rows = range(len(counts))
    begin = [0] * len(counts)
    for number, kind in enumerate(kinds):
        widths = [by_kind[kind] for by_kind in counts.values()]
        if any(widths):
            colour = COLOURS[KINDS[number % len(KINDS)]]
            ax.barh(rows, widths, left=begin, height=0.7, color=colour, label=kind)
            begin = [a + b for a, b in zip(begin, widths, strict=True)]
    for row, total in zip(rows, begin, strict=True):
        ax.text(total + 0.15, row, str(total), va="center", fontsize=8.0)
    ax.set_yticks(rows, [channel.replace("_", " ") for channel in counts])
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("effects that need the channel [-]")
    ax.legend(title="kind of effect", loc="lower right")
    return figure
