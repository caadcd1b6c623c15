"""Changes of parameters during a record in sentences: whether, which, when, and by how much."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_aero.diagnosis.result import ParameterChange
from bayes_aero.diagnosis.trajectories.drift import DRIFT_LEVEL, Drift, DriftChange, Drifted
from bayes_aero.report.text.phrases import several, size_text

LEAST_P = 1e-12
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


def drift_sentences(found: Drift) -> list[str]:
    """A sentence for each parameter, and the assumption of the test; or why there is no test."""
    names = list(found.parameters)
    if not found.usable:
        return [f"Whether {several(names)} changed cannot be said: a fit with drifting parameters did not converge."]
    if found.coloured:
        listed = several([f"{name} ({found.autocorrelation[name]:.2f})" for name in found.coloured])
        return [
            f"Whether {several(names)} changed cannot be said: also with the drift, innovations are autocorrelated "
            f"(neighbouring samples of {listed}), and the test assumes white innovations."
        ]
    sentences = [_told(name, parameter) for name, parameter in found.parameters.items()]
    if not found.changed and found.p < DRIFT_LEVEL:
        sentences.append(
            f"One of {several(names)} changed ({_p(found.p)} for all together), but the record does not determine "
            "which."
        )
    family = f", {len(names)} parameters together (Holm)" if len(names) > 1 else ""
    sentences.append(
        f"These p-values are those of likelihood ratios{family} for white innovations, as this fit has. A drift may "
        "also represent a slow effect that the model lacks."
    )
    return sentences


def _told(name: str, found: Drifted) -> str:
    if found.p >= DRIFT_LEVEL:
        return f"No change of {name} during the record is distinguishable from noise ({_p(found.p)})."
    seen = {manoeuvre: _by(change, found.unit) for manoeuvre, change in found.changes.items() if change.seen}
    away = {m: c for m, c in found.changes.items() if not c.seen and abs(c.farthest[0]) > 2.0 * c.farthest[1]}
    seen |= {m: f"by {size_text(*c.farthest, found.unit)} at {c.at:.1f} s, and back" for m, c in away.items()}
    if not seen:
        return f"{name} changed during the record ({_p(found.p)}), not for long in one direction."
    if len(found.changes) == 1:
        return f"{name} changed during the record ({_p(found.p)}) {next(iter(seen.values()))}."
    where = several([f"in {manoeuvre} {text}" for manoeuvre, text in seen.items()])
    return f"{name} changed during the records ({_p(found.p)}): {where}."


def _by(change: DriftChange, unit: str) -> str:
    tenth, half, most = change.times
    return (
        f"by {size_text(*change.size, unit)} from start to end, half of it by {half:.1f} s "
        f"(a tenth by {tenth:.1f} s, nine tenths by {most:.1f} s)"
    )


def _p(p: float) -> str:
    return f"p < {LEAST_P:.0e}" if p < LEAST_P else f"p = {p:.2g}"


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
    return f"{text} `bayes-aero fly --drift {found.parameter}` shows it over time."
