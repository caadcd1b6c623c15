"""What is not known of a finished model: draws of its parameters, its next flight, hold-out errors, gusts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from bayes_aero.diagnosis.trajectories.holdout_fits import Noise
from bayes_aero.diagnosis.trajectories.time_histories import posterior_draws
from bayes_aero.diagnosis.trajectories.variance_inflation import trajectory_variance_inflation
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.mle import MAX_SEPARATE_FITS
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.jobs.handover.identified_linear import Finished, IdentifiedLinear
from bayes_aero.jobs.handover.identified_result import with_process_noise
from bayes_aero.jobs.handover.posterior_draws import drawn
from bayes_aero.progress import Progress
from bayes_aero.qualification.qualify import Uncertain
from bayes_aero.qualification.refits import alone_fits, fits_without, hold_out, joint_fit, next_parameters
from bayes_aero.report.text.phrases import several

LENGTH = 533.0  # m, of a gust whose intensity alone is stated: MIL-F-8785C, above 610 m
GUSTS = ("vertical_gust", "longitudinal_gust", "lateral_gust")
NEXT_FLIGHT = "next_flight.nc"


@dataclass(frozen=True)
class Source:
    """A finished result: the model, its folder, what it says."""

    found: Finished
    folder: Path
    told: Mapping[str, Any]

    @property
    def linear(self) -> IdentifiedLinear | None:
        """The model, where it is a linear system."""
        return self.found if isinstance(self.found, IdentifiedLinear) else None

    @property
    def by_trajectories(self) -> bool:
        """Whether output error gave the values."""
        return "fitted_outputs" in self.told and "mle" not in self.told and not with_process_noise(self.told)


def uncertain(
    source: Source,
    flown: SegmentTrajectories,
    draws: int,
    seed: int,
    gusts: float | None,
    progress: Progress | None = None,
) -> tuple[Uncertain, dict[str, str]]:
    """What is not known of the model, and a sentence on where each part comes from.

    Args:
        source: the result.
        flown: its records, with the outputs that have a band.
        draws: how many.
        seed: of all draws.
        gusts: a stated intensity, m/s; None: what the result has estimated.
        progress: called with a stage and the share of it that is done.
    """
    names = flown.dynamics.names
    estimate = np.array([source.found.values[name] for name in names])
    values, said = _draws(source, flown, estimate, draws, seed)
    model = Uncertain(estimate, values, fitted=source.by_trajectories)
    origins = {"parameters": said}
    if source.by_trajectories:
        model, more = _refitted(source, model, flown, seed, progress)
        origins |= more
    else:
        origins["structure"] = (
            "The errors of the simulated records, less what the parameters explain: the parameters were not fitted to "
            "these trajectories."
        )
        following = _of_identify(source, names, estimate, draws, seed)
        model = replace(model, following=following)
        origins["next flight"] = (
            f"Partial pooling of the manoeuvres by identify ({NEXT_FLIGHT})."
            if following is not None
            else "Not counted by itself: the result has no scatter between manoeuvres (identify --next-flight has). "
            "The errors of the records hold it."
        )
    found, stated, said = _gusts(source, gusts)
    return replace(model, gusts=found, met=not stated), origins | {"gusts": said}


def _draws(
    source: Source, flown: SegmentTrajectories, estimate: Float[np.ndarray, " k"], count: int, seed: int
) -> tuple[Float[np.ndarray, "m k"], str]:
    """Of the parameters; those that the result does not determine stay at their estimate."""
    names = flown.dynamics.names
    if "causes" in source.told:
        fit = fit_output_error(flown, start=estimate, max_iterations=0)
        inflation = trajectory_variance_inflation(fit)
        return posterior_draws(fit, inflation, seed, count), (
            "Normal distribution about the estimates; the covariance is that of the trajectories at these values, for "
            f"coloured residuals (variances times {inflation:.3g})."
        )
    found = drawn(source.found, source.folder, source.told, names, count, seed)
    values = np.tile(estimate, (count, 1))
    for column, name in enumerate(found.names):
        values[:, names.index(name)] = found.values[:, column]
    return values, f"{found.origin[0].upper()}{found.origin[1:]}."


def _refitted(
    source: Source, model: Uncertain, flown: SegmentTrajectories, seed: int, progress: Progress | None
) -> tuple[Uncertain, dict[str, str]]:
    """Hold-out errors and the scatter between manoeuvres, where there are at least two."""
    count = len(flown.index)
    own = source.linear.rows.by_manoeuvre if source.linear is not None else ()
    alone = "The errors of the fitted records, which are smaller than those of a flight that was not fitted"
    if not 1 < count <= MAX_SEPARATE_FITS:
        return model, {
            "structure": f"{alone}: with {count} manoeuvre{'s' if count > 1 else ''} none was left out.",
            "next flight": f"Not counted: it needs 2 to {MAX_SEPARATE_FITS} manoeuvres.",
        }
    if own:
        return model, {
            "structure": f"{alone}: a flight that is not fitted has no value of {several(own)}, which the card states "
            "for each manoeuvre.",
            "next flight": f"Not counted: the card states {several(own)} for each manoeuvre.",
        }
    if progress:
        progress("fits without each manoeuvre", 0.0)
    inflation = float(source.told["variance_inflation"])
    outputs = tuple(source.told["fitted_outputs"])
    steady = np.ones((*flown.index.shape, len(outputs)))
    fit = joint_fit(replace(flown, outputs=outputs, noise_growth=steady), model.estimate, inflation)
    noise = Noise(inflation, Noise.of(fit).parts)
    without = fits_without(fit, noise)
    held = hold_out(flown, without, inflation, seed)
    flat = source.linear.fitted.flat if source.linear is not None else ()
    following, said = None, ""
    if flat:
        said = (
            f"Not counted by itself: the card states no prior of {several(flat)}, and the scatter between manoeuvres "
        )
        said += "is sought in units of the priors. The errors of manoeuvres left out hold it."
    else:
        if progress:
            progress("scatter between manoeuvres", 0.5)
        following = next_parameters(alone_fits(fit, without, inflation), inflation, len(model.draws), seed, progress)
    origins = {
        "structure": "A manoeuvre flown again: the errors of the fitted records. Other flights: the errors of every "
        "manoeuvre by the fit to the others, less what parameters explain."
        if held is not None
        else f"{alone}; a fit without one manoeuvre cannot fly it.",
        "next flight": f"Partial pooling of the fits to each of the {count} manoeuvres by trajectories."
        if following is not None
        else said or "Not counted: fewer than two manoeuvres have a usable fit of their own.",
    }
    return replace(model, hold_out=held, following=following), origins


def _of_identify(
    source: Source, names: Sequence[str], estimate: Float[np.ndarray, " k"], count: int, seed: int
) -> Float[np.ndarray, "m k"] | None:
    """The next flight's parameters that identify has drawn, where it was asked to."""
    file = source.folder / NEXT_FLIGHT
    if "mle" not in source.told or not file.is_file():
        return None
    with xr.open_datatree(file, engine="h5netcdf") as tree:
        one = tree["posterior"].to_dataset()["next_flight"]
        known, drawn = [str(n) for n in one["parameter"].values], np.asarray(one).reshape(-1, one.shape[-1])
    kept = np.random.default_rng([seed, 11]).choice(len(drawn), count, replace=len(drawn) < count)
    bounds = source.found.bounds
    values = np.tile(estimate, (count, 1))
    for column, name in enumerate(known):
        values[:, list(names).index(name)] = np.clip(drawn[kept, column], *bounds[name])
    return values


def _gusts(source: Source, stated: float | None) -> tuple[dict[str, float], bool, str]:
    """Intensities and lengths, whether they were stated, and a sentence on them."""
    if stated == 0.0:
        return {}, True, "Not counted: calm air was stated."
    if stated is not None:
        found = dict.fromkeys(GUSTS, stated) | {f"{name}_length": LENGTH for name in GUSTS}
        return found, True, f"Stated: {stated:g} m/s in every direction, scale length {LENGTH:.0f} m."
    if source.linear is not None:
        return {}, True, "Not counted: a linear system does not fly through moving air."
    told = source.told
    if with_process_noise(told):
        met = {name: float(x) for name, (x, _) in told["process_noise"]["gusts"].items() if name.startswith(GUSTS)}
        strong = [f"{name} {met[name]:.2g} m/s" for name in GUSTS if met.get(name, 0.0) > 1e-3]
        if strong:
            return met, False, f"As the fit with process noise found them in the records: {', '.join(strong)}."
    return {}, True, "Not counted: the result has no gusts; --gusts states an intensity."
