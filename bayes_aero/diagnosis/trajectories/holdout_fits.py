"""Models fitted to all segments of flight but one, and flown on that one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from threading import Event

import equinox as eqx
import numpy as np

from bayes_aero.diagnosis.trajectories.results import Path
from bayes_aero.diagnosis.trajectories.time_histories import paths_of
from bayes_aero.diagnosis.trajectories.variance_inflation import trajectory_variance_inflation
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult
from bayes_aero.inference.threads import cores
from bayes_aero.inference.variance.noise_growth import SeparatedFlow


@dataclass(frozen=True)
class Noise:
    """What a first fit tells of residuals: their variance inflation, how they grow in the stall."""

    variance_inflation: float
    parts: SeparatedFlow | None

    @classmethod
    def of(cls, fit: OutputErrorResult) -> Noise:
        """From a fit to all."""
        return cls(trajectory_variance_inflation(fit), SeparatedFlow.of(fit))

    def on(self, flown: SegmentTrajectories, without: int | None = None) -> SegmentTrajectories:
        """The same segments with their noise_growth; its size is read from all of them, or from all but one."""
        return flown if self.parts is None else replace(flown, noise_growth=self.parts.noise_growth(without))

    def told(self, outputs: Sequence[str]) -> dict[str, float]:
        """By output, how many times more is missed in wholly separated flow than in attached flow."""
        growths = np.zeros(len(outputs)) if self.parts is None else self.parts.growths()
        return {name: 1.0 + float(b) for name, b in zip(outputs, growths, strict=True)}


@dataclass(frozen=True)
class CandidateFit:
    """A model fitted to all segments; `held` parameters are never fitted, `own` are those of its causes.

    `weighed`: samples count by the noise_growth of what is missed.
    """

    name: str
    fit: OutputErrorResult
    own: frozenset[str] = frozenset()
    held: Mapping[str, float] = field(default_factory=dict)
    weighed: bool = True

    def silent(self, segment: int, unidentified: float) -> dict[str, float]:
        """Parameters of causes whose standard error without this segment is `unidentified` times the joint one; joint
        values."""
        if not self.own:
            return {}
        part = fit_output_error(
            masked(self.fit.flown, segment, keep=False),
            start=self.fit.estimate,
            departure=self.fit.departure,
            max_iterations=0,
        )
        told = zip(self.fit.names, self.fit.estimate, part.crb, self.fit.crb, strict=True)
        with np.errstate(invalid="ignore"):
            return {n: float(x) for n, x, alone, all_ in told if n in self.own and not alone < unidentified * all_}


def masked(flown: SegmentTrajectories, segment: int, *, keep: bool) -> SegmentTrajectories:
    """Only one of the segments counts, or all others; the shapes stay, so nothing compiles anew."""
    counts = (np.arange(len(flown.index)) == segment) == keep
    return eqx.tree_at(lambda f: f.inside, flown, flown.inside & counts[:, None])


def left_out(
    contenders: Sequence[CandidateFit], silent: Mapping[str, Mapping[int, Mapping[str, float]]], noise: Noise
) -> Iterator[tuple[str, OutputErrorResult]]:
    """Every contender (its name is told) and segment: the fit to all other segments, its `silent` parameters held.

    Two fits keep as many cores busy as one with twice the segments, so several are made at once.
    """
    count = len(contenders[0].fit.flown.index)
    jobs = [(c, k) for c in contenders for k in range(count)]
    stopped = Event()

    def one(job: tuple[CandidateFit, int]) -> tuple[str, OutputErrorResult]:
        contender, k = job
        fit, held = contender.fit, {**contender.held, **silent[contender.name][k]}
        weighed = noise.on(fit.flown, without=k) if contender.weighed else fit.flown
        options = {"prior_weight": noise.variance_inflation, "stopped": stopped.is_set}
        rest = masked(weighed, k, keep=False)
        return contender.name, fit_output_error(rest, start=fit.estimate, held=held, **options)

    with ThreadPoolExecutor(max(1, cores() // max(1, count - 1))) as pool:
        try:
            yield from pool.map(one, jobs)
        except BaseException:  # Ctrl-C does not wait for whole fits
            stopped.set()
            raise


def holdout_fits(
    contender: CandidateFit,
    fits: Sequence[OutputErrorResult],
    tolerances: Mapping[str, float],
    variance_inflation: float = 1.0,
    seed: int = 0,
) -> list[Path]:
    """Every segment flown from its measured initial state by the fit without it, in order; by draws from that fit's
    posterior, too, where there are tolerances to stay inside."""
    flown, still, name = contender.fit.flown, np.zeros_like(contender.fit.departure), contender.name
    options = {"drawn": bool(tolerances), "variance_inflation": variance_inflation, "seed": seed}
    alone = [masked(flown, k, keep=True) for k in range(len(fits))]
    found = [
        paths_of(f, one, name, "hold_out", still, tolerances, **options) for f, one in zip(fits, alone, strict=True)
    ]
    return [path for paths in found for path in paths]
