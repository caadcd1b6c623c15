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
from typing import TYPE_CHECKING, Any, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib import style as mpl_style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, NullFormatter
from PIL import Image

from bayes_aero.atomic_write import write_whole

if TYPE_CHECKING:
    from bayes_aero.inference.results import Identification

DPI = 150
COLOURS = 128  # of a file's palette: lines and text need few, and are packed in half the time
TICKS = 5  # intervals along an axis

RC: dict[str, Any] = {
    "font.size": 9.0, "axes.titlesize": 10.0, "axes.labelsize": 9.0, "legend.fontsize": 9.0, "figure.titlesize": 12.0,
    "xtick.labelsize": 8.0, "ytick.labelsize": 8.0, "lines.linewidth": 1.0, "legend.frameon": False,
    "axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True,
    "axes.grid": True, "grid.color": "#e4e4e4", "grid.linewidth": 0.6,
    "axes.formatter.useoffset": False, "axes.formatter.limits": (-4, 5),
    "savefig.dpi": DPI, "figure.dpi": 100.0, "svg.hashsalt": "bayes_aero",
    "axes.titley": 1.0,  # where it stands anyhow, without a search
    "text.parse_math": False,  # a dollar sign in the name of a record is no formula
}  # fmt: skip

NOTE: dict[str, Any] = {
    "bbox": {"fc": "white", "ec": "none", "alpha": 0.85, "pad": 1.5}, "zorder": 5, "fontsize": 8.0,
}  # fmt: skip

MOST_MANOEUVRES = 12  # of a figure with a panel for each
Drawing = Callable[["Identification"], Figure]
Shown = TypeVar("Shown")


class NotDrawn(Exception):  # noqa: N818 - not an error: the run simply has nothing to show there
    """The run holds nothing for this figure; the text says what is missing."""


def needed(part: Shown | None, missing: str) -> Shown:
    """The part of a run that a figure shows; without it (none, or empty) there is no figure."""
    if not part:
        raise NotDrawn(missing)
    return part


def housed(draw: Callable[[Shown], Figure]) -> Callable[[Shown], Figure]:
    """A figure function whose figure looks the same whatever the user's matplotlibrc says."""

    @wraps(draw)
    def styled(shown: Shown) -> Figure:
        with mpl_style.context(["default", RC]):
            figure = draw(shown)
            for axis in (axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)):
                if isinstance(axis.get_major_formatter(), LogFormatter):
                    low, high = axis.get_view_interval()
                    axis.set_major_formatter("{x:g}")  # plain text, as `text.parse_math` is off
                    axis.set_minor_formatter("{x:g}" if high < 10.0 * low else NullFormatter())
        return figure

    return styled


def panels(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Figure, np.ndarray]:
    """A figure of `size` inches with a (rows, columns) array of axes; outside pyplot, so nothing lingers or pops up."""
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for ax in axes.ravel():
        ax.locator_params(nbins=TICKS)  # each costs as much as a curve
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


def finish(figure: Figure, axes: np.ndarray, title: str, heads: Iterable[str], **legend: Any) -> None:
    """Title, heads above the columns of a grid over time, and one legend."""
    for ax, head in zip(axes[0], heads, strict=True):
        ax.set_title(head)
    for ax in axes[-1]:
        ax.set_xlabel("time from start of record [s]")
    legend_below(figure, axes[0, 0], **legend)
    figure.suptitle(title)


def legend_below(figure: Figure, ax: Axes, columns: int = 0, **options: Any) -> None:
    """One legend for all panels, of what `ax` shows; in one row unless the `columns` are given."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns or max(1, len(labels)), **options)


def column_width(columns: int) -> float:
    """Inches for one of `columns` columns: generous for one or two, narrower when there are many."""
    return float(np.clip(15.0 / columns, 2.8, 9.0))


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG whole or not at all, and close the figure."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # once; `savefig` does it twice
    pixels, drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB"), io.BytesIO()
    few = pixels.quantize(COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.save(drawn, format="png", dpi=(DPI, DPI))
    close(figure)
    return write_whole(drawn.getvalue(), path)


def close(figure: Figure) -> None:
    """Release a figure; one made outside pyplot is only emptied."""
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is not None:
        pyplot.close(figure)


@contextmanager
def arviz_plots() -> Iterator[ModuleType]:
    """The package arviz_plots, which only draws through pyplot: by the Agg backend inside, whatever the user's is."""
    import matplotlib.pyplot as plt

    before = mpl.get_backend()
    plt.switch_backend("agg")
    try:
        with warnings.catch_warnings():
            for category in (DeprecationWarning, PendingDeprecationWarning):
                warnings.simplefilter("ignore", category)
            with suppress(ImportError):  # arviz_plots 0.8 needs it, and matplotlib 3.11 does not import it by itself
                import matplotlib.style.core  # noqa: F401
            import arviz_plots as plots
            import arviz_plots.backend.matplotlib  # which it would import later, out of the reach of this filter
        yield plots
    finally:
        with suppress(ImportError):  # a backend that was named but never could run, as TkAgg without a display
            plt.switch_backend(before)
