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
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import LayoutEngine
from matplotlib.ticker import LogFormatter, NullFormatter
from matplotlib.transforms import Bbox
from PIL import Image

from bayes_aero.atomic_write import write_whole

if TYPE_CHECKING:
    from bayes_aero.inference.results import Identification

DPI = 150
COLOURS = 128  # of a file's palette: lines and text need few, and are packed in half the time
TICKS = 5  # intervals along an axis
PAD = 0.06  # inches between the parts of a figure

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


class NotDrawn(Exception):  # noqa: N818 - not an error: the run simply has nothing to show there
    """The run holds nothing for this figure; the text says what is missing."""


Drawing = Callable[["Identification"], Figure]
Shown = TypeVar("Shown")


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


class MeasuredOnce(LayoutEngine):
    """Room around a grid of axes for ticks, labels, titles and legends; labels are aligned along rows and columns.

    Everything is measured once. Constrained layout measures ticks twice, and again for each label that is aligned with
    another, which takes longer than drawing.
    """

    _adjust_compatible = _colorbar_gridspec = True

    def execute(self, fig: Figure) -> None:
        """Place the axes in the room that is left by titles above, legends below, and what stands around themselves."""
        (width, height), places = fig.get_size_inches(), [p for ax in fig.axes if (p := ax.get_subplotspec())]
        rows, columns = places[0].get_gridspec().get_geometry()
        fig.subplots_adjust(0.8 / width, 0.6 / height, 1.0 - 0.2 / width, 1.0 - 0.6 / height)
        ticks, names, others = np.zeros((3, 4, max(rows, columns)))  # inches on the left, below, on the right, above
        named: list[tuple[Axis, int, int]] = []
        for ax, place in zip(fig.axes, places, strict=True):
            at = (place.colspan.start, place.rowspan.stop - 1, place.colspan.stop - 1, place.rowspan.start)
            for side, axis in enumerate((ax.yaxis, ax.xaxis)):
                axis.set_label_coords(0.5, 0.5)  # out of the way of what is measured
                if axis.label.get_visible() and axis.label.get_text():
                    named.append((axis, side, at[side]))
                    size = PAD + axis.label.get_window_extent().size[side] / fig.dpi
                    names[side, at[side]] = max(names[side, at[side]], size)
            boxes = [axis.get_tightbbox(for_layout_only=True) for axis in (ax.xaxis, ax.yaxis)]
            legend = ax.get_legend()
            shown = [*ax.texts, ax.title, *([] if legend is None else [legend])]
            for room, extents in ((ticks, boxes), (others, [artist.get_window_extent() for artist in shown])):
                outer = Bbox.union([ax.bbox, *(box for box in extents if box is not None)])
                beyond = np.abs(np.subtract(ax.bbox.extents, outer.extents)) / fig.dpi
                room[range(4), at] = np.maximum(room[range(4), at], beyond)
        left, below, right, above = np.maximum(ticks + names, others)
        edge = {"left": PAD, "bottom": PAD, "top": PAD}
        for text in fig.texts:
            place = {"top": "top", "bottom": "bottom"}.get(text.get_verticalalignment(), "left")
            edge[place] += PAD + text.get_window_extent().size[0 if place == "left" else 1] / fig.dpi
            text.set_y(1.0 - PAD / height if place == "top" else text.get_position()[1])
        for legend in fig.legends:
            edge["bottom"] += PAD + legend.get_window_extent().height / fig.dpi
        x0, x1 = edge["left"] + left[0], width - 2.0 * PAD - right[columns - 1]
        y0, y1 = edge["bottom"] + below[rows - 1], height - edge["top"] - above[0]
        across = 2.0 * PAD + np.max(left[1:columns] + right[: columns - 1], initial=0.0)
        down = 2.0 * PAD + np.max(above[1:rows] + below[: rows - 1], initial=0.0)
        wide, high = (x1 - x0 - across * (columns - 1)) / columns, (y1 - y0 - down * (rows - 1)) / rows
        fig.subplots_adjust(x0 / width, y0 / height, x1 / width, y1 / height, across / wide, down / high)
        for axis, side, at in named:
            place = -(ticks[side, at] + PAD) * fig.dpi / axis.axes.bbox.size[side]
            axis.set_label_coords(*((0.5, place) if side else (place, 0.5)))


def panels(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Figure, np.ndarray]:
    """A figure of `size` inches with a (rows, columns) array of axes; outside pyplot, so nothing lingers or pops up."""
    figure = Figure(figsize=size, layout=MeasuredOnce())
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
    columns = columns or max(1, len(labels))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, **options)


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
