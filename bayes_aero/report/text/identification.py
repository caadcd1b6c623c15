"""Sentences on the disagreement of Cramer-Rao bounds, corrected bounds and credible intervals, with its causes."""

from __future__ import annotations

import numpy as np

from bayes_aero.flight.health.finding import only_following
from bayes_aero.inference.identification import Identification
from bayes_aero.model.noise import Colour
from bayes_aero.model.observations import Forming
from bayes_aero.report.pooled import between_manoeuvres, left_out, next_flight_sentences
from bayes_aero.report.tables.comparison import (
    Method,
    chosen_posteriors,
    flown,
    methods,
    noise_label,
    ordered,
    usable,
    white_posterior,
)
from bayes_aero.report.tables.run_tables import split_verdict
from bayes_aero.report.text.phrases import several
from bayes_aero.report.text.restraints import (
    agreement_of_engines,
    bound_sentences,
    conflict_sentences,
    inseparable_sentences,
    sign_sentences,
    unfinished,
)

# What counts as a disagreement: our choice, wide enough not to report sampling error or chance.
FACTOR = 1.25  # ratio of two standard errors, either way, up to which they agree
LIMIT = 3.0  # standard errors of a difference from which two values differ


def verdict(identification: Identification) -> list[str]:
    """The findings of the run, one sentence or two each; missing parts of the run are omitted."""
    mle = identification.mle
    chains = [*unfinished(identification.posteriors), *agreement_of_engines(chosen_posteriors(identification))]
    estimates = {n: (v, sd) for n, v, sd in zip(mle.names, mle.estimate, mle.crb_corrected, strict=True)}
    signs = sign_sentences(estimates, mle.parameters, only_following(identification.health))
    if not (usable(mle) and np.all(np.isfinite([*mle.crb, *mle.crb_corrected]))):
        return [
            *signs,
            *mle.warnings(),
            *chains,
            *next_flight_sentences(identification),
            *split_verdict(identification),
        ]
    signs += [*bound_sentences(mle.active_bounds), *conflict_sentences(mle.conflicts)]
    signs += inseparable_sentences(mle.inseparable)
    truth = _truth(identification)
    colour = _colour(identification)
    against = [*colour, *(_white(identification) if colour else [])]
    against += [*_noise_model(identification), *between_manoeuvres(identification, LIMIT)]
    sentences = against or _agreement(identification)
    sentences += [*left_out(identification), *next_flight_sentences(identification), *chains]
    return [*signs, *truth, *identification.preparation, *sentences, *split_verdict(identification), *mle.warnings()]


def _by_key(identification: Identification) -> dict[str, Method]:
    return {method.key: method for method in methods(identification)}


def _ratios(method: Method, base: Method) -> dict[str, float]:
    """Standard error of `method` over that of `base`, by parameter that both have."""
    return {n: e.sd / base.estimates[n].sd for n, e in method.estimates.items() if n in base.estimates}


def _worst(ratios: dict[str, float]) -> tuple[str, float]:
    """The ratio furthest from 1, either way."""
    return max(ratios.items(), key=lambda item: abs(np.log(item[1])))


def _plain(value: float) -> str:
    """Two digits, without an exponent."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"


def _range(ratios: dict[str, float]) -> str:
    return f"{min(ratios.values()):.2f} to {max(ratios.values()):.2f} times"


def _colour(identification: Identification) -> list[str]:
    """Residuals that are not white, and the consequence for the Cramer-Rao bound."""
    mle, found = identification.mle, _by_key(identification)
    ratios = _ratios(found["crb_corrected"], found["crb"])
    chance = LIMIT / np.sqrt(identification.observations.n)
    coloured = {name: r for name, r in mle.lag1.items() if abs(r) > chance}
    median, (name, worst) = float(np.median(list(ratios.values()))), _worst(ratios)
    if 1.0 / FACTOR < median < FACTOR and 0.5 < worst < 2.0:
        return []
    lags = ", ".join(f"{key} {value:+.2f}" for key, value in mle.lag1.items())
    reach = (
        f"(white noise stays within ±{chance:.2f})"
        if coloured
        else "(as for white noise: the correlation is at longer lags)"
    )
    size = "too small" if median > 1.0 else "not right"
    return [
        f"The residuals are not white: lag-1 correlation {lags} {reach}. The Cramér-Rao bound counts every sample as "
        f"new information and is {size}: the bound corrected for correlated residuals (colour) is {_plain(median)} "
        "times as "
        f"large in the median and {_plain(worst)} times for {name}."
    ]


def _white(identification: Identification) -> list[str]:
    """The posterior under white noise against the Cramer-Rao bound: the same assumption gives the same answer."""
    posterior = white_posterior(identification)
    if posterior is None:
        return []
    base = _by_key(identification)["crb"]
    ratios = {n: posterior.marginals[n].sd / e.sd for n, e in base.estimates.items() if n in posterior.marginals}
    median = float(np.median(np.abs(np.array(list(ratios.values())) - 1.0)))
    name, worst = _worst(ratios)
    text = (
        f"The posterior under white noise has the Cramér-Rao standard errors, within {median:.0%} in the median and "
        f"{worst - 1.0:+.0%} at worst ({name}): it makes the same assumption, so its agreement does not support the "
        "bound."
    )
    if not 1.0 / FACTOR < worst < FACTOR:
        text += f" For {name} the prior or the curvature matters, too."
    return [text]


def disputed(identification: Identification) -> dict[str, float]:
    """Parameters whose posterior and maximum likelihood differ by more than `LIMIT` combined standard errors, and the
    difference in these: neither interval is reliable."""
    engines = chosen_posteriors(identification)
    if not engines or white_posterior(identification) in engines.values():
        return {}
    found = _by_key(identification)
    corrected, posterior = found["crb_corrected"].estimates, found[next(iter(engines))].estimates
    start = found["crb"].estimates
    apart = {n: abs(e.centre - start[n].centre) / np.hypot(e.sd, corrected[n].sd) for n, e in posterior.items()}
    return {n: float(apart[n]) for n in ordered(apart, identification.mle.parameters) if apart[n] > LIMIT}


def _noise_model(identification: Identification) -> list[str]:
    """The chosen noise model's posterior against the corrected bound, and how far its mean moved."""
    engines = chosen_posteriors(identification)
    found = _by_key(identification)
    if not engines or white_posterior(identification) in engines.values():
        return []
    engine = next(iter(engines))
    corrected, posterior, crb = found["crb_corrected"], found[engine], found["crb"]
    ratios = _ratios(posterior, corrected)
    median, (name, worst) = float(np.median(list(ratios.values()))), _worst(ratios)
    moved = {n: abs(e.centre - crb.estimates[n].centre) for n, e in posterior.estimates.items()}
    in_crb = {n: d / crb.estimates[n].sd for n, d in moved.items()}
    beyond = disputed(identification)
    if not beyond and 1.0 / FACTOR < median < FACTOR and 0.5 < worst < 2.0:
        return []
    far = max(in_crb, key=lambda n: in_crb[n])
    middle = float(np.median(list(in_crb.values())))
    thinned = "" if identification.noise is Colour.WHITE else ", and a coloured one uses one sample in five"
    sentences = [
        f"The {noise_label(identification.noise)} posterior's standard deviations are {median:.2g} times the "
        f"corrected bounds "
        f"in the median ({worst:.2g} times for {name}): another noise model weighs the data differently{thinned}. "
        f"Its means are {middle:.1f} Cramér-Rao standard errors from the maximum-likelihood estimates in the median, "
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
    found = methods(identification)
    crb, others = found[0], found[1:]
    parts = [f"{m.label} {_range(_ratios(m, crb))}" for m in others]
    sentence = f"The intervals agree. In units of the Cramér-Rao standard error they are: {several(parts)}."
    posteriors = [m for m in others if m.key != "crb_corrected"]
    if posteriors:
        base = crb.estimates
        shift = max(abs(e.centre - base[n].centre) / base[n].sd for m in posteriors for n, e in m.estimates.items())
        sentence += f" Posterior means are within {shift:.1f} Cramér-Rao standard errors of the estimates."
    return [sentence]


def _truth(identification: Identification) -> list[str]:
    """Of simulated records: how many true parameters the intervals of each method contain."""
    known, names = identification.truth or {}, flown(identification)
    if not names:
        return []
    held, far = [], {}
    for method in methods(identification):
        own = {n: method.estimates[n] for n in names if n in method.estimates}
        held.append(f"{sum(e.low <= known[n] <= e.high for n, e in own.items())} ({method.label})")
        if method.key == "crb_corrected":
            far = {n: (e.centre - known[n]) / e.sd for n, e in own.items()}
    name = max(far, key=lambda n: abs(far[n]))
    return [
        f"The records are simulated: of the {len(names)} true parameters, 95 % intervals contain "
        f"{several(held)}. Furthest from its true value is {name}, {far[name]:+.1f} corrected standard errors."
    ]
