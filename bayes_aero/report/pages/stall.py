"""The stall in numbers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayes_aero.inference.identification import Interval, Stall
from bayes_aero.report.html.page import Block, Table, Text
from bayes_aero.report.text.phrases import number

DEG = 180.0 / np.pi
MOST_PLACES = 6  # digits behind the point


def interval(value: Interval, factor: float = 1.0, places: int = 3) -> str:
    """Median and 95 % interval, with more digits where these many show no width."""
    low, middle, high = (factor * x for x in (value.low, value.median, value.high))
    while places < MOST_PLACES and low < high and f"{low:.{places}f}" == f"{high:.{places}f}":
        places += 1
    return f"{middle:.{places}f} ({low:.{places}f} to {high:.{places}f})"


def stall_table(stalls: Mapping[str, Stall], what: str) -> tuple[Block, ...]:
    """CLmax and its angle for each model, with a warning where the record does not show them."""
    rows = []
    for label, s in stalls.items():
        flown = f"{s.alpha[0] * DEG:.1f} to {s.alpha[-1] * DEG:.1f}"
        edge = f"{s.at_edge:.0%}" if s.at_edge in (0.0, 1.0) or s.at_edge >= 0.01 else "< 1%"
        peak, angle = interval(s.CL_max), interval(s.alpha_max, DEG, 1)
        if not s.seen:
            peak = f"at least {peak}"
            angle = "not shown by this record" if s.at_edge > 0.5 else f"at least {angle}"
        rows.append((label, peak, angle, flown, edge))
    first = next(iter(stalls.values()))
    held = [
        f"{name} {number(first.reference[key] * factor)} {unit}".strip()
        for key, name, factor, unit in (
            ("airspeed", "V", 1.0, "m/s"),
            ("mach", "Mach", 1.0, ""),
            ("elevator", "elevator", DEG, "deg"),
        )
        if key in first.reference
    ]
    blocks: list[Block] = [
        Table(
            "Steady stall: highest lift coefficient and its angle of attack, with 95 % intervals",
            ("model", "CLmax [-]", "at α [deg]", "α flown [deg]", "maximum at\nthe edge"),
            tuple(rows),
            words=(1, 2),
            note=f"Steady means α̇ = 0 and no rotation, and the other inputs as near the largest lift "
            f"({', '.join(held)}). {what} "
            f"“Maximum at "
            "the edge” is the share of draws whose largest CL is at the last angle flown: the true maximum then lies "
            "beyond the record.",
        )
    ]
    blocks += [
        Text(
            f"{label[:1].upper() + label[1:]}: for {s.at_edge:.0%} of the draws CL still rises at the edge of the "
            f"angles flown, so the record "
            "gives a lower limit of CLmax, not the stall angle.",
            "warning",
        )
        for label, s in stalls.items()
        if not s.seen
    ]
    return tuple(blocks)
