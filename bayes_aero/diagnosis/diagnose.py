"""The diagnosis: do the sensors agree, where is the model wrong, which cause, what does it gain, what is left."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from bayes_aero.diagnosis import result, selection, selection_state
from bayes_aero.diagnosis.consistency import SENSOR_KINDS, in_gusts, open_errors
from bayes_aero.diagnosis.design import narrowed
from bayes_aero.diagnosis.screening import CandidateScore, lag1_within, screen, uncertainty
from bayes_aero.diagnosis.search import Search, SearchResult, lacking
from bayes_aero.diagnosis.selection_state import DEFAULT, DiagnosisSettings, SelectionState, moved, refitted
from bayes_aero.effect import Effect, Kind, Stage
from bayes_aero.errors import attempted
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import unit_choices
from bayes_aero.flight.health import other_units
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import nats, standard_error_of_sum
from bayes_aero.inference.frequency import MIN_SHARE, cramer_rao, fit_in_band, without_noise_bias_in_band
from bayes_aero.inference.mle import stall_of
from bayes_aero.inference.results import FrequencyFit, score
from bayes_aero.model.model import Model, own_effects
from bayes_aero.model.records import Flights, on_recorded_axes
from bayes_aero.physics.aircraft import LATERAL, NAMES
from bayes_aero.processes import blas_threads
from bayes_aero.progress import Progress, quiet
from bayes_aero.residuals.equation_error import Band, FrequencyError, sampling_times


@blas_threads(0)
def diagnose(
    records: Sequence[FlightRecord],
    card: Card,
    *,
    model: Model | None = None,
    settings: DiagnosisSettings = DEFAULT,
    seed: int = 0,
    extra: Sequence[Effect] = (),
    **told: Any,
) -> result.Diagnosis:
    """Find what the card's model gets wrong on `records`; `settings` hold every threshold, `told` are `progress` and
    `checked` of `Search`.

    The model is compared with coefficients, with trajectories where no accelerometer gives those, or, as the settings
    say, with innovations.
    """
    card, left_out = on_recorded_axes(card, records) if model is None else (card, ())
    gusts = in_gusts(records, card, seed) if settings.process_noise is None else {}
    candidates = (*own_effects(card.effect_files).values(), *extra)
    search = Search(records, card, model or Model.from_card(card), candidates, settings, seed, **told)
    by_model = search.trajectories if lacking(records, card) else search.coefficients
    searched = search.innovations() if settings.process_noise or gusts else by_model()
    stages, state = searched.stages, searched.model.state
    kept_of, failed = {stage: extension.state.active for stage, extension in stages.items()}, ()
    if settings.gains and searched.testable_now:
        candidates, kept_of, failed = _confirmed(searched, search.progress)
    else:
        candidates = causes_of(searched, {}, quiet)
    # Offsets between manoeuvres are in the model beside the causes.
    hardly = stand_ins(candidates, stages, {u.coefficient for u in searched.unknown if not u.offsets})
    causes, beyond, unnamed = attributed(candidates, settings, hardly)
    effects = {e.name: e for e in searched.full.candidates}
    beyond = tuple(replace(c, wrong=wrong_channel(c, effects[c.name], card)) for c in beyond)
    causes = tuple(replace(c, beside_wrong=any(other.wrong for other in beyond)) for c in causes)
    unknown = (*searched.unknown, *structure_of(searched, (*unnamed, *beyond)))
    kept = tuple(name for name in kept_of[state.responses.stage] if name not in {c.name for c in beyond})
    causes, beyond = without_conditional(causes, beyond)
    pairs = [selection.cancelling(x, [c.name for c in causes if c.stage == stage]) for stage, x in stages.items()]
    of_sensors = searched.sensors.minor if searched.sensors else ()
    same = ("noise", "not_testable", "sensors", "changes", "terms", "unreliable")
    return result.Diagnosis(
        verdict=result.Verdict.UNDECIDED,
        causes=causes,
        minor=(*of_sensors, *searched.model.minor, *(c.name for c in unnamed)),
        unknown=unknown,
        aerodynamics=searched.model,
        split=selection.split_name(state),
        base_moves=moves_of(searched.model),
        kept=kept,
        failures=(*searched.failures, *failed),
        notes=(*left_out, *searched.notes),
        together=tuple(pair for of_stage in pairs for pair in of_stage),
        beyond=beyond,
        tested=None if searched.testable_now else result.Tested({}),
        compared=state.responses.stage,
        gusts=gusts,
        absorbed=selection.absorbed(searched.model),
        **{name: getattr(searched, name) for name in same},
    ).judged()


Kept = Mapping[str, tuple[str, ...]]  # by stage, additions that hold-out data confirm


def _confirmed(searched: SearchResult, progress: Progress) -> tuple[list[result.Cause], Kept, tuple[str, ...]]:
    """Causes with what unseen data say of them, the additions of every stage that these confirm, and failures."""

    def tested() -> tuple[list[result.Cause], Kept]:
        """Without a confirmed cause by which hold-out data are predicted worse: all together, or one output."""
        confirmations = {stage: selection.confirmation(extension.state) for stage, extension in searched.stages.items()}
        while True:
            causes, degrades = causes_of(searched, confirmations, progress), searched.full.settings.degrades
            losing = [c for c in causes if c.confirmed and (c.gain.degraded or degrades(c.gain.elpd, c.gain.elpd_se))]
            if not losing:
                return causes, {stage: sure.kept for stage, sure in confirmations.items()}
            last, sure = losing[-1], confirmations[losing[-1].stage]
            confirmations[last.stage] = replace(sure, kept=tuple(name for name in sure.kept if name != last.name))

    causes, failures = attempted("No cause was tested on hold-out data", tested, None)
    if causes is not None:
        return (*causes, failures)
    untested = [replace(cause, confirmed=False) for cause in causes_of(searched, {}, quiet)]
    return untested, dict.fromkeys(searched.stages, ()), failures


def without_conditional(
    causes: Sequence[result.Cause], beyond: Sequence[result.Cause]
) -> tuple[tuple[result.Cause, ...], tuple[result.Cause, ...]]:
    """Causes, and `beyond` with those that were estimated together with one of them: these hold only beside it."""
    joint = [c for c in causes if any(cause.name in c.joint and cause.stage == c.stage for cause in beyond)]
    return tuple(c for c in causes if c not in joint), (*beyond, *joint)


def causes_of(
    searched: SearchResult, confirmations: Mapping[str, result.Confirmation], progress: Progress
) -> list[result.Cause]:
    """Causes of every stage; of selections that were repeated without what is too large, that."""
    causes = list[result.Cause]()
    for stage, extension in searched.stages.items():
        sure, measured = confirmations.get(stage), {}
        if sure is not None and extension.causes:
            measured = gains_of(extension, searched.model, sure.kept, progress)
        forms = searched.forms if extension is searched.model else {}
        causes += _causes_in(searched.full, stage, extension, extension.causes, sure, measured, forms)
        for larger in extension.larger:
            out = selection.without_hold(larger) if stage == result.FLIGHT_PATH else larger.implausible
            causes += _causes_in(searched.full, stage, larger, [n for n in larger.causes if n in out], None, {}, {})
    return causes


def _causes_in(
    full: selection_state.CandidateModel,
    stage: str,
    extension: selection.Extension,
    names: Sequence[str],
    sure: result.Confirmation | None,
    measured: Mapping[str, result.Gain],
    forms: Mapping[str, tuple[str, float]],
) -> list[result.Cause]:
    causes, state = list[result.Cause](), extension.state
    if not names:
        return causes
    joint, noise = selection.correlated(extension, extension.causes), selection.noise_shares(state)
    undecided = {e.name: e.imitators for e in open_errors(extension)} if stage == result.FLIGHT_PATH else {}
    effects = {e.name: e for e in full.candidates}
    for name in names:
        effect, in_place = effects[name], dict[str, tuple[float, float]]()
        probability, others = rivals_of(extension, name, noise=noise[name])
        if sure is not None and name in sure.kept:
            in_place = rival_gains(extension, name, others, sure.kept)
            if worse := [rival for rival, gain in in_place.items() if full.settings.degrades(*gain)]:
                probability, others = rivals_of(extension, name, worse, noise[name])
        if name in forms:  # the odds of the form against the cause
            probability = float(1.0 / (1.0 / max(probability, 1e-300) + math.exp(min(-forms[name][1], 700.0))))
            others = (*others, forms[name][0])
        gain = measured.get(name, NO_GAIN)
        causes.append(
            result.Cause(
                name=name,
                kind=effect.kind.value,
                claim=effect.claim,
                stage=stage,
                probability=probability,
                p_value=next((s.p_value for s in extension.steps if s.chosen == name), float("nan")),
                ambiguous_with=tuple(dict.fromkeys((*others, *undecided.get(name, ())))),
                parameters={p.name: extension.sizes[p.name] for p in effect.parameters},
                gain=gain if sure is None else _with_harm(gain, sure, name),
                excited=_excited(state, name),
                confirmed=sure is None or name in sure.kept,
                missed=NOTHING if sure is None else sure.missed[name],
                implausible=selection.implausible(effect, extension.sizes),
                own_share=own_share(state, name),
                joint=joint.get(name, {}),
                rival_gains={rival: gain for rival, gain in in_place.items() if rival in others},
            )
        )
    return causes


def _with_harm(gain: result.Gain, sure: result.Confirmation, name: str) -> result.Gain:
    return replace(gain, degraded={**gain.degraded, **sure.harmed.get(name, {})})


def structure_of(searched: SearchResult, unnamed: Sequence[result.Cause]) -> tuple[result.UnexplainedStructure, ...]:
    """What the record shows and cannot attribute: to one of several rivals, or to a size that no aircraft has."""
    effects, described = {e.name: e for e in searched.full.candidates}, {u.coefficient for u in searched.unknown}
    structures = []
    for c in (c for c in unnamed if (c.kind not in SENSOR_KINDS if c.implausible else c.ambiguous_with)):
        structure = as_structure(c, searched.stages[c.stage], effects[c.name])
        enough = structure.share >= searched.full.settings.unnamed_share and structure.coefficient not in described
        if c.name in searched.stages[c.stage].state.active or enough:
            structures.append(structure)
    return tuple(structures)


def moves_of(extension: selection.Extension) -> Mapping[str, tuple[float, float, float]]:
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
    extension: selection.Extension, name: str, worse: Sequence[str] = (), noise: float = 0.0
) -> tuple[float, tuple[str, ...]]:
    """Probability of a cause among everything that could take its place, nothing included; and who comes close."""
    # Left out is what predicts hold-out data `worse`, only hides noise, or must be larger than aircraft have.
    state, effects, best = extension.state, {e.name: e for e in extension.state.full.candidates}, {}
    out = {*worse, *(n for larger in extension.larger for n in larger.implausible)}
    for standing in screen(state, without=name).candidate_scores:
        able = standing.score > state.settings.least_rival_score and not selection.mixes_noise(state, standing)
        able = able and not selection.implausible_candidate(effects[standing.effect], standing)
        if standing.effect == name or (able and standing.effect not in out):
            best.setdefault(standing.effect, standing)
    if name not in best:
        return 1.0, ()
    itself = replace(best[name], gain=best[name].gain * (1.0 - noise) ** 2)
    less = {effect: itself.nats(s) for effect, s in best.items()}
    nothing = np.exp(-nats(max(itself.gain, 0.0), itself.variance_inflation))
    close = tuple(effect for effect, x in less.items() if effect != name and x < state.settings.ambiguous)
    return float(1.0 / (sum(np.exp(min(0.0, -x)) for x in less.values()) + nothing)), close


def sensors_not_missed(diagnosis: result.Diagnosis, flights: result.Confirmation) -> result.Confirmation:
    # Coefficients are a regression on recorded channels, whose noise bends it as an error of a sensor may. A simulated
    # flight has no regressors.
    measured = {c.name for c in diagnosis.causes if c.kind == Kind.MEASUREMENT and c.stage == result.COEFFICIENTS}
    return replace(flights, missed={n: x for n, x in flights.missed.items() if n in measured - {*flights.kept}})


def judged_on_held_out_flights(
    diagnosis: result.Diagnosis, flights: result.Confirmation, held: Collection[str] = ()
) -> result.Diagnosis:
    """The diagnosis with causes confirmed by held-out flights, or not; one with parameters `held` was not tested."""

    def judged(c: result.Cause) -> result.Cause:
        if c.name not in flights.missed:
            return replace(c, confirmed=False) if set(held) & set(c.parameters) else c
        gain, kept = _with_harm(c.gain, flights, c.name), c.name in flights.kept
        return replace(c, confirmed=kept, missed=flights.missed[c.name], gain=gain)

    return diagnosis.judged(causes=tuple(map(judged, diagnosis.causes)))


SAME_UNIT = 0.05  # logarithm within which a factor is that of a unit: twice an estimate's and a sensor's own error
NOTHING = (float("nan"), float("nan"))
Pairs = dict[str, tuple[selection.LeftOut, selection.LeftOut]]  # hold-out data without and with each cause
NO_GAIN = result.Gain(*NOTHING, "not measured", {}, {})


def gains_of(
    extension: selection.Extension, aerodynamics: selection.Extension, kept: Sequence[str], progress: Progress
) -> dict[str, result.Gain]:
    """Gains of an extension's causes on left-out folds, each beside nuisances and the confirmed causes before it."""
    state, causes, name_of_split = extension.state, extension.causes, selection.split_name(extension.state)
    nuisances = [name for name in extension.minor if name in kept]

    def chain(left_out: Callable[[list[str]], selection.LeftOut]) -> tuple[selection.LeftOut, Pairs]:
        base = before = left_out([])
        pairs, sure = Pairs(), list[str]()
        for number, name in enumerate(causes):
            progress("gain on hold-out data", number / len(causes))
            pairs[name] = before, left_out([*sure, name])
            if name in kept:
                before, sure = pairs[name][1], [*sure, name]
        return base, pairs

    base, pairs = chain(lambda names: selection.LeftOut.refitted(selection.truncated(state, (*nuisances, *names))))
    gained = {name: (*after.gain(before), name_of_split) for name, (before, after) in pairs.items()}
    if state.of_coefficients:
        measured = selection.measured_blocks(state)
        first = base.scores(measured)
        return {n: result.Gain(*gained[n], first, after.scores(measured)) for n, (_, after) in pairs.items()}
    if extension is aerodynamics:  # no coefficients to score
        return {name: result.Gain(*gain, {}, {}) for name, gain in gained.items()}
    card, gains = aerodynamics.base, {}

    def corrected(sensors: Sequence[str]) -> selection.LeftOut:
        theta = state.full.at_neutral(card.theta, [e for e in state.active if e not in sensors])
        return selection.LeftOut.refitted(moved(card, theta, ()))

    measured, (base, pairs) = selection.measured_blocks(card), chain(corrected)
    first = base.scores(measured)
    for name, (before, after) in pairs.items():  # what each correction does to the coefficients, and what it worsens
        worse = state.settings.degraded(after.output_gains(before))
        gains[name] = result.Gain(*gained[name], first, after.scores(measured), worse)
    return gains


def rival_gains(
    extension: selection.Extension, cause: str, rivals: Sequence[str], kept: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Hold-out log density of each rival in place of a confirmed cause beyond it; minus infinity if too large."""
    state, gains = extension.state, {}
    ranking, others = screen(state, without=cause), [e for e in kept if e != cause]
    reference = selection.LeftOut.refitted(refitted(selection.truncated(state, kept)))
    for rival in rivals:
        if (standing := ranking.of(rival)) is not None:
            other = refitted(selection.added(selection.removed(state, cause), standing))
            other = refitted(selection.truncated(other, [*others, rival]))
            effect = next(e for e in other.full.candidates if e.name == rival)
            values = dict(zip(other.full.model.names, map(float, other.theta), strict=True))
            fitted = {p.name: result.Size(values[p.name], 0.0, p.unit) for p in effect.parameters if p.name in values}
            too_large = selection.implausible(effect, fitted)
            gains[rival] = (-math.inf, 0.0) if too_large else selection.LeftOut.refitted(other).gain(reference)
    return gains


# --- Whether an engineer would sign a cause: sizes that no aircraft has, signals that hardly move, too many rivals.


def own_share(state: SelectionState, effect: str) -> float:
    """Share of what an effect does to the outputs that no other free parameter can do: 1 over its largest VIF."""
    fit = state.best
    at = fit.places([c for c in state.full.own_columns(effect) if c in fit.columns])
    if not at:
        return float("nan")
    S = state.scaled[state.inside][:, :, fit.columns[at]]
    squares = np.einsum("mci,c->i", (S - S.mean(axis=0)) ** 2, 1.0 / fit.variance)
    uncertain = np.diag(selection_state.inverse(fit.normal - np.diag(state.precision[fit.columns])))[at]
    return float(np.max(1.0 / np.maximum(squares * uncertain, 1.0)))


def attributed(
    causes: Sequence[result.Cause], settings: DiagnosisSettings = DEFAULT, stand_ins: Sequence[str] = ()
) -> tuple[tuple[result.Cause, ...], ...]:
    """Causes that the record can attribute; those larger than on any aircraft (another fault is behind); the rest."""

    def named(c: result.Cause) -> bool:  # no more equals than the record can choose among
        few = 1 + len(c.ambiguous_with) <= settings.most_names and (c.confirmed or c.likely)
        return few and c.name not in stand_ins

    beyond, rest = tuple(c for c in causes if c.implausible), [c for c in causes if not c.implausible]
    return tuple(filter(named, rest)), beyond, tuple(c for c in rest if not named(c))


def wrong_channel(cause: result.Cause, effect: Effect, card: Card) -> result.WrongChannel | None:
    """The channel that a cause larger than any error of its sensor scales as a whole."""
    if effect.stage is not Stage.CHANNEL or not effect.name.endswith("_scale"):
        return None
    main, values = effect.channels[0], {name: size.mean for name, size in cause.parameters.items()}
    made = effect.increments(values, {name: np.ones(1) for name in effect.channels}, card.aircraft, {})
    times = float(1.0 / (1.0 + made[main][0]))
    names = tuple(c.name for c in card.channels if c.name in (main, f"{main}_left", f"{main}_right")) or (main,)
    units = other_units(card, names[0], unit_choices(names[0]))
    return result.WrongChannel(names, times, next((u for u, to in units if abs(math.log(to * times)) < SAME_UNIT), ""))


def stand_ins(
    causes: Sequence[result.Cause], extensions: Mapping[str, selection.Extension], unnamed: Collection[str]
) -> tuple[str, ...]:
    """Causes that the record hardly excites, where the output that they move most has structure `unnamed`."""
    # Small errors of the model change their estimates strongly, and there the model is shown to be wrong.
    return tuple(c.name for c in causes if c.hardly_excited and _output(extensions[c.stage], c.name) in unnamed)


def _output(extension: selection.Extension, name: str, step: CandidateScore | None = None) -> str:
    """The output that an addition, or a candidate with this step, moves most, over what is left there."""
    state = extension.state.wide
    columns, away = state.full.own_columns(name), state.departure
    if name not in state.active and step is not None:
        columns, away = np.array(step.columns, int), dict(zip(step.columns, step.step, strict=False))
    shift = (state.scaled[:, :, columns] @ np.array([away[c] for c in columns]))[state.inside]
    return state.outputs[int(np.argmax(np.mean((shift - shift.mean(axis=0)) ** 2, axis=0) / state.best.variance))]


def as_structure(cause: result.Cause, extension: selection.Extension, effect: Effect) -> result.UnexplainedStructure:
    """What a cause that is none explained: the output of which it takes most, through which channel."""
    standing = screen(extension.state, without=cause.name).of(cause.name)
    share = 0.0 if standing is None else selection.explained(extension.state, standing)
    channel, output = (*effect.channels, effect.kind.value)[0], _output(extension, cause.name, standing)
    return result.UnexplainedStructure(output, channel, share, cause.p_value, (cause.name, *cause.ambiguous_with))


DRAWS = 400  # of a model's parameters, for the intervals of its stall
NOT_SIGNALS = ("X", "measured", "modelled", "residual", *NAMES, *LATERAL)
RESPONSES = ("ax", "ay", "az", "p_dot", "q_dot", "r_dot")  # what the forces make, not what makes them


def view_of(diagnosis: result.Diagnosis) -> result.DiagnosisView:
    """Both models; of coefficients without any correction of the sensors in the card's, at the recorded rate."""
    if not diagnosis.by_coefficients:
        units = {p.name: p.unit for p in diagnosis.aerodynamics.state.full.model.free}
        before, nan = diagnosis.base_moves, float("nan")  # whose standard errors are not known
        moves = {name: result.ParameterMove(a, b, nan, sd, units[name]) for name, (a, b, sd) in before.items()}
        deviations = {name: move.sd_after for name, move in moves.items()}
        shown = {"rankings": rankings_of(diagnosis), "moves": moves}
        covariance = joint_covariance(diagnosis.aerodynamics, deviations, diagnosis.causes)
        return result.DiagnosisView(diagnosis=diagnosis, covariance=covariance, **shown)
    last, sensors = diagnosis.aerodynamics, diagnosis.sensors
    before, after = last.base, last.state
    if sensors is not None and sensors.state.active:
        before = refitted(moved(last.base, last.base.full.at_neutral(last.base.theta, sensors.state.active)))
    if set(diagnosis.kept) != set(last.state.active):  # the part of the extension that hold-out data confirm
        after = refitted(selection.truncated(last.state, diagnosis.kept))
    flights = last.state.responses.flights
    signals = before.responses.predict(before.theta)
    channels = {**before.responses.flights.channels, **signals}  # one abscissa for both models
    card, extended = (_fitted(model, signals["measured"], channels) for model in (before, after))
    return result.View(
        diagnosis=diagnosis,
        card=card,
        extended=extended,
        measured=signals["measured"],
        manoeuvre=flights.manoeuvre,
        time=np.concatenate([t - t[0] for t in selection_state.by_manoeuvre(flights.time, flights)]),
        names=flights.names,
        channels=channels,
        parameters=card.state.full.model.parameters,
        rankings=rankings_of(diagnosis),
        moves=_moves(card, extended),
        covariance=joint_covariance(extended, {}, diagnosis.causes),
    )


def with_stalls(view: result.View) -> result.View:
    models, stalls = {"card": view.card, "extended": view.extended} if view.changed else {"card": view.card}, {}
    for name, fitted in models.items():  # parameters are drawn from the normal distribution of their estimates
        model, flights = fitted.state.full.model, fitted.state.responses.flights
        draws = selection.normal_draws(fitted.state.theta, *covariance_of(fitted), model.free, 0, DRAWS)
        signals = {channel: x for channel, x in fitted.signals.items() if channel not in NOT_SIGNALS}
        stalls[name] = stall_of(model, draws, signals, flights.aircraft)
    return replace(view, stalls=stalls)


def _fitted(state: SelectionState, measured: Float[np.ndarray, "n c"], channels: Mapping[str, Any]) -> result.Fitted:
    """A model evaluated; by coefficient, the mean residual over each recorded channel that makes forces."""
    signals = state.responses.predict(state.theta)
    residual = signals["residual"][:, : len(state.outputs)]
    block, recorded = state.responses.block, (*state.responses.flights.recorded, "alpha_dot", "elapsed", "X")
    names = [name for name in recorded if name in channels and name not in RESPONSES]
    blocks = {name: np.asarray(block(jnp.asarray(channels[name]))) for name in names}
    each = [np.asarray(block(x)) for x in residual.T]
    over = tuple(tuple(profiles(x, blocks, state.variance_inflation)) for x in each)
    # Each coefficient's residuals: scores, Theil's parts, lag 1, and calibration of the fitted noise.
    standard = (state.left() / np.sqrt(state.best.variance))[state.inside]
    manoeuvre, composition = state.responses.flights.manoeuvre, {}
    for c, name in enumerate(state.outputs):
        z, e = measured[:, c], residual[:, c]
        scores, parts = score(z, z - e), result.theil_parts(z, z - e)
        within = {f"{p:g}": np.abs(standard[:, c]) <= stats.norm.ppf(0.5 + p / 2) for p in result.LEVELS}
        composition[name] = {
            **{key: getattr(scores, key) for key in ("r", "rmse", "r2")},
            "theil": parts.theil,
            **{f"theil_{part}": getattr(parts, part) for part in ("bias", "variance", "covariance")},
            "lag1": lag1_within(e, manoeuvre),
            "calibration": {level: float(np.mean(x)) for level, x in within.items()},
        }
    return result.Fitted(residual, signals, composition, over, state)


BINS = 12
LEAST = 1e-3  # of the residual's size, that a deviation counts as at least: a simulation at rest has none


def profiles(
    residual: np.ndarray, channels: Mapping[str, np.ndarray], inflation: float
) -> list[result.ResidualProfile]:
    dependences, bins = [], max(1, min(BINS, len(residual) // 2))  # of two blocks: they have a deviation
    least = max(LEAST * float(np.sqrt(np.mean(residual**2))), 1e-300)
    for name, x in channels.items():
        if np.ptp(x) > 1e-9 * max(1.0, float(np.abs(x).max())):
            parts = np.array_split(np.argsort(x, kind="stable"), bins)
            mean, centre = (np.array([y[p].mean() for p in parts]) for y in (residual, x))
            sd = np.array([residual[p].std() * np.sqrt(inflation / len(p)) for p in parts])
            clear = float(np.sum((mean / np.maximum(sd, least)) ** 2))
            dependences.append((-clear, result.ResidualProfile(name, centre, mean, sd)))
    return [profile for _, profile in sorted(dependences, key=lambda pair: pair[0])]


def _moves(before: result.Fitted, after: result.Fitted) -> dict[str, result.ParameterMove]:
    full, moves, (sd, sd_after) = after.state.full, {}, ({}, {})
    for deviations, fitted in ((sd, before), (sd_after, after)):
        columns, covariance = covariance_of(fitted)
        roots = map(float, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
        deviations |= dict(zip((fitted.state.full.model.names[c] for c in columns), roots, strict=True))
    for name in (p for e in full.base for p in full.parameters_of(e) if p in sd and p in sd_after):
        (i,) = map(int, full.columns([name]))
        values = float(before.state.theta[i]), float(after.state.theta[i])
        moves[name] = result.ParameterMove(*values, sd[name], sd_after[name], full.model.free[i].unit)
    return moves


def covariance_of(model: result.Fitted | selection.Extension) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """Which parameters were fitted, and the covariance of their estimates that coloured residuals leave."""
    columns = model.state.best.columns
    parameters = np.flatnonzero(columns < len(model.state.theta))
    return columns[parameters], uncertainty(model.state)[np.ix_(parameters, parameters)]


def joint_covariance(
    model: result.Fitted | selection.Extension, deviations: Mapping[str, float], causes: Sequence[result.Cause]
) -> tuple[tuple[str, ...], Float[np.ndarray, "k k"]]:
    """Of the extended model's parameters, as standard errors are reported: `deviations`, and those of `causes`."""
    # A parameter may be reported with a larger error than coloured residuals leave: noise of the recorded regressors
    # and the scatter between stretches count, too. What is beyond is independent of the other parameters.
    columns, covariance = covariance_of(model)
    names = tuple(model.state.full.model.names[c] for c in columns)
    reported = dict(deviations) | {name: size.sd for cause in causes for name, size in cause.parameters.items()}
    variance = np.diag(covariance)
    beyond = [max(reported.get(name, 0.0) ** 2 - square, 0.0) for name, square in zip(names, variance, strict=True)]
    return names, 0.5 * (covariance + covariance.T) + np.diag(beyond)  # symmetric but for rounding


def holdout_scores(view: result.View) -> result.HoldoutScores:
    """Fit both models again without each fold, and score each manoeuvre by these fits and by those to all data."""
    models = {"card": view.card.state, "extended": view.extended.state}
    left, state = {name: selection.LeftOut.refitted(full) for name, full in models.items()}, view.extended.state
    measured, scores, gains = selection.measured_blocks(state), {}, {}
    for k, manoeuvre in enumerate(view.names):
        here = (state.responses.manoeuvre == k) & left["extended"].inside
        for model, full in models.items():
            for split, residual in (("fitted", full.residual), ("hold_out", left[model].residual)):
                scores[model, split, k] = selection.scores_of(state.outputs, measured[here], residual[here])
        differences = compared(left["card"], left["extended"], state, measured, k)
        gains |= {(manoeuvre, name): gain for name, gain in differences.items()}
    return result.HoldoutScores(view.names, scores, gains, state.settings.hold_out)


def with_holdout_scores(view: result.View) -> result.View:
    if len(view.names) == 1 or not view.extended.state.active:
        return view
    return replace(view, holdout=holdout_scores(view))


def compared(
    before: selection.LeftOut, after: selection.LeftOut, state: SelectionState, measured: np.ndarray, manoeuvre: int
) -> dict[str, result.Compared]:
    """`after` against `before` on one manoeuvre, by coefficient; its blocks' order and colour are kept."""
    here = (state.responses.manoeuvre == manoeuvre) & before.inside
    density = (after.densities() - before.densities())[here[before.inside]] / state.variance_inflation
    total = np.sum((measured[here] - measured[here].mean(axis=0)) ** 2, axis=0)
    squares = (before.residual[here] ** 2 - after.residual[here] ** 2) / total

    def summed(x: np.ndarray) -> tuple[float, float]:
        return float(x.sum()), standard_error_of_sum(x, [len(x)])

    return {n: result.Compared(*summed(density[:, c]), *summed(squares[:, c])) for c, n in enumerate(state.outputs)}


def rankings_of(diagnosis: result.Diagnosis) -> tuple[result.Ranking, ...]:
    rankings, stages = [], {result.FLIGHT_PATH: diagnosis.sensors, diagnosis.compared: diagnosis.aerodynamics}
    for stage, extension in ((stage, x) for stage, x in stages.items() if x is not None and x.steps):
        screening, base, ranked = extension.steps[0].screening, extension.base, {}
        effects = {e.name: e for e in base.full.model.effects}
        for s in (s for s in screening.candidate_scores if s.effect not in ranked):
            effect, at = effects[s.effect], base.theta[base.full.own_columns(s.effect)]
            steps = zip(effect.parameters, at, s.step, s.sd, strict=False)
            sizes, p_value = {p.name: (float(x + d), sd) for p, x, d, sd in steps}, screening.p_value(s.score)
            ranked[s.effect] = result.RankedCandidate(
                s.effect, effect.kind.value, s.score, p_value, selection.explained(base, s), sizes
            )
        level = extension.state.settings.false_alarm_rate
        leaders = tuple(sorted(ranked.values(), key=lambda s: -s.score))
        rankings.append(result.Ranking(stage, leaders, screening.threshold(level), level))
    return tuple(rankings)


# --- Sizes of the causes in a band of frequencies, beside those of the coefficients: bias and drift drop out there.
# The extended model is fitted again to the finite Fourier transforms of the coefficients, with the errors of sensors at
# their values. An effect that only a drift or a slow model error has made is smaller in the band, or gone.

PERIODS = 2.0  # of the lowest frequency in the shortest manoeuvre
POWER, BEYOND = 0.95, 2.0  # share of the rates' power below a frequency, and how far beyond it the band reaches
HIGHEST, SMOOTHED = 0.5, 0.1  # Hz to which it reaches at least; share of the sampling rate that the filters pass


def causes_in_band(diagnosis: result.Diagnosis) -> result.CausesInBand | None:
    """Fit the causes of a diagnosis in a band; None where there are none."""
    wanted = {p: c for c in diagnosis.causes if c.stage == result.COEFFICIENTS for p in c.parameters}
    if not (diagnosis.by_coefficients and wanted):
        return None
    state = diagnosis.aerodynamics.state
    wanted = {p: c for p, c in wanted.items() if c.name in state.active}
    model, start = with_sensor_errors_held(state)
    flights = state.responses.flights
    band = band_of(flights)
    responses = FrequencyError.in_band(flights, model, band)
    fit = without_noise_bias_in_band(fit_in_band(responses, model.free, start, band), responses, model.free)
    if not fit.converged:
        return result.CausesInBand(band, (), tuple(wanted), converged=False)
    shared = _shared(fit, state, model.names)
    sizes = []
    for name, cause in wanted.items():
        if name in fit.names:
            k, size = fit.names.index(name), cause.parameters[name]
            x, sd = float(fit.estimate[k]), float(fit.crb_corrected[k])
            # Of an estimate and one that rests on a part of its data, as `beside_time_domain` has it.
            least = max(abs(sd**2 - size.sd**2), MIN_SHARE * sd**2)
            apart = abs(x - size.mean) / float(np.sqrt(max(size.sd**2 + sd**2 - 2.0 * shared[k], least)))
            sizes.append(result.SizeInBand(cause.name, name, size.unit, (x, sd), (size.mean, size.sd), apart))
    return result.CausesInBand(band, tuple(sizes), tuple(n for n in wanted if n not in fit.names), converged=True)


def with_sensor_errors_held(state: SelectionState) -> tuple[Model, Float[np.ndarray, " k"]]:
    """The model of the coefficients, and the values of its free parameters (k,). Sensor errors keep their values."""
    values = dict(zip(state.full.model.names, map(float, state.theta), strict=True))
    free = {p for name in (*state.full.base, *state.active) for p in state.full.parameters_of(name)}
    away = {name for name, by in zip(values, state.departure, strict=True) if by != 0.0}
    model = narrowed(state, [e.name for e in state.full.model.effects if any(p.name in away for p in e.parameters)])
    held = {p.name: values[p.name] for p in model.free if p.name not in free}
    model = replace(model, fixed=(*model.fixed, *held.items()))
    return model, np.array([values[name] for name in model.names])


def _shared(fit: FrequencyFit, state: SelectionState, names: Sequence[str]) -> np.ndarray:
    """Covariance of each estimate with that of the whole record, in which the parameters `names` are free; (k,)."""
    # The share of the band in the information, times the variance in the band.
    outputs = [state.outputs.index(name) for name in fit.inner]
    residual, S = state.residual[:, outputs], state.S[:, outputs][:, :, state.full.columns(names)]
    R = np.mean(np.square(residual), axis=0)
    _, D = cramer_rao(S, R)
    blocks = sum(state.responses.flights.lengths) / len(residual)
    place = [names.index(name) for name in fit.names]
    inner = sum(of / r for of, r in zip(fit.inner.values(), R, strict=True)) / blocks
    return np.nan_to_num(np.diag(D[np.ix_(place, place)] @ inner @ fit.corrected))


def band_of(flights: Flights) -> Band:
    """The band that the manoeuvres excite, Hz, as far as the smoothing filters pass."""
    times, reach = sampling_times(flights), 0.0
    low = PERIODS / min(n * dt for n, dt in zip(flights.lengths, times, strict=True))
    for name in (name for name in ("p", "q", "r") if name in flights.recorded):
        for x, dt in zip(selection_state.by_manoeuvre(np.asarray(flights.channels[name]), flights), times, strict=True):
            power = np.abs(np.fft.rfft(x - x.mean())) ** 2
            if power.sum() > 0.0:
                share = np.cumsum(power) / power.sum()
                reach = max(reach, float(np.fft.rfftfreq(len(x), dt)[np.searchsorted(share, POWER)]))
    passed = SMOOTHED / max(times)
    return low, float(min(max(BEYOND * reach, HIGHEST, 4.0 * low), max(passed, 4.0 * low)))
