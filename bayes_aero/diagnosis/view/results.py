"""What is shown of a diagnosis, as plain data: both models at every sample, rankings, scores on hold-out data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.screening.regression import RegressionFit
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.trajectories.results import Trajectories
from bayes_aero.inference.results import Stall
from bayes_aero.inference.scores import Scores
from bayes_aero.parameter import Parameter

LEADERS = 10  # candidates of a stage that are listed, by their scores
CONSIDERED = 3  # and by the share of what is left that they explain
LEVELS = (0.5, 0.9, 0.95)


@dataclass(frozen=True)
class ResidualProfile:
    """Mean residual of a coefficient in bins of equal count of a channel, and the deviation of each mean."""

    channel: str
    centre: Float[np.ndarray, " b"]
    mean: Float[np.ndarray, " b"]
    deviation: Float[np.ndarray, " b"]


@dataclass(frozen=True)
class Fitted:
    """One model fitted to all manoeuvres."""

    residual: Float[np.ndarray, "n c"]  # of the coefficients at the recorded rate
    signals: Mapping[str, np.ndarray]  # what explains the coefficients, by name, (n,)
    # By coefficient: scores, Theil's parts, autocorrelation at lag 1 and calibration of the residuals.
    composition: Mapping[str, Mapping[str, Any]]
    profiles: tuple[tuple[ResidualProfile, ...], ...]  # by coefficient, the clearest dependence first
    state: SelectionState  # the regression problem at its optimum
    fit: RegressionFit


@dataclass(frozen=True)
class ParameterMove:
    """A parameter of the card before and after the causes are added; standard errors count the autocorrelation."""

    before: float
    after: float
    sd_before: float
    sd_after: float
    unit: str


@dataclass(frozen=True)
class JointCovariance:
    """Covariance (k, k) of the extended model's estimates, SI, for coloured residuals; `names` (k) are its rows."""

    names: tuple[str, ...]
    matrix: Float[np.ndarray, "k k"]


@dataclass(frozen=True)
class RankedCandidate:
    """One candidate of a stage's first screening, at its best value."""

    effect: str
    kind: str
    score: float
    p_value: float
    explains: float  # share of the remaining variance that it would take away, by which candidates are taken in turn
    estimate: Mapping[str, tuple[float, float]]  # and standard error, by parameter


@dataclass(frozen=True)
class Ranking:
    """Candidates of one stage, the highest score first; `threshold` is what noise alone exceeds in a share `level`."""

    stage: str
    candidate_scores: tuple[RankedCandidate, ...]
    threshold: float
    level: float

    @property
    def leaders(self) -> tuple[RankedCandidate, ...]:
        """Those that tables and figures show: the `LEADERS` highest scores, and what is considered first."""
        first = {s.effect for s in sorted(self.candidate_scores, key=lambda s: -s.explains)[:CONSIDERED]}
        return tuple(s for k, s in enumerate(self.candidate_scores) if k < LEADERS or s.effect in first)


@dataclass(frozen=True)
class Compared:
    """What one model gains on another in one coefficient of one manoeuvre, unseen; each with its deviation."""

    elpd: float  # log density, nats, the colour's cost counted, where noise grows with separated flow as it was found
    elpd_sd: float
    r2: float  # difference of R2, which weighs every sample alike and so hangs on the few of the deepest stall
    r2_sd: float


@dataclass(frozen=True)
class HoldoutScores:
    """Both models on each manoeuvre, in the fit and on hold-out data (means over blocks of about 5 Hz)."""

    names: tuple[str, ...]  # of the manoeuvres
    # Of each coefficient, by model (`card`, `extended`), data (`fitted`, `hold_out`) and the manoeuvre's number.
    scores: Mapping[tuple[str, str, int], Mapping[str, Scores]]
    gains: Mapping[tuple[str, str], Compared]  # of the extended model, on hold-out data, by manoeuvre and coefficient
    hold_out: float  # standard errors of a loss that is significant

    def worse(self) -> list[tuple[str, str]]:
        """Manoeuvres and coefficients for which the extended model loses log density significantly (one-sided, 5 %)."""
        return [pair for pair, gain in self.gains.items() if gain.elpd < -self.hold_out * gain.elpd_sd]


@dataclass(frozen=True, kw_only=True)
class DiagnosisView:
    """A diagnosis with what is derived from it, by coefficients (see `View`) or by trajectories alone."""

    diagnosis: Diagnosis
    rankings: tuple[Ranking, ...]
    moves: Mapping[str, ParameterMove]
    covariance: JointCovariance | None = None
    trajectories: Trajectories | None = None

    @property
    def unseen_scores(self) -> tuple[Mapping[str, Scores], Mapping[str, Scores]] | None:
        """Scores of each coefficient on hold-out data: the card's model, and with all causes that are confirmed."""
        measured = [c.gain for c in self.diagnosis.causes if c.gain.before]
        if not measured:
            return None
        confirmed = [c.gain for c in self.diagnosis.causes if c.gain.before and c.confirmed]
        return measured[0].before, confirmed[-1].after if confirmed else measured[0].before


@dataclass(frozen=True, kw_only=True)
class View(DiagnosisView):
    """A diagnosis by coefficients."""

    card: Fitted
    extended: Fitted
    measured: Float[np.ndarray, "n c"]  # coefficients that the card reconstructs
    manoeuvre: Int[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]  # from the start of each manoeuvre, s
    names: tuple[str, ...]
    channels: Mapping[str, Any]  # (n,) all that was recorded or derived, as the card's model has them
    parameters: tuple[Parameter, ...]
    stalls: Mapping[str, Stall] = field(default_factory=dict)  # by model: card, and extended where it differs
    holdout: HoldoutScores | None = None  # None where it was not computed

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return self.card.state.outputs

    @property
    def changed(self) -> bool:
        """Whether anything was added to the card's model."""
        sensors = self.diagnosis.sensors
        return bool(self.extended.state.active or (sensors is not None and sensors.state.active))

    @property
    def seconds(self) -> float:
        """Sampling time, s."""
        return float(np.median(np.diff(self.time[self.manoeuvre == 0])))
