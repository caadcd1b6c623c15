"""Simulated trajectories in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from bayes_aero.diagnosis.trajectories.results import Trajectories
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.tolerances import TOLERANCES
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.report.text.phrases import SYMBOLS, for_people, nats_text, several, short, size_text

MODELS = ("card", "extended")
STOPPED = "stopped before the optimum, so its errors may be too large"


def simulation_gain(flown: Trajectories) -> str:
    """The RMS errors of both models over all hold-out flights; empty if they are equal or a model leaves the envelope.

    A fit that did not converge is reported with it.
    """
    if not all(p.inside for p in flown.paths if p.split == "hold_out"):
        return ""
    listed = []
    for output in flown.outputs:
        rms = {m: [p.errors[output].rms for p in flown.paths if (p.model, p.split) == (m, "hold_out")] for m in MODELS}
        if not all(rms.values()) or not np.isfinite([x for values in rms.values() for x in values]).all():
            return ""
        unit, factor = for_people(STANDARD_CHANNELS[output].unit)
        before, after = (short(factor * float(np.sqrt(np.mean(np.square(rms[m]))))) for m in MODELS)
        if before != after:
            listed.append(f"{SYMBOLS.get(output, output)} from {before} to {after} {unit}")
    if not listed:
        return ""
    besides = [f"with {flown.lag.effect}"] if flown.lag is not None and flown.lag.kept else []
    besides += [f"without {several(flown.out)}"] if flown.out else []
    model = f" ({several(besides)})" if besides else ""
    text = f"On hold-out flights the extended model{model} changes the RMS error of the simulation: {several(listed)}."
    return " ".join([text, *status_sentences(flown)])


def trajectory_sentences(flown: Trajectories) -> list[str]:
    """How the fits ended, what was held, and the share of time within the tolerances."""
    sentences = [*status_sentences(flown), *lag_sentences(flown), *cause_sentences(flown)]
    for name, held in flown.held.items():
        if held:
            are = (
                ("is", "it is held at its joint estimate")
                if len(held) == 1
                else ("are", "they are held at their joint estimates")
            )
            sentences.append(
                f"Without {name}, {several(held)} {are[0]} not identifiable from the other flights; {are[1]}."
            )
    if flown.extended.held:
        sentences.append(
            f"The trajectories contain little information on {several(flown.extended.held)}; the prior decides."
        )
    return sentences + _tolerance_sentences(flown)


def _tolerance_sentences(flown: Trajectories) -> list[str]:
    """The share of time of the hold-out flights within tolerance: one sentence for all, the worst flight named."""
    unseen = [p for p in flown.paths if (p.model, p.split) == ("extended", "hold_out")]
    outside = [p.manoeuvre for p in unseen if not p.inside]
    leaves = "leaves" if len(outside) == 1 else "leave"
    sentences = [f"In the hold-out simulation {several(outside)} {leaves} the flight envelope."] if outside else []
    inside = [p for p in unseen if p.inside]
    listed = []
    for output in flown.outputs:
        shares = {p.manoeuvre: x for p in inside if (x := p.errors[output].within) is not None}
        if not shares:
            continue
        worst = min(shares, key=lambda name: shares[name])
        where = f" (least, {worst})" if len(shares) > 1 and shares[worst] < max(shares.values()) else ""
        listed.append(f"{SYMBOLS.get(output, output)} {shares[worst]:.0%}{where}")
    if listed:
        what = "every flight is" if len(inside) > 1 else f"{inside[0].manoeuvre} is"
        sentences.append(
            f"In the hold-out simulation {what} within tolerance for at least this share of the time: "
            f"{', '.join(listed)}. "
            f"{tolerance_origin({n: e.tolerance for n, e in inside[0].errors.items() if e.tolerance is not None})}"
        )
    return sentences


def tolerance_origin(bands: Mapping[str, float]) -> str:
    """The origin of the tolerances; `bands` by output, SI."""
    if all(name in TOLERANCES and value == TOLERANCES[name].value for name, value in bands.items()):
        return (
            "The card states no tolerances; the tolerances for flight simulators of 14 CFR Part 60 are used. "
            "[tolerances] of the card replaces them."
        )
    return "The tolerances are those of the card."


def lag_sentences(flown: Trajectories) -> list[str]:
    """The lag test on trajectories, where the coefficients do not decide."""
    lag = flown.lag
    if lag is None:
        return []
    elpd, elpd_se = lag.unseen
    if not lag.kept:
        asked = f", hold-out {nats_text(elpd, elpd_se, '+')}" if math.isfinite(elpd) else ""
        gained = f"fit {lag.gain:+.1f} nats{asked}" if math.isfinite(lag.gain) else "its fit did not converge"
        why = "give a size that is too small to be named" if lag.slight else "do not support it"
        return [f"The coefficients do not decide on {lag.effect}; the trajectory data {why} ({gained})."]
    names = [p.name for p in CATALOGUE[lag.effect].parameters]
    after = flown.extended
    sizes = [f"{n} {size_text(after.values[n], flown.deviation[n], after.units[n])}" for n in names]
    instead = f" in place of {several(lag.instead)}" if lag.instead else ""
    return [
        f"The trajectory fit supports {lag.effect}{instead}: {several(sizes)}. The coefficients do not decide on "
        f"it; it "
        f"gains {lag.gain:.0f} nats in the trajectory fit and {nats_text(elpd, elpd_se)} on hold-out flights."
    ]


def cause_sentences(flown: Trajectories) -> list[str]:
    """Which confirmed causes the hold-out trajectories need, and by how much."""
    missed, kept, sentences = flown.asked.missed, flown.asked.kept, []
    harmed = flown.asked.harmed
    for e, worse in harmed.items():
        gains = [f"{output} by {nats_text(-gain, se)}" for output, (gain, se) in worse.items()]
        sentences.append(f"With {e} hold-out trajectories are predicted worse in {several(gains)}: it is omitted.")
    if idle := [e for e in flown.out if e not in harmed]:
        gains = [f"{e} (by {nats_text(*missed[e], '+')})" for e in idle]
        them, omits = ("it", "omits it") if len(gains) == 1 else ("them", "omits them")
        sentences.append(
            f"Removing {several(gains)} does not significantly degrade the prediction of hold-out trajectories. The "
            f"search confirms {them}; the simulated model {omits}."
        )
    if kept:
        finite = [e for e in kept if math.isfinite(missed[e][0])]  # without the others the flight leaves its envelope
        least = min(finite, key=lambda e: missed[e][0] / missed[e][1], default=None)
        least_of = f"least for {least}, " if len(kept) > 1 else ""
        listed = f" ({least_of}by {nats_text(*missed[least])})" if least else ""
        sentences.append(f"Removing {several(kept)} degrades the prediction of hold-out trajectories{listed}.")
    return sentences


def status_sentences(flown: Trajectories) -> list[str]:
    """How the fits of both models ended, where one did not converge."""
    sentences = []
    for who, fit in (("The card's model", flown.card), ("The extended model", flown.extended)):
        if fit.status is not OutputErrorStatus.CONVERGED:
            names = f" ({several(fit.at_bound)})" if fit.at_bound else ""
            how = STOPPED if fit.status is OutputErrorStatus.NOT_CONVERGED else fit.status.value
            sentences.append(f"{who}, fitted to the trajectories: {how}{names}.")
    return sentences
