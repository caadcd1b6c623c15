"""results.json: what one identification found, in a versioned schema (results.schema.json beside this file)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import xarray as xr

from bayes_aero.atomic_write import write_whole
from bayes_aero.diagnosis.trajectories.results import SimulatedManoeuvre
from bayes_aero.diagnosis.trajectories.results import SimulatedManoeuvre as Flown
from bayes_aero.inference.frequency_result import FrequencyFit
from bayes_aero.inference.identification import GPReport, Identification, Validation
from bayes_aero.inference.likelihood.mle_result import Inseparable, MleResult
from bayes_aero.inference.pooled_result import NextFlight
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.inference.scores import Scores
from bayes_aero.jobs.io.consistency_json import consistency_results, health_results
from bayes_aero.jobs.io.diagnosis_json import record_results
from bayes_aero.jobs.io.output_folder import writable
from bayes_aero.jobs.io.trajectories_json import open_loop
from bayes_aero.jobs.provenance import write_json
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
    found: dict[str, Any] = {
        "schema": SCHEMA,
        "card": {"name": identification.card.name, "title": identification.card.title},
        "records": record_results(identification.records, identification.card),
        "coefficients": identification.forming.value,
        "mle": _mle(identification.mle)
        | {
            "covariance": identification.mle.corrected,
            "alone": {k: _mle(v) for k, v in identification.alone.items()},
        },
    }
    if identification.consistency is not None:
        found["consistency"] = consistency_results(identification.consistency)
    if identification.frequency is not None:
        found["frequency"] = frequency_results(identification.frequency)
    if identification.posteriors:
        found["posterior"] = {"noise": identification.noise.value} | posterior_results(identification.posteriors)
    if identification.next_flight is not None:
        found["next_flight"] = _next_flight(identification.next_flight)
    if identification.stall is not None:
        found["stall"] = identification.stall.numbers()
    if identification.gp is not None:
        found["gpr"] = _gpr(identification.gp)
    if simulated:
        found["simulated"] = [open_loop(path) for path in simulated]
    if identification.truth is not None:
        found["truth"] = {name: identification.truth[name] for name in flown(identification)}
    found["verdict"] = verdict
    found["health"] = health_results(identification.health)
    found["notes"] = list(identification.notes)
    found["failures"] = list(identification.failures)
    found["provenance"] = provenance | {"seconds": {k: round(v, 2) for k, v in identification.seconds.items()}}
    return found


def _scores(scores: Scores) -> dict[str, float]:
    return {key: value for key, value in asdict(scores).items() if key != "status"}


def _mle(result: MleResult) -> dict[str, Any]:
    bias = [None] * len(result.names) if result.bias is None else result.bias
    columns = zip(result.names, result.units, result.estimate, result.crb, result.crb_corrected, bias, strict=True)
    return {
        "status": result.status.name.lower(),
        "advice": result.status.value,
        "det_R": result.det_R,
        "iterations": result.iterations,
        "parameters": {
            name: {"estimate": x, "crb": crb, "crb_corrected": corrected, "noise_bias": moved, "unit": unit}
            for name, unit, x, crb, corrected, moved in columns
        },
        "fit": {name: _scores(scores) for name, scores in result.fit.items()},
        "lag1": result.lag1,
        "separation": {"minimum": result.separation[0], "maximum": result.separation[1]},
        "information_eigenvalues": result.eigenvalues,
        "inseparable": inseparable_results(result.inseparable),
        "strong_correlations": [{"pair": [a, b], "value": value} for a, b, value in result.strong_correlations()],
        "starts": [{"cost": cost, "outcome": outcome} for cost, outcome in result.starts],
        "warnings": result.warnings(),
    }


def frequency_results(fit: FrequencyFit) -> dict[str, Any]:
    """A fit in a band."""
    bias = [None] * len(fit.names) if fit.bias is None else fit.bias
    columns = zip(fit.names, fit.units, fit.estimate, fit.crb, fit.crb_corrected, bias, strict=True)
    return {
        "method": fit.method,
        "band": list(fit.band),
        "frequencies": fit.lines,
        "converged": fit.converged,
        "parameters": {
            name: {"estimate": x, "crb": crb, "crb_corrected": corrected, "noise_bias": moved, "unit": unit}
            | ({"difference": fit.apart[name]} if name in fit.apart else {})
            for name, unit, x, crb, corrected, moved in columns
        },
        "unseen": list(fit.unseen),
        "at_bound": list(fit.at_bound),
    }


def inseparable_results(found: Sequence[Inseparable]) -> list[dict[str, Any]]:
    """Sets of parameters that the record cannot separate."""
    return [{"parameters": dict(zip(one.names, one.wider, strict=True))} for one in found]


def posterior_results(posteriors: Mapping[str, Posterior]) -> dict[str, Any]:
    """Marginals by sampler and parameter, and under `status` whether each sampler's draws may be used."""
    marginals = {key: {n: asdict(m) for n, m in posterior.marginals.items()} for key, posterior in posteriors.items()}
    return marginals | {"status": {key: _status(posterior) for key, posterior in posteriors.items()}}


def _status(posterior: Posterior) -> dict[str, str]:
    return {
        "noise": posterior.noise,
        "status": posterior.status.name.lower(),
        "advice": posterior.status.value,
    }


def _next_flight(found: NextFlight) -> dict[str, Any]:
    return {
        "likelihood": found.tree.attrs["likelihood"],
        "manoeuvres": list(found.manoeuvres),
        "left_out": found.left_out,
        "parameters": {
            p.name: {
                "unit": p.unit,
                "aircraft": asdict(found.aircraft[p.name]),
                "scatter": asdict(found.scatter[p.name]) | {"over_prior": found.narrowed[p.name]},
                "next_flight": asdict(found.following[p.name]),
                "pooled": {m: asdict(found.pooled[m][p.name]) for m in found.manoeuvres},
                "alone": {
                    m: dict(zip(("estimate", "crb_corrected"), found.alone[m][p.name], strict=True))
                    for m in found.manoeuvres
                    if p.name in found.alone[m]
                },
                "undetermined": list(found.undetermined.get(p.name, ())),
            }
            for p in found.parameters
        },
        "status": found.status.name.lower(),
        "advice": found.status.value,
    }


def _gpr(report: GPReport) -> dict[str, Any]:
    found: dict[str, Any] = {"sampled_split": report.chosen}
    for split, folds in report.splits.items():
        found[split] = {name: _pooled([fold[name] for fold in folds]) for name in folds[0]}
    return found


def _pooled(folds: list[Validation]) -> dict[str, Any]:
    """Scores over the test points of all folds together, and each fold's own."""
    all_folds = PooledScores.of(folds)
    return {
        **_scores(all_folds.gp),
        **{f"coverage{round(100 * level)}": share for level, share in all_folds.coverage.items()},
        "k_hat": all_folds.k_hat,
        "status": all_folds.status,
        "mle": _scores(all_folds.mle),
        "folds": [{"gpr": _scores(v.gp_scores), "mle": _scores(v.mle_scores)} for v in folds],
    }


# --- What an identification writes: a file for each finished stage, and results.json with all of them.


class IdentificationFiles:
    """Writes what a run has found so far; without a folder it writes nothing."""

    def __init__(self, out: Path | None, source: dict[str, Any]) -> None:
        self.out, self.source = out, source
        self.flown: tuple[Flown, ...] = ()
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
