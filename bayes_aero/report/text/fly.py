"""A fit to trajectories: tables for a terminal and for files, and sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.table import Table

from bayes_aero.diagnosis.trajectories.results import FITTED, START, Disagreement, TrajectoryFit
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.parameter import Prior
from bayes_aero.report.tables.run_tables import concise
from bayes_aero.report.text.impossible_estimates import sign_sentences
from bayes_aero.report.text.phrases import SYMBOLS, for_people, several, short
from bayes_aero.report.text.restraints import inseparable_sentences

MARKS = {"held_by_prior": "held by its prior", "at_bound": "at its bound", "undetermined": "not determined"}
_WEIGHED = " Priors are mean ± standard deviation, weighted with the variance inflation of the residuals."
COLOURED = 1.5  # variance inflation from which a sentence is written; our choice
OFTEN = 0.5  # share of the time outside a tolerance from which a sentence is written; our choice
SWOLLEN = 2.0  # noise growth in fully separated flow from which a sentence is written; our choice


def parameter_rows(flown: TrajectoryFit) -> dict[str, dict[str, Any]]:
    """By parameter, SI and radians; `crb` is infinite where the data alone do not determine it.

    `prior` is None where the fit had none.
    """
    fit = flown.fit
    return {
        name: {
            "unit": fit.parameters[i].unit,
            "start": float(flown.start[i]),
            "estimate": float(fit.estimate[i]),
            "crb": float(crb),
            "sd_corrected": float(sd),
            "prior": _prior(fit.parameters[i].prior) if flown.setting.priors else None,
            "held_by_prior": name in fit.held,
            "at_bound": name in fit.at_bound,
            "undetermined": name in fit.undetermined,
        }
        for i, (name, crb, sd) in enumerate(zip(fit.names, fit.crb, fit.sd_corrected, strict=True))
    }


def _prior(prior: Prior) -> dict[str, Any]:
    told = {key: getattr(prior, key) for key in ("family", "location", "scale", "source")}
    return told | {"default": not prior.by_card}


def prior_words(row: Mapping[str, Any]) -> str:
    """The prior of one of `parameter_rows`, and whether it is the default or the card's."""
    prior = row["prior"]
    if prior is None:
        return "none"
    location, scale = prior["location"], prior["scale"]
    told = {
        "normal": f"{location:.4g} ± {scale:.4g}",
        "lognormal": f"{location:.4g} × e^±{scale:.4g}",
        "halfnormal": f"{location:.4g} + |{scale:.4g}|",
        "uniform": f"{location:.4g} to {location + scale:.4g}",
    }[prior["family"]]
    return f"{told}, {'default' if prior['default'] else 'card'}"


def remarks(row: Mapping[str, Any]) -> str:
    """Remarks on one of `parameter_rows`; usually none."""
    return ", ".join(words for key, words in MARKS.items() if row[key])


def parameter_frame(flown: TrajectoryFit) -> pd.DataFrame:
    """The same as a table."""
    rows = {name: row | {"prior": prior_words(row)} for name, row in parameter_rows(flown).items()}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")


def parameter_table(flown: TrajectoryFit) -> Table:
    """Estimate, both standard errors, prior and remarks."""
    table = _table(
        f"Parameters fitted to trajectories: {flown.fit.status.name.lower().replace('_', ' ')}",
        "SI and radians. CRB: Cramér-Rao bound of the data alone, for white residuals. sd corr.: with their "
        "autocorrelation and the priors; in brackets after the estimate in units of its last digit."
        + (_WEIGHED if flown.setting.priors else " There are no priors."),
    )
    for head in ("", "unit"):
        table.add_column(head, no_wrap=True)
    for head in ("estimate", "CRB", "sd corr."):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("prior", no_wrap=True)
    table.add_column("")
    for name, row in parameter_rows(flown).items():
        crb = f"{row['crb']:.2g}" if np.isfinite(row["crb"]) else "-"
        sd = row["sd_corrected"]
        table.add_row(name, row["unit"], _estimate(row), crb, _sd(sd), prior_words(row), remarks(row))
    return table


def _estimate(row: Mapping[str, Any]) -> str:
    return "-" if row["undetermined"] else concise(row["estimate"], row["sd_corrected"])


def _sd(sd: float) -> str:
    return f"{sd:.2g}" if np.isfinite(sd) else "-"


def error_table(flown: TrajectoryFit) -> Table:
    """Every manoeuvre and output: error at the first values and of the fit, Theil's coefficient and its parts."""
    table = _table(
        "Error of the simulated trajectory",
        f"Start: first values of the parameters, {'measured' if flown.setting.initial is None else 'fixed'} initial "
        "state. Theil's U, and the shares of bias, variance and covariance in the mean square error.",
    )
    for head in ("manoeuvre", "output"):
        table.add_column(head)
    for head in ("RMS: start → fitted", "largest", "U", "bias", "var.", "cov."):
        table.add_column(head, justify="right")
    for name in flown.manoeuvres:
        before, after = flown.path(name, START), flown.path(name, FITTED)
        for output, error in after.errors.items():
            unit, factor = for_people(flown.units[output])
            theil = error.theil
            left = "" if output in flown.fit.flown.outputs else ", not fitted"
            table.add_row(
                name,
                f"{SYMBOLS.get(output, output)} [{unit}]{left}",
                f"{short(factor * before.errors[output].rms)} → {short(factor * error.rms)}",
                short(factor * error.largest),
                f"{theil.theil:.3f}",
                *(f"{share:.0%}" for share in (theil.bias, theil.variance, theil.covariance)),
            )
    return table


def errors_of_all(flown: TrajectoryFit) -> dict[str, tuple[float, float]]:
    """Root mean square error of each output over all manoeuvres, SI: at the first values, and of the fit."""

    def rms(model: str, output: str) -> float:
        paths = [p for p in flown.paths if p.model == model]
        samples = np.array([len(p.time) for p in paths])
        return float(np.sqrt(np.average(np.square([p.errors[output].rms for p in paths]), weights=samples)))

    with np.errstate(over="ignore", invalid="ignore"):  # the first values may fly anywhere
        return {output: (rms(START, output), rms(FITTED, output)) for output in flown.outputs}


def fly_sentences(flown: TrajectoryFit, hindered: str = "") -> list[str]:
    """How the fit ended, its errors, the variance inflation, what is not identified, what left the envelope.

    `hindered` is why diagnose cannot use the records; empty if it can.
    """
    fit = flown.fit
    bound = f" ({several(fit.at_bound)})" if fit.at_bound else ""
    said = [f"The fit {fit.status.value}{bound}{_off(flown)}."]
    if fit.status is OutputErrorStatus.LEFT_ENVELOPE:
        said = [f"The fit failed: {fit.status.value}."]
    said += _settings(flown)
    said += _wanting(flown, hindered)
    if flown.variance_inflation >= COLOURED and fit.status is not OutputErrorStatus.LEFT_ENVELOPE:
        said.append(
            f"The residuals are autocorrelated. The variance inflation is {short(flown.variance_inflation)} in the "
            f"median, and the "
            "Cramér-Rao bound is too small; use the corrected standard error."
        )
    swollen = {name: times for name, times in flown.noise_growth.items() if times > SWOLLEN}
    if swollen:
        told = several(f"{SYMBOLS.get(name, name)} {short(times)} times" for name, times in swollen.items())
        said.append(f"Residuals grow where the flow has separated ({told}): these samples have less weight.")
    estimates = zip(fit.names, fit.estimate, fit.sd_corrected, strict=True)
    said += sign_sentences({name: (float(value), float(sd)) for name, value, sd in estimates}, fit.parameters)
    if fit.held and fit.status is not OutputErrorStatus.LEFT_ENVELOPE:
        said.append(f"The trajectories contain little information on {several(fit.held)}; the prior decides.")
    if fit.undetermined and flown.converged:
        said.append(
            f"The trajectories do not determine {several(fit.undetermined)}, and there are no priors: these values "
            "are not usable. Fix them on the card, or fit with priors."
        )
    if flown.converged:
        said += inseparable_sentences(fit.inseparable)
    lost = [p.manoeuvre for p in flown.paths if p.model == FITTED and not p.inside]
    if lost:
        said.append(f"Outside the flight envelope at the end of the fit: {several(lost)}.")
    return said


def disagreement_sentences(found: Sequence[Disagreement], hindered: str = "") -> list[str]:
    """Parameters for which the coefficients of the same record give other values.

    `hindered` is why diagnose cannot use the records; empty if it can.
    """
    if not found:
        return []
    told = several(
        f"{d.name} {d.coefficients[0]:.3g} ± {d.coefficients[1]:.2g} from the coefficients, {d.trajectories[0]:.3g} ± "
        f"{d.trajectories[1]:.2g} from trajectories{'' if d.unit == '1' else f' {d.unit}'} ({d.apart:.1f} combined "
        "standard errors apart)"
        for d in found
    )
    look = "check looks for an error of a sensor" if hindered else "check and diagnose look for the last two"
    return [
        f"The coefficients of the same record, as identify fits them, disagree with the trajectories: {told}. Neither "
        "interval covers the difference. Possible causes are turbulence, a sensor error or an effect that the model "
        f"lacks; {look}."
    ]


def _settings(flown: TrajectoryFit) -> list[str]:
    """The cost of the published programs, and the settings that differ from the defaults."""
    if flown.fit.status is OutputErrorStatus.LEFT_ENVELOPE:
        return []
    outputs = several(SYMBOLS.get(name, name) for name in flown.fit.flown.outputs)
    said = [f"det R is {flown.fit.det_R:.5g} (residual covariance of {outputs}, SI and radians)."]
    how = [] if flown.setting.priors else ["without priors"]
    how += [] if flown.setting.initial is None else ["with initial states fixed"]
    how += ["with inputs held between samples"] if flown.setting.held else []
    said += [f"It was fitted {several(how)}."] if how else []
    if flown.setting.held:
        late = 0.5 * float(np.median(np.asarray(flown.fit.flown.dt)))
        said.append(
            f"Held inputs act half a sample ({late:.2g} s) later than interpolated ones, which moves the derivatives "
            "of fast controls. That is right for a command that a digital system holds until the next sample, and "
            "wrong for a recorded position of a surface: leave --inputs held out for that."
        )
    return said


def outside(flown: TrajectoryFit) -> dict[str, float]:
    """Share of the time over all manoeuvres for which the fit of each output is outside its tolerance."""
    paths = [p for p in flown.paths if p.model == FITTED and p.inside]
    shares = {}
    for output in flown.outputs:
        told = [(p.errors[output].within, len(p.time)) for p in paths]
        within = [(share, n) for share, n in told if share is not None]
        if within:
            shares[output] = 1.0 - float(np.average([s for s, _ in within], weights=[n for _, n in within]))
    return shares


def _wanting(flown: TrajectoryFit, hindered: str) -> list[str]:
    """That the model lacks an effect, if its best fit is mostly outside the tolerances."""
    shares = {name: share for name, share in outside(flown).items() if share > OFTEN}
    if not (shares and flown.converged):  # what has not converged may still come nearer
        return []
    told = several(f"{SYMBOLS.get(name, name)} {share:.0%} of the time" for name, share in shares.items())
    looks = f", and diagnose cannot look for it: {hindered}" if hindered else "; bayes-aero diagnose looks for it"
    where = looks if flown.by_effects else ""
    return [f"The fitted model is outside its tolerances ({told}): the model lacks an effect{where}."]


def _off(flown: TrajectoryFit) -> str:
    """How far from the measurements the fit is where it converged."""
    if flown.fit.status is not OutputErrorStatus.CONVERGED:
        return ""
    told = []
    for output, (_, rms) in errors_of_all(flown).items():
        unit, factor = for_people(flown.units[output])
        told.append(f"{SYMBOLS.get(output, output)} {short(factor * rms)}{'' if unit == '1' else ' ' + unit}")
    return f"; the RMS error of the trajectories is {several(told)}"


def _table(title: str, caption: str) -> Table:
    return Table(title=title, caption=caption, box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
