"""Did a parameter change during a record, which one, when, and by how much: in sentences."""

from __future__ import annotations

from bayes_aero.diagnosis.trajectories.drift import DRIFT_LEVEL, Drift, DriftChange, Drifted
from bayes_aero.report.text.phrases import several, size_text

LEAST_P = 1e-12


def drift_sentences(found: Drift) -> list[str]:
    """One for each parameter, and on which assumption they rest; or why nothing can be said."""
    names = list(found.parameters)
    if not found.usable:
        return [f"Whether {several(names)} changed cannot be said: a fit with drifting parameters did not converge."]
    if found.coloured:
        told = several([f"{name} ({found.autocorrelation[name]:.2f})" for name in found.coloured])
        return [
            f"Whether {several(names)} changed cannot be said: with the drift innovations are autocorrelated, too "
            f"(neighbouring samples of {told}), and the test assumes white ones."
        ]
    said = [_told(name, parameter) for name, parameter in found.parameters.items()]
    if not found.changed and found.p < DRIFT_LEVEL:
        said.append(
            f"One of {several(names)} changed ({_p(found.p)} for all together), and the record does not tell which."
        )
    family = f", {len(names)} parameters together (Holm)" if len(names) > 1 else ""
    said.append(
        f"These p-values are of likelihood ratios{family}, for white innovations, and those of this fit are. A drift "
        "stands for whatever changes slowly, also for an effect that the model lacks."
    )
    return said


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
        f"by {size_text(*change.size, unit)} from begin to end, half of it by {half:.1f} s "
        f"(a tenth by {tenth:.1f} s, nine tenths by {most:.1f} s)"
    )


def _p(p: float) -> str:
    return f"p < {LEAST_P:.0e}" if p < LEAST_P else f"p = {p:.2g}"
