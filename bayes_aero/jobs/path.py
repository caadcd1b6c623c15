"""The job of `bayes-aero path`: errors of sensors from the flight path, and the records without them."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from bayes_aero.diagnosis.trajectories.results import TrajectoryFit
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.card.toml_tables import is_file
from bayes_aero.flight.record import FlightRecord
from bayes_aero.flight.writers import write_record
from bayes_aero.jobs.fly import fly
from bayes_aero.jobs.io.fly_json import Flight
from bayes_aero.jobs.io.output_folder import safe_name
from bayes_aero.jobs.options import PathOptions, keywords
from bayes_aero.jobs.provenance import write_json
from bayes_aero.progress import Progress

CORRECTED = "corrected"
WRITTEN, SCHEMA = "written.json", "bayes_aero/corrected/1"  # the files of the folder, with their hashes
UNSAFE = r"[^\w.@+-]"  # in the name of a file


@keywords(PathOptions)
def flight_path(
    records: Sequence[FlightRecord],
    card: Card,
    options: PathOptions = PathOptions(),
    *,
    out: Path | None = None,
    progress: Progress | None = None,
) -> Flight:
    """Reconstruct the flight path, as `bayes-aero path` does: errors of sensors by output error, without aerodynamics.

    Args:
        records: flights, fitted jointly; biases of accelerometers and gyros and the wind are each flight's own.
        card: says where the accelerometer is. Errors of sensors that it states keep their values.
        options: the settings; instead of them their names may be given, e.g. `process_noise=True`.
        out: a folder for trajectories.json, parameters.csv, figures, report.html and the corrected records; None writes
            nothing.
        progress: called with a stage and the share of it that is done.

    Returns:
        The fit with its findings. SI and radians.

    Raises:
        InputError: the flight path needs a channel that was not recorded.

    Source:
        Klein and Morelli, Aircraft System Identification, 2006, ch. 10.
    """
    targets = [] if out is None else corrected_files(records, out / CORRECTED)
    found = fly(records, card, options.fly, out=out, progress=progress)
    if out is None:
        return found
    folder = out / CORRECTED
    for left in written_before(folder):  # records of an earlier run are none of this one, whatever comes of it
        left.unlink()
    if found.flown.converged and not found.flown.worse:
        folder.mkdir(exist_ok=True)
        for record, target in zip(corrected_records(records, found.flown), targets, strict=True):
            write_record(record, target, card.channels)
            files = {path.name: _hash(path) for path in targets if path.is_file()}
            write_json({"schema": SCHEMA, "files": files}, folder / WRITTEN)
    return found


def corrected_files(records: Sequence[FlightRecord], folder: Path) -> list[Path]:
    """Where the corrected records go, a file each; `InputError` for one that this command did not write as it is."""
    own, found = written_before(folder), []
    for record in records:
        name = safe_name(re.sub(UNSAFE, "_", record.name))
        endings = chain([""], (f"_{k}" for k in count(2)))
        path = next(p for p in (folder / f"{name}{k}.csv" for k in endings) if p not in found)
        if path.exists() and path not in own:
            raise InputError(
                f"{path} is not as bayes-aero path wrote it, and would be replaced; move it, or give another folder "
                "with --out"
            )
        found.append(path)
    return found


def written_before(folder: Path) -> list[Path]:
    """The files of an earlier run that are as it wrote them; all others are the user's."""
    try:
        files = dict(json.loads((folder / WRITTEN).read_text(encoding="utf-8"))["files"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []
    there = {folder / Path(name).name: sha256 for name, sha256 in files.items()}
    return [path for path, sha256 in there.items() if is_file(path) and _hash(path) == sha256]


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def corrected_records(records: Sequence[FlightRecord], flown: TrajectoryFit) -> list[FlightRecord]:
    """The records without the errors that were found: flow angles and accelerations as at the true sensors."""
    fit = flown.fit
    flights, dynamics = fit.flown.flights, fit.flown.dynamics
    true = dynamics.corrected(dynamics.values(jnp.asarray(fit.estimate)), flights.channels, flights.aircraft)
    found, begin = [], 0
    for record, length in zip(records, flights.lengths, strict=True):
        part = slice(begin, begin + length)
        changed = {
            n: np.asarray(x[part]) for n, x in true.items() if n in record.channels and x is not flights.channels[n]
        }
        found.append(replace(record, channels={**record.channels, **changed}))
        begin += length
    return found
