"""Estimates in the frequency domain: columns beside those of the time domain, and what is said of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_aero.inference.frequency.result import FrequencyFit
from bayes_aero.report.tables.table import Column, Estimate, Table, in_brackets, parameter_columns
from bayes_aero.report.text.phrases import number, several

LIMIT = 3.0  # standard errors of a difference from which two values differ


def band_text(fit: FrequencyFit) -> str:
    """The band for people."""
    return f"{number(fit.band[0], 2)} to {number(fit.band[1], 2)} Hz"


def frequency_columns(names: Sequence[str], fit: FrequencyFit, head: str | None = None) -> list[Column]:
    """Estimates, both standard errors, and differences from the time domain where they are known.

    `head`: heading on a terminal; None leaves the estimates out there.
    """
    key = f"frequency_{fit.method.replace(' ', '_')}"
    group = f"{fit.method}, {band_text(fit)}"

    def of(sd: np.ndarray) -> list[Estimate | None]:
        found = {n: Estimate.normal(x, s) for n, x, s in zip(fit.names, fit.estimate, sd, strict=True)}
        return [found.get(name) for name in names]

    columns = [
        Column(of(fit.crb), (key, f"{key}_crb"), "Cramér–Rao", group=group),
        Column(of(fit.crb_corrected), ("", f"{key}_crb_corrected"), "corrected", head, "", in_brackets, group=group),
    ]
    if fit.apart:
        apart = [fit.apart.get(name) for name in names]
        columns.append(Column(apart, f"{key}_difference", "difference\n(standard errors)", "diff.", ".1f", group=group))
    return columns


def band_table(
    names: Sequence[str], units: Sequence[str], time: Sequence[Estimate], fits: Sequence[FrequencyFit]
) -> Table:
    """For a terminal, which has no room for more columns: output error in the time domain, then the fits in a band."""
    heads = (fit.method.replace(" ", "\n", 1) for fit in fits)
    return Table(
        [
            *parameter_columns(names, units),
            Column(time, terminal="time\ndomain", terminal_form=in_brackets),
            *(c for fit, head in zip(fits, heads, strict=True) for c in frequency_columns(names, fit, head)),
        ],
        terminal_title=f"Frequency domain, {band_text(fits[0])}",
        terminal_note="In brackets: corrected standard error in units of the last digit. SI and radians.",
    )


def frequency_sentences(fit: FrequencyFit) -> tuple[str, ...]:
    """What drops out of a fit in a band, and whether it agrees with the time domain."""
    what = f"{fit.method.capitalize()} in the frequency domain, {band_text(fit)}, {fit.lines} frequencies"
    if not fit.converged:
        return (f"{what}: the parameters are not determined there; use a wider band.",)
    gone = f": {several(fit.unseen)} drop{'s' if len(fit.unseen) == 1 else ''} out with bias and drift"
    told = [f"{what}{gone if fit.unseen else ''}."]
    if fit.at_bound:
        told.append(f"In the band {several(fit.at_bound)} went to a bound and stayed there.")
    differ = [f"{name} ({number(x, 2)} standard errors)" for name, x in fit.apart.items() if x > LIMIT]
    if differ:
        told.append(f"Time and frequency domain differ on {several(differ)}: suspect drift or a slow model error.")
    elif fit.apart:
        worst = max(fit.apart, key=lambda name: fit.apart[name])
        told.append(f"Time and frequency domain agree within {number(fit.apart[worst], 2)} standard errors ({worst}).")
    return tuple(told)
