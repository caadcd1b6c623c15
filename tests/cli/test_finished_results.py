"""`bayes-aero export`, `qualify` and `open`: finished results read again, of cards of effects and of linear cards."""

import hashlib
import json
import shutil
import signal
import subprocess
import sys
import urllib.request
from functools import reduce
from operator import getitem
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calling import answer, called, holds, refused, succeeded, validated
from linear_cards import SHORT_PERIOD_TRUTH, first_order_hold

from bayes_aero.errors import InputError
from bayes_aero.explore.opened import Choice, Simulator, export_chosen, open_result
from bayes_aero.export.simulators import jsbsim_files
from bayes_aero.flight.card import read_card, shipped_cards
from bayes_aero.flight.reading import read_records
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs import check
from bayes_aero.jobs.finished import FORMS, fitted_records, read_identified
from bayes_aero.jobs.options import FlyOptions
from bayes_aero.jobs.store import as_json, provenance
from bayes_aero.model.model import Model

RESULT, FEW = Path("results/results.json"), ("--draws", "100")


@pytest.fixture
def here(identified, program, tmp_path):
    """A working directory of one's own with result and records."""
    shutil.copytree(identified.results, tmp_path / "results")
    for name in ("stall", "second", "other"):
        shutil.copy(identified.folder / f"{name}.csv", tmp_path)
    return program


@pytest.fixture
def unsampled(here):
    """As if no posterior had converged."""
    change(RESULT, posterior__status__emcee__status="not_converged")
    return here


def drawn(stored):
    """Standard deviations by name of a covariance that 1000 draws in `one` have within 10 %: four of their errors."""
    names = Path("one/draws.csv").read_text().splitlines()[0].split(",")
    draws = np.loadtxt("one/draws.csv", delimiter=",", skiprows=1)
    order = [list(stored["parameters"]).index(name) for name in names]
    covariance = np.array(stored.get("covariance", stored.get("matrix")))[np.ix_(order, order)]
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=0.1)
    np.testing.assert_allclose(np.corrcoef(draws.T), covariance / np.outer(sd, sd), atol=0.15)
    return dict(zip(names, sd, strict=True))


def content(path):
    return json.loads(path.read_text())


def change(path, **changes):
    """Edit a result: `a__b=x` sets x under a, b."""
    whole = content(path)
    for keys, value in changes.items():
        *outer, last = keys.split("__")
        reduce(getitem, outer, whole)[last] = value
    path.write_text(json.dumps(whole))


@pytest.mark.parametrize("form", FORMS)
def test_a_result_becomes_files_that_say_where_they_come_from(unsampled, form, tmp_path):
    done = succeeded(unsampled("export", "results", "--to", form, "--draws", 3))
    out = tmp_path / f"attas_{form}"
    facts = content(out / "export.json")
    assert all((out / name).stat().st_size > 0 for name in (*facts["files"], "README.txt", "draws.csv"))
    assert facts["form"] == form
    estimate = content(RESULT)["mle"]["parameters"]["CLa"]["estimate"]
    assert facts["parameters"]["CLa"] == {"value": estimate, "unit": "1/rad"}
    low, high = facts["flown"]["alpha"]
    assert 0.0 < low < high < 0.5
    readme = " ".join((out / "README.txt").read_text().split())
    holds(readme, "stall (sha256", "attas (sha256", "Flown region", "q c/2V", "normal distribution")
    assert "covariance corrected" in done.out
    assert np.loadtxt(out / "draws.csv", delimiter=",", skiprows=1).shape == (3, 14)


def test_draws_of_the_estimates_have_their_covariance(unsampled):
    for out in ("one", "two"):
        succeeded(unsampled("export", "results", "--to", "jsbsim", "--draws", 1000, "--seed", 4, "--out", out))
    mle = content(RESULT)["mle"]
    assert drawn(mle) == pytest.approx({n: p["crb_corrected"] for n, p in mle["parameters"].items()}, rel=1e-9)
    assert Path("one/draws.csv").read_text() == Path("two/draws.csv").read_text()


def test_a_posterior_that_converged_comes_first(here):
    facts = answer(here("export", "results", "--to", "jsbsim", "--draws", 20, "--json"))
    assert facts["draws"] == {"count": 20, "origin": "posterior by emcee under white noise"}
    draws = np.loadtxt("attas_jsbsim/draws.csv", delimiter=",", skiprows=1)
    names = Path("attas_jsbsim/draws.csv").read_text().splitlines()[0].split(",")
    with xr.open_datatree("results/posterior_emcee.nc", engine="h5netcdf") as tree:
        sampled = np.stack([tree["posterior"][name].to_numpy().ravel() for name in names], axis=1)
    away = np.abs(draws[:, None, :] - sampled) / sampled.std(axis=0)
    rows = away.max(axis=2).argmin(axis=1)
    assert away[np.arange(20), rows].max() < 1e-9  # a row is one draw of all
    assert len(set(rows)) == 20
    asked = ("--draws", len(sampled) + 1, "--out", "more")
    refused(here("export", "results", "--to", "jsbsim", *asked), f"--draws {len(sampled)}", gone=["more"])


@pytest.mark.parametrize(("card", "name", "exported", "outputs"), [
    ("attas", "my aircraft 2", "my_aircraft_2", "CL CD Cm X"), ("full_six", "737", "_737", "CL CD Cm CY Cl Cn"),
])  # fmt: skip
def test_a_card_of_all_values_is_a_model_with_a_name_for_every_system(program, card, name, exported, outputs):
    free = [p.name for p in Model.from_card(read_card(card)).free]
    values = [1.0 if card == "attas" else 0.1 * (k + 1) for k in range(len(free))]
    rows = (f"\n[parameters.{n}]\nstart = {x!r}\n" for n, x in zip(free, values, strict=True))
    Path(f"{name}.toml").write_text(shipped_cards()[card].read_text().split("[parameters")[0] + "".join(rows))
    facts = answer(program("export", f"{name}.toml", "--to", "jsbsim", "--out", "out", "--json"))
    assert facts["name"] == exported
    assert {p["value"] for p in facts["parameters"].values()} <= set(values)
    assert set(facts["outputs"]) == set(outputs.split())
    assert "not stated" in facts["validity"][0]


def test_a_result_of_another_card_is_refused(here):
    """The card is found by its content: shipped, as the command named it, or beside the result."""
    source = shipped_cards()["attas"].read_text()
    Path("mine.toml").write_text(source + "# mine\n")
    refused(here("export", "results", "--to", "jsbsim", "--model", "mine.toml"), "differs", gone=["attas_jsbsim"])
    change(RESULT, provenance__card__name="mine")
    Path("results/mine.toml").write_text(source)
    assert here("export", "results", "--to", "jsbsim").code == 0
    Path("results/mine.toml").rename("there.toml")
    refused(here("export", "results", "--to", "fmu"), "give it with --model", gone=["mine_fmu"])
    change(RESULT, provenance__card__path="there.toml")
    assert here("export", "results", "--to", "jsbsim", "--out", "named").code == 0
    assert here("export", "results", "--to", "jsbsim", "--model", "attas", "--out", "given").code == 0


NOT_EXPORTED = {
    "there is no result 'nothing'": ("nothing --to jsbsim", {}),
    "states no value of CLa": ("attas --to jsbsim", {}),
    "states a linear system": ("short_period --to jsbsim", {}),
    "has not converged": ("results --to jsbsim", {"mle__status": "not_converged"}),
    "no result of identify, fly or diagnose": ("results --to fmu", {"schema": "other/1"}),
    "has no value of CL0": ("results --to jsbsim", {"mle__parameters__CL0__estimate": None}),
    "is not as bayes-aero wrote it": ("results --to jsbsim", {"provenance": {}}),
    "nor a covariance": ("results --to jsbsim --draws 2", {"mle__covariance": None}),
    "flown range of": ("results --to tables", {"records": []}),
    "give a number from 1 to": ("results --to jsbsim --draws 100000", {}),
}


@pytest.mark.parametrize("words", NOT_EXPORTED)
def test_what_cannot_be_exported_is_one_sentence(unsampled, words):
    asked, changes = NOT_EXPORTED[words]
    change(RESULT, **changes)
    refused(unsampled("export", *asked.split(), "--out", "out"), words, gone=["out"])


def test_what_is_no_result_or_in_the_way_is_refused(here, monkeypatch):
    Path("there").mkdir()
    refused(here("export", "results", "--to", "jsbsim", "--out", "there"), "there exists; give another folder")
    refused(here("export", "there", "--to", "jsbsim"), "it has none of results.json")
    shutil.copy("results/results.json", "results/trajectories.json")
    refused(here("export", "results", "--to", "jsbsim"), "it has results.json and trajectories.json: name one of them")
    RESULT.write_text("{")
    refused(here("export", "results/results.json", "--to", "jsbsim"), "cannot be read")
    monkeypatch.setattr("bayes_aero.export.simulators.find_spec", lambda _: None)
    Path("results/trajectories.json").rename("results/results.json")
    refused(here("export", "results", "--to", "fmu"), 'pip install "bayes-aero[export]"', gone=["attas_fmu"])


@pytest.mark.usefixtures("here")
def test_axes_that_were_not_recorded_are_not_exported():
    """A card of six coefficients whose fit had three of them: the lateral effects have no values."""
    six = shipped_cards()["stall_six"]
    card = {"name": "six", "sha256": hashlib.sha256(six.read_bytes()).hexdigest()}
    change(RESULT, provenance__card=card)
    shutil.copy(six, "results/six.toml")
    exported, _ = read_identified("results")
    assert exported.model.coefficients == ("CL", "CD", "Cm")
    assert all("Clbe" not in text for text in jsbsim_files(exported).values())


@pytest.mark.usefixtures("diagnosis_output")
def test_a_diagnosis_gives_the_extended_model_and_draws_as_wide_as_the_reported_errors(program):
    """The causes that hold-out data confirm, with the card's parameters as they move."""
    file = Path("diagnosis/diagnosis.json")
    diagnosis = content(file)
    stored = diagnosis["covariance"]
    matrix, sd = np.array(stored["matrix"]), np.sqrt(np.diag(stored["matrix"]))
    errors = dict(zip(stored["parameters"], sd, strict=True))
    causes = {n: p["sd"] for c in diagnosis["causes"] if c["confirmed"] for n, p in c["parameters"].items()}
    base = {name: move["sd_after"] for name, move in diagnosis["base_parameters"].items()}
    assert stored["residuals"] == "coloured"
    assert set(base) <= set(errors)
    assert [errors[name] for name in base] == pytest.approx(list(base.values()), rel=1e-9)
    assert all(errors[name] >= x * (1.0 - 1e-9) for name, x in causes.items() if name in errors)
    assert open_result("diagnosis").errors.items() >= (base | causes).items()
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix / np.outer(sd, sd)).min() > -1e-9
    asked = ("--to", "jsbsim", "--draws", 1000, "--seed", 4, "--out", "one", "--json")
    facts = answer(program("export", "diagnosis", *asked))
    assert "covariance corrected" in facts["draws"]["origin"]
    drawn(stored)
    assert "Cma2" in facts["parameters"]
    assert [sentence.split(" ")[0] for sentence in facts["left_out"]] == ["pitch_rate_bias"]
    added = [
        {"name": "elevator_drag", "confirmed": False, "parameters": {"CDde": {"mean": 0.1}}},
        {"name": "separation_lag", "confirmed": True, "parameters": {"tau1": {"mean": 4.0}}},
    ]
    change(file, causes=[*diagnosis["causes"], *added], covariance=None)
    facts = answer(program("export", "diagnosis", "--to", "jsbsim", "--out", "two", "--json"))
    assert "tau1" in facts["parameters"]
    assert "CDde" not in facts["parameters"]
    assert facts["states"] == ["X"]
    asked = ("export", "diagnosis", "--to", "jsbsim", "--draws", 3, "--out", "no")
    refused(program(*asked), "run the command of the result again", gone=["no"])


@pytest.fixture(scope="module")
def qualified(identified, tmp_path_factory):
    """A folder with the qualification of the result by a record that was not fitted, and its numbers."""
    folder = tmp_path_factory.mktemp("qualified")
    shutil.copytree(identified.results, folder / "results", ignore=shutil.ignore_patterns("next_flight.nc"))
    asked = (folder / "results", "other.csv", "--gusts", 1, *FEW, "--out", folder, "--json")
    with patch.object(check, "channel_health", lambda *_: (identified.doubt,)):
        numbers = answer(called(identified.folder, "qualify", *asked), 3)
    assert numbers == json.loads((folder / "qualification.json").read_text())
    return SimpleNamespace(folder=folder, numbers=numbers)


def test_the_numbers_follow_the_schema_and_every_thing_counted_makes_a_test_harder(qualified):
    numbers = validated(qualified.numbers, "qualification")
    assert not numbers["failures"]
    assert {t["kind"] for t in numbers["tests"]} == {"again", "test"}
    assert list(numbers["tolerances"]) == ["airspeed", "alpha", "theta", "q", "az"]
    # Draws are shared, so a test that fails by parameters fails with structure and gusts but for single draws.
    for test in numbers["tests"]:
        chances = [test["counted"][name]["value"] for name in ("parameters", "structure", "gusts")]
        assert chances[1] <= chances[0] + 0.05
        assert chances[2] <= chances[1] + 0.05
        assert test["probability"] == chances[2]
        assert test["record"]["passed"]  # the model is the truth, and there is no noise


def test_extrapolation_is_told_of_the_other_record_alone(identified, qualified):
    """Beside the hull of the fitted records the other one is outside where single channels already are."""
    names = ("stall", "second", "other")
    alpha = [np.genfromtxt(identified.folder / f"{n}.csv", delimiter=",", names=True)["ALCG"] for n in names]
    low, high, other = min(alpha[0].min(), alpha[1].min()), max(alpha[0].max(), alpha[1].max()), alpha[2]
    outside = {part["manoeuvre"]: part for part in qualified.numbers["outside"] if part["motion"] == "recorded"}
    assert set(outside) == {"other"}
    clearly = 0.1 * (high - low) / 2.0  # a hull lies within the ranges of its channels
    assert outside["other"]["share"] >= np.mean((other > high + clearly) | (other < low - clearly)) - 0.01
    assert outside["other"]["distance"] >= max(other.max() - high, low - other.min()) / ((high - low) / 2.0) - 0.01
    assert outside["other"]["share"] > 0.0 < outside["other"]["distance"]
    region = {"channels": ["alpha", "beta", "mach", "p", "q", "r"], "not_recorded": []}
    assert qualified.numbers["flown_region"] == region


def test_the_page_can_be_signed(qualified):
    page = (qualified.folder / "qualification.html").read_text()
    assert "was not made" not in page
    holds(page, "signature", "accepted", "refused", "Attachment 7", "was not read", "Stated: 1 m/s")
    holds(page, "altitude is in ft")
    grave = [(h["channel"], h["fault"]) for h in qualified.numbers["health"] if h["grave"]]
    assert grave == [("altitude", "unit")]
    assert ("The model does not qualify" in page) == (qualified.numbers["verdict"] == "fails")
    rows = (qualified.folder / "qualification.csv").read_text().splitlines()
    assert len(rows) == 1 + len(qualified.numbers["tests"])


@pytest.mark.parametrize(("asked", "words"), [
    ("attas", "attas is a card; give the folder of a result"), ("results nosuch.csv", "no such file"),
    ("results stall.csv", "was fitted, so it is tested anyway"), ("results --gusts 99", "--gusts is 99 m/s"),
    ("results --draws 3", "--draws is 3; give a number from 100"),
])  # fmt: skip
def test_what_cannot_be_qualified_is_one_sentence(here, asked, words):
    refused(here("qualify", *asked.split()), words, gone=["qualification"])


def test_new_records_that_are_none_or_cannot_be_flown_and_fitted_ones_that_changed_are_refused(here):
    """A copy with fewer digits, half of the samples and another clock; one in knots; and a changed fitted record."""
    table = pd.read_csv("stall.csv").round(4)
    table.assign(T=table["T"] + 1000.0).iloc[::2].to_csv("new.csv", index=False)
    refused(here("qualify", "results", "new.csv", *FEW), "new is the same record as stall")
    table = pd.read_csv("other.csv")
    table.assign(VTASCG=table["VTASCG"] * 3600.0 / 1852.0).to_csv("knots.csv", index=False)
    refused(here("qualify", "results", "knots.csv", *FEW), "knots: airspeed is in kt", "leave this record out")
    table = pd.read_csv("stall.csv")
    table.assign(ALCG=table["ALCG"] + 1e-6).to_csv("stall.csv", index=False)
    refused(here("qualify", "results", *FEW), "stall.csv has changed since results/results.json")
    Path("stall.csv").unlink()
    refused(here("qualify", "results", *FEW), "stall.csv", "--fitted")


@pytest.fixture
def reread(tmp_path, card, monkeypatch):
    """`reread(made, *files)`: the records of a result made of `made`, found again as its JSON names them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["bayes-aero", "fly", "x@1:0", "--model", "other.toml", "--resample=7", "'"])

    def do(made, *files):
        source = json.loads(as_json(provenance(card, made, 0, {}, FlyOptions())))
        return fitted_records(source, Path("results/trajectories.json"), card, remedy="give it", files=files), source

    return do


def test_records_are_read_again_as_they_were_whatever_the_command_said(identified, card, reread):
    shutil.copy(identified.folder / "stall.csv", "stall.csv")
    (part,) = read_records(["stall.csv@30:60"], card.channels, resample=0.1)
    cut = read_records(["stall.csv"], card.channels)[0].window(40.0, 50.0)
    again, source = reread([part, cut])
    assert [r.content for r in again] == [part.content, cut.content]
    assert [r.name for r in again] == ["stall_30-60", cut.name]
    assert source["inputs"][0]["read"] == {
        "path": "stall.csv", "part": "30:60", "resample": 0.1, "windows": [], "split": False,
    }  # fmt: skip
    assert source["options"]["windows"] == 12.0
    late = pd.read_csv(identified.folder / "other.csv")
    pd.concat([pd.read_csv("stall.csv"), late.assign(T=late["T"] + 60.0)]).to_csv("both.csv", index=False)
    halves = read_records(["both.csv"], card.channels, split=True)
    again, source = reread(halves)
    assert [r.content for r in again] == [r.content for r in halves]
    assert [given["read"]["split"] for given in source["inputs"]] == [True, True]


def test_records_are_found_by_their_content_and_not_by_their_name(identified, card, reread):
    shutil.copy(identified.folder / "stall.csv", "stall.csv")
    made = read_records(["stall.csv"], card.channels)
    table = pd.read_csv("stall.csv", dtype=str)
    table[[*reversed(table.columns)]].to_csv("moved.csv", index=False)
    Path("stall.csv").unlink()
    with pytest.raises(InputError, match=r"record stall\.csv of .* is not where it was"):
        reread(made)
    with pytest.raises(InputError, match=r"record stall\.csv of .* is not where it was"):
        reread(made, identified.folder / "other.csv")
    ((again,), _) = reread(made, identified.folder / "other.csv", Path("moved.csv"))
    assert (again.name, again.content) == ("stall", made[0].content)
    with pytest.raises(InputError, match="was made in memory"):
        reread([FlightRecord.from_arrays("mine", made[0].time, made[0].channels)])


@pytest.mark.usefixtures("interruptible")
def test_it_serves_until_ctrl_c_and_ends_with_zero(identified):
    command = [sys.executable, "-m", "bayes_aero", "open", "results", "--no-browser"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, cwd=identified.folder, text=True, **pipes) as running:
        try:
            line = running.stdout.readline()
            assert line.startswith("identify: results is open at http://127.0.0.1:"), line
            url = line.split(" at ")[1].split(" ")[0]
            with urllib.request.urlopen(url, timeout=120) as page:
                assert b"attached_lift" not in page.read()[:200]
            running.send_signal(signal.SIGINT)
            out, err = running.communicate(timeout=60)
        finally:
            running.kill()
    assert (running.returncode, out, err) == (0, "", "")


def test_records_that_have_moved_are_asked_for(program, identified, tmp_path):
    Path("deep/results").mkdir(parents=True)
    shutil.copy(identified.results / "results.json", "deep/results")
    refused(program("open", "deep/results"), "give its folder with --records")
    refused(program("open", "deep/results", "--records", tmp_path), f"is not in {tmp_path}")


@pytest.fixture
def there(short_period, program, monkeypatch):
    """The program in the folder of a linear model with its flights and its fit."""
    monkeypatch.chdir(short_period.folder)
    return program


def test_a_linear_model_is_qualified(there):
    """The model is the true one. Its noise is far inside 2 deg, and outside 0.02 m/s^2 in every flight."""
    numbers = answer(there("qualify", "flown", "other.csv", *FEW, "--out", "passed", "--json"))
    chances = {(t["kind"], t["output"]): t["probability"] for t in numbers["tests"]}
    assert {output for _, output in chances} == {"alpha", "q", "az"}
    assert all(x == (0.0 if output == "az" else 1.0) for (_, output), x in chances.items())
    assert {name: t["verdict"] for name, t in numbers["tolerances"].items()}["alpha"] == "passes"
    assert "moving air" in numbers["origins"]["gusts"]
    assert "no prior of Z0" in numbers["origins"]["next flight"]
    assert any("tolerance of airspeed is not judged" in note for note in numbers["notes"])
    assert numbers["failures"] == []


def test_what_a_linear_system_lacks_is_one_sentence(there):
    refused(there("qualify", "flown", "--gusts", 1, "--out", "no"), "moving air", "leave --gusts out", gone=["no"])
    opened = open_result("flown")
    with pytest.raises(InputError, match="no form in another simulator"):
        export_chosen(opened, Choice(), opened.identified.values, "jsbsim")


def test_constants_of_each_manoeuvre_cannot_fly_another_one(there):
    text = Path("sp.toml").read_text().replace("[linear]\n", '[linear]\nby_manoeuvre = ["M0"]\n')
    Path("own.toml").write_text(text)
    asked = ("--windows", "5", "--no-figures", "--no-process-noise")
    succeeded(there("fly", "one.csv", "two.csv", "--model", "own.toml", "--out", "own", *asked), 0, 3)
    refused(there("qualify", "own", "other.csv", *FEW, "--out", "no"), "M0", "other")
    numbers = answer(there("qualify", "own", *FEW, "--out", "both", "--json"))
    assert "the card states M0 for each manoeuvre" in numbers["origins"]["structure"]
    turning = open_result("own").groups()[1]
    assert [s.name for s in turning.sliders] == ["M0_1", "M0_2", "Malpha", "Mq", "Mde"]


def test_the_page_flies_it_as_the_matrix_exponential_does(short_period):
    """From the initial state that fly has fitted, at a value of one's own; sliders are the parameters of the rows."""
    opened = open_result(str(short_period.flown))
    simulator, fit = Simulator(opened), json.loads((short_period.flown / "trajectories.json").read_text())
    k = {name: p["estimate"] for name, p in fit["parameters"].items()} | {"Malpha": -2.6}
    begin = [fit["initial_states"]["two"][name]["value"] for name in ("alpha", "q")]
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
    groups = opened.groups()
    switches = {"rate of alpha": False, "rate of q": False, "output az": False}
    assert {g.name: g.switch for g in groups} == switches
    assert [s.name for g in groups for s in g.sliders] == list(SHORT_PERIOD_TRUTH)
    assert opened.addable(("alpha", "q", "elevator")) == ()


def test_identify_prints_the_json_that_it_writes_and_ends_with_zero_on_a_sound_record(program, identified, tmp_path):
    asked = ("--no-sample", "--no-gp", "--no-figures", "--out", "id", "--json")
    printed = answer(program("identify", identified.folder / "stall.csv", *asked), 0)
    assert printed == json.loads((tmp_path / "id" / "results.json").read_text())
