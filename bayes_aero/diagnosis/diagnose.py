"""The diagnosis: do the sensors agree, where is the model wrong, which cause, what does it gain, what is left."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_aero.diagnosis.accuracy import (
    LeftOut,
    confirmation,
    implausible,
    implausible_candidate,
    measured_blocks,
    split_name,
    truncated,
)
from bayes_aero.diagnosis.candidate_set import DEFAULT, CandidateModel, DiagnosisSettings
from bayes_aero.diagnosis.consistency import SENSOR_KINDS, in_gusts, open_errors
from bayes_aero.diagnosis.result import (
    COEFFICIENTS,
    FLIGHT_PATH,
    Cause,
    Confirmation,
    Diagnosis,
    Gain,
    Size,
    Tested,
    UnexplainedStructure,
    as_absorbed,
    as_white,
    verdict_of,
)
from bayes_aero.diagnosis.screening import CandidateScore, screen
from bayes_aero.diagnosis.search import Search, SearchResult
from bayes_aero.diagnosis.selection import (
    Extension,
    absorbed,
    added,
    cancelling,
    correlated,
    explained,
    mixes_noise,
    noise_shares,
    removed,
    without_hold,
)
from bayes_aero.diagnosis.selection_state import RegressionFit, SelectionState, inverse, moved, refitted
from bayes_aero.effect import Effect, Kind
from bayes_aero.errors import attempted
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import nats
from bayes_aero.model.model import Model, own_effects
from bayes_aero.model.records import on_recorded_axes
from bayes_aero.processes import blas_threads
from bayes_aero.progress import Progress


@blas_threads(0)
def diagnose(
    records: Sequence[FlightRecord],
    card: Card,
    *,
    model: Model | None = None,
    settings: DiagnosisSettings = DEFAULT,
    seed: int = 0,
    extra: Sequence[Effect] = (),
    gains_wanted: bool = True,
    process_noise: bool | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find what the card's model gets wrong on `records`; `settings` hold every threshold.

    The model is compared with coefficients, or with trajectories where no accelerometer gives those; with
    innovations by `process_noise` (None: in gusts). Without `gains_wanted` nothing is fitted again to left-out data.
    """
    card, left_out = on_recorded_axes(card, records) if model is None else (card, ())
    gusts = in_gusts(records, card, seed) if process_noise is None else {}
    candidates = (*own_effects(card.effect_files).values(), *extra)
    search = Search(records, card, model or Model.from_card(card), candidates, settings, seed, progress)
    result = search.made(by_innovations=bool(process_noise or gusts))
    if gains_wanted and result.testable_now:
        candidates, kept_of, failed = _confirmed(result, progress)
    else:
        candidates, failed = causes_of(result, {}, None), ()
        kept_of = {stage: extension.state.active for stage, extension in result.stages.items()}
    compared = result.model.state.responses.stage
    # Offsets between manoeuvres are in the model beside the causes.
    hardly = stand_ins(candidates, result.stages, [one for one in result.unknown if not one.offsets])
    causes, beyond, unnamed = attributed(candidates, settings, hardly)
    unknown = (*result.unknown, *structure_of(result, (*unnamed, *beyond)))
    kept = tuple(name for name in kept_of[compared] if name not in {c.name for c in beyond})
    causes, beyond = without_conditional(causes, beyond)
    minor = (*(result.sensors.minor if result.sensors else ()), *result.model.minor, *(c.name for c in unnamed))
    tested = None if result.testable_now else Tested({})
    taken_up, verdict = absorbed(result.model), verdict_of(causes, (*unknown, *result.changes), tested)
    names = {stage: [c.name for c in causes if c.stage == stage] for stage in result.stages}
    pairs = [cancelling(extension, names[stage]) for stage, extension in result.stages.items()]
    same: dict[str, Any] = {n: getattr(result, n) for n in ("noise", "not_testable", "sensors", "changes", "terms")}
    return Diagnosis(
        verdict=as_absorbed(as_white(verdict, result.noise), taken_up),
        causes=causes,
        minor=minor,
        unknown=unknown,
        aerodynamics=result.model,
        theta=result.model.state.theta,
        split=split_name(result.model.state),
        base_moves=moves_of(result.model),
        kept=kept,
        failures=(*result.failures, *failed),
        notes=(*left_out, *result.notes),
        together=tuple(pair for of_stage in pairs for pair in of_stage),
        beyond=beyond,
        tested=tested,
        compared=compared,
        gusts=gusts,
        absorbed=taken_up,
        **same,
    )


Kept = Mapping[str, tuple[str, ...]]  # by stage, additions that hold-out data confirm


def _confirmed(result: SearchResult, progress: Progress | None) -> tuple[list[Cause], Kept, tuple[str, ...]]:
    """Causes with what unseen data say of them, the additions of every stage that these confirm, and failures."""

    def loses(gain: Gain) -> bool:
        """Whether hold-out data are predicted worse with a cause: all together, or one of the outputs."""
        return bool(gain.degraded) or result.full.settings.degrades(gain.elpd, gain.elpd_se)

    def tested() -> tuple[list[Cause], Kept]:
        confirmations = {stage: confirmation(one.state) for stage, one in result.stages.items()}
        while True:
            causes = causes_of(result, confirmations, progress)
            losing = [c for c in causes if c.confirmed and loses(c.gain)]
            if not losing:
                return causes, {stage: one.kept for stage, one in confirmations.items()}
            last, one = losing[-1], confirmations[losing[-1].stage]
            confirmations[last.stage] = replace(one, kept=tuple(name for name in one.kept if name != last.name))

    causes, failures = attempted("No cause was tested on hold-out data", tested, None)
    if causes is not None:
        return (*causes, failures)
    untested = [replace(cause, confirmed=False) for cause in causes_of(result, {}, None)]
    return untested, dict.fromkeys(result.stages, ()), failures


def without_conditional(
    causes: Sequence[Cause], beyond: Sequence[Cause]
) -> tuple[tuple[Cause, ...], tuple[Cause, ...]]:
    """Causes, and `beyond` with those that were estimated together with one of them: these hold only beside it."""
    joint = [c for c in causes if any(one.name in c.joint and one.stage == c.stage for one in beyond)]
    return tuple(c for c in causes if c not in joint), (*beyond, *joint)


def causes_of(
    searched: SearchResult, confirmations: Mapping[str, Confirmation], progress: Progress | None
) -> list[Cause]:
    causes, full = list[Cause](), searched.full
    for stage, extension in searched.stages.items():
        sure = confirmations.get(stage)
        measured = {}
        if sure is not None and extension.causes:
            measured = gains_of(extension, searched.model, sure.kept, progress)
        forms = searched.forms if extension is searched.model else {}
        causes += _causes_in(full, stage, extension, extension.causes, sure, measured, forms)
        for larger in extension.larger:
            out = without_hold(larger) if stage == FLIGHT_PATH else larger.implausible
            causes += _causes_in(full, stage, larger, [n for n in larger.causes if n in out], None, {}, {})
    return causes


def _causes_in(
    full: CandidateModel,
    stage: str,
    extension: Extension,
    names: Sequence[str],
    sure: Confirmation | None,
    measured: Mapping[str, Gain],
    forms: Mapping[str, tuple[str, float]],
) -> list[Cause]:
    """Some causes of one extension."""
    causes = list[Cause]()
    if not names:
        return causes
    joint = correlated(extension, extension.causes)
    noise = noise_shares(extension.state, extension.fit)
    undecided = {e.name: e.imitators for e in open_errors(extension)} if stage == FLIGHT_PATH else {}
    for name in names:
        effect = next(e for e in full.candidates if e.name == name)
        probability, others = rivals_of(extension, name, noise=noise[name])
        in_place: dict[str, tuple[float, float]] = {}
        if sure is not None and name in sure.kept:
            in_place = rival_gains(extension, name, others, sure.kept)
            worse = [rival for rival, gain in in_place.items() if full.settings.degrades(*gain)]
            if worse:
                probability, others = rivals_of(extension, name, worse, noise[name])
        if name in forms:  # the odds of the form against the cause
            probability = float(1.0 / (1.0 / max(probability, 1e-300) + np.exp(-forms[name][1])))
            others = (*others, forms[name][0])
        causes.append(
            Cause(
                name=name,
                kind=effect.kind.value,
                claim=effect.claim,
                stage=stage,
                probability=probability,
                p_value=next((s.p_value for s in extension.steps if s.chosen == name), float("nan")),
                ambiguous_with=tuple(dict.fromkeys((*others, *undecided.get(name, ())))),
                parameters={p.name: extension.sizes[p.name] for p in effect.parameters},
                gain=_with_harm(measured.get(name, NO_GAIN), sure, name),
                excited=_excited(extension.state, name),
                confirmed=sure is None or name in sure.kept,
                missed=NOTHING if sure is None else sure.missed[name],
                implausible=implausible(effect, extension.sizes),
                own_share=own_share(extension.state, extension.fit, name),
                joint=joint.get(name, {}),
                rival_gains={rival: gain for rival, gain in in_place.items() if rival in others},
            )
        )
    return causes


def _with_harm(gain: Gain, sure: Confirmation | None, name: str) -> Gain:
    return gain if sure is None else replace(gain, degraded={**gain.degraded, **sure.harmed.get(name, {})})


def structure_of(result: SearchResult, unnamed: Sequence[Cause]) -> tuple[UnexplainedStructure, ...]:
    """What the record shows and cannot attribute: to one of several rivals, or to a size that no aircraft has."""
    effects, described = {e.name: e for e in result.full.candidates}, {u.coefficient for u in result.unknown}
    structures = []
    for c in unnamed:
        if c.kind not in SENSOR_KINDS if c.implausible else c.ambiguous_with:
            extension = result.stages[c.stage]
            structure = as_structure(c, extension, effects[c.name])
            enough = structure.share >= result.full.settings.unnamed_share and structure.coefficient not in described
            if c.name in extension.state.active or enough:
                structures.append(structure)
    return tuple(structures)


def moves_of(extension: Extension) -> Mapping[str, tuple[float, float, float]]:
    """How the card's parameters moved."""
    before, after, estimates = extension.base, extension.state, extension.sizes
    return {
        name: (float(before.theta[before.full.columns([name])[0]]), float(after.theta[i]), estimates[name].sd)
        for i, name in enumerate(after.full.model.names)
        if name in estimates and any(name in after.full.parameters_of(e) for e in after.full.base)
    }


def _excited(state: SelectionState, name: str) -> bool:
    if len(state.responses.flights.lengths) == 1:
        return True
    S = state.S[:, :, state.full.own_columns(name)]  # without the noise growth, which moves anything
    noise = np.std(state.residual, axis=0)[:, None]
    spread = np.array([np.sqrt(np.sum((S[fold] / noise).var(axis=0))) for fold in state.folds])
    return bool(spread.min() >= state.settings.least_excitation * spread.max())


def rivals_of(
    extension: Extension, name: str, worse: Sequence[str] = (), noise: float = 0.0
) -> tuple[float, tuple[str, ...]]:
    """Probability of a cause among everything that could take its place, nothing included; and who comes close."""
    # Left out is what predicts hold-out data `worse`, only hides noise, or must be larger than aircraft have.
    state, effects = extension.state, {e.name: e for e in extension.state.full.candidates}
    out = {*worse, *(n for larger in extension.larger for n in larger.implausible)}
    ranking = screen(state, extension.fit, without=name).candidate_scores
    best: dict[str, CandidateScore] = {}
    for standing in ranking:
        able = standing.score > state.settings.least_rival_score and not mixes_noise(state, standing)
        able = able and standing.effect not in out and not implausible_candidate(effects[standing.effect], standing)
        if standing.effect == name or able:
            best.setdefault(standing.effect, standing)
    itself = best.get(name)
    if itself is None:
        return 1.0, ()
    itself = replace(itself, gain=itself.gain * (1.0 - noise) ** 2)
    weights = {effect: np.exp(min(0.0, -itself.nats(s))) for effect, s in best.items()}
    nothing = np.exp(-nats(max(itself.gain, 0.0), itself.variance_inflation))
    close = tuple(effect for effect, s in best.items() if effect != name and itself.nats(s) < state.settings.ambiguous)
    return float(1.0 / (sum(weights.values()) + nothing)), close


def sensors_not_missed(diagnosis: Diagnosis, flights: Confirmation) -> Confirmation:
    """Errors of sensors that coefficients confirm and held-out flights do not miss."""
    # Coefficients are a regression on recorded channels, whose noise bends it as an error of a sensor may. A simulated
    # flight has no regressors.
    measured = {c.name for c in diagnosis.causes if c.kind == Kind.MEASUREMENT and c.stage == COEFFICIENTS}
    return replace(flights, missed={n: x for n, x in flights.missed.items() if n in measured - {*flights.kept}})


def judged_on_held_out_flights(
    diagnosis: Diagnosis, confirmation: Confirmation, held: Collection[str] = ()
) -> Diagnosis:
    """The diagnosis with causes confirmed by held-out flights, or not; one with parameters `held` was not tested."""

    def judged(c: Cause) -> Cause:
        if c.name not in confirmation.missed:
            return replace(c, confirmed=False) if set(held) & set(c.parameters) else c
        gain, kept = _with_harm(c.gain, confirmation, c.name), c.name in confirmation.kept
        return replace(c, confirmed=kept, missed=confirmation.missed[c.name], gain=gain)

    causes = tuple(judged(c) for c in diagnosis.causes)
    verdict = as_absorbed(verdict_of(causes, diagnosis.left, diagnosis.tested), diagnosis.absorbed)
    return replace(diagnosis, causes=causes, verdict=verdict)


# --- What every cause gains on hold-out data beside the causes before it.

NOTHING = (float("nan"), float("nan"))
NO_GAIN = Gain(*NOTHING, "not measured", {}, {})


def gains_of(
    extension: Extension, aerodynamics: Extension, kept: Sequence[str], progress: Progress | None
) -> dict[str, Gain]:
    """Gains of an extension's causes on left-out folds, each beside nuisances and the confirmed causes before it."""
    state, causes = extension.state, extension.causes
    nuisances = [name for name in extension.minor if name in kept]
    sure = {name: [other for other in causes[:number] if other in kept] for number, name in enumerate(causes)}
    pairs: dict[str, tuple[LeftOut, LeftOut]] = {}
    base = before = LeftOut.refitted(truncated(state, nuisances))
    for number, name in enumerate(causes):
        if progress:
            progress("gain on hold-out data", number / len(causes))
        after = LeftOut.refitted(truncated(state, (*nuisances, *sure[name], name)))
        pairs[name] = before, after
        before = after if name in kept else before
    gained = {name: (*after.gain(before), split_name(state)) for name, (before, after) in pairs.items()}
    if state.of_coefficients:
        measured = measured_blocks(state)
        return {n: Gain(*gained[n], base.scores(measured), after.scores(measured)) for n, (_, after) in pairs.items()}
    if extension is aerodynamics:  # no coefficients to score
        return {name: Gain(*gain, {}, {}) for name, gain in gained.items()}

    def corrected(sensors: Sequence[str]) -> LeftOut:
        """The card's fit of the coefficients with these corrections of sensors alone."""
        card = aerodynamics.base
        theta = state.full.at_neutral(card.theta, [e for e in state.active if e not in sensors])
        return LeftOut.refitted(moved(card, theta, ()))

    measured, gains = measured_blocks(aerodynamics.base), {}
    base = before = corrected(())
    for name in causes:  # what each correction does to the coefficients: scores, and those that it predicts worse
        after = corrected([*sure[name], name])
        worse = state.settings.degraded(after.output_gains(before))
        gains[name] = Gain(*gained[name], base.scores(measured), after.scores(measured), worse)
        before = after if name in kept else before
    return gains


def rival_gains(
    extension: Extension, cause: str, rivals: Sequence[str], kept: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Hold-out log density of each rival in place of a confirmed cause beyond it; minus infinity if too large."""
    ranking = screen(extension.state, extension.fit, without=cause)
    reference, gains = LeftOut.refitted(refitted(truncated(extension.state, kept))[0]), {}
    for rival in rivals:
        standing = ranking.of(rival)
        if standing is not None:
            other, _ = refitted(added(removed(extension.state, cause), standing))
            other, _ = refitted(truncated(other, [*(e for e in kept if e != cause), rival]))
            effect = next(e for e in other.full.candidates if e.name == rival)
            values = dict(zip(other.full.model.names, other.theta, strict=True))
            fitted = {p.name: Size(float(values[p.name]), 0.0, p.unit) for p in effect.parameters if p.name in values}
            gains[rival] = (-math.inf, 0.0) if implausible(effect, fitted) else LeftOut.refitted(other).gain(reference)
    return gains


# --- Whether an engineer would sign a cause: sizes that no aircraft has, signals that hardly move, too many rivals.


def own_share(state: SelectionState, fit: RegressionFit, effect: str) -> float:
    """Share of what an effect does to the outputs that no other free parameter can do: 1 over its largest VIF."""
    at = fit.places([c for c in state.full.own_columns(effect) if c in fit.columns])
    if not at:
        return float("nan")
    S = state.scaled[state.inside][:, :, fit.columns[at]]
    squares = np.einsum("mci,c->i", (S - S.mean(axis=0)) ** 2, 1.0 / fit.variance)
    uncertain = np.diag(inverse(fit.normal - np.diag(state.precision[fit.columns])))[at]
    return float(np.max(1.0 / np.maximum(squares * uncertain, 1.0)))


def attributed(
    causes: Sequence[Cause], settings: DiagnosisSettings = DEFAULT, stand_ins: Sequence[str] = ()
) -> tuple[tuple[Cause, ...], tuple[Cause, ...], tuple[Cause, ...]]:
    """Causes that the record can attribute; those larger than on any aircraft (another fault is behind); the rest."""
    beyond = tuple(c for c in causes if c.implausible)
    rest = [c for c in causes if c not in beyond]
    few = (c for c in rest if 1 + len(c.ambiguous_with) <= settings.most_names and (c.confirmed or c.likely))
    named = tuple(c for c in few if c.name not in stand_ins)  # no more equals than the record can choose among
    return named, beyond, tuple(c for c in rest if c not in named)


def stand_ins(
    causes: Sequence[Cause], extensions: Mapping[str, Extension], unknown: Sequence[UnexplainedStructure]
) -> tuple[str, ...]:
    """Causes that the record hardly excites, where the output that they move most has structure without a name."""
    # Small errors of the model change their estimates strongly, and there the model is shown to be wrong.
    left = {u.coefficient for u in unknown}
    return tuple(c.name for c in causes if c.hardly_excited and _output(extensions[c.stage], c.name) in left)


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
    standing = screen(extension.state, extension.fit, without=cause.name).of(cause.name)
    share = 0.0 if standing is None else explained(extension.state, standing)
    channel = effect.channels[0] if effect.channels else effect.kind.value
    output = _output(extension, cause.name, standing)
    return UnexplainedStructure(output, channel, share, cause.p_value, (cause.name, *cause.ambiguous_with))
