"""`bayes-aero fly`: output error, process noise, its posterior, bands of frequency; truth, files and exit codes."""

import json
from functools import partial

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calling import answer, holds, page_of, refused, succeeded, validated
from linear_cards import (
    FIRST_ORDER,
    SHORT_PERIOD,
    SHORT_PERIOD_TRUTH,
    card_of,
    disturbed_first_order,
    record_of,
    short_period_flight,
)

from bayes_aero.flight.record import FlightRecord, write_record
from bayes_aero.inference import prediction_error
from bayes_aero.inference.prediction_error import PosteriorLength, sample_innovations
from bayes_aero.inference.sampling import EnsembleLength
from bayes_aero.jobs.identify import identify
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.simulate.demo import TRUTH, demo_records

NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15}


def written(folder, text, channels, name="flight", seed=1, noise=NOISE):
    """Card and record as files; the true channels are those of the matrix exponential, with white noise."""
    card, record = folder / "card.toml", folder / f"{name}.csv"
    card.write_text(text)
    noisy = record_of(channels, noise=noise, rng=np.random.default_rng(seed), name=name)
    write_record(noisy, record, [c for c in card_of(text).channels if noisy.has(c.name) or c.name == "time"])
    return card, record


def two_flights(folder):
    """Of a short period, from different states."""
    card, first = written(folder, SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH), "one", 1)
    other = short_period_flight(SHORT_PERIOD_TRUTH, x0=(0.04, -0.02))
    return card, first, written(folder, SHORT_PERIOD, other, "two", 2)[1]


def told(done):
    """The JSON on standard output, which must follow the schema."""
    return validated(answer(done), "trajectories")


def test_the_short_period_is_recovered_and_written(program, tmp_path):
    card, first, second = two_flights(tmp_path)
    done = succeeded(program("fly", first, second, "--model", card, "--windows", "5", "--out", "out", "--json"))
    found = told(done)
    assert done.out == (tmp_path / "out" / "trajectories.json").read_text()
    assert (found["status"], found["windows"], found["notes"]) == ("converged", 5.0, [])
    assert {r["name"] for r in found["records"]} == set(found["initial_states"]) == {"one", "two"}
    assert set(found["parameters"]) == set(SHORT_PERIOD_TRUTH)
    for name, p in found["parameters"].items():
        assert abs(p["estimate"] - SHORT_PERIOD_TRUTH[name]) < 3.0 * p["sd_corrected"], name
        assert p["sd_corrected"] < max(0.05 * abs(SHORT_PERIOD_TRUTH[name]), 0.003), name
        assert p["sd_corrected"] == pytest.approx(p["crb"], rel=0.4)  # the noise is white
        assert not p["held_by_prior"]
        assert not p["at_bound"]
    for name, sd in found["residual_sd"].items():
        assert sd == pytest.approx(NOISE[name], rel=0.1)
    for manoeuvre, q in {"one": 0.01, "two": -0.02}.items():
        assert found["initial_states"][manoeuvre]["alpha"]["value"] == pytest.approx(0.04, abs=0.002)
        assert found["initial_states"][manoeuvre]["q"]["value"] == pytest.approx(q, abs=0.003)
    table = pd.read_csv(tmp_path / "out" / "parameters.csv", index_col=0)
    assert table["estimate"].to_dict() == {n: p["estimate"] for n, p in found["parameters"].items()}
    for path in found["paths"]:
        for name, error in path["outputs"].items():
            shares = [error[f"theil_{part}"] for part in ("bias", "variance", "covariance")]
            assert sum(shares) == pytest.approx(1.0), name
            assert (error["rms"] < 1.15 * NOISE[name]) == (path["model"] == "fitted")
    page = page_of(tmp_path / "out")
    assert all(name in page for name in SHORT_PERIOD_TRUTH)
    drawn = {path.name for path in (tmp_path / "out" / "figures").iterdir()}
    assert drawn == {f"trajectory_{name}.png" for name in ("alpha", "q", "az")}


def test_constant_errors_of_outputs_are_fitted_where_the_card_allows_them(program, tmp_path):
    """A vane that stands off by another angle in each flight, of which the difference is reported."""
    rng, paths = np.random.default_rng(4132), []
    truth = rng.uniform(0.01, 0.02, 2) * [1.0, -1.0]
    text = SHORT_PERIOD + '\n[output_biases]\nalpha = "1.2 deg"\n'
    for number, x0 in enumerate([(0.04, 0.01), (0.04, -0.02)]):
        channels = short_period_flight(SHORT_PERIOD_TRUTH, x0=x0)
        channels["alpha"] = channels["alpha"] + truth[number]
        card, path = written(tmp_path, text, channels, f"flight{number}", int(rng.integers(10_000)))
        paths.append(path)
    found = told(program("fly", *paths, "--model", card, "--windows", "5", "--out", "out", "--json"))["parameters"]
    assert set(found) == {*SHORT_PERIOD_TRUTH, "bias_alpha_1", "bias_alpha_2"}
    apart = found["bias_alpha_1"]["estimate"] - found["bias_alpha_2"]["estimate"]
    assert apart == pytest.approx(truth[0] - truth[1], abs=0.002), truth


def test_what_a_still_elevator_does_not_tell_is_marked_and_a_linear_card_is_only_flown(program, tmp_path):
    still = short_period_flight(SHORT_PERIOD_TRUTH | {"Zde": 0.0, "Mde": 0.0}, x0=(0.1, -0.1))
    still["elevator"] = np.zeros_like(still["elevator"])
    card, record = written(tmp_path, SHORT_PERIOD, still)
    done = succeeded(program("fly", record, "--model", card, "--no-figures"))
    parameters = validated(tmp_path / "trajectories" / "trajectories.json", "trajectories")["parameters"]
    assert {name for name, p in parameters.items() if p["held_by_prior"]} == {"Zde", "Mde"}
    assert parameters["Mde"]["crb"] is None
    assert done.out.count("held by its prior") == 2
    assert "The fit converged; the RMS error of the trajectories is" in " ".join(done.out.split())
    assert not (tmp_path / "trajectories" / "figures").exists()
    card, record = written(tmp_path, SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH))
    uses = answer(program("check", record, "--model", card, "--json"))["uses"]
    assert uses == {"fly": {"possible": True, "why_not": None}}
    refused(program("diagnose", record, "--model", card), "a linear system, which has no effects; use one with [model]")


def test_a_model_that_cannot_fly_is_exit_code_one(program, tmp_path):
    """A static instability that doubles every 50 ms, fixed on the card."""
    text = SHORT_PERIOD.replace("Zq = 1.0", "Zq = 1.0\nMalpha = 200.0")
    card, record = written(tmp_path, text, short_period_flight(SHORT_PERIOD_TRUTH))
    done = program("fly", record, "--model", card, "--no-figures", "--json")
    assert done.code == 1
    found = validated(json.loads(done.out), "trajectories")
    assert (found["status"], found["converged"]) == ("left_envelope", False)
    assert "cannot be simulated through this record" in found["sentences"][0]
    assert "cannot be simulated through this record" in page_of(tmp_path / "trajectories")


def test_a_model_of_effects_flies_a_stall(program, tmp_path):
    """Without noise, so that the truth is what comes out; in one window, which compiles less."""
    simulated = ("--manoeuvre", "slow_stall", "--duration", "24", "--noise", "none", "--seed", "5")
    assert program("simulate", *simulated, "--out", "stall.csv").code == 0
    found = told(program("fly", "stall.csv", "--windows", "60", "--no-figures", "--json"))
    assert "altitude" not in found["fitted_outputs"]
    start, fitted = (next(p for p in found["paths"] if p["model"] == model) for model in ("start", "fitted"))
    assert set(fitted["outputs"]) == {*found["fitted_outputs"], "altitude"}
    for name in found["fitted_outputs"]:
        assert fitted["outputs"][name]["rms"] < 0.01 * start["outputs"][name]["rms"], name
    assert "h [m] *" in page_of(tmp_path / "trajectories")  # reported, not fitted
    truth = json.loads((tmp_path / "stall.csv.truth.json").read_text())["parameters"]
    told_of = {name for name, p in found["parameters"].items() if not p["held_by_prior"]}
    assert set(found["parameters"]) - told_of <= {"tau2"}  # alpha hardly falls while the flow is separated
    for name in told_of:
        assert found["parameters"][name]["estimate"] == pytest.approx(truth[name], rel=0.002), name
    exported = answer(program("export", "trajectories", "--to", "jsbsim", "--draws", "2", "--json"))
    assert exported["parameters"]["Cma"]["value"] == found["parameters"]["Cma"]["estimate"]
    assert "trajectories (fly)" in exported["sources"][0]
    assert exported["draws"]["origin"].startswith("normal distribution of the estimates, covariance corrected")


def test_in_calm_air_process_noise_changes_nothing(program, tmp_path):
    """The same estimates within the errors, measurement noise as it was made, and next to no process noise."""
    card, record = written(tmp_path, SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH))
    found = told(program("fly", record, "--model", card, "--process-noise", "--out", "out", "--json"))
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
    holds(page, "with process noise", "inside the interval, %")


@pytest.mark.recovery
def test_a_posterior_is_written_and_bad_chains_are_told(program, tmp_path, monkeypatch):
    """NUTS converges about the fit; an ensemble of a hundred steps does not, which terminal, JSON and page say."""
    length = PosteriorLength(emcee=EnsembleLength(1, 100))
    monkeypatch.setattr(prediction_error, "sample_innovations", partial(sample_innovations, length=length))
    card, record = tmp_path / "card.toml", tmp_path / "flight.csv"
    card.write_text(FIRST_ORDER)
    channels = disturbed_first_order(160, 0.05, -0.8, 0.03, 0.01)
    flight = FlightRecord.from_arrays("flight", 0.05 * np.arange(160), channels, "simulated")
    write_record(flight, record, card_of(FIRST_ORDER).channels)
    done = succeeded(program("fly", record, "--model", card, "--process-noise", "--posterior", "--out", "out"))
    assert "The posterior by emcee: not converged" in " ".join(done.out.split())
    found = validated(tmp_path / "out" / "trajectories.json", "trajectories")
    posterior = found["posterior"]
    assert posterior["status"]["nuts"]["status"] == "converged"
    assert posterior["status"]["emcee"]["status"] == "not_converged"
    for name, (estimate, sd) in found["process_noise"]["estimates"].items():
        assert abs(posterior["nuts"][name]["mean"] - estimate) < sd, name
    for engine in ("nuts", "emcee"):
        with xr.open_datatree(tmp_path / "out" / f"posterior_{engine}.nc", engine="h5netcdf") as tree:
            assert set(tree["posterior"].data_vars) == set(posterior[engine])
    table = pd.read_csv(tmp_path / "out" / "posterior.csv", index_col=0)
    assert set(table.index) == {"Zalpha", "F_alpha", "sigma_alpha"}
    page = page_of(tmp_path / "out")
    holds(page, "do not use the intervals", "Posterior of pairs of parameters")


def test_fly_shows_both_fits_in_a_band_beside_the_time_domain(program, tmp_path):
    fine = {"alpha": 0.001, "q": 0.001, "az": 0.05}
    card, record = written(tmp_path, SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH), seed=5, noise=fine)
    asked = ("fly", record, "--model", card, "--frequency", "0.1", "1.5", "--no-priors", "--out", "out")
    done = succeeded(program(*asked))
    assert "in the frequency domain, 0.1 to 1.5 Hz" in " ".join(done.out.split())
    assert "Z0, M0 and az0 drop out with bias and drift" in " ".join(done.out.split())
    found = validated(tmp_path / "out" / "trajectories.json", "trajectories")
    assert [fit["method"] for fit in found["frequency"]] == ["equation error", "output error"]
    assert all(fit["converged"] for fit in found["frequency"])
    table = pd.read_csv(tmp_path / "out" / "parameters.csv", index_col=0)
    told = found["frequency"][1]["parameters"]["Mq"]["estimate"]
    assert table.loc["Mq", "frequency_output_error"] == pytest.approx(told)
    assert (tmp_path / "out" / "figures" / "bode.png").is_file()
    assert "In the frequency domain" in (tmp_path / "out" / "report.html").read_text()


NOT_REQUIRED = SHORT_PERIOD.replace('"de", unit = "deg"', '"de", unit = "deg", required = false')


@pytest.mark.parametrize(
    ("text", "without", "options", "words"),
    [
        (SHORT_PERIOD, "elevator", "", ("flight", "'de'")), (NOT_REQUIRED, "elevator", "", ("flight", "elevator")),
        (SHORT_PERIOD + '\n[output_biases]\nelevator = "1 deg"\n', "", "", ("elevator cannot have a bias",)),
        (SHORT_PERIOD, "", "--windows 0.2", ("at least 1 s",)),
        (SHORT_PERIOD, "", "--windows nan", ("at least 1 s",)), (SHORT_PERIOD, "", "--posterior", ("a posterior",)),
        (SHORT_PERIOD, "", "--posterior --process-noise --no-priors", ("a posterior",)),
        (SHORT_PERIOD, "", "--frequency 2 1", ("2 to 1 Hz",)), (SHORT_PERIOD, "", "--frequency 1 20", ("12.5 Hz",)),
    ],
    ids=lambda given: "card" if "[channels]" in given else None,
)  # fmt: skip
def test_what_cannot_be_flown_is_one_sentence_and_nothing_is_written(program, tmp_path, text, without, options, words):
    channels = short_period_flight(SHORT_PERIOD_TRUTH, n=100)
    channels.pop(without, None)
    card, record = written(tmp_path, text, channels)
    refused(program("fly", record, "--model", card, *options.split()), *words)
    assert not list((tmp_path / "trajectories").glob("*"))
    assert (tmp_path / "trajectories").exists() <= ("output_biases" in text)


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
