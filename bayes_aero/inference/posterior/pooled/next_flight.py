"""From fits of single manoeuvres to the parameters of a flight not yet flown."""

from __future__ import annotations

import time
from collections.abc import Mapping

import arviz_base as azb
import numpy as np
from jaxtyping import Float

from bayes_aero.errors import InputError
from bayes_aero.inference.likelihood.mle import MAX_SEPARATE_FITS
from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.inference.posterior.assembly import diagnose
from bayes_aero.inference.posterior.pooled.hierarchy import SCATTER, Hierarchy, Pooled, pool
from bayes_aero.inference.posterior.pooled.next_flight_result import NextFlight
from bayes_aero.inference.posterior.pooled.normal_estimates import (
    NormalEstimates,
    from_prior_units,
    normal_estimates,
    prior_unit,
)
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Observations
from bayes_aero.progress import Progress

HALF_NORMAL_SD = SCATTER * np.sqrt(1.0 - 2.0 / np.pi)
SHAPES = {name: ["parameter"] for name in ("aircraft", "scatter", "next_flight")}


def check_manoeuvres(count: int) -> None:
    """Refuse records from which no scatter between manoeuvres follows, before anything is computed.

    Raises:
        InputError: there is one manoeuvre, or more than are fitted one by one.
    """
    if not 1 < count <= MAX_SEPARATE_FITS:
        raise InputError(
            f"the next flight needs 2 to {MAX_SEPARATE_FITS} manoeuvres, and there {'is' if count == 1 else 'are'} "
            f"{count}; give other records, or divide a file by --split or parts like flight.csv@12.5:40"
        )


def next_flight(
    model: Model,
    observations: Observations,
    alone: Mapping[str, MleResult],
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> NextFlight:
    """Pool the manoeuvres' own fits: parameters scatter around the aircraft's, by an amount that is sampled.

    Args:
        model: of the fits.
        observations: of all manoeuvres.
        alone: the fits by manoeuvre.
        seed: of chains and draws.
        progress: called after each block of draws.

    Returns:
        Aircraft, scatter, manoeuvres and next flight, in SI and radians.

    Raises:
        InputError: fewer than two of the fits are usable.
    """
    began = time.perf_counter()
    given = normal_estimates(model, observations, alone)
    if len(given.names) < 2:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in given.left_out.items())
        raise InputError(f"fewer than two manoeuvres have a usable fit of their own ({reasons}); add manoeuvres")
    drawn, sampled = pool(Hierarchy.of(model.names, given.y, given.information), seed=seed, progress=progress)
    drawn = _in_units(model, drawn)
    return _result(model, alone, given, drawn, sampled, time.perf_counter() - began)


def _in_units(model: Model, drawn: Pooled) -> Pooled:
    """Draws in SI and radians."""

    def converted(v: Float[np.ndarray, "*s k"]) -> Float[np.ndarray, "*s k"]:
        return np.stack([from_prior_units(p.prior, v[..., i]) for i, p in enumerate(model.free)], axis=-1)

    aircraft = converted(drawn.aircraft)
    units = np.stack([prior_unit(p.prior, aircraft[..., i]) for i, p in enumerate(model.free)], axis=-1)
    return Pooled(aircraft, drawn.scatter * units, converted(drawn.following), converted(drawn.manoeuvres))


def _result(
    model: Model,
    alone: Mapping[str, MleResult],
    given: NormalEstimates,
    drawn: Pooled,
    sampled: Posterior,
    seconds: float,
) -> NextFlight:
    names = model.names
    return NextFlight(
        parameters=model.free,
        manoeuvres=given.names,
        alone={name: _own(model, alone[name], given.sd[m]) for m, name in enumerate(given.names)},
        pooled={name: diagnose(drawn.manoeuvres[:, :, m], names) for m, name in enumerate(given.names)},
        aircraft=diagnose(drawn.aircraft, names),
        scatter=diagnose(drawn.scatter, names),
        following=diagnose(drawn.following, names),
        narrowed={name: one.sd / HALF_NORMAL_SD for name, one in sampled.marginals.items()},
        undetermined={
            name: tuple(m for m, says in zip(given.names, given.determined[:, i], strict=True) if not says)
            for i, name in enumerate(names)
            if not np.all(given.determined[:, i])
        },
        left_out=given.left_out,
        tree=_tree(model, given, drawn, sampled),
        status=sampled.status,
        seconds=seconds,
    )


def _own(model: Model, fit: MleResult, sd: Float[np.ndarray, " k"]) -> dict[str, tuple[float, float]]:
    """Estimates with standard errors, of the parameters that have one."""
    pairs = zip(model.free, fit.estimate, sd, strict=True)
    return {p.name: (float(x), float(s * prior_unit(p.prior, x))) for p, x, s in pairs if np.isfinite(s)}


def _tree(model: Model, given: NormalEstimates, drawn: Pooled, sampled: Posterior):
    groups = {
        "posterior": {
            "aircraft": drawn.aircraft,
            "scatter": drawn.scatter,
            "next_flight": drawn.following,
            "manoeuvre": drawn.manoeuvres,
        },
        "sample_stats": {name: np.asarray(x) for name, x in sampled.tree["sample_stats"].to_dataset().items()},
    }
    coords = {"parameter": list(model.names), "flown": list(given.names)}
    tree = azb.from_dict(groups, dims=SHAPES | {"manoeuvre": ["flown", "parameter"]}, coords=coords)
    tree.attrs |= {"engine": sampled.engine, "likelihood": sampled.noise}
    return tree
