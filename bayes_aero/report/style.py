"""The house style of every figure: one palette with fixed roles, one look, one way to a file."""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib import style as mpl_style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter

from bayes_aero.atomic_write import write_whole
from bayes_aero.inference.results import Identification

DPI = 150
PHONE = 5.0  # inches, of a figure for a phone: shrunk to its width, the text stays legible

RC: dict[str, Any] = {
    "font.size": 9.0, "axes.titlesize": 10.0, "axes.labelsize": 9.0, "legend.fontsize": 9.0, "figure.titlesize": 12.0,
    "xtick.labelsize": 8.0, "ytick.labelsize": 8.0, "lines.linewidth": 1.0, "legend.frameon": False,
    "axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True,
    "axes.grid": True, "grid.color": "#e4e4e4", "grid.linewidth": 0.6,
    "axes.formatter.useoffset": False, "axes.formatter.limits": (-4, 5),
    "savefig.dpi": DPI, "figure.dpi": 100.0, "svg.hashsalt": "bayes_aero",
}  # fmt: skip


MOST_MANOEUVRES = 12
"""Manoeuvres for which figures with a panel for each are drawn."""


class NotDrawn(Exception):  # noqa: N818 - not an error: the run simply has nothing to show there
    """The run holds nothing for this figure; the text says what is missing."""


Drawing = Callable[[Identification], Figure]
Shown = TypeVar("Shown")


def housed(draw: Callable[[Shown], Figure]) -> Callable[[Shown], Figure]:
    """A figure function whose figure looks the same whatever the user's matplotlibrc says."""

    @wraps(draw)
    def styled(shown: Shown) -> Figure:
        with mpl_style.context(["default", RC]):
            figure = draw(shown)
        # texts as they stand: a dollar sign in the name of a record is no formula; powers of ten of log axes stay
        powers = set()
        for axis in (axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)):
            if isinstance(axis.get_major_formatter(), LogFormatter):
                ticks = (*axis.get_major_ticks(), *axis.get_minor_ticks())
                powers |= {text for tick in ticks for text in tick.findobj(Text)}
        for text in figure.findobj(Text):
            if text not in powers:
                text.set_parse_math(False)
        return figure

    return styled


def panels(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Figure, np.ndarray]:
    """A figure of `size` inches with a (rows, columns) array of axes; outside pyplot, so nothing lingers or pops up."""
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, axes


def refuse_many(manoeuvres: int) -> None:
    """Say that there are too many for a figure with a panel for each; the page shows the first ones."""
    if manoeuvres > MOST_MANOEUVRES:
        raise NotDrawn(f"it has a panel for each manoeuvre, and {manoeuvres} are more than {MOST_MANOEUVRES}")


def grid_of(count: int, columns: int, cell: tuple[float, float], **options: Any) -> tuple[Figure, list[Axes]]:
    """A figure with `count` axes in rows of at most `columns`, `cell` inches each."""
    columns = max(1, min(columns, count))
    rows = -(-count // columns)
    figure, axes = panels(rows, columns, (cell[0] * columns, cell[1] * rows + 0.6), **options)
    flat = list(axes.ravel())
    for spare in flat[count:]:
        spare.remove()
    return figure, flat[:count]


def name_panels(axes: np.ndarray, heads: Iterable[str] = (), below: str = "time from start of record [s]") -> None:
    """Heads above the columns of a grid of panels, the axis below it, and aligned labels on its left."""
    for ax, head in zip(axes[0], heads, strict=False):
        ax.set_title(head)
    for ax in axes[-1]:
        ax.set_xlabel(below)
    axes[0, 0].figure.align_ylabels(list(axes[:, 0]))


def legend_below(figure: Figure, ax: Axes, columns: int = 0, **options: Any) -> None:
    """One legend for all panels, of what `ax` shows; in one row unless the `columns` are given."""
    handles, labels = ax.get_legend_handles_labels()
    columns = columns or max(1, len(labels))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, **options)


def column_width(columns: int) -> float:
    """Inches for one of `columns` columns: generous for one or two, narrower when there are many."""
    return float(np.clip(15.0 / columns, 2.8, 9.0))


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG whole or not at all, and close the figure."""
    drawn = io.BytesIO()
    try:
        # little compression: a sixth of the time of drawing, for a tenth more on disk
        quick = {"metadata": {"Software": "bayes_aero"}, "pil_kwargs": {"compress_level": 1}}
        figure.savefig(drawn, format="png", dpi=DPI, **quick)
    finally:
        close(figure)
    return write_whole(drawn.getvalue(), path)


def close(figure: Figure) -> None:
    """Release a figure; one made outside pyplot is only emptied."""
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is not None:
        pyplot.close(figure)


@contextmanager
def quiet_pyplot() -> Iterator[None]:
    """Use the Agg backend inside, whatever the user's is: for libraries that only draw through pyplot."""
    import matplotlib.pyplot as plt

    before = mpl.get_backend()
    plt.switch_backend("agg")
    try:
        yield
    finally:
        with suppress(ImportError):  # a backend that was named but never could run, as TkAgg without a display
            plt.switch_backend(before)


def arviz_plots() -> ModuleType:
    """The package arviz_plots; 0.8 needs matplotlib.style.core, which 3.11 no longer imports by itself."""
    with warnings.catch_warnings():
        for category in (DeprecationWarning, PendingDeprecationWarning):
            warnings.simplefilter("ignore", category)
        with suppress(ImportError):
            import matplotlib.style.core  # noqa: F401
        import arviz_plots
        import arviz_plots.backend.matplotlib  # which it would import later, out of the reach of this filter
    return arviz_plots
