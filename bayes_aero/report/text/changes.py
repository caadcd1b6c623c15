"""Changes of parameters during a record in sentences: which, when, and by how much."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_aero.diagnosis.result import ParameterChange
from bayes_aero.report.text.phrases import several, size_text

LIFT, DRAG = "ice or damage of the wing, flaps or slats that moved", "ice, or gear, flaps or spoilers that moved"
STABILITY = "a shift of the centre of gravity (fuel that was burnt or moved, a load), or ice on the tail"
STALL = "ice or damage of the wing"
REASONS = {
    "CL0": f"{LIFT}, or an offset of the vane",
    "CLa": LIFT,
    "CLaM": LIFT,
    "CD0": DRAG,
    "e": DRAG,
    "Cm0": "a stuck tab, another setting of trim or flaps, or a shift of the centre of gravity",
    "Cma": STABILITY,
    "Cmq": STABILITY,
    "Cmde": "ice on the tail, a damaged elevator, or a shift of the centre of gravity",
    "a1": STALL,
    "alpha_star": STALL,
    "CDX": STALL,
    "CmX": STALL,
}
"""What changes a parameter in flight, for those that have usual reasons."""


def change_sentences(found: Sequence[ParameterChange]) -> list[str]:
    """Parameters that change according to a diagnosis: when, by how much, and possible reasons."""
    return [_change(one) for one in found]


def _change(found: ParameterChange) -> str:
    begin, end = found.interval
    span = f" (95 %: {begin:.1f} to {end:.1f} s)" if end > begin else ""
    when = (
        f"from {found.manoeuvre} on"
        if found.between and found.lasts
        else f"in {found.manoeuvre}"
        if found.between
        else f"at {found.at:.1f} s of {found.manoeuvre}{span}"
    )
    back = "" if found.lasts else ", and the value before in later records"
    text = (
        f"Changed: {found.parameter} has another value {when}: {size_text(*found.before, found.unit)} before, "
        f"{size_text(*found.after, found.unit)} after{back}, a change of {size_text(*found.size, found.unit)} "
        f"({found.share:.0%} of the remaining variance)."
    )
    if found.ambiguous_with:
        text += f" On this record {several(found.ambiguous_with)} would explain the data about as well."
    if found.parameter in REASONS:
        text += f" Possible reasons are {REASONS[found.parameter]}; the record does not determine which."
    return text
