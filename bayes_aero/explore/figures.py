"""Panels over one time axis: the record with its tolerance, the result, what is flown now, and draws as a fan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from bokeh.layouts import column
from bokeh.models import (
    BoxZoomTool,
    Column,
    ColumnDataSource,
    CrosshairTool,
    HoverTool,
    Range1d,
    Span,
    WheelZoomTool,
)
from bokeh.plotting import figure
from jaxtyping import Bool, Float

from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.plots import FARTHEST, Line, Panel, dress, extremes, scale

MOST = 900  # points a line in the window: more than a panel has columns
MOST_FAN = 200  # and of each draw
LEAST, AXIS = 84, 42  # pixels: lowest panel, and the time axis below the last
WORDS = {"measured": "measured", "before": "result", "after": "now", "crb": "draws"}
"""What the colours mean."""

Series = Float[np.ndarray, " n"]


class Shared:
    """What all panels have in common: the range of time, the cross-hair, and the source of what is flown now."""

    def __init__(self) -> None:
        """Empty."""
        self.time = Range1d(start=0.0, end=1.0)
        self.cross = Span(dimension="height", line_dash="dotted", line_color="#777777", line_width=1)
        self.now = ColumnDataSource({}, name="now")

    def draw_now(self, lines: Sequence[Mapping[str, np.ndarray]]) -> None:
        """The columns of all panels, made equally long by gaps."""
        every = {name: np.zeros(0) for name in self.now.column_names}
        for line in lines:
            every |= line
        n = max(map(len, every.values()))
        self.now.update(data={k: np.pad(x, (0, n - len(x)), constant_values=np.nan) for k, x in every.items()})


class View:
    """One panel. `factor` converts SI to the unit of its label, `band` (SI) is the tolerance about the measurement.

    What is flown now has one source for all panels, so that a step is one message to the browser.
    """

    def __init__(self, name: str, label: str, factor: float, shared: Shared, band: float | None) -> None:
        """An empty panel."""
        self.name, self.label, self.factor = name, label, factor
        self.band = None if band is None else factor * band
        self.record = ColumnDataSource({"t": [], "y": [], "low": [], "high": []})
        self.before = ColumnDataSource({"t": [], "y": []})
        self.columns = f"t {name}", f"y {name}"
        self.fan = ColumnDataSource({"xs": [], "ys": []}, name=f"fan-{name}")
        self.range = Range1d(start=0.0, end=1.0)
        self.figure = self._figure(shared)

    def _figure(self, shared: Shared) -> Any:
        box = BoxZoomTool(dimensions="width")
        wheel = WheelZoomTool(dimensions="width", modifiers={"ctrl": True})
        f = figure(
            x_range=shared.time,
            y_range=self.range,
            y_axis_label=self.label,
            sizing_mode="stretch_both",
            min_height=LEAST,
            tools=[box, wheel, CrosshairTool(overlay=shared.cross)],
            active_drag=box,
            toolbar_location=None,
            min_border_left=62,
            min_border_right=6,
            min_border_top=3,
            min_border_bottom=3,
        )
        if self.band is not None:
            f.varea("t", "low", "high", source=self.record, fill_color="#999999", fill_alpha=0.28)
        f.multi_line("xs", "ys", source=self.fan, line_color=COLOURS["crb"], line_alpha=0.3, line_width=1)
        shown = f.line("t", "y", source=self.record, color=COLOURS["measured"], line_width=1.3)
        t, y = self.columns
        shared.now.add([], t)
        shared.now.add([], y)
        now = f.line(t, y, source=shared.now, color=COLOURS["after"], line_width=2.0, level="overlay")
        before = {"color": COLOURS["before"], "line_dash": "dashed", "line_width": 1.4, "level": "overlay"}
        f.line("t", "y", source=self.before, **before)
        for line, (at, value) in ((now, self.columns), (shown, ("t", "y"))):
            tips = [("t", f"@{{{at}}}{{0.00}} s"), (self.label, f"@{{{value}}}{{0.[0000]}}")]
            f.add_tools(HoverTool(renderers=[line], mode="vline", tooltips=tips, line_policy="nearest"))
        return f

    def draw_record(self, time: Series, y: Series) -> None:
        """The measurement, with its tolerance."""
        y = self.factor * y
        index = extremes([y], MOST)
        columns = {"t": time[index], "y": _drawable(y[index])}
        half = self.band or 0.0
        self.record.update(data=columns | {"low": columns["y"] - half, "high": columns["y"] + half})

    def draw_before(self, time: Series, y: Series) -> None:
        """The result."""
        y = self.factor * y
        index = extremes([y], MOST)
        self.before.update(data={"t": time[index], "y": _drawable(y[index])})

    def line_now(self, time: Series, y: Series) -> dict[str, np.ndarray]:
        """The columns of what is flown now."""
        y = self.factor * y
        index = extremes([y], MOST)
        return dict(zip(self.columns, (time[index], _drawable(y[index])), strict=True))

    def draw_fan(self, time: Series, draws: Float[np.ndarray, "m n"]) -> None:
        """Draws; none removes them."""
        chosen = [(extremes([self.factor * y], MOST_FAN), self.factor * y) for y in draws]
        ys = [_drawable(y[index]) for index, y in chosen]
        self.fan.update(data={"xs": [time[index] for index, _ in chosen], "ys": ys})

    def fit(self, shown: Sequence[Series]) -> None:
        """A vertical scale for the measurement (first) and the result; what is flown now cannot flatten them."""
        lines = tuple(Line("", "", self.factor * y) for y in shown)
        found = scale(Panel(self.label, lines, band=self.band))
        self.range.update(start=found.start, end=found.end)


def stacked(views: Sequence[View], name: str) -> Column:
    """Panels below each other, the time axis below the last."""
    for view in views:
        last = view is views[-1]
        dress(view.figure, last, LEAST)
        if last:
            view.figure.xaxis.axis_label = "time of the record [s]"
            view.figure.min_height = LEAST + AXIS
    return column([view.figure for view in views], sizing_mode="stretch_both", spacing=0, name=name)


def _drawable(y: Series) -> Series:
    """Values that a canvas can take; those of a diverged simulation are gaps."""
    return np.where(np.abs(y) < FARTHEST, y, np.nan)


def window_of(time: Series, window: tuple[float, float] | None) -> Bool[np.ndarray, " n"]:
    """Samples in a window of time, s; all, where there is none or it has fewer than two."""
    if window is None:
        return np.ones(len(time), bool)
    inside = (time >= window[0]) & (time <= window[1])
    return inside if inside.sum() > 1 else np.ones(len(time), bool)
