"""What every cause gains on hold-out data beside the causes before it, and whether its size is plausible."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bayes_aero.diagnosis.result import LITTLE, Cause, Gain, UnexplainedStructure
from bayes_aero.diagnosis.screening.accuracy import Size, implausible
from bayes_aero.diagnosis.screening.parameter_fit import refitted
from bayes_aero.diagnosis.screening.regression import Fit, inverse
from bayes_aero.diagnosis.screening.screening import CandidateScore, screen
from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved
from bayes_aero.diagnosis.selection.forward_selection import Extension, added, removed
from bayes_aero.diagnosis.selection.holdout import (
    LeftOut,
    holdout_gain,
    measured_blocks,
    output_gains,
    split_name,
    truncated,
)
from bayes_aero.diagnosis.selection.rivals import correlated
from bayes_aero.diagnosis.settings import DEFAULT, DiagnosisSettings
from bayes_aero.effect import Effect
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


# --- Whether an engineer would sign a cause: sizes that no aircraft has, signals that hardly move, too many rivals.


def without_hold(found: Extension) -> dict[str, Mapping[str, float]]:
    """Additions that are no error by themselves: larger than aircraft have, at a parameter bound, or estimated together
    with such a one; each with its partners and the correlation."""
    state, joint = found.state, correlated(found, found.state.active)
    out = {n for n in state.active if any(found.sizes[p].at_bound for p in state.full.parameters_of(n))}
    out |= set(found.implausible)
    return {n: joint.get(n, {}) for n in state.active if n in out or out & set(joint.get(n, {}))}


def own_share(state: SelectionState, fit: Fit, effect: str) -> float:
    """Share of what an effect does to the outputs, means aside, that no other free parameter can do as well.

    One over the variance inflation factor, the largest over its parameters; priors left out, for they are no data.
    Not a number where the effect is not in the fit.
    """
    columns = state.full.own_columns(effect)
    at = [int(np.flatnonzero(fit.columns == c)[0]) for c in columns if c in fit.columns]
    if not at:
        return float("nan")
    S = state.scaled[state.inside][:, :, fit.columns[at]]
    own = np.einsum("mci,c->i", (S - S.mean(axis=0)) ** 2, 1.0 / fit.variance)
    uncertain = np.diag(inverse(fit.normal - np.diag(state.precision[fit.columns])))[at]
    return float(np.max(1.0 / np.maximum(own * uncertain, 1.0)))


def attributed(
    causes: Sequence[Cause], settings: DiagnosisSettings = DEFAULT, stand_ins: Sequence[str] = ()
) -> tuple[tuple[Cause, ...], tuple[Cause, ...], tuple[Cause, ...]]:
    """Causes that the record can attribute; those larger than on any aircraft, behind which is another fault; others.

    The others have more equals than the record can choose among, or are neither confirmed nor likelier than not, or are
    `stand_ins` (see there).
    """
    beyond = tuple(c for c in causes if c.implausible)
    rest = [c for c in causes if c not in beyond]
    few = (c for c in rest if 1 + len(c.ambiguous_with) <= settings.most_names and (c.confirmed or c.likely))
    named = tuple(c for c in few if c.name not in stand_ins)
    return named, beyond, tuple(c for c in rest if c not in named)


def stand_ins(
    causes: Sequence[Cause], extensions: Mapping[str, Extension], unknown: Sequence[UnexplainedStructure]
) -> tuple[str, ...]:
    """Causes that the record hardly excites, where structure without a name is left in the output that they move most.

    Small errors of the model change their estimates strongly, and there the model is shown to be wrong.
    """
    left = {u.coefficient for u in unknown}
    return tuple(c.name for c in causes if c.own_share < LITTLE and _output(extensions[c.stage], c.name) in left)


def _output(extension: Extension, name: str, step: CandidateScore | None = None) -> str:
    """The output that an addition, or a candidate with this step, moves most, over what is left there."""
    state = extension.state
    columns, away = state.full.own_columns(name), state.departure
    if name not in state.active and step is not None:
        columns, away = np.array(step.columns, int), dict(zip(step.columns, step.step, strict=False))
    moved = (state.scaled[:, :, columns] @ np.array([away[c] for c in columns]))[state.inside]
    return state.outputs[int(np.argmax(np.mean((moved - moved.mean(axis=0)) ** 2, axis=0) / extension.fit.variance))]


def as_structure(cause: Cause, extension: Extension, effect: Effect) -> UnexplainedStructure:
    """What a cause that is none explained: the output of which it takes most, through which channel."""
    state, fit = extension.state, extension.fit
    standing = screen(state, fit, seed=0, nulls=False, without=cause.name).of(cause.name)
    gain = 0.0 if standing is None else max(standing.gain, 0.0)
    share = 1.0 - float(np.exp(-gain / state.products.count.sum()))
    channel = effect.channels[0] if effect.channels else effect.kind.value
    return UnexplainedStructure(
        _output(extension, cause.name, standing), channel, share, cause.p_value, (cause.name, *cause.ambiguous_with)
    )
