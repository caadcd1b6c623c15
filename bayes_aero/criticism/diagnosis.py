"""The diagnosis: do the sensors agree, where is the model wrong, which cause, what does it gain, what is left."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayes_aero.criticism.accuracy import filtered_channels
from bayes_aero.criticism.candidates import Field, field_of
from bayes_aero.criticism.collinear import Together, cancelling
from bayes_aero.criticism.confirmation import Confirmation, confirmation
from bayes_aero.criticism.credibility import as_structure, attributed, implausible, own_share
from bayes_aero.criticism.election import Standing, poll
from bayes_aero.criticism.extension import Extension
from bayes_aero.criticism.finding import FLIGHT_PATH, Cause, Diagnosis, Gain, Unknown, Verdict
from bayes_aero.criticism.gain import LeftOut, gain, gained, measured_blocks, split_name, truncated
from bayes_aero.criticism.residuals import noise_report
from bayes_aero.criticism.responses import Responses
from bayes_aero.criticism.stages import Stages, stages
from bayes_aero.criticism.state import State, linearised
from bayes_aero.criticism.unexplained import Left, has_chunks, unexplained
from bayes_aero.effect import Effect
from bayes_aero.errors import attempted
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.cores import blas_threads
from bayes_aero.inference.mle import fit_mle
from bayes_aero.model.flights import Flights, despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.model.own_effects import own_effects
from bayes_aero.physics.coefficients import NAMES

AMBIGUOUS = 3.0  # nats, under the colour of their difference, within which another effect explains as well
EXCITED = 0.1  # least over largest spread of an effect's sensitivities among manoeuvres; our choice
POSSIBLE = 2.0  # score that an effect needs on its own to be a rival at all

Progress = Callable[[str, float], None]


@blas_threads(0)
def diagnose(
    records: Sequence[FlightRecord],
    card: Card,
    *,
    model: Model | None = None,
    seed: int = 0,
    most: int = 8,
    extra: Sequence[Effect] = (),
    gains_wanted: bool = True,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find what the card's model gets wrong on `records`; at most `most` effects are added in each stage.

    `gains_wanted` False leaves out the refits on left-out data (for studies of naming alone).
    """
    model = model or Model.from_card(card)
    flights, outliers = despiked(join(records, card))
    field = field_of(model, flights, (*own_effects(card.effect_files).values(), *extra))
    responses = Responses.of(flights, field.model)
    mle = fit_mle(model, observe(records, card, model), seed=seed)
    theta = np.array([field.neutral[name] for name in field.model.names])
    for name, value in zip(mle.names, mle.estimate, strict=True):
        if name in field.model.names:
            theta[field.columns([name])[0]] = value
    both = stages(field, responses, theta, seed=seed, most=most, progress=progress)
    left, failures = attempted(
        "Unexplained structure was not sought",
        lambda: unexplained(both.aerodynamics, seed=seed + 2000),
        Left((), ()),
    )
    sensors, aerodynamics = both.sensors, _withdrawn(both.aerodynamics, left.replaced)
    named = [(FLIGHT_PATH, sensors)] if sensors is not None else []
    named.append(("coefficients", aerodynamics))
    candidates, kept, failed = _confirmed(field, named, progress) if gains_wanted else _unasked(field, named)
    failures += failed
    causes, beyond, unnamed = attributed(candidates)
    unknown = (*left.unknown, *structure_of(field, named, unnamed))
    minor = (*(sensors.minor if sensors else ()), *aerodynamics.minor, *(c.name for c in unnamed))
    return Diagnosis(
        verdict=verdict_of(causes, unknown),
        causes=causes,
        minor=minor,
        unknown=unknown,
        noise=noise_report(aerodynamics, outliers),
        not_testable=field.not_testable,
        sensors=sensors,
        aerodynamics=aerodynamics,
        theta=aerodynamics.state.theta,
        split=split_name(aerodynamics.state),
        base_moves=moves_of(aerodynamics),
        kept=kept,
        failures=failures,
        notes=(*_notes(flights), *_too_short(aerodynamics.state), *_denials(both)),
        together=together_of(named, causes),
        beyond=beyond,
    )


def _confirmed(
    field: Field, named: Sequence[tuple[str, Extension]], progress: Progress | None
) -> tuple[list[Cause], tuple[str, ...], tuple[str, ...]]:
    """Causes with what unseen data say of them, the additions to the coefficients that these confirm, and failures.

    Should the hold-out test fail, no cause is confirmed.
    """

    def asked() -> tuple[list[Cause], tuple[str, ...]]:
        confirmations = {stage: confirmation(one.state) for stage, one in named}
        return causes_of(field, named, confirmations, progress), confirmations["coefficients"].kept

    found, failures = attempted("No cause was tested on hold-out data", asked, None)
    if found is not None:
        return (*found, failures)
    causes, _, _ = _unasked(field, named)
    return [replace(cause, confirmed=False) for cause in causes], (), failures


def _unasked(
    field: Field, named: Sequence[tuple[str, Extension]]
) -> tuple[list[Cause], tuple[str, ...], tuple[str, ...]]:
    """The same where unseen data were not asked."""
    return causes_of(field, named, {}, None), dict(named)["coefficients"].state.active, ()


def _withdrawn(found: Extension, names: Sequence[str]) -> Extension:
    """Causes of which little is left beside what is unexplained lose their names: nuisances, in the model as before."""
    causes = tuple(name for name in found.causes if name not in names)
    return replace(found, causes=causes, minor=(*found.minor, *(n for n in found.causes if n in names)))


def _notes(flights: Flights) -> tuple[str, ...]:
    """What the user should know of the intervals."""
    filtered = filtered_channels(flights)
    if not filtered:
        return ()
    return (
        f"The record shows no white noise of {', '.join(filtered)} (filtered before recording, or none): sizes are not "
        "corrected for the bias from such noise, and their intervals do not include it.",
    )


def _too_short(state: State) -> tuple[str, ...]:
    """That periods were not tested, if a manoeuvre is too short for them."""
    return (
        ()
        if has_chunks(state)
        else ("Periodic structure was not tested: a manoeuvre is too short to be divided into blocks.",)
    )


def _denials(found: Stages) -> tuple[str, ...]:
    """A sentence on each sensor error that the flight path selects and the coefficients reject."""
    return tuple(
        f"The flight path alone selects {name}, which can be due to gusts. This correction degrades the fit of the "
        "coefficients by more than the flight path gains, so it is not made."
        for name in found.denied
    )


def causes_of(
    field: Field,
    stages: Sequence[tuple[str, Extension]],
    confirmations: Mapping[str, Confirmation],
    progress: Progress | None,
) -> list[Cause]:
    """What every stage named; with gains on unseen data where these were asked to confirm it (the last stage's are the
    coefficients)."""
    found: list[Cause] = []
    for stage, extension in stages:
        if not extension.causes:
            continue
        sure = confirmations.get(stage)
        measured = {} if sure is None else _gains_of(extension, stages[-1][1], sure.kept, progress)
        for name in extension.causes:
            effect = next(e for e in field.candidates if e.name == name)
            probability, others = _rivals(extension, name)
            found.append(
                Cause(
                    name=name,
                    kind=effect.kind.value,
                    claim=effect.claim,
                    stage=stage,
                    probability=probability,
                    p_value=next((s.p_value for s in extension.steps if s.chosen == name), float("nan")),
                    ambiguous_with=others,
                    parameters={p.name: extension.sizes[p.name] for p in effect.parameters},
                    gain=measured.get(name, NO_GAIN),
                    excited=_excited(extension.state, name),
                    confirmed=sure is None or name in sure.kept,
                    missed=NOTHING if sure is None else sure.missed[name],
                    implausible=implausible(effect, extension.sizes, field.neutral),
                    own_share=own_share(extension.state, extension.fit, name),
                )
            )
    return found


def structure_of(
    field: Field, stages: Sequence[tuple[str, Extension]], unnamed: Sequence[Cause]
) -> tuple[Unknown, ...]:
    """What the record shows and cannot attribute; without rivals it is likelier nothing."""
    effects, extensions = {e.name: e for e in field.candidates}, dict(stages)
    several = [c for c in unnamed if c.ambiguous_with]
    return tuple(as_structure(cause, extensions[cause.stage], effects[cause.name]) for cause in several)


def together_of(stages: Sequence[tuple[str, Extension]], causes: Sequence[Cause]) -> tuple[Together, ...]:
    """Pairs of named causes of one stage that cancel."""
    return tuple(
        pair
        for stage, extension in stages
        for pair in cancelling(extension, [c.name for c in causes if c.stage == stage])
    )


def _excited(state: State, name: str) -> bool:
    """Whether every manoeuvre moves what the effect acts through: the spread of its sensitivities within each."""
    if len(state.responses.flights.lengths) == 1:
        return True
    S = state.S[:, :, state.field.columns(state.field.parameters_of(name))]  # without the swell, which moves anything
    noise = np.std(state.residual, axis=0)[:, None]
    spread = np.array([np.sqrt(np.sum((S[fold] / noise).var(axis=0))) for fold in state.folds])
    return bool(spread.min() >= EXCITED * spread.max())


NOTHING = (float("nan"), float("nan"))
NO_GAIN = Gain(*NOTHING, "not measured", {}, {})


def _gains_of(
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
    if state.outputs != NAMES:
        return _sensor_gains(extension, aerodynamics, kept, pairs)
    measured = measured_blocks(state)
    return {name: gain(base, *pair, state, measured) for name, pair in pairs.items()}


def _sure(causes: Sequence[str], number: int, kept: Sequence[str]) -> list[str]:
    """Confirmed causes before the one of that number."""
    return [name for name in causes[:number] if name in kept]


def _sensor_gains(
    extension: Extension, aerodynamics: Extension, kept: Sequence[str], pairs: Mapping[str, tuple[LeftOut, LeftOut]]
) -> dict[str, Gain]:
    """Density gained on the flight path, and what each correction does to the card's fit of the coefficients."""
    state, card = extension.state, aerodynamics.base

    def corrected(sensors: Sequence[str]) -> LeftOut:
        theta = card.theta.copy()
        for effect in state.active:
            if effect not in sensors:
                names = state.field.parameters_of(effect)
                theta[state.field.columns(names)] = [state.field.neutral[name] for name in names]
        return LeftOut.refitted(linearised(card.field, card.responses, NAMES, theta, (), card.swell, card.temper))

    measured, found = measured_blocks(card), {}
    base = corrected(()).scores(measured)
    for number, name in enumerate(extension.causes):
        after = corrected([*_sure(extension.causes, number, kept), name]).scores(measured)
        found[name] = Gain(*gained(*pairs[name], state), split_name(state), base, after)
    return found


def _rivals(extension: Extension, name: str) -> tuple[float, tuple[str, ...]]:
    """Probability of a cause among everything that could take its place, nothing included; and who comes close."""
    state, fit = extension.state, extension.fit
    ranking = poll(state, fit, seed=0, replicates=0, without=name).standings
    best: dict[str, Standing] = {}
    for standing in ranking:
        if standing.effect == name or standing.score > POSSIBLE:
            best.setdefault(standing.effect, standing)
    own = best.get(name)
    if own is None:
        return 1.0, ()
    weights = {effect: np.exp(min(0.0, -own.nats(s))) for effect, s in best.items()}
    nothing = np.exp(-max(own.gain, 0.0) / (2.0 * max(own.inflation, 1.0)))
    close = tuple(effect for effect, s in best.items() if effect != name and own.nats(s) < AMBIGUOUS)
    return float(1.0 / (sum(weights.values()) + nothing)), close


def moves_of(extension: Extension) -> Mapping[str, tuple[float, float, float]]:
    """How the card's parameters moved."""
    before, after, own = extension.base, extension.state, extension.sizes
    return {
        name: (float(before.theta[before.field.columns([name])[0]]), float(after.theta[i]), own[name].sd)
        for i, name in enumerate(after.field.model.names)
        if name in own and any(name in after.field.parameters_of(e) for e in after.field.base)
    }


def verdict_of(causes: Sequence[Cause], unknown: Sequence[Unknown]) -> Verdict:
    """What is missing counts as explained by causes that are sure alone (see `Cause.sure`)."""
    if any(cause.sure for cause in causes):
        return Verdict.PARTLY_EXPLAINED if unknown else Verdict.EXPLAINED
    of_the_model = [cause for cause in causes if cause.stage != FLIGHT_PATH]  # the others are the sensors', not its own
    return Verdict.UNEXPLAINED if unknown or of_the_model else Verdict.NO_EFFECT


def judged_on_held_out_flights(found: Diagnosis, confirmation: Confirmation) -> Diagnosis:
    """The diagnosis with each cause confirmed, or not, by held-out flights; untested causes stay as they are."""
    causes = tuple(
        replace(c, confirmed=c.name in confirmation.kept, missed=confirmation.missed[c.name])
        if c.name in confirmation.missed
        else c
        for c in found.causes
    )
    return replace(found, causes=causes, verdict=verdict_of(causes, found.unknown))
