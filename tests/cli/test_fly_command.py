"""`bayes-aero fly`: truth, files and exit codes. For process noise see test_run_command.py, test_published_cases.py."""

import json
from functools import partial
from pathlib import Path

import linear_cards as linear
import numpy as np
import pandas as pd
import pytest
import six_axes as six
import stranger_six
import xarray as xr
from calling import RINGS, answer, holds, page_of, refused, succeeded, validated

from bayes_aero.dynamics.flight import AircraftDynamics
from bayes_aero.dynamics.trim import Steady, modes
from bayes_aero.flight.reading import resample_record
from bayes_aero.flight.record import FlightRecord, write_record
from bayes_aero.inference import prediction_error
from bayes_aero.inference.prediction_error import PosteriorLength, sample_innovations
from bayes_aero.inference.sampling import EnsembleLength
from bayes_aero.jobs.identify import identify
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.simulate.demo import TRUTH, simulate_stall

CARD, TRUE, flight = linear.SHORT_PERIOD, linear.SHORT_PERIOD_TRUTH, linear.short_period_flight
QUICK = ("--no-process-noise", "--no-figures", "--out", "out")


def written(folder, text, channels):
    """Card and record as files; the true channels are those of the matrix exponential, with white noise."""
    card, record = folder / "card.toml", folder / "flight.csv"
    card.write_text(text)
    noisy = linear.record_of(channels, noise={"alpha": 0.002, "q": 0.003, "az": 0.15}, rng=np.random.default_rng(1))
    write_record(noisy, record, [c for c in linear.card_of(text).channels if noisy.has(c.name) or c.name == "time"])
    return card, record


def test_the_short_period_is_recovered_and_written(short_period):
    content = validated(short_period.flown / "trajectories.json", "trajectories")
    assert (content["status"], content["windows"]) == ("converged", 5.0)
    assert {r["name"] for r in content["records"]} == set(content["initial_states"]) == {"one", "two"}
    assert set(content["parameters"]) == set(TRUE)
    for name, p in content["parameters"].items():
        assert abs(p["estimate"] - TRUE[name]) < 3.0 * p["sd_corrected"], name
        assert p["sd_corrected"] < max(0.05 * abs(TRUE[name]), 0.003), name
        assert p["sd_corrected"] == pytest.approx(p["crb"], rel=0.4)  # the noise is white
        assert not p["held_by_prior"]
        assert not p["at_bound"]
    for name, sd in content["residual_sd"].items():
        assert sd == pytest.approx(short_period.noise[name], rel=0.1)
    for manoeuvre, q in {"one": 0.01, "two": -0.02}.items():
        assert content["initial_states"][manoeuvre]["alpha"]["value"] == pytest.approx(0.04, abs=0.002)
        assert content["initial_states"][manoeuvre]["q"]["value"] == pytest.approx(q, abs=0.003)
    table = pd.read_csv(short_period.flown / "parameters.csv", index_col=0)
    assert table["estimate"].to_dict() == {n: p["estimate"] for n, p in content["parameters"].items()}
    for path in content["paths"]:
        for name, error in path["outputs"].items():
            shares = [error[f"theil_{part}"] for part in ("bias", "variance", "covariance")]
            assert sum(shares) == pytest.approx(1.0), name
            assert (error["rms"] < 1.15 * short_period.noise[name]) == (path["model"] == "fitted")
    holds(page_of(short_period.flown), *TRUE, "In the frequency domain")
    drawn = {path.stem for path in (short_period.flown / "figures").iterdir()}
    assert drawn == {"bode", *(f"trajectory_{name}" for name in ("alpha", "q", "az"))}


def test_both_fits_in_a_band_stand_beside_the_time_domain(short_period):
    dropped = "Z0, M0 and az0 drop out with bias and drift"
    holds(short_period.said, "in the frequency domain, 0.1 to 1.5 Hz", dropped)
    content = json.loads((short_period.flown / "trajectories.json").read_text())
    assert all(dropped in note or "requency domain" in note for note in content["notes"])
    assert [fit["method"] for fit in content["frequency"]] == ["equation error", "output error"]
    assert all(fit["converged"] for fit in content["frequency"])
    table = pd.read_csv(short_period.flown / "parameters.csv", index_col=0)
    estimate = content["frequency"][1]["parameters"]["Mq"]["estimate"]
    assert table.loc["Mq", "frequency_output_error"] == pytest.approx(estimate)


def test_what_a_still_elevator_does_not_tell_is_marked_and_a_linear_card_is_only_flown(program, tmp_path):
    still = flight(TRUE | {"Zde": 0.0, "Mde": 0.0}, x0=(0.1, -0.1))
    still["elevator"] = np.zeros_like(still["elevator"])
    card, record = written(tmp_path, CARD, still)
    done = succeeded(program("fly", record, "--model", card, "--no-figures"))
    parameters = validated(tmp_path / "trajectories" / "trajectories.json", "trajectories")["parameters"]
    assert {name for name, p in parameters.items() if p["held_by_prior"]} == {"Zde", "Mde"}
    assert parameters["Mde"]["crb"] is None
    assert done.out.count("held by its prior") == 2
    assert "The fit converged; the RMS error of the trajectories is" in " ".join(done.out.split())
    assert not (tmp_path / "trajectories" / "figures").exists()
    uses = answer(program("check", record, "--model", card, "--json"))["uses"]
    assert uses == {"fly": {"possible": True, "why_not": None}}
    refused(program("diagnose", record, "--model", card), "a linear system, which has no effects; use one with [model]")


def test_a_model_that_cannot_fly_is_exit_code_one(program, tmp_path):
    """A static instability that doubles every 50 ms, fixed on the card."""
    text = CARD.replace("Zq = 1.0", "Zq = 1.0\nMalpha = 200.0")
    card, record = written(tmp_path, text, flight(TRUE))
    done = program("fly", record, "--model", card, "--no-figures", "--json")
    assert done.code == 1
    assert done.out == (tmp_path / "trajectories" / "trajectories.json").read_text()
    content = validated(json.loads(done.out), "trajectories")
    assert (content["status"], content["converged"]) == ("left_envelope", False)
    assert "cannot be simulated through this record" in content["sentences"][0]
    assert "cannot be simulated through this record" in page_of(tmp_path / "trajectories")


def test_a_model_of_effects_flies_a_stall(program, flights):
    """Without noise, so that the truth is what comes out; in one window, which compiles less."""
    asked = ("--windows", "60", "--resample", "0.08", "--no-process-noise", "--no-figures", "--json")
    content = validated(answer(program("fly", flights.sound, *asked), RINGS), "trajectories")
    assert "altitude" not in content["fitted_outputs"]
    start, fitted = (next(p for p in content["paths"] if p["model"] == model) for model in ("start", "fitted"))
    assert set(fitted["outputs"]) == {*content["fitted_outputs"], "altitude"}
    for name in content["fitted_outputs"]:
        assert fitted["outputs"][name]["rms"] < 0.01 * start["outputs"][name]["rms"], name
    assert "h [m] *" in page_of(Path("trajectories"))  # reported, not fitted
    truth = json.loads((flights.folder / "sound.csv.truth.json").read_text())["parameters"]
    estimated = {n: p["estimate"] for n, p in content["parameters"].items() if not p["held_by_prior"]}
    assert set(content["parameters"]) - set(estimated) <= {"tau2"}  # alpha hardly falls while the flow is separated
    assert estimated == pytest.approx({name: truth[name] for name in estimated}, rel=0.002)
    exported = answer(program("export", "trajectories", "--to", "jsbsim", "--draws", "2", "--json"))
    assert exported["parameters"]["Cma"]["value"] == content["parameters"]["Cma"]["estimate"]
    assert "trajectories (fly)" in exported["sources"][0]
    assert exported["draws"]["origin"].startswith("normal distribution of the estimates, covariance corrected")


@pytest.mark.recovery
def test_a_posterior_is_written_and_bad_chains_are_told(program, tmp_path, monkeypatch):
    """NUTS converges about the fit; an ensemble of a hundred steps does not, which terminal, JSON and page say."""
    length = PosteriorLength(emcee=EnsembleLength(1, 100))
    monkeypatch.setattr(prediction_error, "sample_innovations", partial(sample_innovations, length=length))
    card, record = tmp_path / "card.toml", tmp_path / "flight.csv"
    card.write_text(linear.FIRST_ORDER)
    channels = linear.disturbed_first_order(160, 0.05, -0.8, 0.03, 0.01)
    record_made = FlightRecord.from_arrays("flight", 0.05 * np.arange(160), channels, "simulated")
    write_record(record_made, record, linear.card_of(linear.FIRST_ORDER).channels)
    done = succeeded(program("fly", record, "--model", card, "--process-noise", "--posterior", "--out", "out"))
    assert "The posterior by emcee: not converged" in " ".join(done.out.split())
    content = validated(tmp_path / "out" / "trajectories.json", "trajectories")
    posterior = content["posterior"]
    assert posterior["status"]["nuts"]["status"] == "converged"
    assert posterior["status"]["emcee"]["status"] == "not_converged"
    for name, (estimate, sd) in content["process_noise"]["estimates"].items():
        assert abs(posterior["nuts"][name]["mean"] - estimate) < sd, name
    for engine in ("nuts", "emcee"):
        with xr.open_datatree(tmp_path / "out" / f"posterior_{engine}.nc", engine="h5netcdf") as tree:
            assert set(tree["posterior"].data_vars) == set(posterior[engine])
    table = pd.read_csv(tmp_path / "out" / "posterior.csv", index_col=0)
    assert set(table.index) == {"Zalpha", "F_alpha", "sigma_alpha"}
    page = page_of(tmp_path / "out")
    holds(page, "do not use the intervals", "Posterior of pairs of parameters")


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Three manoeuvres of another simulator as files, and their aircraft."""
    folder, rng = tmp_path_factory.mktemp("stranger"), np.random.default_rng(11)
    plane = stranger_six.drawn(rng, **six.ATTACHED)
    for kind in ("elevator", "aileron", "rudder"):
        manoeuvre = six.recorded(stranger_six.fly(plane, kind, rng, seconds=14.0), rng)
        pd.DataFrame(manoeuvre).to_csv(folder / f"{kind}.csv", index=False)
    return folder, plane


def test_six_coefficients_come_back_from_three_manoeuvres(flown, program):
    """And the modes of motion, within four standard errors of those of the true derivatives."""
    folder, plane = flown
    Path("six.toml").write_text(six.card_text(plane))
    files = [folder / f"{kind}.csv" for kind in ("elevator", "aileron", "rudder")]
    content = validated(answer(program("fly", *files, "--model", "six.toml", *QUICK, "--json")), "trajectories")
    assert content["converged"]
    assert len(content["parameters"]) == 22
    for name, row in content["parameters"].items():
        true = getattr(plane, name)
        assert abs(row["estimate"] - true) < 4.0 * row["sd_corrected"] < 4.0 * (0.1 * abs(true) + 0.01), name
    assert content["fitted_outputs"] == [
        "airspeed", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi", "ax", "ay", "az",
    ]  # fmt: skip
    assert set(content["initial_states"]["rudder"]) == {*content["fitted_outputs"][:9], "altitude"}
    model, motion = six.model(), content["motion"]
    steady = Steady(motion["airspeed"], motion["altitude"])
    true = modes(AircraftDynamics(model), six.values(plane, model), six.aircraft(plane), steady)
    assert [mode["name"] for mode in motion["modes"]] == ["short period", "phugoid", "Dutch roll", "roll", "spiral"]
    for mode, right in zip(motion["modes"], true, strict=True):
        off = complex(*mode["eigenvalue"]) - right.eigenvalue
        real, imaginary = mode["eigenvalue_sd"]
        assert abs(off.real) < 4.0 * real < 0.1, mode["name"]
        assert abs(off.imag) <= 4.0 * imaginary < 0.1, mode["name"]
    holds(page_of(Path("out")), "Clda", "Modes of motion", "Dutch roll", "spiral")


def test_lateral_derivatives_come_back_with_the_longitudinal_motion_and_what_the_card_states_held(flown, program):
    """Sideslip as recorded, too: what the vane's noise adds is not in the errors."""
    folder, plane = flown
    effects = [n for n in six.LATERAL if not n.endswith("side_force")]
    more = '[fly]\nheld = ["beta"]\noutputs = ["p", "r", "phi", "psi"]\n'
    Path("lateral.toml").write_text(six.card_text(plane, effects, (six.BOTH[1],), more))
    files = [folder / f"{kind}.csv" for kind in ("aileron", "rudder")]
    content = answer(program("fly", *files, "--model", "lateral.toml", *QUICK, "--json"))
    assert content["fitted_outputs"] == ["p", "r", "phi", "psi"]
    assert any("Held to the record: airspeed, alpha, beta, q, theta and altitude" in n for n in content["notes"])
    for name in ("Clp", "Clda", "Cnbe", "Cndr"):
        assert content["parameters"][name]["estimate"] == pytest.approx(getattr(plane, name), rel=0.05)
    assert content["motion"]["modes"] == []
    (why,) = (sentence for sentence in content["sentences"] if sentence.startswith("Modes of motion are not given"))
    assert "holds beta to the record" in why
    Path("wrong.toml").write_text(six.card_text(plane, more='[fly]\nheld = ["bank"]\n'))
    refused(program("fly", files[1], "--model", "wrong.toml"), "[fly] held", "airspeed, alpha")


@pytest.mark.parametrize(("text", "without", "options", "words"), [
    (CARD, "elevator", "", "'de'"),
    (CARD.replace('"de", unit = "deg"', '"de", unit = "deg", required = false'), "elevator", "", "elevator"),
    (CARD + '\n[output_biases]\nelevator = "1 deg"\n', "", "", "elevator cannot have a bias"),
    (CARD, "", "--windows 0.2", "at least 1 s"), (CARD, "", "--posterior", "a posterior"),
    (CARD, "", "--posterior --process-noise --no-priors", "a posterior"),
    (CARD, "", "--frequency 2 1", "2 to 1 Hz"), (CARD, "", "--frequency 1 20", "12.5 Hz"),
], ids=lambda given: "card" if "[channels]" in given else None)  # fmt: skip
def test_what_cannot_be_flown_is_one_sentence_and_nothing_is_written(program, tmp_path, text, without, options, words):
    channels = flight(TRUE, n=100)
    channels.pop(without, None)
    card, record = written(tmp_path, text, channels)
    refused(program("fly", record, "--model", card, *options.split()), words)
    assert not list((tmp_path / "trajectories").glob("*"))
    assert (tmp_path / "trajectories").exists() <= ("output_biases" in text)


def test_identify_in_a_band_finds_the_truth_and_agrees_with_the_time_domain(card):
    """Noise with a lag-1 correlation of 0.9 widens bounds threefold in the time domain, and hardly in a band."""
    records = [resample_record(simulate_stall(k, card=card).window(25.0, 65.0), 0.08) for k in range(2)]
    result = identify(records, card, IdentifyOptions(sample=False, gp=False, frequency=(0.05, 1.5)))
    fit, mle = result.frequency, result.mle
    assert fit is not None
    assert fit.converged
    assert set(fit.unseen) == {"CD0", "Cm0"}  # CL0 is in the drag polar
    scores = [(x - TRUTH[n]) / sd for n, x, sd in zip(fit.names, fit.estimate, fit.crb_corrected, strict=True)]
    assert max(map(abs, scores)) < 4.0
    assert max(fit.apart.values()) < 4.0
    assert np.median(fit.crb_corrected / fit.crb) < 1.3 < 2.0 < np.median(mle.crb_corrected / mle.crb)
    assert any("agree within" in note for note in result.notes)
