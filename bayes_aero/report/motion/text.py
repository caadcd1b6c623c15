"""Modes of motion and objective tests in sentences."""

from __future__ import annotations

from bayes_aero.diagnosis.trajectories.motion.results import Motion
from bayes_aero.flight.tolerances import DUTCH_ROLL
from bayes_aero.report.text.phrases import several


def motion_sentences(found: Motion | None) -> list[str]:
    """Why there are no modes, which tests are not met, and which no manoeuvre shows."""
    if found is None:
        return []
    sentences = [f"Modes of motion are not given: {found.why_not}."] if found.why_not else []
    open_ones = [mode.name for mode in found.modes if not mode.quantities]
    if open_ones:
        sentences.append(
            f"Whether the {several(open_ones)} grows or falls is not determined: its rate is within its error."
        )
    missed = [f"{row.entry} {row.test} ({row.quantity}, {row.manoeuvre})" for row in found.tests if not row.within]
    if missed:
        sentences.append(f"The fitted model does not meet objective tests: {several(missed)}.")
    short = dict.fromkeys((row.manoeuvre, row.remark) for row in found.tests if row.quantity == "period" and row.remark)
    if short:
        listed = "; ".join(f"{manoeuvre}: {remark}" for manoeuvre, remark in short)
        sentences.append(f"Free responses fall short of {DUTCH_ROLL.entry} ({listed}).")
    free = found.untested.get(DUTCH_ROLL.name, {})
    if free:
        listed = "; ".join(f"{why} ({several(manoeuvres)})" for why, manoeuvres in free.items())
        sentences.append(f"No free response shows the Dutch roll: {listed}.")
    shown = {f"{row.entry} {row.test}" for row in found.tests}
    gone = {name: reasons for name, reasons in found.untested.items() if name not in {*shown, DUTCH_ROLL.name}}
    if gone:
        listed = several(f"{name} ({'; '.join(reasons)})" for name, reasons in gone.items())
        sentences.append(f"Objective tests that no manoeuvre shows: {listed}.")
    return sentences
