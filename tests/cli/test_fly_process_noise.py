"""Process noise and its posterior, from the command line."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from flying import NOISE, page_of, told, written
from linear_cards import (
    FIRST_ORDER,
    SHORT_PERIOD,
    SHORT_PERIOD_TRUTH,
    card_of,
    disturbed_first_order,
    short_period_flight,
)

from bayes_aero.diagnosis.trajectories import process_noise
from bayes_aero.flight.reading.read_record import write_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.posterior.ensemble import EnsembleLength
from bayes_aero.inference.posterior.innovations import PosteriorLength, sample_innovations


def test_in_calm_air_process_noise_changes_nothing(program, tmp_path):
    """The same estimates within the errors, measurement noise as it was made, and next to no process noise."""
    card, record = written(tmp_path, SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH))
    done = program("fly", record, "--model", card, "--process-noise", "--no-figures", "--out", "out", "--json")
    assert done.code == 0, done.err
    found = told(done)
    filtered = found["process_noise"]
    assert filtered["converged"]
    for name, (estimate, sd) in filtered["estimates"].items():
        assert abs(estimate - found["parameters"][name]["estimate"]) < sd, name
        assert abs(estimate - SHORT_PERIOD_TRUTH[name]) < 3.5 * sd, name
    for name, sd in filtered["noise_sd"].items():
        assert sd == pytest.approx(NOISE[name], rel=0.1)
    assert filtered["F"]["alpha"] < 0.2 * NOISE["alpha"] / 0.04**0.5  # of what noise adds to a step
    assert abs(filtered["gain"]) < 10.0
    assert max(map(abs, filtered["autocorrelation"].values())) < 0.2
    one_step = filtered["one_step"]
    assert one_step["status"] == "calibrated"
    assert set(one_step["outputs"]) == set(filtered["noise_sd"])
    for name, predicted in one_step["outputs"].items():
        assert predicted["rms"] == pytest.approx(NOISE[name], rel=0.15)  # the state is known far better
        assert [share["level"] for share in predicted["shares"]] == [0.5, 0.9, 0.95, 0.99]
    assert any("inside their 95 % intervals: α " in sentence for sentence in found["sentences"])
    page = page_of(tmp_path / "out")
    assert "with process noise" in page
    assert "inside the interval, %" in page


@pytest.mark.recovery
def test_a_posterior_is_written_and_bad_chains_are_told(program, tmp_path, monkeypatch):
    """NUTS converges about the fit; an ensemble of a hundred steps does not, which terminal, JSON and page say."""
    length = PosteriorLength(emcee=EnsembleLength(1, 100))
    monkeypatch.setattr(process_noise, "sample_innovations", partial(sample_innovations, length=length))
    card, record = tmp_path / "card.toml", tmp_path / "flight.csv"
    card.write_text(FIRST_ORDER)
    channels = disturbed_first_order(160, 0.05, -0.8, 0.03, 0.01)
    write_record(
        FlightRecord.from_arrays("flight", 0.05 * np.arange(160), channels, "simulated"),
        record,
        card_of(FIRST_ORDER).channels,
    )
    done = program("fly", record, "--model", card, "--process-noise", "--posterior", "--out", "out")
    assert done.code == 0, done.err
    assert "The posterior by emcee: not converged" in " ".join(done.out.split())
    text = (tmp_path / "out" / "trajectories.json").read_text()
    found = told(SimpleNamespace(out=text))
    posterior = found["posterior"]
    assert {key: row["status"] for key, row in posterior["status"].items()} == {
        "nuts": "converged",
        "emcee": "not_converged",
    }
    for name, (estimate, sd) in found["process_noise"]["estimates"].items():
        marginal = posterior["nuts"][name]
        assert abs(marginal["mean"] - estimate) < sd, name
        assert marginal["sd"] == pytest.approx(sd, rel=0.3), name
        assert marginal["rhat"] <= 1.01
        assert marginal["ess_bulk"] >= 400.0
    for engine in ("nuts", "emcee"):
        with xr.open_datatree(tmp_path / "out" / f"posterior_{engine}.nc", engine="h5netcdf") as tree:
            assert set(tree["posterior"].data_vars) == set(posterior[engine])
    table = pd.read_csv(tmp_path / "out" / "posterior.csv", index_col=0)
    assert set(table.index) == {"Zalpha", "F_alpha", "sigma_alpha"}
    page = page_of(tmp_path / "out")
    assert "do not use the intervals" in page
    assert "Pair plot" in page


@pytest.mark.parametrize("options", [["--posterior"], ["--posterior", "--process-noise", "--no-priors"]])
def test_a_posterior_that_cannot_be_is_refused(program, tmp_path, options):
    card, record = written(tmp_path, SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH, n=100))
    done = program("fly", record, "--model", card, *options)
    assert done.code == 2
    assert "a posterior" in done.err
    assert "Traceback" not in done.err
    assert not (tmp_path / "trajectories").exists()


def test_one_step_predictions_of_two_flights_are_drawn(program, tmp_path):
    card, first = written(tmp_path, SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH), "one", 1)
    other = short_period_flight(SHORT_PERIOD_TRUTH, x0=(0.04, -0.02))
    _, second = written(tmp_path, SHORT_PERIOD, other, "two", 2)
    done = program("fly", first, second, "--model", card, "--process-noise", "--out", "out")
    assert done.code == 0, done.err
    assert (tmp_path / "out" / "figures" / "one_step.png").exists()
    assert "Quantile plots of innovations by output: " in page_of(tmp_path / "out")
