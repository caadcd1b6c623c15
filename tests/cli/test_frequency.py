"""The option --frequency of fly and identify, from files to numbers."""

from __future__ import annotations

import json
from importlib import resources

import jsonschema
import numpy as np
import pandas as pd
import pytest
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, record_of, short_period_flight

from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.reading.read_record import write_record
from bayes_aero.jobs.identify import identify
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.simulate.demo import TRUTH, demo_records

NOISE = {"alpha": 0.001, "q": 0.001, "az": 0.05}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A linear card, and a record of it."""
    folder = tmp_path_factory.mktemp("band")
    (folder / "linear.toml").write_text(SHORT_PERIOD)
    record = record_of(short_period_flight(SHORT_PERIOD_TRUTH), noise=NOISE, rng=np.random.default_rng(5))
    write_record(record, folder / "flight.csv", read_card(folder / "linear.toml").channels)
    return folder


def test_fly_shows_both_fits_in_a_band_beside_the_time_domain(program, folder, tmp_path):
    asked = ("fly", folder / "flight.csv", "--model", folder / "linear.toml", "--frequency", "0.1", "1.5")
    done = program(*asked, "--no-priors", "--out", "out")
    assert done.code == 0, done.err
    assert "Frequency domain, 0.1 to 1.5 Hz" in done.out
    assert "Z0, M0 and az0 drop out with bias and drift" in " ".join(done.out.split())
    found = json.loads((tmp_path / "out" / "trajectories.json").read_text())
    schema = json.loads(resources.files("bayes_aero.jobs.io.schemas").joinpath("trajectories.schema.json").read_text())
    jsonschema.validate(found, schema)
    assert [fit["method"] for fit in found["frequency"]] == ["equation error", "output error"]
    for fit in found["frequency"]:
        assert fit["converged"]
        for name, p in fit["parameters"].items():
            assert abs(p["estimate"] - SHORT_PERIOD_TRUTH[name]) < 4.0 * p["crb_corrected"] + 0.003, name
    table = pd.read_csv(tmp_path / "out" / "parameters.csv", index_col=0)
    told = found["frequency"][1]["parameters"]["Mq"]["estimate"]
    assert table.loc["Mq", "frequency_output_error"] == pytest.approx(told)
    assert (tmp_path / "out" / "figures" / "bode.png").is_file()
    assert "In the frequency domain" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("model", "band", "said"),
    [("linear.toml", ("2", "1"), "the band 2 to 1 Hz is empty"), ("linear.toml", ("1", "20"), "below 12.5 Hz only")],
)
def test_a_wrong_band_is_one_sentence_and_nothing_is_written(program, folder, tmp_path, model, band, said):
    done = program("fly", folder / "flight.csv", "--model", folder / model, "--frequency", *band, "--out", "none")
    assert done.code == 2
    assert said in " ".join(done.err.split())
    assert "Traceback" not in done.err
    assert not (tmp_path / "none").exists()


def test_identify_in_a_band_finds_the_truth_and_agrees_with_the_time_domain(card):
    """Noise with a lag-1 correlation of 0.9 widens bounds threefold in the time domain, and hardly in a band."""
    found = identify(demo_records(), card, IdentifyOptions(sample=False, gp=False, frequency=(0.05, 1.5)))
    fit, mle = found.frequency, found.mle
    assert fit is not None
    assert fit.converged
    assert set(fit.unseen) == {"CD0", "Cm0"}  # CL0 is in the drag polar
    scores = [(x - TRUTH[n]) / sd for n, x, sd in zip(fit.names, fit.estimate, fit.crb_corrected, strict=True)]
    assert max(map(abs, scores)) < 4.0
    assert max(fit.apart.values()) < 4.0
    assert np.median(fit.crb_corrected / fit.crb) < 1.3 < 2.0 < np.median(mle.crb_corrected / mle.crb)
    assert any("agree within" in note for note in found.notes)


def test_a_card_of_effects_is_sent_to_identify(program, tmp_path, card):
    path = tmp_path / "stall.csv"
    record = demo_records()[0].window(25.0, 65.0)
    write_record(record, path, [c for c in card.channels if record.has(c.name) or c.name == "time"])
    done = program("fly", path, "--frequency", "0.1", "1.5", "--out", "none")
    assert done.code == 2
    assert "use bayes-aero identify --frequency" in " ".join(done.err.split())
    assert not (tmp_path / "none").exists()
