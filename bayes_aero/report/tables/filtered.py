"""Tables of a fit with process noise: parameters, gusts, posterior by both samplers, one-step predictions."""

from __future__ import annotations

from collections.abc import Mapping

from bayes_aero.diagnosis.trajectories.results import ProcessNoise, TrajectoryFit
from bayes_aero.inference.posterior.posterior import Marginal, Posterior
from bayes_aero.inference.scores import Calibration, OneStep
from bayes_aero.report.tables.comparison import engine_label
from bayes_aero.report.tables.table import Column, Estimate, Table, columns_of, in_brackets
from bayes_aero.report.text.phrases import axis_label, for_people, number, plain_unit, short

CALIBRATION = {
    Calibration.CALIBRATED: "calibrated",
    Calibration.TOO_NARROW: "too narrow",
    Calibration.TOO_WIDE: "too wide",
    Calibration.NOT_NORMAL: "not normal",
    Calibration.COLOURED: "coloured",
    Calibration.UNDECIDED: "undecided",
}


def posterior_table(posteriors: Mapping[str, Posterior]) -> Table:
    """A row a parameter; of each sampler mean, deviation, 95 % interval, effective sample size and R-hat."""
    names = list(next(iter(posteriors.values())).names)
    columns = [Column(names, "parameter", "parameter", "")]
    for key, posterior in posteriors.items():
        rows = [posterior.marginals[name] for name in names]
        label = engine_label(key)
        parts = tuple(f"{key}_{part}" for part in ("mean", "sd", "low", "high"))
        columns += [
            Column([estimate_of(m) for m in rows], parts, "mean", label, in_brackets, group=label),
            Column([interval_of(m) for m in rows], page="95 % interval", group=label),
            Column([m.ess for m in rows], f"{key}_ess", "ESS", f"ESS {label}", ".0f", group=label),
            Column([m.rhat for m in rows], f"{key}_rhat", "R-hat", f"R-hat {label}", ".3f", group=label),
        ]
    note = (
        "SI units and radians; in brackets the standard deviation in units of the last digit. F: process noise of a "
        "state, per square root of a second; sigma: standard deviation of the measurement noise. ESS: effective sample "
        "size, of centre or tails, whichever is less."
    )
    return Table(columns, "Posterior with process noise", note, terminal_note=note)


def estimate_of(m: Marginal) -> Estimate:
    """A marginal as a cell of a table."""
    return Estimate(m.mean, m.sd, *m.ci95)


def interval_of(m: Marginal) -> str:
    """Its 95 % interval in words."""
    low, high = m.ci95
    return f"{number(low, 3)} to {number(high, 3)}"


def one_step_table(found: OneStep, units: Mapping[str, str]) -> Table:
    """A row an output, and one for all together: error, innovations over their predicted standard deviations, and the
    share of innovations inside central intervals, in per cent; `units` are SI units by output."""
    rows = [
        (axis_label(name, units.get(name, "1")), for_people(units.get(name, "1"))[1], one)
        for name, one in found.outputs.items()
    ]
    rows += [("all together", 1.0, found.together)] if len(rows) > 1 else []
    column = columns_of(rows)
    levels = [f"{100.0 * share.level:.0f} %" for share in found.together.shares]
    inside = (
        column(
            lambda r, k=k: Estimate(100.0 * r[2].shares[k].share, 100.0 * r[2].shares[k].sd),
            "",
            head,
            head,
            _per_cent,
            group="inside the interval, %",
        )
        for k, head in enumerate(levels)
    )
    note = (
        "RMS: measured minus predicted from the samples before. e/sd: root mean square of innovations over their "
        "predicted standard deviations, 1 if calibrated. Then the per cent of innovations inside central predictive "
        "intervals. In brackets: standard errors, with the autocorrelation counted, in units of the last digit."
    )
    return Table(
        [
            column(lambda r: r[0], "", "output", ""),
            column(lambda r: None if r[2].rms is None else r[1] * r[2].rms, "", "RMS", "RMS", _size),
            column(lambda r: Estimate(*r[2].ratio), "", "e/sd", "e/sd", in_brackets),
            *inside,
            column(lambda r: CALIBRATION[r[2].calibration], "", "predictions", "predictions"),
        ],
        "Errors, and innovations inside their predictive intervals",
        note,
        "One-step predictions",
        note,
    )


def _per_cent(e: Estimate) -> str:
    """A share with one digit of its standard error."""
    return f"{e.centre:.0f}({e.sd:.0f})" if e.sd >= 0.95 else f"{e.centre:.1f}({10.0 * e.sd:.0f})"


def _size(x: float) -> str:
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
        "In brackets: the standard error in units of the last digit; for output error with autocorrelated "
        "residuals, with process noise for white innovations.",
        terminal_note="SI and radians; standard errors in brackets in units of the last digit, with process noise for "
        "white innovations.",
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
