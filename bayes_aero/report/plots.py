"""The palette, and panels over one time axis, of which the page's script makes figures that can be zoomed."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_aero.report.phrases import bracket, channel_axis, for_people, short, symbol

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import SimulatedManoeuvre

# Roles of colours in figures and pages. Okabe and Ito's, and two of Paul Tol's: told apart with every common colour
# blindness.
COLOURS = {
    "measured": "#1a1a1a", "mle": "#0072B2", "gpr": "#D55E00", "crb": "#56B4E9", "crb_corrected": "#E69F00",
    "white": "#332288", "emcee": "#009E73", "nuts": "#CC79A7", "alone": "#1a1a1a", "scatter": "#D55E00",
    "prior": "#b0b0b0", "rising": "#882255", "falling": "#2a9d8f", "before": "#0072B2", "unconfirmed": "#d0d0d0",
    "after": "#D55E00", "chosen": "#D55E00", "candidate": "#9fb8c9",
}  # fmt: skip

MOST = 1600  # points a line: more than a screen has columns
PANEL, AXIS = 150, 44  # pixels: height of a panel, and of the time axis below the last
LOW = 105  # of a panel that only gives context
LETTER = 7.5  # pixels of an axis label's letter, with some room
HIGHEST = 2 * PANEL  # whatever a channel is called
PAPER = 580  # pixels of all panels together on paper, so that two figures share a sheet
LEAST = 0.5  # of a panel's height there, however many panels there are
FARTHEST = 1e30  # single precision ends soon beyond
# What simulated a path, and what people read.
MODELS = {"card": "card's model", "extended": "extended model"}
FLOWN = {"start": "first values", "fitted": "fitted model"}


class Line(NamedTuple):
    """One curve in the units of its panel; `style` is solid, dashed or dotted."""

    label: str
    colour: str
    values: Float[np.ndarray, " n"]
    style: str = "solid"
    width: float = 1.4


class Panel(NamedTuple):
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
        return f"{self.name} {bracket(self.unit)}"


def measured_panel(channel: str, values: np.ndarray, si: str = "", **look: Any) -> Panel:
    """A recorded channel (SI) by itself; `si`: its unit, if it is no standard channel."""
    name, unit, factor = channel_axis(channel, si)
    return Panel(name, unit, (Line("measured", COLOURS["measured"], factor * values),), **look)


def compared_panel(
    name: str,
    unit: str,
    measured: np.ndarray,
    simulated: Mapping[str, np.ndarray],
    note: str = "",
    band: float | None = None,
) -> Panel:
    """Measured and simulated in the unit of people, the last curve's error shaded."""
    lines = [Line("measured", COLOURS["measured"], measured, width=1.0)]
    for (label, values), colour in zip(simulated.items(), (COLOURS["before"], COLOURS["after"]), strict=False):
        lines.append(Line(label, colour, values, "solid" if len(lines) == len(simulated) else "dashed"))
    return Panel(name, unit, tuple(lines), ((0, len(simulated)),), band, note=note)


def output_panels(paths: Mapping[str, SimulatedManoeuvre], units: Mapping[str, str]) -> list[Panel]:
    """A panel for each output of `units` (SI) of one manoeuvre, simulated by the models that name the paths."""
    first, panels = next(iter(paths.values())), []
    for output in (name for name in units if name in first.measured):
        (unit, factor), tolerance = for_people(units[output]), first.errors[output].tolerance
        with np.errstate(over="ignore"):  # first values of parameters may fly anywhere
            simulated = {label: factor * path.simulated[output] for label, path in paths.items()}
        note = f"RMS error {' → '.join(short(factor * path.errors[output].rms) for path in paths.values())}"
        band = None if tolerance is None else factor * tolerance
        panels.append(compared_panel(symbol(output), unit, factor * first.measured[output], simulated, note, band))
    return panels


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
        blocks, finite = values[stretches], np.isfinite(values)[stretches]
        keep[stretches[row, np.argmin(np.where(finite, blocks, np.inf), axis=1)]] = True
        keep[stretches[row, np.argmax(np.where(finite, blocks, -np.inf), axis=1)]] = True
    return np.flatnonzero(keep)


def linked(time: Float[np.ndarray, " n"], panels: Sequence[Panel], name: str) -> dict[str, Any]:
    """The panels below each other over one shared axis, time (s), called `name`, as `page.js` draws them."""
    fitting = [_fitting(panel) for panel in panels]
    share = max(min((PAPER - AXIS) / sum(height for _, height in fitting), 1.0), LEAST)
    described = []
    for panel, (label, height) in zip(panels, fitting, strict=True):
        # when printed lower than on a screen, though never than a label is long; the axis stands with the last
        longest = LETTER * max(map(len, label.split("\n")))
        unit = "" if bracket(panel.unit) == bracket("1") else panel.unit
        axis = AXIS if panel is panels[-1] else 0
        described.append(
            {
                "label": label,
                "height": height + axis,
                "printed": int(min(max(share * height, longest + 6), height)) + axis,
                "ticks": 4 if height >= PANEL else 3,
                "scale": scale(panel.lines, panel.band),
                "shade": panel.shade,
                "band": panel.band is not None,
                "lines": [
                    {"label": x.label, "unit": unit, "colour": x.colour, "style": x.style, "width": x.width}
                    for x in panel.lines
                ],
                "columns": _columns(time, panel),
            }
        )
    return {"name": name, "span": [float(time[0]), float(time[-1])], "panels": described}


def _columns(time: Float[np.ndarray, " n"], panel: Panel) -> dict[str, str]:
    """What a panel draws, in single precision (base64); parts of a diverged simulation are gaps."""
    index = extremes([line.values for line in panel.lines])
    columns = {"t": np.asarray(time[index], np.float32)}
    for i, line in enumerate(panel.lines):
        values = line.values[index]
        columns[f"y{i}"] = np.where(np.abs(values) < FARTHEST, values, np.nan).astype(np.float32)
    if panel.band is not None:
        columns |= {"low": columns["y0"] - np.float32(panel.band), "high": columns["y0"] + np.float32(panel.band)}
    return {key: base64.b64encode(x.astype("<f4").tobytes()).decode("ascii") for key, x in columns.items()}


def _fitting(panel: Panel) -> tuple[str, int]:
    """Label and height: a long label has its unit below it, and a longer one a higher panel, so that none is cut."""
    if LETTER * len(panel.label) <= panel.height:
        return panel.label, panel.height
    longest = LETTER * max(len(panel.name), len(bracket(panel.unit)))
    return f"{panel.name}\n{bracket(panel.unit)}", int(min(max(panel.height, longest), HIGHEST))


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
