"""Sentences on the estimates of a run: bounds and intervals that disagree, with causes; priors, bounds and signs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np
import pandas as pd

from bayes_aero.flight.health import only_following
from bayes_aero.inference.results import (
    SENSITIVITY_LIMIT,
    ActiveBound,
    Identification,
    Inseparable,
    NextFlight,
    Posterior,
    PosteriorStatus,
    PriorConflict,
)
from bayes_aero.model.noise import Colour
from bayes_aero.model.observations import Forming
from bayes_aero.parameter import Parameter
from bayes_aero.report.tables import comparison
from bayes_aero.report.tables.run_tables import split_verdict
from bayes_aero.report.tables.table import Estimate
from bayes_aero.report.text.phrases import decimals, from_to, plus_minus, several, unit_behind
from bayes_aero.units import number

# What counts as a disagreement: our choice, wide enough not to report sampling error or chance.
FACTOR = 1.25  # ratio of two standard errors, either way, up to which they agree
LIMIT = 3.0  # standard errors of a difference from which two values differ


def verdict(identification: Identification) -> list[str]:
    """The findings of the run, one sentence or two each; missing parts of the run are omitted."""
    mle = identification.mle
    chains = posterior_sentences(identification.posteriors)
    estimates = {n: (v, sd) for n, v, sd in zip(mle.names, mle.estimate, mle.crb_corrected, strict=True)}
    signs = sign_sentences(estimates, mle.parameters, only_following(identification.health))
    if not (comparison.usable(mle) and np.all(np.isfinite([*mle.crb, *mle.crb_corrected]))):
        following = [*next_flight_sentences(identification), *split_verdict(identification)]
        return [*signs, *mle.warnings(), *chains, *following]
    signs += [*bound_sentences(mle.active_bounds), *conflict_sentences(mle.conflicts)]
    signs += inseparable_sentences(mle.inseparable)
    truth, colour = _truth(identification), _colour(identification)
    against = [*colour, *(_white(identification) if colour else [])]
    against += [*_noise_model(identification), *between_manoeuvres(identification, LIMIT)]
    sentences = against or _agreement(identification)
    sentences += [*left_out(identification), *next_flight_sentences(identification), *chains]
    return [*signs, *truth, *identification.preparation, *sentences, *split_verdict(identification), *mle.warnings()]


def _by_key(identification: Identification) -> dict[str, comparison.Method]:
    return {method.key: method for method in comparison.methods(identification)}


def _ratios(method: comparison.Method, base: comparison.Method) -> dict[str, float]:
    """Standard error of `method` over that of `base`, by parameter that both have."""
    return {n: e.sd / base.estimates[n].sd for n, e in method.estimates.items() if n in base.estimates}


def _spread(ratios: dict[str, float]) -> tuple[float, str, float]:
    """Their median, and name and value of the ratio furthest from 1, either way."""
    name, worst = max(ratios.items(), key=lambda item: abs(np.log(item[1])))
    return float(np.median(list(ratios.values()))), name, worst


def _plain(value: float) -> str:
    """Two digits, without an exponent."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"


def _colour(identification: Identification) -> list[str]:
    """Residuals that are not white, and the consequence for the Cramer-Rao bound."""
    mle, found = identification.mle, _by_key(identification)
    median, name, worst = _spread(_ratios(found["crb_corrected"], found["crb"]))
    chance = LIMIT / np.sqrt(identification.observations.n)
    if 1.0 / FACTOR < median < FACTOR and 0.5 < worst < 2.0:
        return []
    lags = ", ".join(f"{key} {value:+.2f}" for key, value in mle.lag1.items())
    reach = "(as for white noise: the correlation is at longer lags)"
    if any(abs(r) > chance for r in mle.lag1.values()):
        reach = f"(white noise stays within ±{chance:.2f})"
    size = "too small" if median > 1.0 else "not right"
    return [
        f"The residuals are not white: lag-1 correlation {lags} {reach}. The Cramér-Rao bound counts every sample as "
        f"new information and is {size}: the bound corrected for correlated residuals (colour) is {_plain(median)} "
        f"times as large in the median and {_plain(worst)} times for {name}."
    ]


def _white(identification: Identification) -> list[str]:
    """The posterior under white noise against the Cramer-Rao bound: the same assumption gives the same answer."""
    posterior = comparison.white_posterior(identification)
    if posterior is None:
        return []
    base = _by_key(identification)["crb"]
    ratios = {n: posterior.marginals[n].sd / e.sd for n, e in base.estimates.items() if n in posterior.marginals}
    median = float(np.median(np.abs(np.array(list(ratios.values())) - 1.0)))
    _, name, worst = _spread(ratios)
    text = (
        f"The posterior under white noise has the Cramér-Rao standard errors, within {median:.0%} in the median and "
        f"{worst - 1.0:+.0%} at worst ({name}): it makes the same assumption, so its agreement does not support the "
        "bound."
    )
    if not 1.0 / FACTOR < worst < FACTOR:
        text += f" For {name} the prior or the curvature matters, too."
    return [text]


def disputed(identification: Identification) -> dict[str, float]:
    """Parameters whose posterior and maximum likelihood differ by more than `LIMIT` combined errors, and how far."""
    engines = comparison.chosen_posteriors(identification)
    if not engines or comparison.white_posterior(identification) in engines.values():
        return {}
    found = _by_key(identification)
    corrected, posterior = found["crb_corrected"].estimates, found[next(iter(engines))].estimates
    start = found["crb"].estimates
    apart = {n: abs(e.centre - start[n].centre) / np.hypot(e.sd, corrected[n].sd) for n, e in posterior.items()}
    return {n: float(apart[n]) for n in comparison.ordered(apart, identification.mle.parameters) if apart[n] > LIMIT}


def _noise_model(identification: Identification) -> list[str]:
    """The chosen noise model's posterior against the corrected bound, and how far its mean moved."""
    engines = comparison.chosen_posteriors(identification)
    found = _by_key(identification)
    if not engines or comparison.white_posterior(identification) in engines.values():
        return []
    posterior, crb = found[next(iter(engines))].estimates, found["crb"].estimates
    median, name, worst = _spread(_ratios(found[next(iter(engines))], found["crb_corrected"]))
    in_crb = {n: abs(e.centre - crb[n].centre) / crb[n].sd for n, e in posterior.items()}
    beyond = disputed(identification)
    if not beyond and 1.0 / FACTOR < median < FACTOR and 0.5 < worst < 2.0:
        return []
    far = max(in_crb, key=lambda n: in_crb[n])
    middle = float(np.median(list(in_crb.values())))
    noise = comparison.noise_label(identification.noise)
    thinned = "" if identification.noise is Colour.WHITE else ", and a coloured one uses one sample in five"
    sentences = [
        f"The {noise} posterior's standard deviations are {median:.2g} times the corrected bounds in the median "
        f"({worst:.2g} times for {name}): another noise model weighs the data differently{thinned}. Its means are "
        f"{middle:.1f} Cramér-Rao standard errors from the maximum-likelihood estimates in the median, "
        f"{_plain(in_crb[far])} for {far}."
    ]
    if beyond:
        sentences.append(
            f"The difference exceeds the intervals of {several(f'{n} ({z:.1f})' for n, z in beyond.items())}, in "
            f"combined standard errors. {_why_apart(identification)} Neither interval covers this."
        )
    return sentences


def _why_apart(identification: Identification) -> str:
    """Why posterior and maximum likelihood differ, certain causes before possible ones."""
    conflicts = identification.mle.conflicts
    if conflicts:
        names = several(c.name for c in conflicts)
        return f"Maximum likelihood uses no prior; the posterior uses priors that contradict the record: {names}."
    smoothing = "only one side is smoothed (see above), " if identification.preparation else ""
    alike = (
        "; if the modelled and the measured side were filtered alike, both would give the same values. So "
        if identification.forming is Forming.PUBLISHED
        else ". Either "
    )
    return (
        "A likelihood with correlated noise weighs mostly changes from sample to sample, a white one weighs levels"
        f"{alike}{smoothing}the model's mean function is wrong, or the residuals' correlation is not of first order."
    )


def _agreement(identification: Identification) -> list[str]:
    """The sentence when all methods agree, with the numbers that show it."""
    found = comparison.methods(identification)
    crb, others = found[0], found[1:]
    spans = {m.label: _ratios(m, crb).values() for m in others}
    parts = [f"{label} {min(ratios):.2f} to {max(ratios):.2f} times" for label, ratios in spans.items()]
    sentence = f"The intervals agree. In units of the Cramér-Rao standard error they are: {several(parts)}."
    posteriors = [m for m in others if m.key != "crb_corrected"]
    if posteriors:
        pairs = [(e, crb.estimates[n]) for m in posteriors for n, e in m.estimates.items()]
        shift = max(abs(e.centre - base.centre) / base.sd for e, base in pairs)
        sentence += f" Posterior means are within {shift:.1f} Cramér-Rao standard errors of the estimates."
    return [sentence]


def _truth(identification: Identification) -> list[str]:
    """Of simulated records: how many true parameters the intervals of each method contain."""
    known, names = identification.truth or {}, comparison.flown(identification)
    if not names:
        return []
    held, far = [], {}
    for method in comparison.methods(identification):
        own = {n: method.estimates[n] for n in names if n in method.estimates}
        held.append(f"{sum(e.low <= known[n] <= e.high for n, e in own.items())} ({method.label})")
        if method.key == "crb_corrected":
            far = {n: (e.centre - known[n]) / e.sd for n, e in own.items()}
    name = max(far, key=lambda n: abs(far[n]))
    return [
        f"The records are simulated: of the {len(names)} true parameters, 95 % intervals contain "
        f"{several(held)}. Furthest from its true value is {name}, {far[name]:+.1f} corrected standard errors."
    ]


# --- Manoeuvres side by side: those that differ by more than their intervals, and the flight not yet flown.

LITTLE = 0.6  # share of its prior's deviation above which the scatter is called the prior's: our choice


def left_out(identification: Identification) -> list[str]:
    """Manoeuvres whose own fit cannot be compared, with the reason."""
    return [
        f"{name} alone: {fit.status.value}; it is left out of the comparison between manoeuvres."
        for name, fit in identification.alone.items()
        if not comparison.usable(fit)
    ]


def between_manoeuvres(identification: Identification, limit: float) -> list[str]:
    """Sentences on differences beyond `limit` standard errors; none if the intervals explain them."""
    names = comparison.ordered(identification.mle.names, identification.mle.parameters)
    compared = [n for n in names if len(comparison.alone(identification, n)) > 1]
    kinds = {"crb": "the Cramér-Rao bound", "crb_corrected": "the corrected bound"}
    for engine in list(comparison.chosen_posteriors(identification))[:1]:
        kinds[engine] = f"the {comparison.noise_label(identification.noise)} posterior's width"
    beyond, counts = {}, []
    for kind, label in kinds.items():
        far = {n: z for n in compared if (z := _largest(identification, n, kind)[0]) > limit}
        listed = several(f"{name} ({z:.1f})" for name, z in far.items()) or "none"
        if len(far) > 6:
            worst = max(far, key=lambda n: far[n])
            listed = f"{len(far)} of {len(compared)} parameters (up to {far[worst]:.0f}, {worst})"
        beyond[label] = far
        counts.append(f"{label}: {listed}")
    if not any(beyond.values()):
        return []
    sentences = [
        f"Fitted alone, manoeuvres differ by more than {limit:.0f} standard errors of the difference, by "
        + "; by ".join(counts)
        + "."
    ]
    wider = [set(found) for label, found in beyond.items() if label != "the Cramér-Rao bound"]
    unexplained = [n for n in compared if wider and any(n in found for found in wider)]
    always = [n for n in compared if wider and all(n in found for found in wider)]
    if unexplained:
        numbers = []
        for name in always or unexplained:
            (_, *pair), single = _largest(identification, name, "crb"), comparison.alone(identification, name)
            values = " and ".join(f"{single[m][0]:.{decimals(single[m][1])}f} from {m}" for m in pair)
            bound = max(single[m][1] for m in pair)
            numbers.append(f"{name} is {values}, with Cramér-Rao standard errors up to {bound:.2g}")
        sentences.append(
            f"No noise model alone explains this: {'; '.join(numbers)}. "
            "The model lacks an effect, the conditions of the manoeuvres differ in a way that it does not contain, or "
            "filters act differently on the measured and the modelled side. The intervals of the joint fit assume one "
            "value for all manoeuvres and cover none of these."
        )
    return sentences


def _largest(identification: Identification, name: str, kind: str) -> tuple[float, str, str]:
    """Largest difference of two manoeuvres in standard errors of the difference, and which two."""
    # manoeuvres were not sampled one by one: their Cramer-Rao deviations times the joint ratio of posterior to bound
    single = comparison.alone(identification, name)
    by_key = {m.key: m.estimates for m in comparison.methods(identification)}
    estimate = by_key[kind].get(name)
    widen = estimate.sd / by_key["crb"][name].sd if estimate else np.nan
    sd = {m: corrected if kind == "crb_corrected" else widen * crb for m, (_, crb, corrected) in single.items()}
    return max((comparison.apart(single[a][0], single[b][0], sd[a], sd[b]), a, b) for a, b in combinations(single, 2))


def next_flight_sentences(run: Identification) -> list[str]:
    """What the pooled manoeuvres say, and how little they can say; nothing where they were not pooled."""
    if run.next_flight is None:
        return []
    found, count = run.next_flight, len(run.next_flight.manoeuvres)
    low, high = found.at_best
    names = comparison.ordered(found.aircraft, found.parameters)
    little = [n for n in names if found.narrowed[n] > LITTLE]
    which = f"all {len(names)} parameters" if len(little) == len(names) else several(little)
    joint = comparison.bounds(run.mle, run.mle.crb_corrected)
    widest = "the joint fit has no intervals beside which to put its own"
    growth = {n: (m.ci95[1] - m.ci95[0]) / (joint[n].high - joint[n].low) for n, m in found.following.items()}
    finite = {n: g for n, g in growth.items() if g > 0.0 and g < float("inf")}
    if finite:  # by how much intervals grow from the joint fit to the next flight
        name = sorted(finite, key=lambda n: finite[n])[len(finite) // 2]
        both = [from_to(e.low, e.high, e.sd) for e in (Estimate.of(found.following[name]), joint[name])]
        widest = (
            f"intervals are {finite[name]:.1f} times as wide as those of the joint fit (median over parameters; "
            f"{name} {both[0]}, joint fit {both[1]})"
        )
    said = [
        f"The next flight: {widest}. Every manoeuvre enters by the normal approximation of its own fit.",
        f"{count} manoeuvres cannot tell the scatter between flights better than this: if each were known exactly, its "
        f"95 % interval would reach from {number(low, 2)} to {number(high, 2)} times the standard deviation of their "
        "estimates.",
    ]
    if little:
        said.append(
            f"The scatter of {which} is mostly its prior (above {LITTLE:.0%} of the prior's standard deviation is "
            "left); more manoeuvres would narrow the intervals of the next flight."
        )
    return [*said, *_doubts(found)]


def _doubts(found: NextFlight) -> Iterator[str]:
    """Parameters and manoeuvres that do not count, and a sampler that has not converged."""
    for n, manoeuvres in found.undetermined.items():
        others = len(found.manoeuvres) - len(manoeuvres)
        rests = f"its value rests on the other {others}" if others > 1 else "its scatter is the prior's"
        yield f"{several(manoeuvres)} do{'es' if len(manoeuvres) == 1 else ''} not determine {n}; {rests}."
    for m, reason in found.left_out.items():
        yield f"{m} is left out of the next flight: {reason}."
    if found.status is not PosteriorStatus.CONVERGED:
        yield f"Scatter between manoeuvres, NUTS: {found.status.value}."


# --- Contradicted priors, estimates at their bounds or impossible, and inseparable parameters.

MIN_ERRORS = 3.0  # standard errors from zero from which a sign is wrong


def conflict_sentences(conflicts: Sequence[PriorConflict]) -> list[str]:
    """A sentence for each prior that the record contradicts."""
    return [
        f"The card's prior on {c.name}, {plus_minus(*c.prior)}{unit_behind(c.unit)} ({c.source}), contradicts "
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
        bound = f"{'lower' if b.lower else 'upper'} bound, {number(b.bound, 4)}{unit_behind(b.unit)}"
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
            f"{name} {plus_minus(x, sd)}{unit_behind(unit)}"
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


def _beyond(limit: float, value: float, deviation: float, side: float) -> bool:
    """Whether a value is beyond the limit on that side, significantly or by more than twice the limit."""
    margin = MIN_ERRORS * deviation if math.isfinite(deviation) else 0.0
    return bool(side * (value - limit) > (min(margin, 2.0 * abs(limit)) if limit else margin))


# --- Whether the chains of samplers may be used, and whether samplers of one density agree.

MEANS = 0.2  # difference of means, in standard deviations, up to which samplers agree; our choice
SDS = 0.15  # relative difference of standard deviations up to which samplers agree; our choice


def unfinished(posteriors: Mapping[str, Posterior]) -> list[str]:
    """Posteriors that must not be used."""
    labels = {key: comparison.engine_label(key) for key in posteriors} | {"white": "emcee under white noise"}
    doubtful = {labels[key]: p.status for key, p in posteriors.items() if p.status is not PosteriorStatus.CONVERGED}
    return [f"The posterior by {label}: {status.value}." for label, status in doubtful.items()]


def posterior_sentences(posteriors: Mapping[str, Posterior]) -> list[str]:
    """Chains that did not converge, and whether the samplers of one density agree."""
    return [*unfinished(posteriors), *agreement_of_engines({k: p for k, p in posteriors.items() if k != "white"})]


def agreement_of_engines(posteriors: Mapping[str, Posterior]) -> list[str]:
    """Whether engines that sampled the same density give the same posterior."""
    sentences = []
    for (a, one), (b, two) in combinations(posteriors.items(), 2):
        pairs = {n: (one.marginals[n], two.marginals[n]) for n in one.names if n in two.marginals}
        means = {n: abs(p.mean - q.mean) / np.sqrt((p.sd**2 + q.sd**2) / 2.0) for n, (p, q) in pairs.items()}
        sds = {n: p.sd / q.sd for n, (p, q) in pairs.items()}
        far, wide = max(means, key=lambda n: means[n]), max(sds, key=lambda n: abs(np.log(sds[n])))
        pair = f"{comparison.engine_label(a)} and {comparison.engine_label(b)}"
        agree = means[far] < MEANS and abs(sds[wide] - 1.0) < SDS
        sentences.append(
            f"{pair} {'agree' if agree else 'disagree'} on the same density: means "
            f"differ by at most {means[far]:.2f} standard deviations ({far}), standard deviations by "
            f"{abs(sds[wide] - 1.0):.0%} ({wide})" + ("." if agree else "; run longer before you use either.")
        )
    return sentences
