"""results.json: what one identification found, in a versioned schema (results.schema.json beside this file)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import xarray as xr

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
from bayes_aero.inference.scores import Scores
from bayes_aero.jobs.io.consistency_json import consistency_results
from bayes_aero.jobs.io.diagnosis_json import path_results, record_results
from bayes_aero.jobs.io.result_file import writable
from bayes_aero.jobs.provenance import named_pairs, picked, write_json
from bayes_aero.report.figures.every_figure import FIGURES
from bayes_aero.report.pooled import next_flight_table
from bayes_aero.report.tables.comparison import flown
from bayes_aero.report.tables.run_tables import PooledScores, parameter_table, validation_table
from bayes_aero.report.tables.table import write_csv
from bayes_aero.report.text.identification import verdict

SCHEMA = "bayes_aero/results/1"


def results(
    identification: Identification,
    verdict: list[str],
    provenance: dict[str, Any],
    simulated: Sequence[SimulatedManoeuvre] = (),
) -> dict[str, Any]:
    """The table of contents of a run as plain numbers and text; parts not yet computed are absent.

    `simulated` are the manoeuvres flown with the fitted coefficients.
    """
    run = identification
    alone = {name: _mle(fit) for name, fit in run.alone.items()}
    parts: dict[str, Any] = {
        "consistency": run.consistency and consistency_results(run.consistency),
        "frequency": run.frequency and frequency_results(run.frequency),
        "posterior": {"noise": run.noise.value} | posterior_results(run.posteriors) if run.posteriors else None,
        "next_flight": run.next_flight and next_flight_results(run.next_flight),
        "stall": run.stall and run.stall.numbers(),
        "gpr": run.gp and gpr_results(run.gp),
        "simulated": [path_results(path, alone=True) for path in simulated] or None,
        "truth": None if run.truth is None else {name: run.truth[name] for name in flown(run)},
    }
    return {
        "schema": SCHEMA,
        "card": picked(run.card, "name", "title"),
        "records": record_results(run.records, run.card),
        "coefficients": run.forming.value,
        "mle": _mle(run.mle) | {"covariance": run.mle.corrected, "alone": alone},
        **{key: part for key, part in parts.items() if part is not None},
        "verdict": verdict,
        **picked(run, "health", "notes", "failures"),
        "provenance": provenance | {"seconds": {k: round(v, 2) for k, v in run.seconds.items()}},
    }


def _scores(scores: Scores) -> dict[str, float]:
    return {key: value for key, value in asdict(scores).items() if key != "status"}


def _mle(result: MleResult) -> dict[str, Any]:
    return {
        "status": result.status.name.lower(),
        "advice": result.status.value,
        **picked(result, "det_R", "iterations"),
        "parameters": _estimates(result),
        "fit": {name: _scores(scores) for name, scores in result.fit.items()},
        "lag1": result.lag1,
        "separation": {"minimum": result.separation[0], "maximum": result.separation[1]},
        "information_eigenvalues": result.eigenvalues,
        "inseparable": inseparable_results(result.inseparable),
        "strong_correlations": [{"pair": [a, b], "value": value} for a, b, value in result.strong_correlations()],
        "starts": [{"cost": cost, "outcome": outcome} for cost, outcome in result.starts],
        "warnings": result.warnings(),
    }


def _estimates(fit: MleResult | FrequencyFit) -> dict[str, dict[str, Any]]:
    """Estimates with their bounds, and by how much the bias of sensor noise was moved."""
    bias = [None] * len(fit.names) if fit.bias is None else fit.bias
    keys = ("estimate", "crb", "crb_corrected", "noise_bias", "unit")
    columns = zip(fit.estimate, fit.crb, fit.crb_corrected, bias, fit.units, strict=True)
    return {name: dict(zip(keys, row, strict=True)) for name, row in zip(fit.names, columns, strict=True)}


def frequency_results(fit: FrequencyFit) -> dict[str, Any]:
    """A fit in a band."""
    differences = {name: {"difference": x} for name, x in fit.apart.items()}
    rows = {name: row | differences.get(name, {}) for name, row in _estimates(fit).items()}
    about = picked(fit, "method", "band", "frequencies=lines", "converged")
    return about | {"parameters": rows} | picked(fit, "unseen", "at_bound")


def inseparable_results(found: Sequence[Inseparable]) -> list[dict[str, Any]]:
    """Sets of parameters that the record cannot separate."""
    return [{"parameters": dict(zip(one.names, one.wider, strict=True))} for one in found]


def posterior_results(posteriors: Mapping[str, Posterior]) -> dict[str, Any]:
    """Marginals by sampler and parameter, and under `status` whether each sampler's draws may be used."""
    status = {
        key: {"noise": p.noise, "status": p.status.name.lower(), "advice": p.status.value}
        for key, p in posteriors.items()
    }
    return {key: dict(posterior.marginals) for key, posterior in posteriors.items()} | {"status": status}


def next_flight_results(found: NextFlight) -> dict[str, Any]:
    """Aircraft, scatter, next flight and manoeuvres, pooled and alone, by parameter."""
    return {
        "likelihood": found.tree.attrs["likelihood"],
        **picked(found, "manoeuvres", "left_out"),
        "parameters": {
            p.name: {
                "unit": p.unit,
                "aircraft": found.aircraft[p.name],
                "scatter": asdict(found.scatter[p.name]) | {"over_prior": found.narrowed[p.name]},
                "next_flight": found.following[p.name],
                "pooled": {m: found.pooled[m][p.name] for m in found.manoeuvres},
                "alone": named_pairs(
                    {m: found.alone[m][p.name] for m in found.manoeuvres if p.name in found.alone[m]},
                    "estimate",
                    "crb_corrected",
                ),
                "undetermined": list(found.undetermined.get(p.name, ())),
            }
            for p in found.parameters
        },
        "status": found.status.name.lower(),
        "advice": found.status.value,
    }


def gpr_results(report: GPReport) -> dict[str, Any]:
    """By split and coefficient: scores over the test points of all folds together, and each fold's own."""
    found: dict[str, Any] = {"sampled_split": report.chosen}
    for split, folds in report.splits.items():
        found[split] = {}
        for name in folds[0]:
            own = [fold[name] for fold in folds]
            pooled = PooledScores.of(own)
            found[split][name] = {
                **_scores(pooled.gp),
                **{f"coverage{round(100 * level)}": share for level, share in pooled.coverage.items()},
                **picked(pooled, "k_hat", "status"),
                "mle": _scores(pooled.mle),
                "folds": [{"gpr": _scores(v.gp_scores), "mle": _scores(v.mle_scores)} for v in own],
            }
    return found


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
