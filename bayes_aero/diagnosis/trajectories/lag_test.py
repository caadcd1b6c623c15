"""A lag of the separation point that coefficients leave open, asked of trajectories.

The coefficients follow from the measured angle of attack and its rate, so that a lag and a quasi-steady hysteresis draw
nearly the same loops of a few seconds. Flown, they differ: hysteresis answers alpha-dot at once, so that lift depends
on what it does itself, and a lag does not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import CandidateModel, lag_of
from bayes_aero.diagnosis.selection.forward_selection import Extension, large
from bayes_aero.diagnosis.settings import DEFAULT, DiagnosisSettings
from bayes_aero.diagnosis.trajectories.holdout_fits import CandidateFit, Noise
from bayes_aero.diagnosis.trajectories.log_score import HoldoutScore, holdout_gain
from bayes_aero.diagnosis.trajectories.results import LagTest, Path
from bayes_aero.diagnosis.trajectories.time_histories import posterior_covariance
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.output_biases import with_biases_of
from bayes_aero.effect import Effect, Stage
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult, OutputErrorStatus
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.model import Model

SETTLED = (OutputErrorStatus.CONVERGED, OutputErrorStatus.AT_BOUND)


def open_lag(full: CandidateModel, found: Extension, model: Model) -> Effect | None:
    """The catalogue's lag, if the flow of the extended model separates without one and the last election gives it the
    score of a rival."""
    lag, stages = lag_of(full), {e.stage for e in model.acting}
    if lag is None or Stage.LAG in stages or Stage.SEPARATION not in stages or not found.steps:
        return None
    scores = [s.score for s in found.steps[-1].screening.candidate_scores if s.effect == lag.name]
    return lag if max(scores, default=0.0) >= full.settings.least_rival_score else None


def with_lag(
    model: Model,
    effect: Effect,
    extended: CandidateFit,
    noise: Noise,
    flights: Flights,
    settings: DiagnosisSettings = DEFAULT,
) -> tuple[CandidateFit, LagTest]:
    """`model`, the extended one with the lag, fitted to all from the extended one's optimum.

    Hysteresis that is left at none is held there: the lag stands in for it.
    """
    model = _without_lead(model)
    dynamics = with_biases_of(extended.fit.flown.dynamics, aircraft_dynamics(model, flights))
    fitted = dict(zip(extended.fit.names, map(float, extended.fit.estimate), strict=True))
    start = np.array([fitted.get(p.name, p.start) for p in dynamics.free])
    whole = replace(extended.fit.flown, dynamics=dynamics, substeps=dynamics.substeps(start, flights))
    fit = fit_output_error(whole, start=start, prior_weight=noise.variance_inflation)
    found = dict(zip(fit.names, fit.estimate, strict=True))
    none = {n: x for n, x in _hysteresis(model).items() if n in fit.at_bound and found[n] == x}
    if none:
        fit = fit_output_error(
            whole, start=fit.estimate, departure=fit.departure, held=none, prior_weight=noise.variance_inflation
        )
    gain = -np.inf
    if fit.status in SETTLED and extended.fit.status in SETTLED:
        gain = (extended.fit.cost - fit.cost) / noise.variance_inflation
    own = extended.own | {p.name for p in effect.parameters}
    slight = np.isfinite(gain) and not large(effect, _away(effect, fit, noise.variance_inflation), settings.least_score)
    lag = LagTest(effect.name, float(gain), instead=tuple(none), slight=bool(slight), decisive=settings.decisive)
    return CandidateFit("lagged", fit, own, none), lag


def _away(effect: Effect, fit: OutputErrorResult, inflation: float) -> dict[str, tuple[float, float]]:
    """By parameter of which the effect says what is worth a name: how far from neutral it is, and the deviation."""
    sd = np.sqrt(np.diag(posterior_covariance(fit, inflation)))
    told = {n: (float(x), float(s)) for n, x, s in zip(fit.names, fit.estimate, sd, strict=True)}
    return {p.name: p.away(*told[p.name]) for p in effect.parameters if p.name in effect.sizes}


def confirmed(
    lag: LagTest,
    without: Sequence[Path],
    lagged: Sequence[Path],
    outputs: Sequence[str],
    noise_growth: Sequence[Float[np.ndarray, "_ c"]],
    variance_inflation: float,
    hold_out: float = DEFAULT.hold_out,
) -> LagTest:
    """Kept if hold-out prediction degrades without the lag, as for any cause; both predict the same manoeuvres."""
    before, after = (HoldoutScore.of(paths, outputs, noise_growth) for paths in (without, lagged))
    told = holdout_gain(before, after, variance_inflation)
    return replace(lag, unseen=told, kept=bool(after.inside and told[0] > hold_out * told[1]))


def _hysteresis(model: Model) -> Mapping[str, float]:
    """Parameters of the quasi-steady flow's hysteresis and their neutral values."""
    own = [e for e in model.effects if e.stage is Stage.INCIDENCE and "incidence" in e.example.increments]
    return {name: x for e in own for name, x in e.neutral_values.items()}


def _without_lead(model: Model) -> Model:
    """Hysteresis not below none: beside a lag it would be a lead that cancels it, and mean nothing."""
    own = _hysteresis(model)
    bounded = [
        replace(p, bounds=(max(own[p.name], p.bounds[0]), p.bounds[1])) if p.name in own else p
        for p in model.parameters
    ]
    return replace(model, parameters=tuple(bounded))
