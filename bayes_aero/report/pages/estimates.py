"""Estimates by every method of a run, in one order for tables, figures and sentences; where they disagree, and why."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bayes_aero.flight.health import only_following
from bayes_aero.report.phrases import decimals, plus_minus, sentence, several, unit_behind
from bayes_aero.report.table import Column, Estimate
from bayes_aero.units import number

if TYPE_CHECKING:
    import pandas as pd

    from bayes_aero.diagnosis.result import CausesInBand
    from bayes_aero.inference.results import (
        ActiveBound,
        FrequencyFit,
        Identification,
        Inseparable,
        MleResult,
        Posterior,
        PriorConflict,
    )
    from bayes_aero.parameter import Parameter

LABELS = {"nuts": "NUTS", "ar1": "AR(1)", "buffet-ar1": "AR(1) with buffet"}
# What counts as a disagreement: our choice, wide enough not to report sampling error or chance.
FACTOR = 1.25  # ratio of two standard errors, either way, up to which they agree
LIMIT = 3.0  # standard errors of a difference from which two values differ


class Method(NamedTuple):
    """One method of interval estimation: `key` for colours and columns, `label` for readers, estimates by parameter."""

    key: str
    label: str
    estimates: dict[str, Estimate]

    def of(self, names: Iterable[str]) -> list[Estimate | None]:
        """Estimates of the parameters `names`, None where it has none."""
        return [self.estimates.get(name) for name in names]

    def over(self, base: Method) -> dict[str, float]:
        """Its standard error over that of `base`, by parameter that both have."""
        sd = {name: estimate.sd for name, estimate in base.estimates.items() if estimate.sd > 0.0}
        return {name: e.sd / sd[name] for name, e in self.estimates.items() if name in sd}


def ordered(names: Iterable[str], parameters: Iterable[Parameter]) -> list[str]:
    """Names in the order that their parameters declare; names without an order last."""
    places = {p.name: p.place for p in parameters if p.place is not None}
    return sorted(names, key=lambda name: places.get(name, math.inf))


def flown(run: Identification) -> list[str]:
    """Fitted parameters with a known true value (simulated records)."""
    return [name for name in ordered(run.mle.names, run.mle.parameters) if name in (run.truth or {})]


def unit_of(run: Identification, name: str) -> str:
    """The unit of a parameter of the model or of its noise."""
    return run.mle.units[run.mle.names.index(name)] if name in run.mle.names else "1"


def chosen_posteriors(run: Identification) -> dict[str, Posterior]:
    """Posteriors under the chosen noise model, by engine."""
    return {key: p for key, p in run.posteriors.items() if key != "white"}


def white_posterior(run: Identification) -> Posterior | None:
    """The posterior under white noise, which is also the chosen one where white noise was chosen."""
    if "white" in run.posteriors or run.noise != "white":
        return run.posteriors.get("white")
    return next(iter(chosen_posteriors(run).values()), None)


def label_of(key: str) -> str:
    return LABELS.get(key, key)


def methods(run: Identification) -> list[Method]:
    """Bounds, then posteriors, each with the estimates it has of the model's parameters."""
    mle = run.mle
    every = [
        Method("crb", "ML, Cramér-Rao bound", bounds(mle, mle.crb)),
        Method("crb_corrected", "ML, corrected bound", bounds(mle, mle.crb_corrected)),
    ]
    for key in sorted(run.posteriors, key=lambda key: key != "white"):
        label = "emcee, white noise" if key == "white" else f"{label_of(key)}, {label_of(run.noise)} noise"
        marginals = run.posteriors[key].marginals.items()
        every.append(Method(key, label, {n: Estimate.of(m) for n, m in marginals if n in mle.names}))
    return every


def bounds(mle: MleResult | FrequencyFit, sd: np.ndarray) -> dict[str, Estimate]:
    """Estimates of a fit with the standard deviations `sd`."""
    return {n: Estimate.normal(x, s) for n, x, s in zip(mle.names, mle.estimate, sd, strict=True)}


def usable(mle: MleResult) -> bool:
    return mle.status.name in ("CONVERGED", "AT_BOUND")


def alone(run: Identification, name: str) -> dict[str, tuple[float, float, float]]:
    """Estimate, Cramer-Rao bound and corrected bound of `name` by manoeuvre, from usable fits inside their bounds."""
    single = {}
    for manoeuvre, mle in run.alone.items():
        if usable(mle) and name in mle.names and name not in mle.at_bound:
            i = mle.names.index(name)
            single[manoeuvre] = tuple(float(x[i]) for x in (mle.estimate, mle.crb, mle.crb_corrected))
    return {manoeuvre: numbers for manoeuvre, numbers in single.items() if np.all(np.isfinite(numbers))}


def scatter(run: Identification, name: str) -> tuple[float, float] | None:
    """Of a parameter between manoeuvres fitted alone: sd, and the largest difference in its Cramer-Rao errors."""
    single = [numbers[0] for numbers in alone(run, name).values()]
    return (float(np.std(single, ddof=1)), _largest(run, name, 1)[0]) if len(single) > 1 else None


def verdict(run: Identification) -> list[str]:
    """The findings of the run, one sentence or two each; missing parts of the run are omitted."""
    mle, chains = run.mle, posterior_sentences(run.posteriors)
    cautions = [sentence("caution", text=text) for text in mle.warnings()]
    estimates = {n: (v, sd) for n, v, sd in zip(mle.names, mle.estimate, mle.crb_corrected, strict=True)}
    signs = sign_sentences(estimates, mle.parameters, only_following(run.health))
    if not (usable(mle) and np.all(np.isfinite([*mle.crb, *mle.crb_corrected]))):
        return [*signs, *cautions, *chains, *next_flight_sentences(run), *split_verdict(run)]
    signs += [*bound_sentences(mle.active_bounds), *conflict_sentences(mle.conflicts)]
    signs += inseparable_sentences(mle.inseparable)
    against = [*_colour(run), *_noise_model(run), *between_manoeuvres(run)]
    left = {name: fit.status.value for name, fit in run.alone.items() if not usable(fit)}
    sentences = against or _agreement(run)
    sentences += [sentence("alone_left_out", name=name, status=status) for name, status in left.items()]
    sentences += [*next_flight_sentences(run), *chains]
    return [*signs, *_truth(run), *run.preparation, *sentences, *split_verdict(run), *cautions]


def _by_key(run: Identification) -> dict[str, Method]:
    return {method.key: method for method in methods(run)}


def _spread(ratios: dict[str, float]) -> tuple[float, str, float, bool]:
    """Their median, name and value of the ratio furthest from 1, either way, and whether all are near 1."""
    name, worst = max(ratios.items(), key=lambda item: abs(np.log(item[1])))
    median = float(np.median(list(ratios.values())))
    return median, name, worst, bool(1.0 / FACTOR < median < FACTOR and 0.5 < worst < 2.0)


def _plain(value: float) -> str:
    """Two digits, without an exponent."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"


def _colour(run: Identification) -> list[str]:
    """Residuals that are not white, the consequence for the bound, and that white posteriors only repeat the bound."""
    mle, by = run.mle, _by_key(run)
    median, name, worst, near = _spread(by["crb_corrected"].over(by["crb"]))
    if near:
        return []
    chance = LIMIT / np.sqrt(run.observations.n)
    lags = ", ".join(f"{key} {value:+.2f}" for key, value in mle.lag1.items())
    reach = "(as for white noise: the correlation is at longer lags)"
    if any(abs(r) > chance for r in mle.lag1.values()):
        reach = f"(white noise stays within ±{chance:.2f})"
    sizes = {"median": _plain(median), "worst": _plain(worst), "size": "too small" if median > 1.0 else "not right"}
    sentences = [sentence("not_white", lags=lags, reach=reach, name=name, **sizes)]
    sentences += [sentence("white_posterior")] if white_posterior(run) is not None else []
    return sentences


def disputed(run: Identification) -> dict[str, float]:
    """Parameters whose posterior and maximum likelihood differ by more than `LIMIT` combined errors, and how far."""
    engines, by = chosen_posteriors(run), _by_key(run)
    if not engines or white_posterior(run) in engines.values():
        return {}
    corrected, posterior = by["crb_corrected"].estimates, by[next(iter(engines))].estimates
    apart = {n: abs(e.centre - corrected[n].centre) / np.hypot(e.sd, corrected[n].sd) for n, e in posterior.items()}
    return {n: float(apart[n]) for n in ordered(apart, run.mle.parameters) if apart[n] > LIMIT}


def _noise_model(run: Identification) -> list[str]:
    engines, by, beyond = chosen_posteriors(run), _by_key(run), disputed(run)
    if not engines or white_posterior(run) in engines.values():
        return []
    median, name, worst, near = _spread(by[next(iter(engines))].over(by["crb_corrected"]))
    if near and not beyond:
        return []
    thinned = "" if run.noise == "white" else ", and a coloured one uses one sample in five"
    sizes = {"median": median, "worst": worst, "name": name, "noise": label_of(run.noise)}
    sentences = [sentence("noise_model", thinned=thinned, **sizes)]
    if beyond:  # certain causes before possible ones
        why = sentence("why_priors", names=[c.name for c in run.mle.conflicts])
        if not run.mle.conflicts:
            smoothing = "only one side is smoothed (see above), " if run.preparation else ""
            why = sentence("why_noise", smoothing=smoothing)
        sentences.append(sentence("beyond_intervals", names=[f"{n} ({z:.1f})" for n, z in beyond.items()], why=why))
    return sentences


def _agreement(run: Identification) -> list[str]:
    crb, *others = methods(run)
    spans = {m.label: m.over(crb).values() for m in others}
    parts = [f"{label} {min(ratios):.2f} to {max(ratios):.2f} times" for label, ratios in spans.items()]
    posteriors = [m for m in others if m.key != "crb_corrected"]
    pairs = [(e, crb.estimates[n]) for m in posteriors for n, e in m.estimates.items()]
    shift = max((abs(e.centre - base.centre) / base.sd for e, base in pairs), default=0.0)
    means = f" Posterior means are within {shift:.1f} Cramér-Rao standard errors of the estimates." if pairs else ""
    return [sentence("intervals_agree", parts=parts, means=means)]


def _truth(run: Identification) -> list[str]:
    true, names, held = run.truth or {}, flown(run), []
    if not names:
        return []
    for method in methods(run):
        intervals = {n: method.estimates[n] for n in names if n in method.estimates}
        held.append(f"{sum(e.low <= true[n] <= e.high for n, e in intervals.items())} ({method.label})")
    far = {n: (e.centre - true[n]) / e.sd for n, e in _by_key(run)["crb_corrected"].estimates.items() if n in names}
    name = max(far, key=lambda n: abs(far[n]))
    return [sentence("true_parameters", n=len(names), held=held, name=name, far=far[name])]


# --- Manoeuvres side by side: those that differ by more than their intervals, and the flight not yet flown.

LITTLE = 0.6  # share of its prior's deviation above which the scatter is called the prior's: our choice
MOST = 6  # parameters that are named one by one
LEAK = 0.02  # a correlation that falls by more from the random split to another one was leaked; our choice
NOTABLE = 0.001  # a difference of correlations not worth a sentence below; our choice
SPLITS = {"random": "the random split", "block": "hold-out blocks", "manoeuvre": "a hold-out manoeuvre"}


def between_manoeuvres(run: Identification) -> list[str]:
    """Sentences on differences beyond `LIMIT` standard errors; none if the intervals explain them."""
    compared = [n for n in ordered(run.mle.names, run.mle.parameters) if len(alone(run, n)) > 1]
    beyond, counts = [], []
    for kind, label in ((1, "the Cramér-Rao bound"), (2, "the corrected bound")):
        far = {n: z for n in compared if (z := _largest(run, n, kind)[0]) > LIMIT}
        listed = several((f"{name} ({z:.1f})" for name, z in far.items()), MOST) or "none"
        beyond.append(list(far))
        counts.append(f"{label}: {listed}")
    if not any(beyond):
        return []
    sentences, numbers = [sentence("alone_differ", limit=LIMIT, counts="; by ".join(counts))], []
    for name in beyond[1]:
        (_, *pair), single = _largest(run, name, 1), alone(run, name)
        values = " and ".join(f"{single[m][0]:.{decimals(single[m][1])}f} from {m}" for m in pair)
        bound = max(single[m][1] for m in pair)
        numbers.append(f"{name} is {values}, with Cramér-Rao standard errors up to {bound:.2g}")
    return sentences + ([sentence("no_noise_model", numbers="; ".join(numbers))] if numbers else [])


def _largest(run: Identification, name: str, kind: int) -> tuple[float, str, str]:
    """Largest difference of two manoeuvres, in Cramer-Rao (1) or corrected (2) errors of the difference."""
    pairs = combinations(alone(run, name).items(), 2)
    return max((abs(x[0] - y[0]) / math.hypot(x[kind], y[kind]), a, b) for (a, x), (b, y) in pairs)


def next_flight_sentences(run: Identification) -> list[str]:
    """What the pooled manoeuvres say, and how little they can say; nothing where they were not pooled."""
    pooled = run.next_flight
    if pooled is None:
        return []
    count, (low, high) = len(pooled.manoeuvres), pooled.at_best
    names, joint = ordered(pooled.aircraft, pooled.parameters), bounds(run.mle, run.mle.crb_corrected)
    pairs = [(m.ci95[1] - m.ci95[0], joint[n].high - joint[n].low) for n, m in pooled.following.items()]
    growth = [following / fit for following, fit in pairs if 0.0 < fit < math.inf]  # a singular fit has no intervals
    sentences = [sentence("next_flight", times=float(np.median(growth)))] if growth else []
    sentences.append(sentence("scatter_limit", count=count, low=number(low, 2), high=number(high, 2)))
    if little := [n for n in names if pooled.narrowed[n] > LITTLE]:
        which = f"all {len(names)} parameters" if len(little) == len(names) else several(little)
        sentences.append(sentence("scatter_prior", which=which, limit=LITTLE))
    for name, manoeuvres in pooled.undetermined.items():
        others = count - len(manoeuvres)
        rests = f"its value rests on the other {others}" if others > 1 else "its scatter is the prior's"
        sentences.append(sentence("undetermined_by", manoeuvres=manoeuvres, name=name, rests=rests))
    sentences += [f"{m} is left out of the next flight: {reason}." for m, reason in pooled.left_out.items()]
    ended = [] if pooled.status.name == "CONVERGED" else [pooled.status.value]
    doubt = [sentence("ended", what="Scatter between manoeuvres, NUTS", status=status) for status in ended]
    return sentences + doubt


def split_verdict(run: Identification) -> list[str]:
    """Correlations by split, the leak of the random one, and hyperparameters that could not be sampled."""
    report = run.gp
    if report is None:
        return []
    first = report.splits[report.chosen][0]
    unsampled = {n: first[n].status.rstrip(".") for n, fit in report.fits.items() if fit.posterior is None}
    kind = "No sampled hyperparameters of the Gaussian process of {}"
    sentences = [sentence("ended", what=kind.format(name), status=why) for name, why in unsampled.items()]
    splits = [split for split in SPLITS if split in report.splits]
    if splits[0] != "random" or len(splits) < 2:
        return sentences
    by_gp_and_mle = "gp_scores", "mle_scores"
    pooled = {s: {n: report.pooled(s, n) for n in report.splits["random"][0]} for s in splits}
    r, mle = ({s: {n: getattr(v, by).r for n, v in of.items()} for s, of in pooled.items()} for by in by_gp_and_mle)
    drops = {n: x - min(r[s][n] for s in splits[1:]) for n, x in r["random"].items()}
    lost = [f"{n} -{drop:.2f}" for n, drop in drops.items() if drop > LEAK]
    away = 1000.0 * run.observations.dt
    leak = sentence("leak", away=away, lost=lost) if lost else "The random split does not leak significantly."
    numbers = [f"{n} {' / '.join(f'{r[s][n]:.3f}' for s in splits)}" for n in drops]
    order = " / ".join(SPLITS[s] for s in splits)
    sentences.append(sentence("gp_correlation", order=order, numbers=numbers, leak=leak))
    for split in ("random", splits[-1]):  # coefficients that the Gaussian process predicts worse than the stall model
        worse = {n: x for n, x in r[split].items() if x < mle[split][n] - NOTABLE}
        behind = [f"{n} ({mle[split][n]:.3f} against {x:.3f})" for n, x in worse.items()]
        sentences += [sentence("gp_behind", split=SPLITS[split], names=behind)] if behind else []
    return sentences


# --- Contradicted priors, estimates at their bounds or impossible, and inseparable parameters.

MIN_ERRORS = 3.0  # standard errors from zero from which a sign is wrong
MEANS = 0.2  # difference of means, in standard deviations, up to which samplers agree; our choice
SDS = 0.15  # relative difference of standard deviations up to which samplers agree; our choice


def conflict_sentences(conflicts: Sequence[PriorConflict]) -> list[str]:
    return [sentence("prior_conflict", c=c, unit=unit_behind(c.unit)) for c in conflicts]


def leaning_sentences(table: pd.DataFrame, conflicts: Sequence[PriorConflict]) -> tuple[str, ...]:
    """How far the posterior depends on contradicted priors, and which others do, by `prior_sensitivity`'s table."""
    names = [c.name for c in conflicts if c.name in table.index]
    if not names:
        return ()
    sizes = [f"{n} {table['prior'][n]:.2f} to the prior, {table['likelihood'][n]:.2f} to the data" for n in names]
    others = [str(n) for n in table.index[table["leans"].to_numpy(bool)] if n not in names]
    more = f" Priors also move {several(others)}." if others else ""
    return (sentence("sensitivity", sizes=sizes, more=more),)


def bound_sentences(bound: Sequence[ActiveBound]) -> list[str]:
    sentences = []
    for b in bound:
        shifts = several(f"{n} ({-x:+.1f} corrected standard errors)" for n, x in b.shifts.items())
        moves = f"; the bound moves {shifts}" if shifts else ""
        numbers = {"bound": number(b.bound, 4), "free": number(b.unbounded, 4), "unit": unit_behind(b.unit)}
        sentences.append(sentence("at_bound", b=b, side="lower" if b.lower else "upper", moves=moves, **numbers))
    return sentences


def inseparable_sentences(sets: Sequence[Inseparable]) -> list[str]:
    sentences = []
    for alike in sets:
        three = zip(alike.names, alike.units, alike.estimates, strict=True)
        listed = [f"{name} {plus_minus(x, sd)}{unit_behind(unit)}" for name, unit, (x, sd) in three]
        low, high = (_plain(x) for x in (min(alike.wider), max(alike.wider)))
        times = low if low == high else f"{low} to {high}"
        sentences.append(sentence("inseparable", names=alike.names, listed=listed, times=times))
    return sentences


def sign_sentences(
    estimates: Mapping[str, tuple[float, float]], parameters: Iterable[Parameter], following: Sequence[str] = ()
) -> list[str]:
    """A sentence for every estimate (value and standard error, SI) that is impossible for an aircraft."""
    wrong, impossible = [], []
    for p, value, sd in [(p, *estimates[p.name]) for p in parameters if p.name in estimates]:
        if p.sign is not None and not following and p.sign.side * value < -MIN_ERRORS * sd:
            wrong.append(sentence("wrong_sign", p=p, value=value))
        if p.limits is not None and (_beyond(p.limits.low, value, sd, -1.0) or _beyond(p.limits.high, value, sd, 1.0)):
            impossible.append(sentence("impossible", p=p, value=value))
    return wrong + impossible


def _beyond(limit: float, value: float, deviation: float, side: float) -> bool:
    """Whether a value is beyond the limit on that side, significantly or by more than twice the limit."""
    margin = MIN_ERRORS * deviation if math.isfinite(deviation) else 0.0
    return bool(side * (value - limit) > (min(margin, 2.0 * abs(limit)) if limit else margin))


def unfinished(posteriors: Mapping[str, Posterior]) -> list[str]:
    """Posteriors that must not be used."""
    labels = {key: label_of(key) for key in posteriors} | {"white": "emcee under white noise"}
    doubtful = {labels[key]: p.status.value for key, p in posteriors.items() if p.status.name != "CONVERGED"}
    return [sentence("ended", what=f"The posterior by {x}", status=status) for x, status in doubtful.items()]


def posterior_sentences(posteriors: Mapping[str, Posterior]) -> list[str]:
    sentences = unfinished(posteriors)
    for (a, first), (b, second) in combinations([pair for pair in posteriors.items() if pair[0] != "white"], 2):
        pairs = {n: (first.marginals[n], second.marginals[n]) for n in first.names if n in second.marginals}
        means = {n: abs(p.mean - q.mean) / np.sqrt((p.sd**2 + q.sd**2) / 2.0) for n, (p, q) in pairs.items()}
        sds = {n: p.sd / q.sd for n, (p, q) in pairs.items()}
        far, wide = max(means, key=lambda n: means[n]), max(sds, key=lambda n: abs(np.log(sds[n])))
        agree = means[far] < MEANS and abs(sds[wide] - 1.0) < SDS
        sizes = {"means": means[far], "far": far, "sds": abs(sds[wide] - 1.0), "wide": wide}
        key, engines = "samplers" if agree else "samplers_disagree", [label_of(a), label_of(b)]
        sentences.append(sentence(key, engines=engines, **sizes))
    return sentences


def band_text(fit: FrequencyFit | CausesInBand) -> str:
    return f"{number(fit.band[0], 2)} to {number(fit.band[1], 2)} Hz"


def frequency_columns(names: Sequence[str], fit: FrequencyFit) -> list[Column]:
    """Estimates, both standard errors, and differences from the time domain."""
    key = f"frequency_{fit.method.replace(' ', '_')}"
    group = f"{fit.method}, {band_text(fit)}"
    crb, corrected = bounds(fit, fit.crb), bounds(fit, fit.crb_corrected)
    both, files = [corrected.get(n) for n in names], ("", f"{key}_crb_corrected")
    columns = [
        Column([crb.get(n) for n in names], (key, f"{key}_crb"), "Cramér–Rao", group=group),
        Column(both, files, "corrected", group=group),
    ]
    if fit.apart:
        apart = [fit.apart.get(name) for name in names]
        columns.append(Column(apart, f"{key}_difference", "difference\n(standard errors)", form=".1f", group=group))
    return columns


def frequency_sentences(fit: FrequencyFit) -> tuple[str, ...]:
    what = f"{fit.method.capitalize()} in the frequency domain, {band_text(fit)}, {fit.lines} frequencies"
    if not fit.converged:
        return (f"{what}: the parameters are not determined there; use a wider band.",)
    sentences = [sentence("drop_out", what=what, names=fit.unseen) if fit.unseen else f"{what}."]
    if fit.at_bound:
        sentences.append(f"In the band {several(fit.at_bound)} went to a bound and stayed there.")
    differ = [f"{name} ({number(x, 2)} standard errors)" for name, x in fit.apart.items() if x > LIMIT]
    if differ:
        sentences.append(sentence("domains_differ", names=differ))
    elif fit.apart:
        worst = max(fit.apart, key=lambda name: fit.apart[name])
        sentences.append(sentence("domains_agree", most=number(fit.apart[worst], 2), worst=worst))
    return tuple(sentences)
