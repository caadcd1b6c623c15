"""histories.nc: the time histories behind the numbers of a run, to be laid over those of another tool. SI, radians."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from bayes_aero.atomic_write import write_whole
from bayes_aero.diagnosis.result import SimulatedManoeuvre as FlightPath
from bayes_aero.diagnosis.result import View
from bayes_aero.errors import failure, plain_line
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.inference.results import Identification

HISTORIES = "histories.nc"
SCHEMA = "bayes_aero/histories/1"
ENGINE = "h5netcdf"
Histories = Mapping[str, xr.Dataset]
"""Groups of the file by name: manoeuvres end to end, `manoeuvre` the number of each sample's, from 1 as in `names`."""


def diagnosed(view: View) -> Histories:
    """Coefficients as the card reconstructs them, by the card's model and by the extended one, and both models' X.

    By a model is what was measured less what the model leaves: errors of sensors that it knows are in it.
    """
    models = {"card": view.card, "extended": view.extended}
    columns = {}
    for c, name in enumerate(view.coefficients):
        columns[f"{name}_measured"] = view.measured[:, c]
        columns |= {f"{name}_{key}": view.measured[:, c] - m.residual[:, c] for key, m in models.items()}
    columns |= {f"X_{key}": m.signals["X"] for key, m in models.items() if "X" in m.signals}
    time = view.diagnosis.aerodynamics.state.responses.flights.time
    return {"coefficients": _group(columns, view.names, view.manoeuvre, time)}


def identified(run: Identification) -> Histories:
    """Coefficients as measured and by the maximum-likelihood fit to all manoeuvres."""
    o, fitted = run.observations, run.fitted
    measured, columns = np.asarray(o.measured), {}
    for c, name in enumerate(o.coefficients):
        columns |= {f"{name}_measured": measured[:, c], f"{name}_fitted": fitted[:, c]}
    return {"coefficients": _group(columns, o.names, o.manoeuvre, o.time)}


def flights(paths: Iterable[FlightPath], units: Mapping[str, str] | None = None) -> Histories:
    """Outputs as measured and by each model: groups trajectories_fitted and trajectories_hold_out, by the paths' split.

    `units` of outputs (SI), for channels that the program does not know by name.
    """
    known = units or {name: channel.unit for name, channel in STANDARD_CHANNELS.items()}
    splits: dict[str, dict[str, list[FlightPath]]] = {}
    for path in paths:
        splits.setdefault(path.split, {}).setdefault(path.manoeuvre, []).append(path)
    found = {}
    for split, named in splits.items():
        firsts = [own[0] for own in named.values()]
        columns: dict[str, np.ndarray] = {}
        unit: dict[str, str] = {}
        for output in firsts[0].measured:
            columns[column(output, "measured")] = np.concatenate([p.measured[output] for p in firsts])
            for number, model in enumerate(p.model for p in next(iter(named.values()))):
                simulated = [own[number].simulated[output] for own in named.values()]
                columns[column(output, model)] = np.concatenate(simulated)
            unit |= dict.fromkeys(list(columns)[len(unit) :], known[output])
        manoeuvre = np.repeat(np.arange(len(firsts)), [len(p.time) for p in firsts])
        time = np.concatenate([p.time for p in firsts])
        found[f"trajectories_{split}"] = _group(columns, tuple(named), manoeuvre, time, unit)
    return found


def column(output: str, kind: str) -> str:
    """A column's name; a slash in the name of a card's channel would open a group."""
    return f"{output}_{kind}".replace("/", "|")


def _group(
    columns: Mapping[str, Float[np.ndarray, " n"]],
    names: Sequence[str],
    manoeuvre: Int[np.ndarray, " n"],
    time: Float[np.ndarray, " n"],
    units: Mapping[str, str] | None = None,
) -> xr.Dataset:
    unit = units or dict.fromkeys(columns, "1")
    about = {"long_name": "time as recorded, s"}  # xarray would make durations of what has the unit s
    data = {
        "time": ("sample", time, about),
        "manoeuvre": ("sample", manoeuvre + 1),
        **{key: ("sample", x, {"units": unit[key]}) for key, x in columns.items()},
    }
    return xr.Dataset(data, attrs={"names": [plain_line(name) for name in names]})


def put_histories(make: Callable[[], Histories], folder: Path) -> tuple[str, ...]:
    """Write `histories.nc` into `folder`, whole or not at all.

    Histories that cannot be written cost nothing else: an older file goes, and a sentence on it is returned.
    """
    path = folder / HISTORIES
    try:
        groups = make()
        tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs={"schema": SCHEMA}), **groups})
        small = {"zlib": True, "complevel": 1}
        encoding = {f"/{key}": {str(name): small for name in group.data_vars} for key, group in groups.items()}
        write_whole(tree.to_netcdf(engine=ENGINE, encoding=encoding), path)
    except Exception as reason:  # whatever it is, the numbers stand
        path.unlink(missing_ok=True)
        return (failure(f"{HISTORIES} was not written", reason, folder),)
    return ()
