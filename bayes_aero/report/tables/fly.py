"""Tables of a fit to trajectories: parameters, errors, tolerances, initial states."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

from bayes_aero.diagnosis.trajectories.results import FITTED, START, Error, TrajectoryFit
from bayes_aero.parameter import Prior
from bayes_aero.report.frequency.tables import band_table, frequency_columns
from bayes_aero.report.tables.table import (
    NONE,
    Change,
    Column,
    Estimate,
    Table,
    columns_of,
    in_brackets,
    or_dash,
    parameter_columns,
)
from bayes_aero.report.text.phrases import axis_label, decimals, for_people, number, short
from bayes_aero.report.text.restraints import unparted

MARKS = {"held_by_prior": "held by its prior", "at_bound": "at its bound", "undetermined": "not determined"}
MAX_RELATIVE_ERROR = 100.0  # standard error over value from which digits of the value are not shown


def parameter_table(flown: TrajectoryFit) -> Table:
    """Every parameter, SI and radians; `crb` is infinite where the data alone do not determine it."""
    fit, errors = flown.fit, "standard error"
    in_bands = [column for band in flown.frequency for column in frequency_columns(fit.names, band)]
    start, estimate, crb, sd = (list(map(float, x)) for x in (flown.start, fit.estimate, fit.crb, fit.sd_corrected))
    priors = [prior_text(p.prior if flown.setting.priors else None) for p in fit.parameters]
    marked = dict(zip(MARKS, (fit.held_by_prior, fit.at_bound, fit.undetermined), strict=True))
    remarks = [", ".join(MARKS[mark] for mark, some in marked.items() if name in some) for name in fit.names]
    return Table(
        [
            *parameter_columns(fit.names, [p.unit for p in fit.parameters]),
            Column(start, "start", "first value", form=4),
            Column(list(map(Estimate, estimate, sd)), ("estimate",), "fit", "estimate", _fit, _known),
            Column(crb, "crb", "Cramér–Rao", "CRB", 2, group=errors),
            Column(sd, "sd_corrected", "corrected", "sd corr.", 2, group=errors),
            *in_bands,
            Column(priors, "prior", "prior", "prior"),
            Column([_bounds(*p.bounds) for p in fit.parameters], page="bounds"),
            *(Column([name in some for name in fit.names], mark) for mark, some in marked.items()),
            Column(remarks, page="remark", terminal="", form=or_dash, terminal_form=str, words=True),
        ],
        "Parameters fitted to the trajectories",
        "SI units and radians. Cramér–Rao: the data alone, for white residuals; a dash where they do not "
        "determine the parameter. Corrected: with the autocorrelation of the residuals and the prior. Prior: mean ± "
        "standard deviation, the program's default or the card's.",
        "Parameters fitted to trajectories: " + unparted(fit.status.name.lower().replace("_", " "), flown.following),
        "SI and radians. CRB: Cramér-Rao bound of the data alone, for white residuals. sd corr.: with their "
        "autocorrelation and the priors; in brackets after the estimate in units of its last digit. "
        + (
            "Priors are mean ± standard deviation, weighted with the variance inflation of the residuals."
            if flown.setting.priors
            else "There are no priors."
        ),
    )


def beside_table(flown: TrajectoryFit) -> Table:
    """For a terminal: output error in the time domain beside the fits in a band."""
    fit = flown.fit
    time = [Estimate.normal(x, sd) for x, sd in zip(fit.estimate, fit.sd_corrected, strict=True)]
    return band_table(fit.names, [p.unit for p in fit.parameters], time, flown.frequency)


def parameter_rows(flown: TrajectoryFit) -> dict[str, dict[str, Any]]:
    """The same by parameter, as JSON has it: `prior` in its parts, and None where the fit had none."""
    rows = {str(row.pop("parameter")): row for row in parameter_table(replace(flown, frequency=())).records()}
    for parameter in flown.fit.parameters:
        prior = parameter.prior
        parts = {key: getattr(prior, key) for key in ("family", "location", "scale", "source")}
        rows[parameter.name]["prior"] = parts | {"default": not prior.by_card} if flown.setting.priors else None
    return rows


def prior_text(prior: Prior | None) -> str:
    """A prior, and whether it is the default or the card's."""
    if prior is None:
        return "none"
    location, scale, end = (number(x, 4) for x in (prior.location, prior.scale, prior.location + prior.scale))
    text = {
        "normal": f"{location} ± {scale}",
        "lognormal": f"{location} × e^±{scale}",
        "halfnormal": f"{location} + |{scale}|",
        "uniform": f"{location} to {end}",
    }[prior.family]
    return f"{text}, {'card' if prior.by_card else 'default'}"


def _fit(e: Estimate) -> str:
    """As many digits as the standard error allows; three if it is far larger than the value."""
    return f"{e.centre:.{decimals(e.sd)}f}" if 0.0 < e.sd < MAX_RELATIVE_ERROR * abs(e.centre) else number(e.centre, 3)


def _known(e: Estimate) -> str:
    return in_brackets(e) if math.isfinite(e.sd) else NONE


def _bounds(lower: float, upper: float) -> str:
    if math.isinf(lower) and math.isinf(upper):
        return "none"
    if math.isinf(lower) or math.isinf(upper):
        return f"≥ {number(lower)}" if math.isinf(upper) else f"≤ {number(upper)}"
    return f"{number(lower)} to {number(upper)}"


class _Row(NamedTuple):
    """One output of one manoeuvre: errors of first values and of the fit, and the unit for people with its factor."""

    manoeuvre: str
    output: str
    before: Error
    after: Error
    unit: str
    factor: float


def _rows(flown: TrajectoryFit) -> list[_Row]:
    return [
        _Row(name, output, flown.path(name, START).errors[output], error, *for_people(flown.units[output]))
        for name in flown.manoeuvres
        for output, error in flown.path(name, FITTED).errors.items()
    ]


def error_table(flown: TrajectoryFit) -> Table:
    """Error at the first values and of the fit by manoeuvre and output, with Theil's coefficient and its parts."""
    rows, fitted = _rows(flown), flown.fit.flown.outputs
    left = "" if set(flown.outputs) <= set(fitted) else " *: reported, not fitted."
    column = columns_of(rows)
    shares = "shares of the fit's squared error"
    return Table(
        [
            Column([row.manoeuvre for row in rows], terminal="manoeuvre", words=True),
            column(lambda r: _label(flown, r.output) + ("" if r.output in fitted else " *"), "", "output", "output"),
            column(
                lambda r: Change(r.factor * r.before.rms, r.factor * r.after.rms),
                page=("first values", "fit"),
                terminal="RMS: start → fitted",
                form=short,
                group="root mean square",
            ),
            column(lambda r: r.factor * r.after.largest, "", "fit", "largest", short, group="largest"),
            column(lambda r: r.after.theil.theil, "", "fit", "U", ".3f", group="Theil U"),
            column(lambda r: r.after.theil.bias, "", "bias", "bias", ".0%", group=shares),
            column(lambda r: r.after.theil.variance, "", "variance", "var.", ".0%", group=shares),
            column(lambda r: r.after.theil.covariance, "", "covariance", "cov.", ".0%", group=shares),
        ],
        "Error of the simulated trajectories, in the unit of each output",
        "A good model leaves covariance only (noise): bias is a constant offset, variance a wrong amplitude." + left,
        "Error of the simulated trajectory",
        f"Start: first values of the parameters, {'measured' if flown.setting.initial is None else 'fixed'} initial "
        f"state. Theil's U, and the shares of bias, variance and covariance in the mean square error.{left}",
        below=[row.manoeuvre for row in rows],
    )


def tolerance_table(flown: TrajectoryFit) -> Table | None:
    """Share of the time inside the tolerance, before and after; nothing where no output has one."""
    rows = [r for r in _rows(flown) if None not in (r.after.tolerance, r.after.within, r.before.within)]
    if not rows:
        return None
    column = columns_of(rows)
    return Table(
        [
            column(lambda r: _label(flown, r.output), page="output"),
            column(lambda r: f"± {number(r.factor * r.after.tolerance)} {r.unit}", page="tolerance"),
            column(lambda r: Change(r.before.within, r.after.within), page=("first values", "fit"), form=".0%"),
        ],
        "Share of the time inside the tolerance",
        "These data were fitted; errors on hold-out flights may be larger.",
        below=[r.manoeuvre for r in rows],
    )


def initial_table(flown: TrajectoryFit) -> Table:
    """The fitted state at each manoeuvre's first sample, how far it is from the measured one, and the prior of that."""
    rows = [
        (name, state, value, departure, for_people(flown.units.get(state, "1"))[1])
        for name in flown.manoeuvres
        for state, (value, departure) in flown.initial[name].items()
    ]
    own, free = flown.departure_sd, flown.setting.initial is None
    columns = [
        Column([_label(flown, state) for _, state, *_ in rows], page="state"),
        Column([factor * value for *_, value, _, factor in rows], page="fitted" if free else "value", form=4),
    ]
    if free:
        priors = [f"0 ± {number(factor * own[s], 2)}, default" if own else "none" for _, s, *_, factor in rows]
        columns += [
            Column([factor * x for *_, x, factor in rows], page="departure", form=_signed),
            Column(priors, page="prior of the departure"),
        ]
    return Table(
        columns,
        f"State at the first sample: {'fitted, and its departure from the measured one' if free else 'fixed'}",
        "" if free else "Fixed to the card's values, and to the first sample where the card gives none.",
        below=[row[0] for row in rows],
    )


def _signed(x: float) -> str:
    return f"{'+' if x > 0.0 else ''}{number(x, 2)}"


def _label(flown: TrajectoryFit, channel: str) -> str:
    return axis_label(channel, flown.units.get(channel, "1"))
