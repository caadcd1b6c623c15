"""Modes of motion as a table and in sentences."""

from __future__ import annotations

import math

from bayes_aero.diagnosis.trajectory_result import FlownMode, Motion
from bayes_aero.report.tables.table import Estimate, Table, columns_of, in_brackets
from bayes_aero.report.text.phrases import several

SHOWN = {
    "period": "period, s",
    "damping_ratio": "damping ratio",
    "time_constant": "time constant, s",
    "time_to_half": "time to half, s",
    "time_to_double": "time to double, s",
}
SWINGS, DECAYS, SPIRALS = ("period", "damping_ratio"), ("time_constant",), ("time_to_half",)
"""What people read beside the time to double: of an oscillation, of what does not oscillate, of a spiral."""


def mode_rows(modes: tuple[FlownMode, ...]) -> list[tuple[FlownMode, str, Estimate]]:
    """Mode, quantity and its estimate."""
    rows = []
    for mode in modes:
        read = SWINGS if mode.eigenvalue.imag > 0.0 else SPIRALS if mode.name == "spiral" else DECAYS
        quantities = [(mode, n, Estimate(*x)) for n, x in mode.quantities.items() if n in (*read, "time_to_double")]
        rows += quantities or [(mode, "", Estimate(math.nan, math.nan))]
    return rows


def mode_table(found: Motion) -> Table:
    """Period and damping, or times, of every mode."""
    rows = mode_rows(found.modes)
    column = columns_of(rows)
    estimates = "with process noise, with errors for white innovations" if found.filtered else "of output error"
    equations = (
        "the equations of motion with fixed controls, linearised about straight level flight at "
        f"{found.airspeed:.0f} m/s and {found.altitude:.0f} m"
    )
    if math.isnan(found.airspeed):
        equations = "the card's linear equations"
    note = (
        f"Eigenvalues of {equations}, for the estimates {estimates}. In brackets: the standard error in units "
        "of the last digit, of first order in the parameters."
    )
    return Table(
        [
            column(lambda r: r[0].name, "", "mode", "mode"),
            column(lambda r: SHOWN.get(r[1], "neither grows nor falls beyond its error"), "", "quantity", "quantity"),
            column(lambda r: r[2], "", "value", "value", in_brackets),
        ],
        "Modes of motion",
        note,
        terminal_note=note,
    )


# --- Modes of motion in sentences.


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
