"""Parameters by every method of a run in one order, for tables, figures and sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from bayes_aero.inference.results import Identification, MleResult, MleStatus, Posterior
from bayes_aero.model.noise import Colour
from bayes_aero.parameter import Parameter
from bayes_aero.report.tables.table import Estimate

ENGINES = {"emcee": "emcee", "nuts": "NUTS"}
NOISES = {"ar1": "AR(1)", "buffet-ar1": "AR(1) with buffet"}


@dataclass(frozen=True)
class Method:
    """One method of interval estimation: `key` for colours and columns, `label` for readers, estimates by parameter."""

    key: str
    label: str
    estimates: dict[str, Estimate]

    def of(self, names: Iterable[str]) -> list[Estimate | None]:
        """Estimates of the parameters `names`, None where it has none."""
        return [self.estimates.get(name) for name in names]


class Scatter(NamedTuple):
    """One parameter between manoeuvres fitted alone."""

    sd: float  # of the estimates
    in_crb: float  # the largest difference of a pair, in units of its combined Cramer-Rao deviation


def ordered(names: Iterable[str], parameters: Iterable[Parameter]) -> list[str]:
    """Names in the order that their parameters declare; names without an order last."""
    places = {p.name: p.place for p in parameters if p.place is not None}
    return sorted(names, key=lambda name: places.get(name, math.inf))


def flown(identification: Identification) -> list[str]:
    """Fitted parameters with a known true value (simulated records)."""
    truth = identification.truth or {}
    return [name for name in ordered(identification.mle.names, identification.mle.parameters) if name in truth]


def unit_of(identification: Identification, name: str) -> str:
    """The unit of a parameter of the model or of its noise."""
    mle = identification.mle
    return mle.units[mle.names.index(name)] if name in mle.names else "1"


def chosen_posteriors(identification: Identification) -> dict[str, Posterior]:
    """Posteriors under the chosen noise model, by engine."""
    return {key: p for key, p in identification.posteriors.items() if key != "white"}


def white_posterior(identification: Identification) -> Posterior | None:
    """The posterior under white noise, which is also the chosen one where white noise was chosen."""
    if "white" in identification.posteriors or identification.noise is not Colour.WHITE:
        return identification.posteriors.get("white")
    return next(iter(chosen_posteriors(identification).values()), None)


def engine_label(key: str) -> str:
    """Name of an engine for readers."""
    return ENGINES.get(key, key)


def noise_label(noise: str) -> str:
    """Name of a noise model for readers."""
    return NOISES.get(noise, noise)


def methods(identification: Identification) -> list[Method]:
    """Bounds, then posteriors, each with the estimates it has of the model's parameters."""
    mle = identification.mle
    found = [
        Method("crb", "ML, Cramér-Rao bound", bounds(mle, mle.crb)),
        Method("crb_corrected", "ML, corrected bound", bounds(mle, mle.crb_corrected)),
    ]
    posteriors = identification.posteriors
    for key in [*(["white"] if "white" in posteriors else []), *chosen_posteriors(identification)]:
        noise = noise_label(identification.noise)
        label = "emcee, white noise" if key == "white" else f"{engine_label(key)}, {noise} noise"
        marginals = posteriors[key].marginals.items()
        found.append(Method(key, label, {n: Estimate.of(m) for n, m in marginals if n in mle.names}))
    return found


def bounds(mle: MleResult, sd: np.ndarray) -> dict[str, Estimate]:
    """Estimates of a fit with the standard deviations `sd`."""
    return {n: Estimate.normal(x, s) for n, x, s in zip(mle.names, mle.estimate, sd, strict=True)}


def usable(mle: MleResult) -> bool:
    """Whether the numbers of a fit are usable."""
    return mle.status in (MleStatus.CONVERGED, MleStatus.AT_BOUND)


def alone(identification: Identification, name: str) -> dict[str, tuple[float, float, float]]:
    """Estimate, Cramer-Rao bound and corrected bound of `name` by manoeuvre, from usable fits inside their bounds."""
    found = {}
    for manoeuvre, mle in identification.alone.items():
        if usable(mle) and name in mle.names and name not in mle.at_bound:
            i = mle.names.index(name)
            numbers = float(mle.estimate[i]), float(mle.crb[i]), float(mle.crb_corrected[i])
            if np.all(np.isfinite(numbers)):
                found[manoeuvre] = numbers
    return found


def scatter(identification: Identification, name: str) -> Scatter | None:
    """Scatter of `name` between manoeuvres fitted alone; None with fewer than two usable estimates."""
    single = list(alone(identification, name).values())
    if len(single) < 2:
        return None
    largest = max(apart(a[0], b[0], a[1], b[1]) for a, b in combinations(single, 2))
    return Scatter(float(np.std([x for x, _, _ in single], ddof=1)), largest)


def apart(a: float, b: float, sd_a: float, sd_b: float) -> float:
    """|a - b| in units of the standard deviation of the difference of independent estimates."""
    return abs(a - b) / float(np.hypot(sd_a, sd_b))
