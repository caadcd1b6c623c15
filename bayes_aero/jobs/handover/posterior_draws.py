"""Draws of the parameters of a finished result: of its posterior, or of the normal distribution of its estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from bayes_aero.errors import InputError
from bayes_aero.export.identified import Draws, Identified
from bayes_aero.jobs.handover.identified_linear import Finished
from bayes_aero.jobs.handover.identified_result import with_process_noise

SAMPLERS = ("nuts", "emcee")
MOST_DRAWS = 10_000
TRIES = 50  # times as many normal draws are made until enough lie within the bounds


def exported(found: Identified) -> tuple[str, ...]:
    """Free parameters that the exported coefficients need."""
    return tuple(p.name for p in found.exported.free if p.name in found.program.inputs_of("parameter"))


def drawn(
    found: Finished, folder: Path | None, told: Mapping[str, Any], wanted: Sequence[str], count: int, seed: int
) -> Draws:
    """`count` draws of the parameters `wanted` that were fitted.

    A posterior that converged comes first; else estimates and covariance, corrected for coloured residuals, give a
    normal distribution, of which draws beyond a parameter's bounds are left out.

    Raises:
        InputError: the result has neither, or `count` is no sensible number.
    """
    if not 1 <= count <= MOST_DRAWS:
        raise InputError(f"--draws is {count}; give a number from 1 to {MOST_DRAWS}")
    rng = np.random.default_rng(seed)
    for sampler in SAMPLERS:
        status = told.get("posterior", {}).get("status", {}).get(sampler)
        file = None if folder is None else folder / f"posterior_{sampler}.nc"
        if status is not None and status["status"] == "converged" and file is not None and file.is_file():
            return _of_posterior(file, wanted, count, rng, f"posterior by {sampler} under {status['noise']} noise")
    rows, matrix = _stored(told)
    if matrix is None:
        raise InputError(
            f"{found.name}: there is neither a posterior that converged nor a covariance to draw from; run the command "
            "of the result again with this version, or do without draws"
        )
    return _normal(found, wanted, tuple(rows), np.array(matrix, dtype=float), count, rng, with_process_noise(told))


def _stored(told: Mapping[str, Any]) -> tuple[Sequence[str], Sequence[Sequence[float]] | None]:
    """The covariance of the estimates, and the names of its rows; None where the result has none."""
    if "causes" in told:  # a diagnosis
        stored = told.get("covariance")
        return ((), None) if stored is None else (stored["parameters"], stored["matrix"])
    filtered = with_process_noise(told)
    part = told["process_noise"] if filtered else told.get("mle", told)
    return tuple(part["estimates"] if filtered else part["parameters"]), part.get("covariance")


def _of_posterior(file: Path, wanted: Sequence[str], count: int, rng: np.random.Generator, origin: str) -> Draws:
    with xr.open_datatree(file, engine="h5netcdf") as tree:
        posterior = tree["posterior"].to_dataset()
        names = tuple(name for name in wanted if name in posterior)
        values = np.stack([np.asarray(posterior[name]).reshape(-1) for name in names], axis=1)
    if count > len(values):
        raise InputError(f"{file} has {len(values)} draws; give --draws {len(values)} or less")
    return Draws(names, values[rng.choice(len(values), count, replace=False)], origin)


def _normal(
    found: Finished,
    wanted: Sequence[str],
    rows: Sequence[str],
    covariance: Float[np.ndarray, "k k"],
    count: int,
    rng: np.random.Generator,
    filtered: bool,
) -> Draws:
    known = [name in wanted and bool(np.all(np.isfinite(covariance[i]))) for i, name in enumerate(rows)]
    names = tuple(name for name, one in zip(rows, known, strict=True) if one)
    part = covariance[np.ix_(known, known)]
    low, high = np.array([found.bounds[name] for name in names]).T
    centre = np.array([found.values[name] for name in names])
    values, vectors = np.linalg.eigh(part)
    white = rng.standard_normal((TRIES * count, len(names)))
    draws = centre + (white * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    draws = draws[np.all((draws >= low) & (draws <= high), axis=1)][:count]
    if len(draws) < count:
        raise InputError(
            f"{found.name}: almost all normal draws of {', '.join(names)} lie beyond the bounds; sample the posterior "
            "with identify, or fly --posterior"
        )
    held = [name for name in wanted if name not in names]
    origin = "normal distribution of the estimates, " + (
        "covariance of the fit with process noise" if filtered else "covariance corrected for coloured residuals"
    )
    return Draws(names, draws, origin + (f"; {', '.join(held)} held at the estimate" if held else ""))
