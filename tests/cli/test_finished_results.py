"""`bayes-aero qualify` and `open`: finished results read again, of cards of effects and of linear cards.

From a result to a page that is signed and one that flies it, and a sentence for what a result lacks.
"""

import json
import shutil
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calling import answer, called, holds, refused, succeeded, validated
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, first_order_hold, record_of, short_period_flight

from bayes_aero.errors import InputError
from bayes_aero.explore.opened import Choice, Simulator, export_chosen, open_result
from bayes_aero.flight.card import read_card, shipped_cards
from bayes_aero.flight.reading import read_records
from bayes_aero.flight.record import FlightRecord, write_record
from bayes_aero.jobs.finished import card_of, fitted_records
from bayes_aero.jobs.options import FlyOptions
from bayes_aero.jobs.store import as_json, provenance

FEW = ("--draws", "100")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, identified):
    """Two simulated stalls without noise, the result of identify on one, and its qualification."""
    there = tmp_path_factory.mktemp("qualified")
    shutil.copytree(identified, there, dirs_exist_ok=True)
    table = pd.read_csv(there / "other.csv")  # an altitude in feet costs nothing that is compared
    table.assign(HQNH=table["HQNH"] / 0.3048).to_csv(there / "other.csv", index=False)
    told = answer(called(there, "qualify", "results", "other.csv", "--gusts", 1, *FEW, "--json"), 3)
    assert told == json.loads((there / "qualification" / "qualification.json").read_text())
    return there


@pytest.fixture
def here(folder, program, tmp_path):
    """A working directory of one's own with result and records."""
    shutil.copytree(folder / "results", tmp_path / "results")
    for name in ("stall", "other"):
        shutil.copy(folder / f"{name}.csv", tmp_path)
    return program


@pytest.fixture(scope="module")
def found(folder):
    return json.loads((folder / "qualification" / "qualification.json").read_text())


def test_the_numbers_follow_the_schema_and_every_thing_counted_makes_a_test_harder(found):
    validated(found, "qualification")
    assert not found["failures"]
    assert {t["kind"] for t in found["tests"]} == {"again", "test"}
    assert list(found["tolerances"]) == ["airspeed", "alpha", "theta", "q", "az"]
    # Draws are shared, so a test that fails by parameters fails with structure and gusts but for single draws.
    for test in found["tests"]:
        chances = [test["counted"][name]["value"] for name in ("parameters", "structure", "gusts")]
        assert chances[1] <= chances[0] + 0.05
        assert chances[2] <= chances[1] + 0.05
        assert test["probability"] == chances[2]
        assert test["record"]["passed"]  # the model is the truth, and there is no noise


def test_extrapolation_is_told_of_the_other_record_alone(folder, found):
    """Beside the hull of the fitted record the other one is outside where single channels already are."""
    fitted, other = (np.genfromtxt(folder / f"{n}.csv", delimiter=",", names=True) for n in ("stall", "other"))
    alpha, low, high = other["ALCG"], fitted["ALCG"].min(), fitted["ALCG"].max()
    told = {one["manoeuvre"]: one for one in found["outside"] if one["motion"] == "recorded"}
    assert set(told) == {"other"}
    clearly = 0.1 * (high - low) / 2.0  # a hull lies within the ranges of its channels
    assert told["other"]["share"] >= np.mean((alpha > high + clearly) | (alpha < low - clearly)) - 0.01
    assert told["other"]["distance"] >= max(alpha.max() - high, low - alpha.min()) / ((high - low) / 2.0) - 0.01
    assert told["other"]["share"] > 0.0 < told["other"]["distance"]
    assert found["flown_region"] == {"channels": ["alpha", "beta", "mach", "p", "q", "r"], "not_recorded": []}


def test_the_page_can_be_signed(folder, found):
    page = (folder / "qualification" / "qualification.html").read_text()
    assert "was not made" not in page
    holds(page, "signature", "accepted", "refused", "Attachment 7", "was not read", "Stated: 1 m/s")
    assert ("The model does not qualify" in page) == (found["verdict"] == "fails")
    rows = (folder / "qualification" / "qualification.csv").read_text().splitlines()
    assert len(rows) == 1 + len(found["tests"])


@pytest.mark.parametrize(("arguments", "words"), [
    (("attas",), "attas is a card; give the folder of a result"),
    (("nowhere",), "there is no result 'nowhere'"),
    (("results", "nosuch.csv"), "no such file"),
    (("results", "stall.csv"), "was fitted, so it is tested anyway"),
    (("results", "--draws", "3"), "--draws is 3; give a number from 100"),
    (("results", "--gusts", "99"), "--gusts is 99 m/s"),
])  # fmt: skip
def test_bad_input_is_one_sentence(here, arguments, words):
    refused(here("qualify", *arguments), words, gone=["qualification"])


def test_records_that_changed_are_refused(here):
    table = pd.read_csv("stall.csv")
    table.assign(ALCG=table["ALCG"] + 1e-6).to_csv("stall.csv", index=False)
    refused(here("qualify", "results", *FEW), "stall.csv has changed since results/results.json")
    Path("stall.csv").unlink()
    refused(here("qualify", "results", *FEW), "stall.csv", "--fitted")


def test_a_copy_of_a_fitted_record_is_no_new_one(here):
    """With fewer digits, half of the samples, and another clock."""
    table = pd.read_csv("stall.csv").round(4)
    table.assign(T=table["T"] + 1000.0).iloc[::2].to_csv("new.csv", index=False)
    refused(here("qualify", "results", "new.csv", *FEW), "new is the same record as stall")


def test_faults_of_a_new_record_are_told(here, folder, found):
    """In knots no flight can be simulated."""
    table = pd.read_csv("other.csv")
    table = table.assign(HQNH=table["HQNH"] * 0.3048, VTASCG=table["VTASCG"] * 3600.0 / 1852.0)
    table.to_csv("knots.csv", index=False)
    refused(here("qualify", "results", "knots.csv", *FEW), "knots: airspeed is in kt", "leave this record out")
    assert ("altitude", "unit") in {(f["channel"], f["fault"]) for f in found["health"] if f["grave"]}
    assert "altitude is in ft" in (folder / "qualification" / "qualification.html").read_text()


@pytest.fixture
def reread(tmp_path, card, monkeypatch):
    """`reread(made, *files)`: the records of a result made of `made`, found again as its JSON names them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["bayes-aero", "fly", "x@1:0", "--model", "other.toml", "--resample=7", "'"])

    def again(made, *files):
        source = json.loads(as_json(provenance(card, made, 0, {}, FlyOptions())))
        return fitted_records(source, Path("results/trajectories.json"), card, remedy="give it", files=files), source

    return again


def test_records_are_read_again_as_they_were_whatever_the_command_said(folder, card, reread):
    shutil.copy(folder / "stall.csv", "stall.csv")
    (part,) = read_records(["stall.csv@30:60"], card.channels, resample=0.1)
    cut = read_records(["stall.csv"], card.channels)[0].window(40.0, 50.0)
    found, source = reread([part, cut])
    assert [r.content for r in found] == [part.content, cut.content]
    assert [r.name for r in found] == ["stall_30-60", cut.name]
    assert source["inputs"][0]["read"] == {
        "path": "stall.csv", "part": "30:60", "resample": 0.1, "windows": [], "split": False,
    }  # fmt: skip
    assert source["options"]["windows"] == 12.0
    late = pd.read_csv(folder / "other.csv")
    pd.concat([pd.read_csv("stall.csv"), late.assign(T=late["T"] + 60.0)]).to_csv("both.csv", index=False)
    halves = read_records(["both.csv"], card.channels, split=True)
    found, source = reread(halves)
    assert [r.content for r in found] == [r.content for r in halves]
    assert [given["read"]["split"] for given in source["inputs"]] == [True, True]


def test_records_are_found_by_their_content_and_not_by_their_name(folder, card, reread):
    shutil.copy(folder / "stall.csv", "stall.csv")
    made = read_records(["stall.csv"], card.channels)
    table = pd.read_csv("stall.csv", dtype=str)
    table[[*reversed(table.columns)]].to_csv("moved.csv", index=False)
    Path("stall.csv").unlink()
    with pytest.raises(InputError, match=r"record stall\.csv of .* is not where it was"):
        reread(made)
    with pytest.raises(InputError, match=r"record stall\.csv of .* is not where it was"):
        reread(made, folder / "other.csv")
    ((found,), _) = reread(made, folder / "other.csv", Path("moved.csv"))
    assert (found.name, found.content) == ("stall", made[0].content)
    with pytest.raises(InputError, match="was made in memory"):
        reread([FlightRecord.from_arrays("mine", made[0].time, made[0].channels)])


@pytest.mark.usefixtures("reread")
def test_a_card_is_found_where_the_result_says(tmp_path):
    text = shipped_cards()["attas"].read_text()
    (tmp_path / "cards").mkdir()
    (tmp_path / "cards" / "mine.toml").write_text(text)
    own = read_card("cards/mine.toml")
    source = json.loads(as_json(provenance(own, [], 0, {})))
    assert card_of(source, Path("elsewhere/results.json"), None).path == "cards/mine.toml"
    (tmp_path / "cards" / "mine.toml").write_text(text + "\n")
    with pytest.raises(InputError, match="not found here unchanged"):
        card_of(source, Path("elsewhere/results.json"), None)


@pytest.mark.usefixtures("interruptible")
def test_it_serves_until_ctrl_c_and_ends_with_zero(identified):
    command = [sys.executable, "-m", "bayes_aero", "open", "results", "--no-browser"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, cwd=identified, text=True, **pipes) as running:
        try:
            line = running.stdout.readline()
            assert line.startswith("identify: results is open at http://127.0.0.1:"), (line, running.stderr.read())
            url = line.split(" at ")[1].split(" ")[0]
            with urllib.request.urlopen(url, timeout=120) as page:
                assert b"attached_lift" not in page.read()[:200]
            running.send_signal(signal.SIGINT)
            out, err = running.communicate(timeout=60)
        finally:
            running.kill()
    assert (running.returncode, out, err) == (0, "", "")


def test_what_is_no_result_or_has_moved_is_one_sentence(program, identified, tmp_path):
    (tmp_path / "empty").mkdir()
    refused(program("open", "empty"), "identify, fly or diagnose")
    refused(program("open", "nosuch"), "there is no result 'nosuch'")
    refused(program("open", "attas"), "attas is a card; give the folder of a result")
    told = json.loads((identified / "results" / "results.json").read_text())
    told["mle"]["status"] = "not_converged"
    (tmp_path / "results.json").write_text(json.dumps(told))
    refused(program("open", "results.json"), "has not converged")
    (tmp_path / "deep" / "results").mkdir(parents=True)
    result = tmp_path / "deep" / "results" / "results.json"
    result.write_bytes((identified / "results" / "results.json").read_bytes())
    refused(program("open", "deep/results"), "give its folder with --records")
    refused(program("open", "deep/results", "--records", tmp_path), f"is not in {tmp_path}")


NOISE = {"alpha": 2e-4, "q": 2e-4, "az": 0.02}
FLAGS = ("--no-figures", "--no-process-noise")
TOLERANCES = '\n[tolerances]\nalpha = "2 deg"\nq = "2 deg/s"\naz = "0.02 m/s^2"\nairspeed = "3 kt"\n'


@pytest.fixture(scope="module")
def linear(tmp_path_factory):
    """Three flights of a short period, the third of another start, and the fit of the first two."""
    there = tmp_path_factory.mktemp("linear")
    (there / "sp.toml").write_text(SHORT_PERIOD + TOLERANCES)
    card, rng = read_card(there / "sp.toml"), np.random.default_rng(7)
    for name, begin in (("one", (0.04, 0.01)), ("two", (0.02, 0.0)), ("other", (0.0, 0.02))):
        record = record_of(short_period_flight(SHORT_PERIOD_TRUTH, x0=begin), noise=NOISE, rng=rng, name=name)
        write_record(record, there / f"{name}.csv", card.channels)
    succeeded(called(there, "fly", "one.csv", "two.csv", "--model", "sp.toml", "--out", "flown", *FLAGS), 0, 3)
    return there


@pytest.fixture
def there(linear, program, monkeypatch):
    """The program in that folder."""
    monkeypatch.chdir(linear)
    return program


def test_a_linear_model_is_qualified(there):
    """The model is the true one. Its noise is far inside 2 deg, and outside 0.02 m/s^2 in every flight."""
    found = answer(there("qualify", "flown", "other.csv", "--draws", 100, "--out", "passed", "--json"))
    chances = {(t["kind"], t["output"]): t["probability"] for t in found["tests"]}
    assert {output for _, output in chances} == {"alpha", "q", "az"}
    assert all(x == (0.0 if output == "az" else 1.0) for (_, output), x in chances.items())
    assert {name: t["verdict"] for name, t in found["tolerances"].items()}["alpha"] == "passes"
    assert "moving air" in found["origins"]["gusts"]
    assert "no prior of Z0" in found["origins"]["next flight"]
    assert any("tolerance of airspeed is not judged" in note for note in found["notes"])
    assert found["failures"] == []


def test_what_a_linear_system_lacks_is_one_sentence(there, linear):
    refused(there("qualify", "flown", "--gusts", 1, "--out", "no"), "moving air", "leave --gusts out", gone=["no"])
    opened = open_result(str(linear / "flown"))
    with pytest.raises(InputError, match="no form in another simulator"):
        export_chosen(opened, Choice(), opened.identified.values, "jsbsim")


def test_constants_of_each_manoeuvre_cannot_fly_another_one(there, linear):
    text = (linear / "sp.toml").read_text().replace("[linear]\n", '[linear]\nby_manoeuvre = ["M0"]\n')
    (linear / "own.toml").write_text(text)
    succeeded(there("fly", "one.csv", "two.csv", "--model", "own.toml", "--out", "own", *FLAGS), 0, 3)
    refused(there("qualify", "own", "other.csv", "--draws", 100, "--out", "no"), "M0", "other")
    found = answer(there("qualify", "own", "--draws", 100, "--out", "both", "--json"))
    assert "the card states M0 for each manoeuvre" in found["origins"]["structure"]
    turning = open_result(str(linear / "own")).groups()[1]
    assert [s.name for s in turning.sliders] == ["M0_1", "M0_2", "Malpha", "Mq", "Mde"]


def test_the_page_flies_it_as_the_matrix_exponential_does(linear):
    """From the initial state that fly has fitted, at a value of one's own."""
    simulator = Simulator(open_result(str(linear / "flown")))
    told = json.loads((linear / "flown" / "trajectories.json").read_text())
    k = {name: p["estimate"] for name, p in told["parameters"].items()} | {"Malpha": -2.6}
    begin = [told["initial_states"]["two"][name]["value"] for name in ("alpha", "q")]
    A = np.array([[k["Zalpha"], 1.0], [k["Malpha"], k["Mq"]]])
    B = np.array([[k["Zde"], k["Z0"]], [k["Mde"], k["M0"]]])
    elevator = simulator.recorded(1)["elevator"]
    u = np.stack([elevator, np.ones(len(elevator))], axis=1)
    exact = first_order_hold(A, B, begin, u, 0.04)
    now = simulator.fly(1, Choice({"Malpha": -2.6}))
    for name, y in zip(("alpha", "q"), exact.T, strict=True):
        np.testing.assert_allclose(now.simulated[name], y, rtol=0.0, atol=1e-6 * np.ptp(y), err_msg=name)
    az = k["az0"] + 90.0 * (k["Zalpha"] * exact[:, 0] + k["Zde"] * elevator)
    np.testing.assert_allclose(now.simulated["az"], az, rtol=0.0, atol=1e-6 * np.ptp(az))
    assert now.coefficients == {}


def test_sliders_are_the_parameters_of_the_rows(linear):
    opened = open_result(str(linear / "flown"))
    groups = opened.groups()
    assert [(g.name, g.switch) for g in groups] == [
        ("rate of alpha", False), ("rate of q", False), ("output az", False),
    ]  # fmt: skip
    assert [s.name for g in groups for s in g.sliders] == list(SHORT_PERIOD_TRUTH)
    assert opened.addable(("alpha", "q", "elevator")) == ()
