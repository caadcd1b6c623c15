"""Time histories that can be zoomed: panels over one time axis, drawn by Bokeh in the browser."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import count
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_aero.report.phrases import bracket

MOST = 1600  # points a line: more than a screen has columns
PANEL, AXIS = 150, 44  # pixels: height of a panel, and of the time axis below the last
LOW = 105  # of a panel that only gives context
LETTER = 7.5  # pixels of an axis label's letter, with some room
HIGHEST = 2 * PANEL  # whatever a channel is called
PAPER = 580  # pixels of all panels together on paper, so that two figures share a sheet
LEAST = 0.5  # of a panel's height there, however many panels there are
FARTHEST = 1e30  # single precision ends soon beyond
BORDERS: dict[str, Any] = {f"min_border_{k}": x for k, x in (("left", 66), ("right", 8), ("top", 6), ("bottom", 6))}
INK, GRID = "#222222", "#dddddd"

FIT_HEIGHT = files("bayes_aero.report").joinpath("templates/fit_height.js").read_text("utf-8")
"""What is seen of a stretch of time fills its panel; nothing leaves the scale of the whole."""


@dataclass(frozen=True)
class Over:
    """The axis below the panels: its label, and its name, unit and digits in the tooltip."""

    label: str
    name: str
    unit: str
    digits: str


TIME = Over("time from start of record [s]", "time", "s", "{0.00}")
SAMPLE = Over("number of the sample [-]", "sample", "samples", "{0}")


@dataclass(frozen=True)
class Line:
    """One curve in the units of its panel; `style` is solid, dashed or dotted."""

    label: str
    colour: str
    values: Float[np.ndarray, " n"]
    style: str = "solid"
    width: float = 1.4


@dataclass(frozen=True)
class Panel:
    """Curves over time, on a page and in a file; the first one sets the scale."""

    name: str
    unit: str  # as people read it
    lines: tuple[Line, ...]
    shade: tuple[tuple[int, int], ...] = ()  # lines (by index) with the difference filled, in the second one's colour
    band: float | None = None  # half the width of a tolerance about the first line
    height: int = PANEL
    note: str = ""  # for a file, where no curve can be pointed at

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} {bracket(self.unit)}"


def extremes(columns: Sequence[Float[np.ndarray, " n"]], most: int = MOST) -> Int[np.ndarray, " m"]:
    """Indices that keep each column's shape at some `most` points: extremes of equal stretches, and the ends."""
    n = len(columns[0])
    if n <= most:
        return np.arange(n)
    edges = np.linspace(0, n, most // 2 + 1).astype(int)
    stretches = edges[:-1, None] + np.arange(int(np.diff(edges).max()))
    stretches = np.minimum(stretches, edges[1:, None] - 1)  # a shorter one repeats its last sample
    row = np.arange(len(stretches))
    keep: Bool[np.ndarray, " n"] = np.zeros(n, bool)
    keep[[0, -1]] = True
    for values in columns:
        own, finite = values[stretches], np.isfinite(values)[stretches]
        keep[stretches[row, np.argmin(np.where(finite, own, np.inf), axis=1)]] = True
        keep[stretches[row, np.argmax(np.where(finite, own, -np.inf), axis=1)]] = True
    return np.flatnonzero(keep)


def linked(time: Float[np.ndarray, " n"], panels: Sequence[Panel], name: str, over: Over = TIME) -> dict[str, Any]:
    """Bokeh's JSON of the panels below each other over one shared axis, time (s), called `name` in the document."""
    from bokeh.core.serialization import Serializer

    empty = np.empty(0)
    shapes = tuple(
        (p.name, p.unit, p.shade, p.height, p.band is None, *((x.label, x.colour, x.style, x.width) for x in p.lines))
        for p in panels
    )
    bare = [replace(p, lines=tuple(replace(line, values=empty) for line in p.lines)) for p in panels]
    if (shapes, over) not in _LAYOUTS:
        _LAYOUTS[shapes, over] = _layout(bare, over)
    layout, shared, ranges, sources = _LAYOUTS[shapes, over]
    limits = [scale(panel.lines, panel.band) for panel in panels]
    first, last = float(time[0]), float(time[-1])
    filled = {shared: {"start": first, "end": last, "name": name, "tags": [first, last, [list(x) for x in limits]]}}
    filled |= {key: {"start": low, "end": high} for key, (low, high) in zip(ranges, limits, strict=True)}
    for key, panel in zip(sources, panels, strict=True):
        filled[key] = {"data": Serializer(deferred=False).encode(_columns(time, panel))}
    return _copied(layout, f"-{next(_COPIES)}", filled)


# Bokeh takes long to make its models and to write them: panels of one shape, as of several manoeuvres, are made once.
_LAYOUTS: dict[Any, tuple[dict[str, Any], str, list[str], list[str]]] = {}
_COPIES = count()


def _copied(node: Any, suffix: str, filled: Mapping[str, Mapping[str, Any]]) -> Any:
    """A part of Bokeh's JSON with ids of its own, and with what is `filled` in by id."""
    if isinstance(node, list | tuple):
        return [_copied(x, suffix, filled) for x in node]
    if not isinstance(node, dict):
        return node
    copy = {k: x + suffix if k in ("id", "root_id") else _copied(x, suffix, filled) for k, x in node.items()}
    if node.get("type") == "object" and node.get("id") in filled:
        copy["attributes"] = copy.get("attributes", {}) | filled[node["id"]]
    return copy


def _columns(time: Float[np.ndarray, " n"], panel: Panel) -> dict[str, Any]:
    """What a panel draws, in single precision; parts of a diverged simulation are gaps."""
    index = extremes([line.values for line in panel.lines])
    columns = {"t": np.asarray(time[index], np.float32)}
    for i, line in enumerate(panel.lines):
        values = line.values[index]
        columns[f"y{i}"] = np.where(np.abs(values) < FARTHEST, values, np.nan).astype(np.float32)
    if panel.band is not None:
        columns |= {"low": columns["y0"] - np.float32(panel.band), "high": columns["y0"] + np.float32(panel.band)}
    return columns


def _layout(panels: Sequence[Panel], over: Over) -> tuple[dict[str, Any], str, list[str], list[str]]:
    """Bokeh's JSON of panels without values, and the ids of what their values go into: axis, scales, columns."""
    from bokeh.embed import json_item
    from bokeh.layouts import gridplot
    from bokeh.models import CustomJS, Range1d, Span

    shared = Range1d(bounds="auto")
    cross = Span(dimension="height", line_dash="dotted", line_color="#777777", line_width=1)
    figures = [_panel(panel, shared, cross, over, last=panel is panels[-1]) for panel in panels]
    fitting = [_fitting(panel) for panel in panels]
    share = max(min((PAPER - AXIS) / sum(height for _, height in fitting), 1.0), LEAST)
    for f, (label, height) in zip(figures, fitting, strict=True):
        # when printed lower than on a screen, though never than a label is long; the axis stands with the last
        longest = LETTER * max(map(len, label.split("\n")))
        f.tags = [int(min(max(share * height, longest + 6), height)) + (AXIS if f is figures[-1] else 0)]
    ranges, sources = [f.y_range for f in figures], [f.renderers[0].data_source for f in figures]
    callback = CustomJS(args={"x": shared, "ranges": ranges, "sources": sources}, code=FIT_HEIGHT)
    for edge in ("start", "end"):  # a zoom to an end of the record moves one of them only
        shared.js_on_change(edge, callback)
    grid = gridplot([[f] for f in figures], sizing_mode="stretch_width", toolbar_location="above", merge_tools=True)
    grid.toolbar.logo = None
    return dict(json_item(grid)), shared.id, [x.id for x in ranges], [x.id for x in sources]


def _panel(panel: Panel, shared: Any, cross: Any, over: Over, *, last: bool) -> Any:
    from bokeh import models
    from bokeh.plotting import figure

    box = models.BoxZoomTool(dimensions="width")
    wheel = models.WheelZoomTool(dimensions="width", modifiers={"ctrl": True})
    others = models.ResetTool(), models.SaveTool(), models.CrosshairTool(overlay=cross)
    label, height = _fitting(panel)
    f = figure(
        height=height + (AXIS if last else 0),
        sizing_mode="stretch_width",
        x_range=shared,
        y_range=models.Range1d(),
        y_axis_label=label,
        x_axis_label=over.label if last else None,
        tools=[box, models.PanTool(dimensions="width"), wheel, *others],
        active_drag=box,
        background_fill_color="#ffffff",
        border_fill_color="#ffffff",
        **BORDERS,
    )
    source = models.ColumnDataSource(_columns(np.empty(0), panel))
    if panel.band is not None:
        f.varea("t", "low", "high", source=source, fill_color="#999999", fill_alpha=0.28)
    for first, second in panel.shade:
        f.varea("t", f"y{first}", f"y{second}", source=source, fill_color=panel.lines[second].colour, fill_alpha=0.25)
    shown = [
        f.line("t", f"y{i}", source=source, color=line.colour, line_dash=line.style, line_width=line.width)
        for i, line in enumerate(panel.lines)
    ]
    unit = "" if bracket(panel.unit) == bracket("1") else panel.unit
    values = ((line.label, f"@y{i}{{0.[0000]}} {unit}".strip()) for i, line in enumerate(panel.lines))
    tips = [(over.name, f"@t{over.digits} {over.unit if over is TIME else ''}".strip()), *values]
    f.add_tools(models.HoverTool(renderers=[shown[0]], mode="vline", tooltips=tips, line_policy="nearest"))
    dress(f, last, height)
    return f


def _fitting(panel: Panel) -> tuple[str, int]:
    """Label and height: a long label has its unit below it, and a longer one a higher panel, so that none is cut."""
    if LETTER * len(panel.label) <= panel.height:
        return panel.label, panel.height
    longest = LETTER * max(len(panel.name), len(bracket(panel.unit)))
    return f"{panel.name}\n{bracket(panel.unit)}", int(min(max(panel.height, longest), HIGHEST))


def dress(f: Any, last: bool, panel_height: int) -> None:
    """The look of a panel; the time axis is seen below the last one only."""
    f.xaxis.visible = last
    f.grid.grid_line_color = GRID
    f.outline_line_color = "#bbbbbb"
    for axis in (f.xaxis, f.yaxis):
        axis.axis_label_text_font_size = "13px"
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_color = INK
        axis.major_label_text_font_size = "12px"
        axis.major_label_text_color = INK
        axis.minor_tick_line_color = None
    f.yaxis.ticker.desired_num_ticks = 4 if panel_height >= PANEL else 3


def scale(lines: Sequence[Line], half: float | None) -> tuple[float, float]:
    """The first line's span, widened for its tolerance: a simulation that has lost the flight would flatten it."""
    first, band = lines[0].values[np.isfinite(lines[0].values)], half or 0.0
    low, high = (float(first.min()), float(first.max())) if first.size else (0.0, 1.0)
    span = max(high - low, 1e-9 * max(1.0, abs(high)))
    others = [line.values[np.isfinite(line.values)] for line in lines[1:]]
    below = min([low, *(float(x.min()) for x in others if x.size)])
    above = max([high, *(float(x.max()) for x in others if x.size)])
    reach = max(0.35 * span, 1.5 * band)
    start = max(low - reach, min(below, low - band) - 0.05 * span)
    end = min(high + reach, max(above, high + band) + 0.05 * span)
    return (start, end) if end > start else (low - 1.0, high + 1.0)
