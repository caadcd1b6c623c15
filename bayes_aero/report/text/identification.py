"""Sentences on the disagreement of Cramer-Rao bounds, corrected bounds and credible intervals, with its causes."""

from __future__ import annotations

import numpy as np

from bayes_aero.flight.health.finding import only_following
from bayes_aero.inference.results import Identification
from bayes_aero.model.noise import Colour
from bayes_aero.model.observations import Forming
from bayes_aero.report.pooled import between_manoeuvres, left_out, next_flight_sentences
from bayes_aero.report.tables import comparison
from bayes_aero.report.tables.run_tables import split_verdict
from bayes_aero.report.text import restraints
from bayes_aero.report.text.phrases import several

# What counts as a disagreement: our choice, wide enough not to report sampling error or chance.
FACTOR = 1.25  # ratio of two standard errors, either way, up to which they agree
LIMIT = 3.0  # standard errors of a difference from which two values differ


def verdict(identification: Identification) -> list[str]:
    """The findings of the run, one sentence or two each; missing parts of the run are omitted."""
    mle = identification.mle
    chains = [
        *restraints.unfinished(identification.posteriors),
        *restraints.agreement_of_engines(comparison.chosen_posteriors(identification)),
    ]
    estimates = {n: (v, sd) for n, v, sd in zip(mle.names, mle.estimate, mle.crb_corrected, strict=True)}
    signs = restraints.sign_sentences(estimates, mle.parameters, only_following(identification.health))
    if not (comparison.usable(mle) and np.all(np.isfinite([*mle.crb, *mle.crb_corrected]))):
        following = [*next_flight_sentences(identification), *split_verdict(identification)]
        return [*signs, *mle.warnings(), *chains, *following]
    signs += [*restraints.bound_sentences(mle.active_bounds), *restraints.conflict_sentences(mle.conflicts)]
    signs += restraints.inseparable_sentences(mle.inseparable)
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
