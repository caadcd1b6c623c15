"""Tables of a fit to trajectories: parameters, errors, tolerances, initial states."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from bayes_aero.diagnosis.result import (
    FITTED,
    START,
    Error,
    Motion,
    ProcessNoise,
    SimulatedManoeuvre,
    Trajectories,
    TrajectoryFit,
)
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.inference.results import Marginal, OneStep, Posterior
from bayes_aero.parameter import Prior
from bayes_aero.report.frequency import band_text, frequency_columns
from bayes_aero.report.tables.comparison import engine_label
from bayes_aero.report.tables.table import (
    NONE,
    BeforeAfter,
    Column,
    Estimate,
    Table,
    columns_of,
    in_brackets,
    or_dash,
    parameter_columns,
)
from bayes_aero.report.text.fly import MODELS, status_sentences
from bayes_aero.report.text.phrases import WORDS, axis_label, decimals, for_people, plain_unit, several, short, unparted
from bayes_aero.units import number

MARKS = {"held_by_prior": "held by its prior", "at_bound": "at its bound", "undetermined": "not determined"}
MAX_RELATIVE_ERROR = 100.0  # standard error over value from which digits of the value are not shown


def parameter_table(flown: TrajectoryFit) -> Table:
    """Every parameter, SI and radians; `crb` is infinite where the data alone do not determine it."""
    fit, errors = flown.fit, "standard error"
    in_bands = [column for band in flown.frequency for column in frequency_columns(fit.names, band)]
    start, estimate, crb, sd = (list(map(float, x)) for x in (flown.start, fit.estimate, fit.crb, fit.sd_corrected))
    priors = [prior_text(p.prior if flown.setting.priors else None) for p in fit.parameters]
    said = WORDS["notes"]["trajectory_priors"] if flown.setting.priors else "There are no priors."
    marked = dict(zip(MARKS, (fit.held_by_prior, fit.at_bound, fit.undetermined), strict=True))
    remarks = [", ".join(MARKS[mark] for mark, some in marked.items() if name in some) for name in fit.names]
    return Table(
        [
            *parameter_columns(fit.names, [p.unit for p in fit.parameters]),
            Column(start, "start", "first value", form=4),
            Column(
                list(map(Estimate, estimate, sd)),
                ("estimate",),
                "fit",
                "estimate",
                _fit,
                lambda e: in_brackets(e) if math.isfinite(e.sd) else NONE,
            ),
            Column(crb, "crb", "Cramér–Rao", "CRB", 2, group=errors),
            Column(sd, "sd_corrected", "corrected", "sd corr.", 2, group=errors),
            *in_bands,
            Column(priors, "prior", "prior", "prior"),
            Column([p.bounds for p in fit.parameters], page="bounds", form=_bounds),
            *(Column([name in some for name in fit.names], mark) for mark, some in marked.items()),
            Column(remarks, page="remark", terminal="", form=or_dash, terminal_form=str, words=True),
        ],
        "Parameters fitted to the trajectories",
        WORDS["notes"]["trajectory_parameters"],
        "Parameters fitted to trajectories: " + unparted(fit.status.name.lower().replace("_", " "), flown.following),
        f"{WORDS['notes']['trajectory_parameters_terminal']} {said}",
    )


def beside_table(flown: TrajectoryFit) -> Table:
    """For a terminal, which has no room for more columns: output error in the time domain, then the fits in a band."""
    fit, bands = flown.fit, flown.frequency
    time = [Estimate.normal(x, sd) for x, sd in zip(fit.estimate, fit.sd_corrected, strict=True)]
    in_bands = [frequency_columns(fit.names, band, band.method.replace(" ", "\n", 1)) for band in bands]
    return Table(
        [
            *parameter_columns(fit.names, [p.unit for p in fit.parameters]),
            Column(time, terminal="time\ndomain", terminal_form=in_brackets),
            *(column for columns in in_bands for column in columns),
        ],
        terminal_title=f"Frequency domain, {band_text(bands[0])}",
        terminal_note="In brackets: corrected standard error in units of the last digit. SI and radians.",
    )


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


def _bounds(bounds: tuple[float, float]) -> str:
    lower, upper = bounds
    if math.isinf(lower) or math.isinf(upper):
        one = f"≥ {number(lower)}" if math.isinf(upper) else f"≤ {number(upper)}"
        return "none" if math.isinf(lower) and math.isinf(upper) else one
    return f"{number(lower)} to {number(upper)}"


class OutputErrors(NamedTuple):
    """One output of one manoeuvre: errors of first values and of the fit, and the unit for people with its factor."""

    manoeuvre: str
    output: str
    before: Error
    after: Error
    unit: str
    factor: float


def _errors(flown: TrajectoryFit) -> list[OutputErrors]:
    return [
        OutputErrors(name, output, flown.path(name, START).errors[output], error, *for_people(flown.units[output]))
        for name in flown.manoeuvres
        for output, error in flown.path(name, FITTED).errors.items()
    ]


def error_table(flown: TrajectoryFit) -> Table:
    """Error at the first values and of the fit by manoeuvre and output, with Theil's coefficient and its parts."""
    rows, fitted = _errors(flown), flown.fit.flown.outputs
    left = "" if set(flown.outputs) <= set(fitted) else " *: reported, not fitted."
    column, rms = columns_of(rows), [BeforeAfter(r.factor * r.before.rms, r.factor * r.after.rms) for r in rows]
    shares = "shares of the fit's squared error"
    return Table(
        [
            Column([row.manoeuvre for row in rows], terminal="manoeuvre", words=True),
            column(lambda r: _label(flown, r.output) + ("" if r.output in fitted else " *"), "", "output", "output"),
            Column(rms, "", ("first values", "fit"), "RMS: start → fitted", short, group="root mean square"),
            column(lambda r: r.factor * r.after.largest, "", "fit", "largest", short, group="largest"),
            column(lambda r: r.after.theil.theil, "", "fit", "U", ".3f", group="Theil U"),
            *(
                column(lambda r, part=part: getattr(r.after.theil, part), "", part, head, ".0%", group=shares)
                for part, head in (("bias", "bias"), ("variance", "var."), ("covariance", "cov."))
            ),
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
    rows = [r for r in _errors(flown) if None not in (r.after.tolerance, r.after.within, r.before.within)]
    if not rows:
        return None
    column = columns_of(rows)
    return Table(
        [
            column(lambda r: _label(flown, r.output), page="output"),
            column(lambda r: f"± {number(r.factor * r.after.tolerance)} {r.unit}", page="tolerance"),
            column(lambda r: BeforeAfter(r.before.within, r.after.within), page=("first values", "fit"), form=".0%"),
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
            Column(
                [factor * x for *_, x, factor in rows],
                page="departure",
                form=lambda x: f"{'+' if x > 0.0 else ''}{number(x, 2)}",
            ),
            Column(priors, page="prior of the departure"),
        ]
    return Table(
        columns,
        f"State at the first sample: {'fitted, and its departure from the measured one' if free else 'fixed'}",
        "" if free else "Fixed to the card's values, and to the first sample where the card gives none.",
        below=[row[0] for row in rows],
    )


def _label(flown: TrajectoryFit, channel: str) -> str:
    return axis_label(channel, flown.units.get(channel, "1"))


# --- Tables of a fit with process noise: parameters, gusts, posterior by both samplers, one-step predictions.


def posterior_table(posteriors: Mapping[str, Posterior]) -> Table:
    """A row a parameter; of each sampler mean, deviation, 95 % interval, effective sample size and R-hat."""
    names = list(next(iter(posteriors.values())).names)
    columns = [Column(names, "parameter", "parameter", "")]
    for key, posterior in posteriors.items():
        rows = [posterior.marginals[name] for name in names]
        label = engine_label(key)
        parts = tuple(f"{key}_{part}" for part in ("mean", "sd", "low", "high"))
        columns += [
            Column([Estimate.of(m) for m in rows], parts, "mean", label, in_brackets, group=label),
            Column([interval_of(m) for m in rows], page="95 % interval", group=label),
            Column([m.ess for m in rows], f"{key}_ess", "ESS", f"ESS {label}", ".0f", group=label),
            Column([m.rhat for m in rows], f"{key}_rhat", "R-hat", f"R-hat {label}", ".3f", group=label),
        ]
    note = WORDS["notes"]["posterior"]
    return Table(columns, "Posterior with process noise", note, terminal_note=note)


def interval_of(m: Marginal) -> str:
    """Its 95 % interval in words."""
    low, high = m.ci95
    return f"{number(low, 3)} to {number(high, 3)}"


def one_step_table(found: OneStep, units: Mapping[str, str]) -> Table:
    """A row an output, and one for all: error, innovations over their predicted deviations, shares inside intervals."""
    rows = [
        (axis_label(name, units.get(name, "1")), for_people(units.get(name, "1"))[1], one)
        for name, one in found.outputs.items()
    ]
    rows += [("all together", 1.0, found.together)] if len(rows) > 1 else []
    column = columns_of(rows)
    levels = [f"{100.0 * share.level:.0f} %" for share in found.together.shares]
    group = "inside the interval, %"
    inside = (
        column(lambda r, k=k: Estimate(r[2].shares[k].share, r[2].shares[k].sd), "", head, head, _per_cent, group=group)
        for k, head in enumerate(levels)
    )
    note = WORDS["notes"]["one_step"]
    return Table(
        [
            column(lambda r: r[0], "", "output", ""),
            column(lambda r: None if r[2].rms is None else r[1] * r[2].rms, "", "RMS", "RMS", _rms),
            column(lambda r: Estimate(*r[2].ratio), "", "e/sd", "e/sd", in_brackets),
            *inside,
            column(lambda r: r[2].calibration.value.replace("_", " "), "", "predictions", "predictions"),
        ],
        "Errors, and innovations inside their predictive intervals",
        note,
        "One-step predictions",
        note,
    )


def _per_cent(e: Estimate) -> str:
    """A share with one digit of its standard error."""
    share, sd = 100.0 * e.centre, 100.0 * e.sd
    return f"{share:.0f}({sd:.0f})" if sd >= 0.95 else f"{share:.1f}({10.0 * sd:.0f})"


def _rms(x: float) -> str:
    """Small ones with an exponent: a record without noise is predicted to its last digits."""
    return short(x) if x >= 1e-4 else number(x, 2)


def process_noise_table(
    found: ProcessNoise, flown: TrajectoryFit, posteriors: Mapping[str, Posterior] | None = None
) -> Table:
    """Every parameter by output error and with process noise, and its credible interval where it was sampled."""
    fit = flown.fit
    every = zip(fit.parameters, fit.estimate, fit.sd_corrected, strict=True)
    rows = [(p, Estimate(float(x), float(sd))) for p, x, sd in every if p.name in found.estimates]
    ours, theirs = "output error", "with process noise"
    return Table(
        [
            Column([p.name for p, _ in rows], page="parameter", terminal=""),
            Column([plain_unit(p.unit) for p, _ in rows], page="unit"),
            Column([estimate for _, estimate in rows], "", ours, ours, in_brackets),
            Column([Estimate(*found.estimates[p.name]) for p, _ in rows], "", theirs, theirs, in_brackets),
            *(
                Column([interval_of(posterior.marginals[p.name]) for p, _ in rows], "", head, head)
                for key, posterior in (posteriors or {}).items()
                for head in [f"95 % {engine_label(key)}"]
            ),
        ],
        "Parameters with and without process noise",
        WORDS["notes"]["process_noise"],
        terminal_note=WORDS["notes"]["process_noise_terminal"],
    )


def gust_table(found: ProcessNoise) -> Table:
    """A row for each sample: manoeuvre, time (s), mean and standard deviation of each gust (m/s)."""
    column = columns_of([(h, k) for h in found.histories for k in range(len(h.time))])
    names = dict.fromkeys(name for h in found.histories for name in h.gusts)
    gusts = (
        column(lambda r, name=name: Estimate(*(x[r[1]] for x in r[0].gusts[name])), (name, f"{name}_sd"))
        for name in names
    )
    return Table(
        [column(lambda r: r[0].manoeuvre, "manoeuvre"), column(lambda r: r[0].time[r[1]], "time"), *gusts], index=2
    )


# --- Tables of simulated trajectories: errors and time inside the tolerances by flight and output.

SI = {name: channel.unit for name, channel in STANDARD_CHANNELS.items()}
TAIL = 6  # characters of a manoeuvre's name on a terminal
SPLIT_NAMES = {"fitted": "fitted", "hold_out": "hold-out"}
"""What people read, by the split of a simulated path."""
BOTH = ("before", "after")
Flights = list[tuple[str, str]]


def hold_out_error_table(flown: Trajectories) -> Table:
    """Root mean square error of every output, fitted jointly and on hold-out flights: card's model, extended model."""
    flights, columns = _flights(flown)
    for output in flown.outputs:
        label, factor = axis_label(output, SI[output]), for_people(SI[output])[1]
        errors = _changes(flown, flights, output, lambda e, factor=factor: factor * e.rms)
        columns.append(Column(errors, "", BOTH, label, short, group=label))
    return Table(
        columns,
        "Root-mean-square error of the simulated trajectory: card's model before, extended model after",
        terminal_title="Error of the simulated trajectory (RMS), card's model → extended model",
        terminal_note=" ".join([WORDS["notes"]["hold_out_errors"], *status_sentences(flown)]),
    )


def hold_out_tolerance_table(flown: Trajectories) -> Table:
    """Share of the time inside the tolerance, and how probably the extended model stays inside all the time."""
    flights, columns = _flights(flown)
    banded = [n for n in flown.outputs if any(p.errors[n].within is not None for p in flown.paths)]
    for output in banded:
        inside = _changes(flown, flights, output, lambda e: e.within)
        columns.append(Column(inside, "", BOTH, form=".0%", group=axis_label(output, SI[output])))
    least = []
    for split, name in flights:
        path = flown.path(name, "extended", split)
        chances = [] if path is None else [path.errors[n].probability for n in banded]
        least.append(min((chance for chance in chances if chance is not None), default=None))
    columns.append(Column(least, page="whole flight inside,\nweakest output", form=".0%", group="probability"))
    return Table(columns, "Share of the time inside the tolerance", WORDS["notes"]["hold_out_tolerances"])


def given_table(paths: Sequence[SimulatedManoeuvre]) -> Table:
    """Errors of one model's simulation by flight and output."""
    columns = [Column([path.manoeuvre for path in paths], page="flight")]
    for output in paths[0].errors:
        label, factor = axis_label(output, SI[output]), for_people(SI[output])[1]
        errors = [path.errors[output] for path in paths]
        columns += [
            Column([factor * error.rms for error in errors], page="RMS", form=short, group=label),
            Column([error.within for error in errors], page="inside", form=".0%", group=label),
        ]
    return Table(columns, "Error of the simulated trajectories", WORDS["notes"]["given"])


def _flights(flown: Trajectories) -> tuple[Flights, list[Column]]:
    """Split and manoeuvre of each flight, and the columns that name them."""
    found = ((split, p.manoeuvre) for split in SPLIT_NAMES for p in flown.paths if p.split == split)
    flights = list(dict.fromkeys(found))
    # the end of a record's name usually distinguishes records, for the width of a terminal
    tails = [name if len(name) <= TAIL + 1 else f"…{name[-TAIL:]}" for _, name in flights]
    return flights, [
        Column(tails, terminal="manoeuvre"),
        Column([SPLIT_NAMES[split] for split, _ in flights], terminal=""),
        Column([f"{name}, {SPLIT_NAMES[split]}" for split, name in flights], page="flight"),
    ]


def _changes(
    flown: Trajectories, flights: Flights, output: str, get: Callable[[Error], float | None]
) -> list[BeforeAfter]:
    """A number of each flight by the card's and by the extended model."""
    paths = ([flown.path(name, model, split) for model in MODELS] for split, name in flights)
    return [BeforeAfter(*(None if path is None else get(path.errors[output]) for path in pair)) for pair in paths]


# --- Modes of motion.

QUANTITIES = {
    "period": "period, s",
    "damping_ratio": "damping ratio",
    "time_constant": "time constant, s",
    "time_to_half": "time to half, s",
    "time_to_double": "time to double, s",
}
SWINGS, DECAYS, SPIRALS = ("period", "damping_ratio"), ("time_constant",), ("time_to_half",)
"""What people read beside the time to double: of an oscillation, of what does not oscillate, of a spiral."""


def mode_table(found: Motion) -> Table:
    """Period and damping, or times, of every mode."""
    rows = []
    for mode in found.modes:
        read = SWINGS if mode.eigenvalue.imag > 0.0 else SPIRALS if mode.name == "spiral" else DECAYS
        quantities = [(mode, n, Estimate(*x)) for n, x in mode.quantities.items() if n in (*read, "time_to_double")]
        rows += quantities or [(mode, "", Estimate(math.nan, math.nan))]
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
            column(
                lambda r: QUANTITIES.get(r[1], "neither grows nor falls beyond its error"), "", "quantity", "quantity"
            ),
            column(lambda r: r[2], "", "value", "value", in_brackets),
        ],
        "Modes of motion",
        note,
        terminal_note=note,
    )


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
