"""Simulated trajectories: what they say, their errors and time histories; what process noise changes in them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import TOLERANCES
from bayes_aero.report.page import Facts, Fold, fold
from bayes_aero.report.pages import parts
from bayes_aero.report.pages.estimates import label_of
from bayes_aero.report.phrases import (
    WORDS,
    amounts,
    axis_label,
    for_people,
    nats_text,
    plus_minus,
    sentence,
    several,
    short,
    size_text,
    symbol,
)
from bayes_aero.report.plots import MODELS, Panel, output_panels
from bayes_aero.report.table import BeforeAfter, Column, Estimate, Table, parameter_columns, table
from bayes_aero.units import number

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import Disagreement, ProcessNoise, SimulatedManoeuvre, Trajectories, TrajectoryFit
    from bayes_aero.flight.card import Card
    from bayes_aero.inference.results import OneStep, Posterior

MOST_OUTPUTS = 3  # whose errors are in the sentence on the gain
SI = {name: channel.unit for name, channel in STANDARD_CHANNELS.items()}
SPLITS = {
    "hold_out": "Hold-out: simulated from the measured initial state with the fit to the other flights",
    "fitted": "Fitted: parameters and initial states fitted to all flights",
}


def simulation_gain(flown: Trajectories) -> str:
    """RMS errors of both models over all hold-out flights, of the outputs that change most; empty if they are equal or
    a model leaves the envelope."""
    unseen, errors = [p for p in flown.paths if p.split == "hold_out"], {}
    for output in flown.outputs:
        rms = [[p.errors[output].rms for p in unseen if p.model == model] for model in MODELS]
        if not all(p.inside for p in unseen) or not all(rms) or not all(np.isfinite(of).all() for of in rms):
            return ""
        errors[output] = [float(np.sqrt(np.mean(np.square(of)))) for of in rms]
    most = sorted(errors, key=lambda n: min(errors[n]) / (max(errors[n]) or 1.0))[:MOST_OUTPUTS]
    both = {n: amounts(SI[n], *errors[n]) for n in errors if n in most}
    listed = [f"{symbol(n)} {x[0]} → {x[1]}{x[2]}" for n, x in both.items() if x[0] != x[1]]
    if not listed:
        return ""
    besides = [f"with {flown.lag.effect}"] if flown.lag is not None and flown.lag.kept else []
    besides += [f"without {several(flown.out)}"] if flown.out else []
    return sentence("simulation_gain", model=f" ({several(besides)})" if besides else "", listed=listed)


def trajectory_sentences(flown: Trajectories) -> list[str]:
    sentences = [*status_sentences(flown), *lag_sentences(flown), *cause_sentences(flown)]
    sentences += [sentence("held_alone", name=name, held=held) for name, held in flown.held.items() if held]
    if flown.extended.held:
        sentences.append(sentence("held_by_prior", names=flown.extended.held))
    unseen = [p for p in flown.paths if (p.model, p.split) == ("extended", "hold_out")]
    if lost := [p.manoeuvre for p in unseen if not p.inside]:
        sentences.append(sentence("leaves_envelope", names=lost))
    return sentences


def lag_sentences(flown: Trajectories) -> list[str]:
    """The lag test on trajectories, where the coefficients do not decide."""
    lag = flown.lag
    if lag is None:
        return []
    elpd, elpd_se = lag.unseen
    if not lag.kept:
        hold_out = f", hold-out {nats_text(elpd, elpd_se, '+')}" if math.isfinite(elpd) else ""
        gained = f"fit {lag.gain:+.1f} nats{hold_out}" if math.isfinite(lag.gain) else "its fit did not converge"
        why = "give a size that is too small to be named" if lag.slight else "do not support it"
        return [sentence("no_lag", effect=lag.effect, why=why, gained=gained)]
    after = flown.extended
    names = [p.name for p in CATALOGUE[lag.effect].parameters]
    sizes = [f"{n} {size_text(after.values[n], flown.deviation[n], after.units[n])}" for n in names]
    instead = f" in place of {several(lag.instead)}" if lag.instead else ""
    return [sentence("lag", lag=lag, instead=instead, sizes=sizes, unseen=nats_text(elpd, elpd_se))]


def cause_sentences(flown: Trajectories) -> list[str]:
    missed, kept, harmed, sentences = flown.asked.missed, flown.asked.kept, flown.asked.harmed, []
    for e, worse in harmed.items():
        gains = [f"{output} by {nats_text(-gain, se)}" for output, (gain, se) in worse.items()]
        sentences.append(sentence("cause_harms", name=e, gains=gains))
    if idle := [f"{e} (by {nats_text(*missed[e], '+')})" for e in flown.out if e not in harmed]:
        sentences.append(sentence("causes_idle", gains=idle))
    if kept:
        finite = [e for e in kept if math.isfinite(missed[e][0])]  # without the others the flight leaves its envelope
        least = min(finite, key=lambda e: missed[e][0] / missed[e][1], default=None)
        least_of = f"least for {least}, " if len(kept) > 1 else ""
        by = f" ({least_of}by {nats_text(*missed[least])})" if least else ""
        sentences.append(sentence("causes_needed", names=kept, by=by))
    return sentences


def status_sentences(flown: Trajectories) -> list[str]:
    sentences = []
    for who, fit in (("The card's model", flown.card), ("The extended model", flown.extended)):
        if fit.status.name != "CONVERGED":
            names = f" ({several(fit.at_bound)})" if fit.at_bound else ""
            stopped = "stopped before the optimum, so its errors may be too large"
            how = stopped if fit.status.name == "NOT_CONVERGED" else fit.status.value
            sentences.append(sentence("ended", what=f"{who}, fitted to the trajectories", status=f"{how}{names}"))
    return sentences


def error_table(
    key: str,
    flights: Mapping[str, Sequence[SimulatedManoeuvre | None]],
    units: Mapping[str, str],
    heads: tuple[str, ...],
    fitted: Sequence[str] | None = None,
    **texts: str,
) -> Table:
    """A row for each output of each flight: errors of its paths, as `heads` name them; Theil's parts of the last."""
    each, rows = len(heads) > 1, []
    for flight, paths in flights.items():
        for n in next(path for path in paths if path is not None).errors:
            star = "" if fitted is None or n in fitted else " *"
            errors = [None if path is None else path.errors[n] for path in paths]
            rows.append((flight, f"{axis_label(n, units[n])}{star}", errors, for_people(units[n])[1]))
    rms = [[e and f * e.rms for e in errors] for *_, errors, f in rows]
    within = [[e and e.within for e in errors] for *_, errors, _ in rows]
    last, page = [errors[-1] for *_, errors, _ in rows], heads if each else heads[0]
    shares = "shares of the squared error"
    largest = [e and f * e.largest for e, (*_, f) in zip(last, rows, strict=True)]
    columns = [
        Column([label for _, label, *_ in rows], "", "output"),
        Column([BeforeAfter(*x) if each else x[0] for x in rms], "", page, form=short, group="RMS"),
        Column(largest, "", heads[-1], form=short, group="largest"),
        Column([e and e.theil.theil for e in last], "", heads[-1], form=".3f", group="Theil U"),
    ]
    for part in ("bias", "variance", "covariance"):
        columns.append(Column([e and getattr(e.theil, part) for e in last], "", part, form=".0%", group=shares))
    if any(x is not None for inside in within for x in inside):
        bands = [e and e.tolerance and f"± {number(f * e.tolerance)}" for e, (*_, f) in zip(last, rows, strict=True)]
        columns.append(Column(bands, page="tolerance"))
        inside = [BeforeAfter(*x) if each else x[0] for x in within]
        columns.append(Column(inside, "", page, form=".0%", group="time inside"))
    chances = [e and e.probability for e in last]
    if any(chance is not None for chance in chances):
        columns.append(Column(chances, page="whole flight", form=".0%", group="time inside"))
    return table(key, columns, below=[flight for flight, *_ in rows], **texts)


def hold_out_table(flown: Trajectories) -> Table:
    """Errors of both models, fitted jointly and on hold-out flights."""
    flights = {}
    for split, m in dict.fromkeys((p.split, p.manoeuvre) for p in sorted(flown.paths, key=lambda p: p.split)):
        flights[f"{m}, {split.replace('_', '-')}"] = [flown.path(m, model, split) for model in MODELS]
    status = "".join(f" {text}" for text in status_sentences(flown))
    return error_table("hold_out_errors", flights, SI, ("before", "after"), status=status)


def trajectories(flown: Trajectories, card: Card) -> list[Any]:
    """Tables, then the hold-out flights, then the fitted ones, folded."""
    of_rule = all(name in TOLERANCES and t.value == TOLERANCES[name].value for name, t in card.tolerances.items())
    origin = sentence("tolerances_of_rule" if of_rule else "tolerances_of_card")
    units, plots = {name: SI[name] for name in flown.outputs}, {}
    for split, about in SPLITS.items():

        def drawn(_: int, name: str, split: str = split) -> tuple[np.ndarray, list[Panel]]:
            paths = {label: p for key, label in MODELS.items() if (p := flown.path(name, key, split)) is not None}
            return next(iter(paths.values())).time, output_panels(paths, units)

        names = list(dict.fromkeys(p.manoeuvre for p in flown.paths if p.split == split))
        remark, *made = parts.flights(names, split, f"{about}: measured and simulated outputs", drawn)
        texts = [{"caption": f"{about}. {p.caption}", "title": f"{p.title}, {split.replace('_', '-')}"} for p in made]
        plots[split] = [remark, *(p._replace(**text) for p, text in zip(made, texts, strict=True))]
    return [
        f"{WORDS['paragraphs']['trajectories']} {origin}",
        hold_out_table(flown),
        plots["hold_out"],
        fold("The same, fitted to all flights", plots["fitted"]),
        sources(card, units),
    ]


def given_flights(paths: Sequence[SimulatedManoeuvre], card: Card) -> list[Any]:
    """The identified model with the recorded inputs: errors, then each manoeuvre with the error shaded."""
    if not paths:
        return []
    units = {name: SI[name] for name in paths[0].errors}
    names, what = [p.manoeuvre for p in paths], "Measured outputs, and those simulated with the fitted coefficients,"
    simulated = [(p.time, output_panels({"simulation": p}, units)) for p in paths[: parts.MOST_SHOWN]]
    plots = parts.flights(names, "given", what, lambda k, _: simulated[k])
    left = [f"The simulation of {path.manoeuvre} leaves the flight envelope." for path in paths if not path.inside]
    text = WORDS["paragraphs"]["given_flights"] + tolerance_band(paths)
    errors = error_table("given", {path.manoeuvre: [path] for path in paths}, SI, ("simulation",))
    return [text, parts.warnings(left), plots, errors, sources(card, units)]


def tolerance_band(paths: Sequence[SimulatedManoeuvre]) -> str:
    """What the grey band is, where there is one."""
    band = any(error.tolerance is not None for path in paths for error in path.errors.values())
    return WORDS["paragraphs"]["tolerance_band"] if band else ""


def sources(card: Card, units: Mapping[str, str]) -> Fold | None:
    """Where the tolerances of outputs (by their SI units) come from; nothing where the card has none."""
    facts = []
    for name, tolerance in card.tolerances.items():
        if name in units:
            unit, factor = for_people(units[name])
            facts.append((f"{symbol(name)} ± {number(factor * tolerance.value)} {unit}", tolerance.source))
    return fold("Origin of the tolerances", Facts(tuple(facts)) if facts else None)


# --- What process noise changes, and whether its one-step predictions are calibrated.

MIN_DIFFERENCE = 3.0  # combined standard errors of two estimates from which a parameter is named; our choice
LEVEL = 0.95  # of the intervals whose shares a sentence states
FAULTS = {
    "too_narrow": "intervals of {} are too narrow",
    "too_wide": "intervals of {} are too wide",
    "not_normal": "innovations of {} are not normally distributed",
    "coloured": "innovations of {} are autocorrelated",
}
GUSTS = {"vertical_gust": "vertical", "longitudinal_gust": "longitudinal", "lateral_gust": "lateral"}


def gust_sentences(gusts: Mapping[str, float], fit: ProcessNoise | None = None) -> list[str]:
    """Records that need process noise by their `gusts` (m/s), and which estimates of trajectories to use."""
    if not gusts:
        return []
    better = " Use the estimates with process noise: in gusts those of output error are biased."
    estimated = [f"{name} {size:.2g} m/s" for name, size in gusts.items()]
    return [sentence("path_gusts", gusts=estimated, better=better if fit is not None and fit.preferred else "")]


def settled_sentences(
    disagree: Sequence[Disagreement], fit: ProcessNoise | None, apart: Sequence[str], *, disputed: bool
) -> list[str]:
    """Which estimates to prefer where output error and coefficients disagree; `disputed`: process noise is for that."""
    if not disagree or fit is None:
        return []
    names = [d.name for d in disagree]
    why = [sentence("disputed", names=names)] if disputed else []
    if not fit.preferred:
        return why
    listed = [f"{name} {plus_minus(*fit.estimates[name])}" for name in names if name in fit.estimates]
    settled = sentence("still_apart" if apart else "settled", names=apart or names, listed=listed)
    return [" ".join([*why, settled])]


def process_noise_sentences(disturbed: ProcessNoise, flown: TrajectoryFit) -> list[str]:
    if not disturbed.converged:
        return [sentence("ended", what="The fit with process noise", status=disturbed.status)]
    predicted = [] if disturbed.one_step is None else prediction_sentences(disturbed.one_step)
    if disturbed.gain <= 0.0:
        return [sentence("process_noise_no_gain"), *predicted]
    sentences = [sentence("process_noise_gain", gain=disturbed.gain), *_estimated_gusts(disturbed)]
    fit, changed = flown.fit, []
    for name, estimate, sd in zip(fit.names, fit.estimate, fit.sd_corrected, strict=True):
        other, other_sd = disturbed.estimates.get(name, (float(estimate), float(sd)))
        if abs(other - estimate) > MIN_DIFFERENCE * math.hypot(sd, other_sd):
            changed.append(f"{name} {plus_minus(other, other_sd)} (output error {plus_minus(estimate, sd)})")
    if changed:
        sentences.append(sentence("process_noise_changes", limit=MIN_DIFFERENCE, changed=changed))
    if coloured := [f"{name} ({disturbed.autocorrelation[name]:.2f})" for name in disturbed.coloured]:
        more = ", and these standard errors are too small"
        sentences.append(sentence("coloured_innovations", names=coloured, more=more))
    return sentences + predicted


def prediction_sentences(predictions: OneStep) -> list[str]:
    """The share of each output inside its 95 % intervals, and whether predictions are calibrated."""
    inside = []
    for name, output in predictions.outputs.items():
        share = next(s for s in output.shares if s.level == LEVEL)
        digits = 0 if share.sd >= 0.01 else 1
        inside.append(f"{symbol(name)} {100.0 * share.share:.{digits}f} % (± {100.0 * share.sd:.{digits}f})")
    every = {symbol(name): output.calibration.value for name, output in predictions.outputs.items()}
    every["all outputs together"] = predictions.together.calibration.value
    faulty = {fault: [n for n, kind in every.items() if kind == wrong] for wrong, fault in FAULTS.items()}
    faults = "; ".join(fault.format(several(names)) for fault, names in faulty.items() if names)
    return [sentence("one_step", level=100.0 * LEVEL, inside=inside), sentence(predictions.status, faults=faults)]


def _estimated_gusts(disturbed: ProcessNoise) -> list[str]:
    estimated, undetected, gusts = [], [], disturbed.gusts
    for name, word in ((n, word) for n, word in GUSTS.items() if n in gusts):
        (intensity, sd), (length, length_sd) = gusts[name], gusts[f"{name}_length"]
        if name in disturbed.distinguishable:
            estimated.append(f"{word} {plus_minus(intensity, sd)} m/s (scale length {length:z.0f} ± {length_sd:.0f} m)")
        else:
            undetected.append(word)
    sentences = [f"Estimated gusts, standard deviation: {several(estimated)}."] if estimated else []
    if undetected:
        sentences.append(f"No {' and no '.join(undetected)} gusts are distinguishable from noise of the states.")
    if "buffet" in gusts:
        key = "buffet" if "buffet" in disturbed.distinguishable else "no_buffet"
        sentences.append(sentence(key, intensity=gusts["buffet"], length=gusts["buffet_length"]))
    return sentences


def posterior_table(posteriors: Mapping[str, Posterior]) -> Table:
    """A row a parameter; of each sampler mean, deviation, 95 % interval, effective sample size and R-hat."""
    names = list(next(iter(posteriors.values())).names)
    columns = [Column(names, "parameter", "parameter")]
    for key, posterior in posteriors.items():
        rows, label = [posterior.marginals[name] for name in names], label_of(key)
        files = tuple(f"{key}_{part}" for part in ("mean", "sd", "low", "high"))
        interval = [" to ".join(number(end, 3) for end in m.ci95) for m in rows]
        columns += [
            Column([Estimate.of(m) for m in rows], files, "mean", group=label),
            Column(interval, page="95 % interval", group=label),
            Column([m.ess for m in rows], f"{key}_ess", "ESS", form=".0f", group=label),
            Column([m.rhat for m in rows], f"{key}_rhat", "R-hat", form=".3f", group=label),
        ]
    return table("posterior", columns)


def one_step_table(predictions: OneStep, units: Mapping[str, str]) -> Table:
    """A row an output, and one for all: error, innovations over their predicted deviations, shares inside intervals."""
    outputs, every = predictions.outputs, list(predictions.outputs.values())
    every += [predictions.together] if len(every) > 1 else []
    labels = [*(axis_label(name, units.get(name, "1")) for name in outputs), "all together"][: len(every)]
    factors = [*(for_people(units.get(name, "1"))[1] for name in outputs), 1.0]
    rms = [None if p.rms is None else factor * p.rms for p, factor in zip(every, factors, strict=False)]
    columns = [
        Column(labels, "", "output"),
        Column(rms, "", "RMS", form=lambda x: short(x) if x >= 1e-4 else number(x, 2)),
        Column([Estimate(*p.ratio) for p in every], "", "e/sd"),
    ]
    for k, share in enumerate(predictions.together.shares):
        inside = [Estimate(100.0 * p.shares[k].share, 100.0 * p.shares[k].sd) for p in every]
        columns.append(Column(inside, "", f"{100.0 * share.level:.0f} %", group="inside the interval, %"))
    kinds = [p.calibration.value.replace("_", " ") for p in every]
    return table("one_step", [*columns, Column(kinds, "", "predictions")])


def process_noise_table(disturbed: ProcessNoise, flown: TrajectoryFit) -> Table:
    fit = flown.fit
    every = zip(fit.parameters, fit.estimate, fit.sd_corrected, strict=True)
    rows = [(p, Estimate(float(x), float(sd))) for p, x, sd in every if p.name in disturbed.estimates]
    theirs = [Estimate(*disturbed.estimates[p.name]) for p, _ in rows]
    columns = [
        *parameter_columns([p.name for p, _ in rows], [p.unit for p, _ in rows]),
        Column([estimate for _, estimate in rows], "", "output error"),
        Column(theirs, "", "with process noise"),
    ]
    return table("process_noise", columns)


def gust_table(disturbed: ProcessNoise) -> Table:
    """A row for each sample: manoeuvre, time (s), mean and standard deviation of each gust (m/s)."""
    histories, columns = disturbed.histories, []
    for name in dict.fromkeys(name for h in histories for name in h.gusts):
        both = [Estimate(*pair) for h in histories for pair in zip(*h.gusts[name], strict=True)]
        columns.append(Column(both, (name, f"{name}_sd")))
    manoeuvre = Column([h.manoeuvre for h in histories for _ in h.time], "manoeuvre")
    time = Column([t for h in histories for t in h.time], "time")
    return Table([manoeuvre, time, *columns], index=2)
