"""The posterior of a fit with process noise by both samplers: marginals with what tells of their chains."""

from __future__ import annotations

from collections.abc import Mapping

from bayes_aero.inference.posterior.posterior import Marginal, Posterior
from bayes_aero.report.tables.comparison import engine_label
from bayes_aero.report.tables.table import Column, Estimate, Table, in_brackets
from bayes_aero.report.text.phrases import number


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
    """A marginal as tables show it."""
    return Estimate(m.mean, m.sd, *m.ci95)


def interval_of(m: Marginal) -> str:
    """Its 95 % interval in words."""
    low, high = m.ci95
    return f"{number(low, 3)} to {number(high, 3)}"
