"""Sizes of the causes in a band of frequencies beside those of the coefficients: a table, and what it says."""

from __future__ import annotations

from bayes_aero.diagnosis.in_band.result import CausesInBand, SizeInBand
from bayes_aero.report.tables.table import Column, Estimate, Table, in_brackets, parameter_columns
from bayes_aero.report.text.phrases import number, several

LIMIT = 3.0  # standard errors of a difference from which two values differ


def in_band_table(found: CausesInBand) -> Table:
    """A row for each parameter of a cause that the band shows, SI and radians."""
    sizes = found.sizes
    both = (([s.coefficients for s in sizes], "coefficients"), ([s.in_band for s in sizes], "in the band"))
    return Table(
        [
            Column([s.cause for s in sizes], "cause", "cause"),
            *parameter_columns([s.parameter for s in sizes], [s.unit for s in sizes]),
            *(Column([Estimate.normal(*x) for x in values], page=head, form=in_brackets) for values, head in both),
            Column([s.apart for s in sizes], page="difference\n[standard errors]", form=".1f"),
        ],
        f"Sizes from {_band(found)}, where bias and drift drop out",
        "In brackets: standard error in units of the last digit. SI and radians.",
    )


def in_band_sentences(found: CausesInBand | None) -> tuple[str, ...]:
    """Whether the band confirms the causes."""
    if found is None:
        return ()
    if not found.converged:
        return (f"The causes could not be fitted from {_band(found)}: the band does not determine them.",)
    sentences = []
    apart = [s for s in found.sizes if s.apart > LIMIT]
    agree = list(dict.fromkeys(s.cause for s in found.sizes if s.cause not in {a.cause for a in apart}))
    if agree:
        sentences.append(f"From {_band(found)}, where bias and drift drop out, the sizes agree: {several(agree)}.")
    sentences += [
        f"{one.cause}: from {_band(found)} its size is {_size(one.in_band, one)}, {one.apart:.1f} standard errors from "
        f"{_size(one.coefficients, one)} of the whole record: a drift or a slow model error has a part in it."
        for one in apart
    ]
    if found.unseen:
        sentences.append(f"The band does not show {several(found.unseen)}.")
    return tuple(sentences)


def _band(found: CausesInBand) -> str:
    low, high = found.band
    return f"{number(low, 2)} to {number(high, 2)} Hz"


def _size(value: tuple[float, float], one: SizeInBand) -> str:
    return f"{in_brackets(Estimate.normal(*value))} {one.unit}"
