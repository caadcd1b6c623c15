"""Whether the chains of samplers may be used, and whether samplers of one density agree."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from bayes_aero.inference.posterior.posterior import Posterior, PosteriorStatus
from bayes_aero.report.tables.comparison import engine_label

MEANS = 0.2  # difference of means, in standard deviations, up to which samplers agree; our choice
SDS = 0.15  # relative difference of standard deviations up to which samplers agree; our choice


def unfinished(posteriors: Mapping[str, Posterior]) -> list[str]:
    """Posteriors that must not be used."""
    return [
        f"The posterior by {engine_label(key) if key != 'white' else 'emcee under white noise'}: {p.status.value}."
        for key, p in posteriors.items()
        if p.status is not PosteriorStatus.CONVERGED
    ]


def agreement_of_engines(posteriors: Mapping[str, Posterior]) -> list[str]:
    """Whether engines that sampled the same density give the same posterior."""
    sentences = []
    for (a, one), (b, two) in combinations(posteriors.items(), 2):
        pairs = {n: (one.marginals[n], two.marginals[n]) for n in one.names if n in two.marginals}
        means = {n: abs(p.mean - q.mean) / np.sqrt((p.sd**2 + q.sd**2) / 2.0) for n, (p, q) in pairs.items()}
        sds = {n: p.sd / q.sd for n, (p, q) in pairs.items()}
        far, wide = max(means, key=lambda n: means[n]), max(sds, key=lambda n: abs(np.log(sds[n])))
        agree = means[far] < MEANS and abs(sds[wide] - 1.0) < SDS
        sentences.append(
            f"{engine_label(a)} and {engine_label(b)} {'agree' if agree else 'disagree'} on the same density: means "
            f"differ by at most {means[far]:.2f} standard deviations ({far}), standard deviations by "
            f"{abs(sds[wide] - 1.0):.0%} ({wide})" + ("." if agree else "; run longer before you use either.")
        )
    return sentences
