"""`bayes-aero export`: from a finished result or a card to files, its draws, and its words for bad input."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from calling import answer, refused, succeeded

from bayes_aero.explore.opened import DRAWS, Simulator, open_result
from bayes_aero.export.simulators import jsbsim_files
from bayes_aero.flight.card import read_card, shipped_cards
from bayes_aero.jobs.finished import FORMS, read_identified
from bayes_aero.model.model import Model


@pytest.fixture
def here(identified, program, tmp_path):
    """A working directory of one's own with the result."""
    shutil.copytree(identified / "results", tmp_path / "results")
    return program


def drawn(stored):
    """Standard deviations of the parameters drawn into `one`, by name, from a result's covariance.

    1000 normal draws: standard deviations within 10 % (four of their errors), correlations within 0.15.
    """
    names = Path("one/draws.csv").read_text().splitlines()[0].split(",")
    draws = np.loadtxt("one/draws.csv", delimiter=",", skiprows=1)
    order = [list(stored["parameters"]).index(name) for name in names]
    covariance = np.array(stored.get("covariance", stored.get("matrix")))[np.ix_(order, order)]
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=0.1)
    np.testing.assert_allclose(np.corrcoef(draws.T), covariance / np.outer(sd, sd), atol=0.15)
    return dict(zip(names, sd, strict=True))


def told(path):
    return json.loads(path.read_text())


def change(path, **changes):
    """Edit a result: `a__b=x` sets x under a, b."""
    content = told(path)
    for keys, value in changes.items():
        *outer, last = keys.split("__")
        place = content
        for key in outer:
            place = place[key]
        place[last] = value
    path.write_text(json.dumps(content))


@pytest.mark.parametrize("form", FORMS)
def test_a_result_becomes_files_that_say_where_they_come_from(here, form, tmp_path):
    done = succeeded(here("export", "results", "--to", form, "--draws", 3))
    out = tmp_path / f"attas_{form}"
    facts = told(out / "export.json")
    assert all((out / name).stat().st_size > 0 for name in (*facts["files"], "README.txt", "draws.csv"))
    assert facts["form"] == form
    estimate = told(Path("results/results.json"))["mle"]["parameters"]["CLa"]["estimate"]
    assert facts["parameters"]["CLa"] == {"value": estimate, "unit": "1/rad"}
    low, high = facts["flown"]["alpha"]
    assert 0.0 < low < high < 0.5
    readme = " ".join((out / "README.txt").read_text().split())
    assert all(x in readme for x in ("stall (sha256", "attas (sha256", "Flown region", "q c/2V", "normal distribution"))
    assert "covariance corrected" in done.out
    assert np.loadtxt(out / "draws.csv", delimiter=",", skiprows=1).shape == (3, 14)


def test_draws_of_the_estimates_have_their_covariance(here):
    for out in ("one", "two"):
        assert here("export", "results", "--to", "jsbsim", "--draws", 1000, "--seed", 4, "--out", out).code == 0
    mle = told(Path("results/results.json"))["mle"]
    assert drawn(mle) == pytest.approx({n: p["crb_corrected"] for n, p in mle["parameters"].items()}, rel=1e-9)
    assert Path("one/draws.csv").read_text() == Path("two/draws.csv").read_text()


def test_a_posterior_that_converged_comes_first(here):
    names = list(told(Path("results/results.json"))["mle"]["parameters"])
    values = {name: (("chain", "draw"), k + np.arange(20.0).reshape(2, 10)) for k, name in enumerate(names)}
    xr.DataTree.from_dict({"posterior": xr.Dataset(values)}).to_netcdf("results/posterior_nuts.nc", engine="h5netcdf")
    status = {"nuts": {"noise": "ar1", "status": "converged", "advice": "converged"}}
    change(Path("results/results.json"), posterior={"noise": "ar1", "status": status})
    facts = answer(here("export", "results", "--to", "jsbsim", "--draws", 20, "--json"))
    assert facts["draws"] == {"count": 20, "origin": "posterior by nuts under ar1 noise"}
    draws = np.loadtxt("attas_jsbsim/draws.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(np.sort(draws[:, 1]) - 1.0, np.arange(20.0))
    assert set(draws[:, 1] - draws[:, 0]) == {1.0}  # a row is one draw of all
    refused(here("export", "results", "--to", "jsbsim", "--draws", 21, "--out", "more"), "--draws 20", gone=["more"])
    status["nuts"]["status"] = "not_converged"
    change(Path("results/results.json"), posterior={"noise": "ar1", "status": status})
    facts = answer(here("export", "results", "--to", "jsbsim", "--draws", 20, "--json", "--out", "again"))
    assert facts["draws"]["origin"].startswith("normal distribution")


def test_a_diagnosis_gives_the_extended_model(here):
    """The causes that hold-out data confirm, with the card's parameters as they move."""
    content = told(Path("results/results.json"))
    content["schema"] = "bayes_aero/diagnosis/5"
    moves = {n: {"before": 0.0, "after": p["estimate"]} for n, p in content.pop("mle")["parameters"].items()}
    causes = [
        {"name": "sideslip_drag", "confirmed": True, "parameters": {"CDb2": {"mean": -1.5}}},
        {"name": "elevator_drag", "confirmed": False, "parameters": {"CDde": {"mean": 0.1}}},
        {"name": "separation_lag", "confirmed": True, "parameters": {"tau1": {"mean": 4.0}}},
        {"name": "pitch_rate_bias", "confirmed": True, "parameters": {"pitch_rate_bias": {"mean": 0.005}}},
    ]
    Path("diagnosis").mkdir()
    Path("diagnosis/diagnosis.json").write_text(json.dumps(content | {"base_parameters": moves, "causes": causes}))
    facts = answer(here("export", "diagnosis", "--to", "jsbsim", "--json"))
    assert {"CDb2", "tau1"} <= set(facts["parameters"])
    assert "CDde" not in facts["parameters"]
    assert facts["states"] == ["X"]
    assert [sentence.split(" ")[0] for sentence in facts["left_out"]] == ["pitch_rate_bias"]
    asked = ("export", "diagnosis", "--to", "jsbsim", "--draws", 3, "--out", "no")
    refused(here(*asked), "run the command of the result again", gone=["no"])


def stating(name, path, value):
    """A shipped card that states a value of its k-th free parameter, as a file; these values."""
    names = [p.name for p in Model.from_card(read_card(name)).free]
    values = [value(k) for k in range(len(names))]
    rows = (f"\n[parameters.{own}]\nstart = {x!r}\n" for own, x in zip(names, values, strict=True))
    Path(path).write_text(shipped_cards()[name].read_text().split("[parameters")[0] + "".join(rows))
    return values


@pytest.mark.parametrize(("card", "name", "outputs"), [
    ("attas", "my aircraft 2", "CL CD Cm X"), ("attas", "737", "CL CD Cm X"), ("full_six", "mine", "CL CD Cm CY Cl Cn"),
])  # fmt: skip
def test_a_card_that_states_all_values_is_a_model_named_as_xml_and_every_system_allow(program, card, name, outputs):
    values = stating(card, f"{name}.toml", lambda k: 1.0 if card == "attas" else 0.1 * (k + 1))
    facts = answer(program("export", f"{name}.toml", "--to", "jsbsim", "--out", "out", "--json"))
    assert facts["name"] == {"my aircraft 2": "my_aircraft_2", "737": "_737"}.get(name, name)
    assert {p["value"] for p in facts["parameters"].values()} <= set(values)
    assert set(facts["outputs"]) == set(outputs.split())
    assert "not stated" in facts["validity"][0]


def test_a_result_of_another_card_is_refused(here):
    """The card is found by its content: shipped, as the command named it, or beside the result."""
    path = Path("results/results.json")
    source = shipped_cards()["attas"].read_text()
    Path("mine.toml").write_text(source + "# mine\n")
    refused(here("export", "results", "--to", "jsbsim", "--model", "mine.toml"), "differs", gone=["attas_jsbsim"])
    change(path, provenance__card__name="mine")
    Path("results/mine.toml").write_text(source)
    assert here("export", "results", "--to", "jsbsim").code == 0
    Path("results/mine.toml").unlink()
    refused(here("export", "results", "--to", "fmu"), "give it with --model", gone=["mine_fmu"])
    assert here("export", "results", "--to", "jsbsim", "--model", "attas", "--out", "given").code == 0


BAD = {
    "there is no result 'nothing'": (("nothing", "--to", "jsbsim"), {}),
    "states no value of CLa": (("attas", "--to", "jsbsim"), {}),
    "states a linear system": (("short_period", "--to", "jsbsim"), {}),
    "has not converged": (("results", "--to", "jsbsim"), {"mle__status": "not_converged"}),
    "no result of identify, fly or diagnose": (("results", "--to", "fmu"), {"schema": "other/1"}),
    "has no value of CL0": (("results", "--to", "jsbsim"), {"mle__parameters__CL0__estimate": None}),
    "is not as bayes-aero wrote it": (("results", "--to", "jsbsim"), {"provenance": {}}),
    "nor a covariance": (("results", "--to", "jsbsim", "--draws", "2"), {"mle__covariance": None}),
    "flown range of": (("results", "--to", "tables"), {"records": []}),
    "give a number from 1 to": (("results", "--to", "jsbsim", "--draws", "100000"), {}),
}


@pytest.mark.parametrize("words", BAD)
def test_bad_input_is_one_sentence(here, words):
    arguments, changes = BAD[words]
    if changes:
        change(Path("results/results.json"), **changes)
    refused(here("export", *arguments, "--out", "out"), words, gone=["out"])


def test_what_is_no_result_or_in_the_way_is_refused(here, monkeypatch):
    Path("there").mkdir()
    refused(here("export", "results", "--to", "jsbsim", "--out", "there"), "there exists; give another folder")
    refused(here("export", "there", "--to", "jsbsim"), "it has none of results.json")
    shutil.copy("results/results.json", "results/trajectories.json")
    refused(here("export", "results", "--to", "jsbsim"), "it has results.json and trajectories.json: name one of them")
    Path("results/results.json").write_text("{")
    refused(here("export", "results/results.json", "--to", "jsbsim"), "cannot be read")
    monkeypatch.setattr("bayes_aero.export.simulators.find_spec", lambda _: None)
    Path("results/trajectories.json").rename("results/results.json")
    refused(here("export", "results", "--to", "fmu"), 'pip install "bayes-aero[export]"', gone=["attas_fmu"])


@pytest.mark.usefixtures("here")
def test_axes_that_were_not_recorded_are_not_exported():
    """A card of six coefficients whose fit had three of them: the lateral effects have no values."""
    six = shipped_cards()["stall_six"]
    card = {"name": "six", "sha256": hashlib.sha256(six.read_bytes()).hexdigest()}
    change(Path("results/results.json"), provenance__card=card)
    shutil.copy(six, "results/six.toml")
    found, _ = read_identified("results")
    assert found.model.coefficients == ("CL", "CD", "Cm")
    assert all("Clbe" not in text for text in jsbsim_files(found).values())


@pytest.mark.usefixtures("told_diagnosis")
def test_draws_of_a_diagnosis_are_as_wide_as_the_reported_errors_and_the_page_has_their_fan(program):
    diagnosis_told = told(Path("diagnosis/diagnosis.json"))
    stored = diagnosis_told["covariance"]
    matrix, sd = np.array(stored["matrix"]), np.sqrt(np.diag(stored["matrix"]))
    own = dict(zip(stored["parameters"], sd, strict=True))
    causes = {n: p["sd"] for c in diagnosis_told["causes"] if c["confirmed"] for n, p in c["parameters"].items()}
    base = {name: move["sd_after"] for name, move in diagnosis_told["base_parameters"].items()}
    assert stored["residuals"] == "coloured"
    assert set(base) <= set(own)
    assert [own[name] for name in base] == pytest.approx(list(base.values()), rel=1e-9)
    assert all(own[name] >= x * (1.0 - 1e-9) for name, x in causes.items() if name in own)
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix / np.outer(sd, sd)).min() > -1e-9
    asked = ("--to", "jsbsim", "--draws", 1000, "--seed", 4, "--out", "one", "--json")
    assert "covariance corrected" in answer(program("export", "diagnosis", *asked))["draws"]["origin"]
    drawn(stored)
    simulator = Simulator(open_result("diagnosis"))
    origin, fan = simulator.fan(0)
    assert "covariance corrected" in origin
    assert fan["alpha"].shape == (DRAWS, len(simulator.time(0)))
    assert np.all(np.std(fan["CL"], axis=0).max() > 0.0)
