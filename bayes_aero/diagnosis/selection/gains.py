"""What every cause of a stage gains on left-out data, beside the confirmed causes before it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bayes_aero.diagnosis.result import Gain
from bayes_aero.diagnosis.screening.accuracy import Size, implausible
from bayes_aero.diagnosis.screening.parameter_fit import refitted
from bayes_aero.diagnosis.screening.screening import screen
from bayes_aero.diagnosis.screening.selection_state import moved
from bayes_aero.diagnosis.selection.cross_validation import (
    LeftOut,
    holdout_gain,
    measured_blocks,
    output_gains,
    split_name,
    truncated,
)
from bayes_aero.diagnosis.selection.forward_selection import Extension, added, removed
from bayes_aero.progress import Progress

NOTHING = (float("nan"), float("nan"))
NO_GAIN = Gain(*NOTHING, "not measured", {}, {})


def gains_of(
    extension: Extension, aerodynamics: Extension, kept: Sequence[str], progress: Progress | None
) -> dict[str, Gain]:
    """Gains of an extension's causes on left-out folds, each beside nuisances and the confirmed causes before it."""
    state, causes = extension.state, extension.causes
    nuisances = [name for name in extension.minor if name in kept]
    pairs: dict[str, tuple[LeftOut, LeftOut]] = {}
    base = before = LeftOut.refitted(truncated(state, nuisances))
    for number, name in enumerate(causes):
        if progress:
            progress("gain on hold-out data", number / len(causes))
        after = LeftOut.refitted(truncated(state, (*nuisances, *_sure(causes, number, kept), name)))
        pairs[name] = before, after
        before = after if name in kept else before
    by_coefficients = state.outputs == state.responses.model.coefficients
    if extension is aerodynamics and not by_coefficients:  # no coefficients to score
        return {n: Gain(*holdout_gain(*pair, state), split_name(state), {}, {}) for n, pair in pairs.items()}
    if not by_coefficients:
        return _sensor_gains(extension, aerodynamics, kept, pairs)
    measured = measured_blocks(state)
    return {
        name: Gain(*holdout_gain(*pair, state), split_name(state), base.scores(measured), pair[1].scores(measured))
        for name, pair in pairs.items()
    }


def _sure(causes: Sequence[str], number: int, kept: Sequence[str]) -> list[str]:
    """Confirmed causes before the one of that number."""
    return [name for name in causes[:number] if name in kept]


def _sensor_gains(
    extension: Extension, aerodynamics: Extension, kept: Sequence[str], pairs: Mapping[str, tuple[LeftOut, LeftOut]]
) -> dict[str, Gain]:
    """Density gained on the flight path, and what each correction does to the card's fit of the coefficients: scores,
    and coefficients that it predicts worse."""
    state, card = extension.state, aerodynamics.base

    def corrected(sensors: Sequence[str]) -> LeftOut:
        theta = state.full.at_neutral(card.theta, [e for e in state.active if e not in sensors])
        return LeftOut.refitted(moved(card, theta, ()))

    measured, found = measured_blocks(card), {}
    base = before = corrected(())
    for number, name in enumerate(extension.causes):
        after = corrected([*_sure(extension.causes, number, kept), name])
        gains = output_gains(before, after, card)
        found[name] = Gain(
            *holdout_gain(*pairs[name], state), split_name(state), base.scores(measured), after.scores(measured),
            state.settings.degraded(gains),
        )  # fmt: skip
        before = after if name in kept else before
    return found


def rival_gains(
    extension: Extension, cause: str, rivals: Sequence[str], kept: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Hold-out log density that each rival in place of a confirmed cause has beyond it, everything fitted again; minus
    infinity for one that is larger then than aircraft have."""
    ranking = screen(extension.state, extension.fit, seed=0, nulls=False, without=cause)
    state = truncated(extension.state, kept)
    own, found = LeftOut.refitted(refitted(state)[0]), {}
    for rival in rivals:
        standing = ranking.of(rival)
        if standing is not None:
            other, _ = refitted(added(removed(extension.state, cause), standing))
            other, _ = refitted(truncated(other, [*(e for e in kept if e != cause), rival]))
            effect = next(e for e in state.full.candidates if e.name == rival)
            values = dict(zip(other.full.model.names, other.theta, strict=True))
            fitted = {p.name: Size(float(values[p.name]), 0.0, p.unit) for p in effect.parameters if p.name in values}
            absurd = bool(implausible(effect, fitted))
            found[rival] = (-math.inf, 0.0) if absurd else holdout_gain(own, LeftOut.refitted(other), state)
    return found
