"""Sentences on contradicted priors, on estimates at their bounds or impossible, and on inseparable parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np
import pandas as pd

from bayes_aero.inference.results import (
    SENSITIVITY_LIMIT,
    ActiveBound,
    Inseparable,
    Posterior,
    PosteriorStatus,
    PriorConflict,
)
from bayes_aero.parameter import Parameter
from bayes_aero.report.tables.comparison import engine_label
from bayes_aero.report.text.phrases import plus_minus, several
from bayes_aero.units import number

MIN_ERRORS = 3.0  # standard errors from zero from which a sign is wrong


def conflict_sentences(conflicts: Sequence[PriorConflict]) -> list[str]:
    """A sentence for each prior that the record contradicts."""
    return [
        f"The card's prior on {c.name}, {plus_minus(*c.prior)}{_unit(c.unit)} ({c.source}), contradicts "
        f"the record: the likelihood alone gives {plus_minus(*c.likelihood)}, {c.distance:.1f} "
        f"combined standard errors away. The prior shifts the posterior of {c.name} and of correlated parameters. "
        "Widen the prior, or find the reason why the record differs."
        for c in conflicts
    ]


def leaning_sentences(table: pd.DataFrame, conflicts: Sequence[PriorConflict]) -> tuple[str, ...]:
    """How far the posterior depends on contradicted priors, and which others do, by `prior_sensitivity`'s table."""
    names = [c.name for c in conflicts if c.name in table.index]
    if not names:
        return ()
    prior, data = (table[part].astype(float).to_dict() for part in ("prior", "likelihood"))
    own = several(f"{n} {prior[n]:.2f} to the prior, {data[n]:.2f} to the data" for n in names)
    others = [str(n) for n in prior if n not in names and prior[n] >= SENSITIVITY_LIMIT]
    more = f" Priors also move {several(others)}." if others else ""
    return (f"Sensitivity of the posterior by power-scaling ({SENSITIVITY_LIMIT:g} and above matters): {own}.{more}",)


def bound_sentences(found: Sequence[ActiveBound]) -> list[str]:
    """A sentence for each parameter at its bound."""
    sentences = []
    for b in found:
        bound = f"{'lower' if b.lower else 'upper'} bound, {number(b.bound, 4)}{_unit(b.unit)}"
        text = (
            f"{b.name} is at its {bound}: its interval is not reliable. Without the bound it would be about "
            f"{number(b.unbounded, 4)} (to first order)"
        )
        if b.shifts:
            shifts = several(f"{n} ({-x:+.1f} corrected standard errors)" for n, x in b.shifts.items())
            text += f"; the bound moves {shifts}"
        sentences.append(f"{text}. Widen the bound, or fix {b.name}.")
    return sentences


def inseparable_sentences(found: Sequence[Inseparable]) -> list[str]:
    """A sentence for each set of parameters that the record cannot separate."""
    sentences = []
    for one in found:
        listed = several(
            f"{name} {plus_minus(x, sd)}{_unit(unit)}"
            for name, unit, (x, sd) in zip(one.names, one.units, one.estimates, strict=True)
        )
        low, high = (f"{x:.0f}" if x >= 10.0 else f"{x:.2g}" for x in (min(one.wider), max(one.wider)))
        times = low if low == high else f"{low} to {high}"
        sentences.append(
            f"The record cannot separate {several(one.names)} ({listed}): if the others were known, each interval "
            f"would be {times} times narrower. Fly manoeuvres that excite them differently, fix one, or give one a "
            "prior."
        )
    return sentences


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def sign_sentences(
    estimates: Mapping[str, tuple[float, float]], parameters: Iterable[Parameter], following: Sequence[str] = ()
) -> list[str]:
    """A sentence for every estimate (value and standard error, SI) that is impossible for an aircraft."""
    asked = [(p, *estimates[p.name]) for p in parameters if p.name in estimates]
    wrong = [
        f"{p.name} = {value:+.4g} has the wrong sign: {p.sign.otherwise}. If the sign of {p.sign.channel} is reversed "
        "in the file, write sign = -1 at that channel on the card."
        for p, value, deviation in asked
        if p.sign is not None and not following and p.sign.side * value < -MIN_ERRORS * deviation
    ]
    return wrong + [
        f"{p.name} = {value:.4g} is impossible: {p.limits.reason}. Do not use these numbers. Look for a faulty channel "
        "(bayes-aero check), or for a record that is too short or contains too little excitation."
        for p, value, deviation in asked
        if p.limits is not None
        and (_beyond(p.limits.low, value, deviation, -1.0) or _beyond(p.limits.high, value, deviation, 1.0))
    ]


def unparted(status: str, following: Sequence[str]) -> str:
    """The status of a fit, and that feedback and aircraft cannot be parted where a surface only follows the outputs."""
    return f"{status}, but feedback and aircraft cannot be parted ({several(following)})" if following else status


def _beyond(limit: float, value: float, deviation: float, side: float) -> bool:
    """Whether a value is beyond the limit on that side, significantly or by more than twice the limit."""
    margin = MIN_ERRORS * deviation if math.isfinite(deviation) else 0.0
    return bool(side * (value - limit) > (min(margin, 2.0 * abs(limit)) if limit else margin))


# --- Whether the chains of samplers may be used, and whether samplers of one density agree.

MEANS = 0.2  # difference of means, in standard deviations, up to which samplers agree; our choice
SDS = 0.15  # relative difference of standard deviations up to which samplers agree; our choice


def unfinished(posteriors: Mapping[str, Posterior]) -> list[str]:
    """Posteriors that must not be used."""
    return [
        f"The posterior by {engine_label(key) if key != 'white' else 'emcee under white noise'}: {p.status.value}."
        for key, p in posteriors.items()
        if p.status is not PosteriorStatus.CONVERGED
    ]


def agreement_of_engines(posteriors: Mapping[str, Posterior]) -> list[str]:
    """Whether engines that sampled the same density give the same posterior."""
    sentences = []
    for (a, one), (b, two) in combinations(posteriors.items(), 2):
        pairs = {n: (one.marginals[n], two.marginals[n]) for n in one.names if n in two.marginals}
        means = {n: abs(p.mean - q.mean) / np.sqrt((p.sd**2 + q.sd**2) / 2.0) for n, (p, q) in pairs.items()}
        sds = {n: p.sd / q.sd for n, (p, q) in pairs.items()}
        far, wide = max(means, key=lambda n: means[n]), max(sds, key=lambda n: abs(np.log(sds[n])))
        agree = means[far] < MEANS and abs(sds[wide] - 1.0) < SDS
        sentences.append(
            f"{engine_label(a)} and {engine_label(b)} {'agree' if agree else 'disagree'} on the same density: means "
            f"differ by at most {means[far]:.2f} standard deviations ({far}), standard deviations by "
            f"{abs(sds[wide] - 1.0):.0%} ({wide})" + ("." if agree else "; run longer before you use either.")
        )
    return sentences
