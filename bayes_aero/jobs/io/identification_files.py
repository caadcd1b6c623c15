"""What an identification writes: a file for each finished stage, and results.json with all of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from bayes_aero.atomic_write import write_whole
from bayes_aero.diagnosis.trajectories.results import Path as Flown
from bayes_aero.inference.identification import Identification
from bayes_aero.jobs.io.identification_json import results
from bayes_aero.jobs.io.output_folder import writable
from bayes_aero.jobs.provenance.provenance import write_json
from bayes_aero.report.figures.every_figure import FIGURES
from bayes_aero.report.pooled.next_flight import next_flight_table
from bayes_aero.report.tables.run_tables import parameter_table, validation_table
from bayes_aero.report.tables.table import write_csv
from bayes_aero.report.text.identification import verdict


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
