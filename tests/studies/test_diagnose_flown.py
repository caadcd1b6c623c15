"""The diagnosis of a record without accelerometers as a job."""

import json
from importlib import resources

import jsonschema
import numpy as np
import pytest
from history_files import flight_of, read_histories

from bayes_aero.diagnosis import candidate_set
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.diagnose import diagnose_records
from bayes_aero.jobs.options import DiagnoseOptions
from bayes_aero.simulate.injection import hidden_records

FEW = ("thrust_moment", "pitch_rate_lift", "mach_drag", "alpha_bias")


def without(record: FlightRecord, *names: str) -> FlightRecord:
    channels = {name: x for name, x in record.channels.items() if name not in names}
    return FlightRecord.from_arrays(record.name, record.time, channels)


@pytest.mark.recovery
def test_numbers_histories_and_page_are_of_this_run(card, tmp_path, monkeypatch):
    """A folder that an interrupted diagnosis has left keeps nothing of it. Of few effects, which compile sooner."""
    monkeypatch.setattr(candidate_set, "CATALOGUE", {name: CATALOGUE[name] for name in FEW})
    for name in ("diagnosis.json", "histories.nc"):
        (tmp_path / name).write_text("of another run")
    hidden = {"thrust_moment": {"thrust_arm": 0.6}}
    records = [without(r, "ax", "ay", "az") for r in hidden_records(hidden, seed=413_233, seconds=40.0)]
    told = diagnose_records(records, card, DiagnoseOptions(max_effects=1), out=tmp_path)
    found, flown = told.diagnosis, told.view.trajectories
    content = json.loads((tmp_path / "diagnosis.json").read_text())
    jsonschema.validate(
        content, json.loads(resources.files("bayes_aero.jobs.io.schemas").joinpath("diagnosis.schema.json").read_text())
    )
    assert [c["name"] for c in content["causes"]] == [c.name for c in found.causes] != []
    assert (tmp_path / "report.html").stat().st_size > 10_000
    groups = read_histories(tmp_path / "histories.nc")
    for path, told in zip(flown.paths, content["trajectories"]["paths"], strict=True):
        flight = flight_of(groups[f"trajectories_{path.split}"], path.manoeuvre)
        residual = flight["alpha_measured"] - flight[f"alpha_{path.model}"]
        assert np.sqrt(np.mean(residual**2)) == pytest.approx(told["outputs"]["alpha"]["rms"], rel=1e-9)
