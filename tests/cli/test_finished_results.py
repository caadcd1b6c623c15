"""`bayes-aero open` and results of linear cards: opened, qualified and drawn, and a sentence for what they lack."""

import json
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from calling import answer, called, holds, refused, succeeded
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, first_order_hold, record_of, short_period_flight

from bayes_aero.errors import InputError
from bayes_aero.explore.opened import Choice, export_chosen, open_result
from bayes_aero.explore.simulator import DRAWS, Simulator
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import write_record


def test_help_names_the_options(program):
    text = program("open", "--help").out
    holds(text, "DIR", "--records", "--model", "--port", "--no-browser", "127.0.0.1", "Ctrl-C")


@pytest.fixture
def interrupts():
    """Ctrl-C reaches programs that a test starts: it is ignored where the tests run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts")
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
FLAGS = ("--model", "sp.toml", "--no-figures", "--no-process-noise")
TOLERANCES = '\n[tolerances]\nalpha = "2 deg"\nq = "2 deg/s"\naz = "0.02 m/s^2"\nairspeed = "3 kt"\n'
BOOK = Path(__file__).resolve().parents[3] / "shared" / "book"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three flights of a short period, the third of another start, and the fit of the first two."""
    there = tmp_path_factory.mktemp("linear")
    (there / "sp.toml").write_text(SHORT_PERIOD + TOLERANCES)
    card, rng = read_card(there / "sp.toml"), np.random.default_rng(7)
    for name, begin in (("one", (0.04, 0.01)), ("two", (0.02, 0.0)), ("other", (0.0, 0.02))):
        record = record_of(short_period_flight(SHORT_PERIOD_TRUTH, x0=begin), noise=NOISE, rng=rng, name=name)
        write_record(record, there / f"{name}.csv", card.channels)
    succeeded(called(there, "fly", "one.csv", "two.csv", "--out", "flown", *FLAGS), 0, 3)
    return there


@pytest.fixture
def here(folder, program, monkeypatch):
    monkeypatch.chdir(folder)
    return program


def test_a_linear_model_is_qualified(here):
    """The model is the true one. Its noise is far inside 2 deg, and outside 0.02 m/s^2 in every flight."""
    found = answer(here("qualify", "flown", "other.csv", "--draws", 100, "--out", "passed", "--json"))
    chances = {(t["kind"], t["output"]): t["probability"] for t in found["tests"]}
    assert {output for _, output in chances} == {"alpha", "q", "az"}
    assert all(x == (0.0 if output == "az" else 1.0) for (_, output), x in chances.items())
    assert {name: t["verdict"] for name, t in found["tolerances"].items()}["alpha"] == "passes"
    assert "moving air" in found["origins"]["gusts"]
    assert "no prior of Z0" in found["origins"]["next flight"]
    assert any("tolerance of airspeed is not judged" in note for note in found["notes"])
    assert found["failures"] == []


def test_what_a_linear_system_lacks_is_one_sentence(here, folder):
    refused(here("qualify", "flown", "--gusts", 1, "--out", "no"), "moving air", "leave --gusts out")
    refused(here("export", "flown", "--to", "jsbsim", "--out", "no"), "states a linear system", "[model]")
    assert not (folder / "no").exists()
    opened = open_result(str(folder / "flown"))
    with pytest.raises(InputError, match="no form in another simulator"):
        export_chosen(opened, Choice(), opened.identified.values, "jsbsim")


def test_parts_of_a_divided_file_are_found_again(here, folder):
    """Two flights in one file, 10 s of time apart."""
    head, *first = (folder / "one.csv").read_text().splitlines()
    second = (folder / "two.csv").read_text().splitlines()[1:]
    column = head.split(",").index("t")

    def later(row):
        cells = row.split(",")
        cells[column] = repr(float(cells[column]) + 30.0)
        return ",".join(cells)

    (folder / "both.csv").write_text("\n".join([head, *first, *map(later, second)]) + "\n")
    assert here("fly", "both.csv", "--split", "--out", "divided", *FLAGS).code in (0, 3)
    found = answer(here("qualify", "divided", "--draws", 100, "--out", "parts", "--json"))
    assert len({t["manoeuvre"] for t in found["tests"]}) == 2


def test_constants_of_each_manoeuvre_cannot_fly_another_one(here, folder):
    text = (folder / "sp.toml").read_text().replace("[linear]\n", '[linear]\nby_manoeuvre = ["M0"]\n')
    (folder / "own.toml").write_text(text)
    flags = ("--model", "own.toml", "--no-figures", "--no-process-noise")
    assert here("fly", "one.csv", "two.csv", "--out", "own", *flags).code in (0, 3)
    refused(here("qualify", "own", "other.csv", "--draws", 100, "--out", "no"), "M0", "other")
    found = answer(here("qualify", "own", "--draws", 100, "--out", "both", "--json"))
    assert "no value of M0" in found["origins"]["structure"]
    turning = open_result(str(folder / "own")).groups()[1]
    assert [s.name for s in turning.sliders] == ["M0_1", "M0_2", "Malpha", "Mq", "Mde"]


def test_the_page_flies_it_as_the_matrix_exponential_does(folder):
    """From the initial state that fly has fitted, at a value of one's own."""
    simulator = Simulator(open_result(str(folder / "flown")))
    told = json.loads((folder / "flown" / "trajectories.json").read_text())
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


def test_the_fan_has_the_covariance_of_the_fit(folder):
    """q of 400 draws: standard deviation by the law of error propagation, within four of its own errors (15 %)."""
    simulator = Simulator(open_result(str(folder / "flown")))
    told = json.loads((folder / "flown" / "trajectories.json").read_text())
    assert simulator.fan(0)[1]["q"].shape == (DRAWS, 500)
    origin, fan = simulator.fan(0, count=400, seed=1)
    assert origin.startswith("normal distribution of the estimates")
    slopes = []
    for name, p in told["parameters"].items():
        h = 0.1 * p["sd_corrected"]
        up, down = (simulator.fly(0, Choice({name: p["estimate"] + x})).simulated["q"] for x in (h, -h))
        slopes.append((up - down) / (2.0 * h))
    expected = np.sqrt(np.einsum("in,ij,jn->n", slopes, np.array(told["covariance"]), slopes))
    np.testing.assert_allclose(np.std(fan["q"], axis=0)[5:], expected[5:], rtol=0.15)


def test_sliders_are_the_parameters_of_the_rows(folder):
    opened = open_result(str(folder / "flown"))
    groups = opened.groups()
    assert [(g.name, g.switch) for g in groups] == [
        ("rate of alpha", False), ("rate of q", False), ("output az", False),
    ]  # fmt: skip
    assert [s.name for g in groups for s in g.sliders] == list(SHORT_PERIOD_TRUTH)
    assert opened.addable(("alpha", "q", "elevator")) == ()
    for group in groups:
        for s in group.sliders:
            assert s.value / s.factor == pytest.approx(opened.identified.values[s.name])
            assert s.low < s.value < s.high


@pytest.mark.skipif(not (BOOK / "fAttasElv1.mat").is_file(), reason="the book's records are not there")
def test_the_short_period_of_a_recorded_flight_is_qualified_and_opened(program):
    """TC11: the fit leaves 0.1 deg and 0.15 deg/s, far inside 2 deg and 2 deg/s."""
    records = [str(BOOK / f"fAttasElv{k}.mat") for k in (1, 2)]
    succeeded(program("fly", *records, "--model", "attas_short_period", "--no-figures", "--no-process-noise"), 0, 3)
    found = answer(program("qualify", "trajectories", "--draws", 100, "--json"))
    assert found["verdict"] == "passes"
    assert {t["manoeuvre"] for t in found["tests"]} == {"fAttasElv1", "fAttasElv2"}
    simulator = Simulator(open_result("trajectories"))
    for k in (0, 1):
        recorded, now = simulator.recorded(k), simulator.result(k).simulated
        assert np.rad2deg(np.sqrt(np.mean((recorded["alpha"] - now["alpha"]) ** 2))) < 0.15
        assert np.rad2deg(np.sqrt(np.mean((recorded["q"] - now["q"]) ** 2))) < 0.25
