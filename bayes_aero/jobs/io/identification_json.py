"""results.json: what one identification found, in a versioned schema."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import xarray as xr
from msgspec import UNSET

from bayes_aero.atomic_write import write_whole
from bayes_aero.diagnosis.trajectory_result import SimulatedManoeuvre
from bayes_aero.inference.results import (
    FrequencyFit,
    GPReport,
    Identification,
    Inseparable,
    MleResult,
    NextFlight,
    Posterior,
)
from bayes_aero.jobs.io import documents as parts
from bayes_aero.jobs.io.diagnosis_json import path_part, record_parts
from bayes_aero.jobs.io.result_file import writable
from bayes_aero.jobs.provenance import picked, write_json
from bayes_aero.report.figures.every_figure import FIGURES
from bayes_aero.report.pages.estimates import PooledScores, flown, verdict
from bayes_aero.report.pages.identification import next_flight_table, parameter_table, validation_table
from bayes_aero.report.table import write_csv

SCHEMA = "bayes_aero/results/1"


def results(
    identification: Identification,
    verdict: list[str],
    provenance: dict[str, Any],
    simulated: Sequence[SimulatedManoeuvre] = (),
) -> parts.IdentificationDocument:
    """The table of contents of a run as plain numbers and text; parts not yet computed are absent.

    `simulated` are the manoeuvres flown with the fitted coefficients.
    """
    run = identification
    alone = {name: parts.AloneFit.of(fit, **_fit(fit)) for name, fit in run.alone.items()}
    return parts.IdentificationDocument.of(
        schema=SCHEMA,
        card=run.card,
        records=record_parts(run.records, run.card),
        coefficients=run.forming.value,
        mle=parts.FitPart.of(run.mle, **_fit(run.mle), covariance=run.mle.corrected, alone=alone),
        consistency=parts.ConsistencyPart.of(run.consistency) if run.consistency else UNSET,
        frequency=frequency_part(run.frequency) if run.frequency else UNSET,
        posterior=parts.IdentifiedPosterior(noise=run.noise.value, **posterior_parts(run.posteriors))
        if run.posteriors
        else UNSET,
        next_flight=next_flight_part(run.next_flight) if run.next_flight else UNSET,
        stall=run.stall.numbers() if run.stall else UNSET,
        gpr=processes_part(run.gp) if run.gp else UNSET,
        simulated=[path_part(parts.FlownPath, path) for path in simulated] or UNSET,
        truth=UNSET if run.truth is None else {name: run.truth[name] for name in flown(run)},
        verdict=verdict,
        **picked(run, "health", "notes", "failures"),
        provenance=provenance | {"seconds": {k: round(v, 2) for k, v in run.seconds.items()}},
    )


def _fit(result: MleResult) -> dict[str, Any]:
    return {
        "status": result.status.name.lower(),
        "advice": result.status.value,
        "parameters": _estimates(result),
        "inseparable": inseparable_parts(result.inseparable),
        "strong_correlations": [parts.CorrelatedPart([a, b], value) for a, b, value in result.strong_correlations()],
        "warnings": result.warnings(),
    }


def _estimates(fit: MleResult | FrequencyFit, apart: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Estimates with their bounds, by how much the bias of sensor noise was moved, and how far they are apart."""
    bias = [None] * len(fit.names) if fit.bias is None else fit.bias
    keys = ("estimate", "crb", "crb_corrected", "noise_bias", "unit")
    columns = zip(fit.estimate, fit.crb, fit.crb_corrected, bias, fit.units, strict=True)
    rows = zip(fit.names, (dict(zip(keys, row, strict=True)) for row in columns), strict=True)
    return {name: parts.BandEstimate.of(**row, difference=(apart or {}).get(name, UNSET)) for name, row in rows}


def frequency_part(fit: FrequencyFit) -> parts.FrequencyPart:
    """A fit in a band."""
    return parts.FrequencyPart.of(fit, parameters=_estimates(fit, fit.apart))


def inseparable_parts(found: Sequence[Inseparable]) -> list[parts.InseparablePart]:
    """Sets of parameters that the record cannot separate."""
    return [parts.InseparablePart(dict(zip(one.names, one.wider, strict=True))) for one in found]


def posterior_parts(posteriors: Mapping[str, Posterior]) -> dict[str, Any]:
    """Marginals by sampler and parameter, and under `status` whether each sampler's draws may be used."""
    status = {
        key: parts.SamplerPart.of((p.noise, p.status.name.lower(), p.status.value)) for key, p in posteriors.items()
    }
    return {key: posterior.marginals for key, posterior in posteriors.items()} | {"status": status}


def next_flight_part(found: NextFlight) -> parts.NextFlightPart:
    """Aircraft, scatter, next flight and manoeuvres, pooled and alone, by parameter."""
    parameters = {
        p.name: parts.NextParameter.of(
            unit=p.unit,
            aircraft=found.aircraft[p.name],
            scatter=asdict(found.scatter[p.name]) | {"over_prior": found.narrowed[p.name]},
            next_flight=found.following[p.name],
            pooled={m: found.pooled[m][p.name] for m in found.manoeuvres},
            alone={m: found.alone[m][p.name] for m in found.manoeuvres if p.name in found.alone[m]},
            undetermined=found.undetermined.get(p.name, ()),
        )
        for p in found.parameters
    }
    status = {"status": found.status.name.lower(), "advice": found.status.value}
    return parts.NextFlightPart.of(found, likelihood=found.tree.attrs["likelihood"], parameters=parameters, **status)


def processes_part(report: GPReport) -> parts.ProcessesPart:
    """By split and coefficient: scores over the test points of all folds together, and each fold's own."""
    splits: dict[str, Any] = {}
    for split, folds in report.splits.items():
        splits[split] = {}
        for name in folds[0]:
            own = [fold[name] for fold in folds]
            pooled = PooledScores.of(own)
            inside = {f"coverage{round(100 * level)}": share for level, share in pooled.coverage.items()}
            each = [{"gpr": v.gp_scores, "mle": v.mle_scores} for v in own]
            scores = {"k_hat": pooled.k_hat, "status": pooled.status, "mle": pooled.mle, "folds": each}
            splits[split][name] = parts.ProcessPart.of(pooled.gp, **inside, **scores)
    return parts.ProcessesPart.of(sampled_split=report.chosen, **splits)


# --- What an identification writes: a file for each finished stage, and results.json with all of them.


class IdentificationFiles:
    """Writes what a run has found so far; without a folder it writes nothing."""

    def __init__(self, out: Path | None, source: dict[str, Any]) -> None:
        self.out, self.source = out, source
        self.flown: tuple[SimulatedManoeuvre, ...] = ()
        if out is not None:
            writable(out)

    def stage(self, run: Identification, posterior_name: str | None = None, gp_done: bool = False) -> None:
        """Write what `run` holds; a posterior and the Gaussian processes when they are new."""
        if self.out is None:
            return
        if posterior_name is not None:
            run.posteriors[posterior_name].save(self.out / f"posterior_{posterior_name}.nc")
        if run.gp is not None and gp_done:
            save_gp(run, self.out / "gpr.nc")
        write_csv(parameter_table(run), self.out / "parameters.csv")
        if run.next_flight is not None:
            write_csv(next_flight_table(run), self.out / "next_flight.csv")
            run.next_flight.save(self.out / "next_flight.nc")
        if run.gp is not None:
            write_csv(validation_table(run), self.out / "validation.csv")
        write_json(results(run, verdict(run), self.source, self.flown), self.out / "results.json")

    def remove_older(self, run: Identification, *, page: bool, figures: bool) -> None:
        """Take away what an earlier run has left in the folder and this one, now complete, has no successor for."""
        if self.out is None:
            return
        older = {self.out / f"posterior_{key}.nc" for key in ("emcee", "nuts", "white") if key not in run.posteriors}
        if run.gp is None:
            older |= {self.out / name for name in ("gpr.nc", "validation.csv")}
        if run.next_flight is None:
            older |= {self.out / name for name in ("next_flight.csv", "next_flight.nc")}
        if not page:
            older.add(self.out / "report.html")
        if not figures:
            older |= {self.out / "figures" / f"{stem}.png" for stem in FIGURES}
        for path in older:
            path.unlink(missing_ok=True)


def save_gp(run: Identification, path: Path) -> None:
    """gpr.nc: a group per coefficient with its hyperparameters' posterior, and the validation of every split."""
    assert run.gp is not None
    tree = xr.DataTree(name="gpr")
    for name, fit in run.gp.fits.items():
        if fit.posterior is not None:
            tree[name] = fit.posterior.copy()
    for split, folds in run.gp.splits.items():
        for number, fold in enumerate(folds):
            for name, v in fold.items():
                columns = {k: ("test", getattr(v, k)) for k in ("measured", "gp", "gp_low", "gp_high", "mle")}
                tree[f"validation/{split}_{number}/{name}"] = xr.DataTree(
                    xr.Dataset(columns, coords={"index": ("test", v.test)})
                )
    write_whole(tree.to_netcdf(engine="h5netcdf"), path)
