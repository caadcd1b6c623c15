"""Tables of a fit to trajectories for the page."""

from __future__ import annotations

import math
from collections.abc import Callable

from bayes_aero.diagnosis.trajectories.results import FITTED, START, ProcessNoise, TrajectoryFit
from bayes_aero.report.html.page import Table
from bayes_aero.report.html.parts import number, plain_unit
from bayes_aero.report.tables.comparison import decimals
from bayes_aero.report.tables.run_tables import concise
from bayes_aero.report.text.fly import parameter_rows, prior_words, remarks
from bayes_aero.report.text.phrases import axis_label, bracket, for_people, short

UNKNOWN = 100.0  # times the value from which its deviation says only that it is not known
Row = tuple[str, ...]


def errors(flown: TrajectoryFit) -> Table:
    """Error at the first values and of the fit by manoeuvre and output, with Theil's coefficient and its parts."""
    fitted = flown.fit.flown.outputs

    def rows(name: str) -> list[Row]:
        before, after = flown.path(name, START), flown.path(name, FITTED)
        found = []
        for output, error in after.errors.items():
            factor, theil = for_people(flown.units[output])[1], error.theil
            found.append(
                (
                    _label(flown, output) + ("" if output in fitted else " *"),
                    short(factor * before.errors[output].rms),
                    short(factor * error.rms),
                    short(factor * error.largest),
                    _given(theil.theil, ".3f"),
                    *(_given(part, ".0%") for part in (theil.bias, theil.variance, theil.covariance)),
                )
            )
        return found

    left = "" if set(flown.outputs) <= set(fitted) else " *: reported, not fitted."
    return Table(
        "Error of the simulated trajectories, in the unit of each output",
        ("output", "first values", "fit", "fit", "fit", "bias", "variance", "covariance"),
        _by_manoeuvre(flown, rows),
        (("", 1), ("root mean square", 2), ("largest", 1), ("Theil U", 1), ("shares of the fit's squared error", 3)),
        note="A good model leaves covariance only (noise): bias is a constant offset, variance a wrong amplitude."
        + left,
    )


def kept(flown: TrajectoryFit) -> Table | None:
    """Share of the time inside the tolerance, before and after; nothing where no output has one."""

    def rows(name: str) -> list[Row]:
        before, after = flown.path(name, START), flown.path(name, FITTED)
        found = []
        for output, error in after.errors.items():
            unit, factor = for_people(flown.units[output])
            first = before.errors[output].within
            if error.tolerance is not None and error.within is not None and first is not None:
                band = f"± {number(factor * error.tolerance)} {unit}"
                found.append((_label(flown, output), band, f"{first:.0%}", f"{error.within:.0%}"))
        return found

    found = _by_manoeuvre(flown, rows)
    if not found:
        return None
    return Table(
        "Share of the time inside the tolerance",
        ("output", "tolerance", "first values", "fit"),
        found,
        note="These data were fitted; errors on hold-out flights may be larger.",
    )


def parameters(flown: TrajectoryFit) -> Table:
    """First value, estimate, both standard errors and bounds of every parameter."""
    bounds = {p.name: p.bounds for p in flown.fit.parameters}
    rows = [
        (
            f"{name} {bracket(plain_unit(row['unit']))}",
            number(row["start"], 4),
            _estimate(row["estimate"], row["sd_corrected"]),
            number(row["crb"], 2),
            number(row["sd_corrected"], 2),
            prior_words(row).replace("-", "−"),
            _bounds(*bounds[name]),
            remarks(row) or "–",
        )
        for name, row in parameter_rows(flown).items()
    ]
    return Table(
        "Parameters fitted to the trajectories",
        ("parameter", "first value", "fit", "Cramér–Rao", "corrected", "prior", "bounds", "remark"),
        tuple(rows),
        (("", 3), ("standard error", 2), ("", 3)),
        note="SI units and radians. Cramér–Rao: the data alone, for white residuals; a dash where they do not "
        "determine the parameter. Corrected: with the autocorrelation of the residuals and the prior. Prior: mean ± "
        "standard deviation, the program's default or the card's.",
    )


def initial(flown: TrajectoryFit) -> Table:
    """The fitted state at each manoeuvre's first sample, how far it is from the measured one, and the prior of that."""
    own = flown.departure_sd

    def rows(name: str) -> list[Row]:
        found = []
        for state, (value, departure) in flown.initial[name].items():
            factor = for_people(flown.units.get(state, "1"))[1]
            shown = f"{'+' if departure > 0.0 else ''}{number(factor * departure, 2)}"
            prior = f"0 ± {number(factor * own[state], 2)}, default" if own else "none"
            found.append((_label(flown, state), number(factor * value, 4), shown, prior))
        return found

    if flown.setting.initial is not None:
        return Table(
            "State at the first sample: fixed",
            ("state", "value"),
            _by_manoeuvre(flown, lambda name: [row[:2] for row in rows(name)]),
            note="Fixed to the card's values, and to the first sample where the card gives none.",
        )
    return Table(
        "State at the first sample: fitted, and its departure from the measured one",
        ("state", "fitted", "departure", "prior of the departure"),
        _by_manoeuvre(flown, rows),
    )


def _by_manoeuvre(flown: TrajectoryFit, rows: Callable[[str], list[Row]]) -> tuple[Row, ...]:
    """Each manoeuvre's rows, below its name where there are several."""
    found: list[Row] = []
    for name in flown.manoeuvres:
        own = rows(name)
        if own and len(flown.manoeuvres) > 1:
            found.append((name, *[""] * (len(own[0]) - 1)))
        found += own
    return tuple(found)


def _label(flown: TrajectoryFit, channel: str) -> str:
    return axis_label(channel, flown.units.get(channel, "1"))


def _given(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "–"


def _estimate(value: float, sd: float) -> str:
    """As many digits as the standard error allows; three if it is far larger than the value."""
    return f"{value:.{decimals(sd)}f}" if 0.0 < sd < UNKNOWN * abs(value) else number(value, 3)


def _bounds(lower: float, upper: float) -> str:
    if math.isinf(lower) and math.isinf(upper):
        return "none"
    if math.isinf(lower) or math.isinf(upper):
        return f"≥ {number(lower)}" if math.isinf(upper) else f"≤ {number(upper)}"
    return f"{number(lower)} to {number(upper)}"


def process_noise(flown: TrajectoryFit, found: ProcessNoise) -> Table:
    """Every parameter by output error and with process noise."""
    fit = flown.fit
    rows = [
        (name, plain_unit(p.unit), concise(float(x), float(sd)), concise(*found.estimates[name]))
        for name, p, x, sd in zip(fit.names, fit.parameters, fit.estimate, fit.sd_corrected, strict=True)
        if name in found.estimates
    ]
    return Table(
        "Parameters with and without process noise",
        ("parameter", "unit", "output error", "with process noise"),
        tuple(rows),
        note="In brackets: the standard error in units of the last digit; for output error with autocorrelated "
        "residuals, with process noise for white innovations.",
    )
