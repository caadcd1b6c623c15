"""Modes of motion in sentences."""

from __future__ import annotations

from bayes_aero.diagnosis.trajectories.motion.results import Motion
from bayes_aero.report.text.phrases import several


def motion_sentences(found: Motion | None) -> list[str]:
    """Why there are no modes, and which have no rate beyond its error."""
    if found is None:
        return []
    sentences = [f"Modes of motion are not given: {found.why_not}."] if found.why_not else []
    open_ones = [mode.name for mode in found.modes if not mode.quantities]
    if open_ones:
        sentences.append(
            f"Whether the {several(open_ones)} grows or falls is not determined: its rate is within its error."
        )
    return sentences
