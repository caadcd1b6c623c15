"""The house style of every figure: one palette with fixed roles, one look, one way to a file."""

from __future__ import annotations

import os
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

from bayes_aero.inference.identification import Identification

DPI = 150
PHONE = 5.0  # inches, of a figure for a phone: shrunk to its width, the text stays legible

# Okabe and Ito's colours, and two of Paul Tol's: told apart with every common colour blindness.
COLOURS = {
    "measured": "#1a1a1a",
    "mle": "#0072B2",
    "gpr": "#D55E00",
    "crb": "#56B4E9",
    "crb_corrected": "#E69F00",
    "white": "#332288",
    "emcee": "#009E73",
    "nuts": "#CC79A7",
    "alone": "#1a1a1a",
    "scatter": "#D55E00",
    "prior": "#b0b0b0",
    "rising": "#882255",
    "falling": "#2a9d8f",
    "before": "#0072B2",
    "unconfirmed": "#d0d0d0",
    "after": "#D55E00",
    "chosen": "#D55E00",
    "candidate": "#9fb8c9",
}

RC: dict[str, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 5),
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "lines.linewidth": 1.0,
    "figure.titlesize": 12.0,
    "savefig.dpi": DPI,
    "figure.dpi": 100.0,
    "svg.hashsalt": "bayes_aero",
}


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
        _take_literally(figure)
        return figure

    return styled


def _take_literally(figure: Figure) -> None:
    """Texts as they stand: a dollar sign in the name of a record is no formula. Powers of ten of log axes stay."""
    powers = set()
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis):
            if isinstance(axis.get_major_formatter(), LogFormatter):
                powers |= {
                    text for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()) for text in tick.findobj(Text)
                }
    for text in figure.findobj(Text):
        if text not in powers:
            text.set_parse_math(False)


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


def column_width(columns: int) -> float:
    """Inches for one of `columns` columns: generous for one or two, narrower when there are many."""
    return float(np.clip(15.0 / columns, 2.8, 9.0))


FOR_PEOPLE = {
    "rad": ("deg", 180.0 / np.pi),
    "rad/s": ("deg/s", 180.0 / np.pi),
    "m/s^2": ("m/s²", 1.0),
    "rad/s^2": ("deg/s²", 180.0 / np.pi),
    "1/rad^2": ("1/rad²", 1.0),
    "kg/m^3": ("kg/m³", 1.0),
}


def for_people(unit: str) -> tuple[str, float]:
    """The unit in which people read a quantity, and the factor to it from SI."""
    return FOR_PEOPLE.get(unit, (unit, 1.0))


def size_text(mean: float, sd: float, unit: str) -> str:
    """0.62 ± 0.11 deg: two digits of the deviation, units as people read them."""
    shown, factor = for_people(unit)
    shown = "" if shown == "1" else f" {shown}"
    if not np.isfinite(sd) or sd <= 0.0:
        return f"{factor * mean:.3g}{shown}"
    places = max(0, 1 - int(np.floor(np.log10(factor * sd))))
    return f"{factor * mean:.{places}f} ± {factor * sd:.{places}f}{shown}"


def bracket(unit: str) -> str:
    """A unit as it stands behind a name on an axis."""
    return "[-]" if unit in ("1", "", "-") else f"[{unit}]"


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG whole or not at all, and close the figure."""
    partial = path.with_name(path.name + ".part")
    try:
        figure.savefig(partial, format="png", dpi=DPI, metadata={"Software": "bayes_aero"})
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
        close(figure)
    return path


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


def several(items: Iterable[str]) -> str:
    """Items as they are read out: a, b and c."""
    given = list(items)
    return " and ".join([", ".join(given[:-1]), given[-1]]) if len(given) > 1 else "".join(given)
