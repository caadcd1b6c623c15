"""What the page flies, scores and hands on: by the result's values as `fly` wrote it, by others as the package does.

What is chosen is handed on as shown, scored in a window, and served to this machine alone.
"""

import http.client
import math
import shutil
import socket
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.stats import norm

from bayes_aero.diagnosis.trajectories import fly_given
from bayes_aero.errors import InputError
from bayes_aero.explore import opened as explored
from bayes_aero.explore.opened import Choice, Simulator
from bayes_aero.explore.page import Asked, PageServer, gain, read_asked, scores
from bayes_aero.export.simulators import slave_source
from bayes_aero.flight.reading import read_record
from bayes_aero.jobs.finished import FORMS
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe

UPGRADE = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}  # with the key of RFC 6455
UPGRADE |= {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol": "bokeh, none"}


def agree(found, expected):
    for name, y in expected.items():
        np.testing.assert_allclose(found[name], y, rtol=1e-9, atol=1e-9 * np.ptp(y), err_msg=name)


def test_the_result_is_the_one_that_fly_wrote(results, simulator):
    with xr.open_datatree(results.flown / "histories.nc", engine="h5netcdf") as tree:
        written = tree["trajectories_fitted"].to_dataset().load()
    for k in (0, 1):
        now = simulator.fly(k, Choice())
        assert now.inside.all()
        for name in simulator.outputs:
            y = np.asarray(written[f"{name}_fitted"])[written["manoeuvre"] == k + 1]
            np.testing.assert_allclose(now.simulated[name], y, rtol=1e-6, atol=1e-6 * np.ptp(y), err_msg=name)


LAG = ("separation_lag",)
CHOICES = {
    "moved": Choice({"CLa": 3.9, "Cmde": -1.1}),
    "attached": Choice(off=frozenset({"separated_moment"})),
    "heavy": Choice({"mass_scale": 1.04}, added=("mass_scale",)),
    "lagged": Choice({"tau1": 9.0}, added=LAG),
    "lag off": Choice({"tau1": 9.0}, frozenset(LAG), LAG),  # exactly absent: a lag of zero would leave a fast state
}


@pytest.mark.parametrize("name", CHOICES)
def test_other_values_and_effects_fly_as_the_package_does(packaged, simulator, model, card, name):
    kept = tuple(e for e in card.effects if name != "attached" or e != "separated_moment")
    fixed = {key: x for key, x in card.fixed.items() if name != "lagged" or key != "tau1"}
    flown = model.extended("mass_scale") if name == "heavy" else Model.of(kept, fixed)
    values = CHOICES[name].values if name != "lag off" else {}
    agree(simulator.fly(0, CHOICES[name]).simulated, packaged(flown, **values))


def test_effects_are_those_with_parameters_that_act_and_what_is_not_flown_is_said(simulator, model):
    shown = {e.name for e in explored.shown_effects(model)}
    assert "attached_lift" in shown
    assert shown.isdisjoint({"kirchhoff_lift", "separation_lag"})  # without parameters; fixed at neutral by the card
    more = {e.name for e in explored.addable(model, tuple(simulator.flights.channels))}
    assert {"separation_lag", "mass_scale"} <= more
    assert more.isdisjoint({"attached_lift", "vertical_gusts", "longitudinal_gusts"})
    opened = simulator.opened
    assert opened.limits == ()
    noisy = {"converged": True, "gain": 5.0}
    (said,) = replace(opened, told={**opened.told, "process_noise": noisy}).limits
    assert "gusts and the noise of its states are not flown here" in said


def test_coefficients_are_those_of_the_record_and_the_model(results, simulator, card, model):
    """As the observations of `identify` form and model them."""
    seen = observe([read_record(results.folder / "stall.csv", card.channels)], card, model)
    now = simulator.fly(0, Choice())
    theta = np.array([now.values[name] for name in model.names])
    predicted = np.asarray(model.predicted(theta, seen.signals, seen.aircraft))
    for c, name in enumerate(model.coefficients):
        for found, expected in ((now.coefficients, predicted), (now.formed, np.asarray(seen.measured))):
            assert np.sqrt(np.mean((found[name] - expected[:, c]) ** 2)) < 0.01 * np.ptp(expected[:, c])


def test_draws_have_the_covariance_of_the_fit(simulator, monkeypatch):
    """CL of 400 draws: standard deviation as by the law of error propagation, within four of its own errors (15 %).
    A tenth of the standard errors, because a stall is not linear over the whole."""
    told = dict(simulator.opened.told)
    told["covariance"] = (0.01 * np.array(told["covariance"])).tolist()
    monkeypatch.setitem(simulator.opened.told, "covariance", told["covariance"])
    fans = [simulator.fan(0, seed=seed) for seed in range(10)]  # of 40, as the page draws them
    assert all(origin.startswith("normal distribution of the estimates") for origin, _ in fans)
    drawn = np.concatenate([fan["CL"] for _, fan in fans])
    assert len(drawn) == 400
    slopes = []
    for name, p in told["parameters"].items():
        h = 0.01 * p["sd_corrected"]
        up, down = (simulator.fly(0, Choice({name: p["estimate"] + x})).coefficients["CL"] for x in (h, -h))
        slopes.append((up - down) / (2.0 * h))
    expected = np.sqrt(np.einsum("in,ij,jn->n", slopes, np.array(told["covariance"]), slopes))
    np.testing.assert_allclose(np.std(drawn, axis=0), expected, rtol=0.15)


def test_without_fitted_states_every_manoeuvre_flies_from_its_measured_one(simulator, model):
    """As of a result of identify; as the package flies all of them together."""
    found = Simulator(replace(simulator.opened, departures={}))
    assert found.manoeuvres == ("stall", "second")
    paths = fly_given(found.flights, model, found.opened.identified.values, {})
    assert len(paths[0].time) > len(paths[1].time)
    for k, path in enumerate(paths):
        now = found.fly(k, Choice())
        agree(now.simulated, path.simulated)
        np.testing.assert_array_equal(found.time(k), path.time)
        assert {len(y) for y in (*now.coefficients.values(), *now.formed.values())} == {len(path.time)}


SENSOR = Choice({"alpha_bias": 0.01}, frozenset({"mach_lift"}), ("alpha_bias", "alpha_dot_moment"))
EXPORTED = CHOICES | {"sensor": SENSOR}


@pytest.fixture(scope="module")
def own(results, served):
    """A simulator of a result that may be written to."""
    return Simulator(explored.open_result(str(served.folder), None, [results.folder]))


@pytest.mark.parametrize(
    ("form", "name"), [*((form, "sensor") for form in FORMS), *(("jsbsim", name) for name in CHOICES)]
)
def test_every_form_takes_every_choice(own, form, name):
    choice = EXPORTED[name]
    folder, files = explored.export_chosen(own.opened, choice, own.fly(0, choice).values, form)
    assert folder.parent == own.opened.folder / "exports"
    assert all((folder / file).stat().st_size > 0 for file in files)


@pytest.mark.parametrize("name", ["moved", "attached", "sensor"])
def test_the_exported_function_has_the_coefficients_of_the_page(own, name):
    """The function of an FMU at single samples of the corrected record, against the model that is flown."""
    choice = EXPORTED[name]
    values = own.fly(0, choice).values
    chosen, exported = explored.chosen_model(own.opened, choice, values), {}
    exec(compile(slave_source(chosen, "exported"), "exported.py", "exec"), exported)
    flown, flights = explored.flown_model(own.opened.identified.model, choice), own.flights
    arrays = {name: np.asarray(x) for name, x in values.items()}
    channels = flights.with_slopes(flown.corrected(arrays, flights.channels, flights.aircraft))
    for k in (100, 300, 500):
        signals = {name: np.asarray(x)[k] for name, x in channels.items()}
        expected = flown.flow(arrays, signals, flights.aircraft)
        told = exported["aerodynamics"]({name: float(signals[name]) for name in chosen.signals}, {})
        for c in ("CL", "CD", "Cm"):
            assert told[c] == pytest.approx(float(expected[c]), rel=1e-9, abs=1e-12), (c, k)


def test_a_folder_that_cannot_be_made_is_one_sentence(own):
    blocked = own.opened.folder / "exports"
    shutil.rmtree(blocked, ignore_errors=True)
    blocked.write_text("a file")
    with pytest.raises(InputError, match=r"cannot write .*exports"):
        explored.export_chosen(own.opened, Choice(), own.fly(0, Choice()).values, "jsbsim")
    blocked.unlink()


def test_sliders_hold_the_estimate_within_the_bounds(own):
    identified = own.opened.identified
    added = ("separation_lag", "mass_scale")
    groups = explored.groups_of(identified.model, identified.values, own.opened.errors, added)
    sliders = {s.name: s for group in groups for s in group.sliders}
    bounds = {p.name: p.bounds for p in identified.model.extended("mass_scale").parameters}
    for s in sliders.values():
        assert -math.inf < s.low <= s.value <= s.high < math.inf
        assert s.low < s.high
        assert s.low / s.factor >= bounds[s.name][0] - 1e-12
        assert s.high / s.factor <= bounds[s.name][1] + 1e-12
    star = sliders["alpha_star"]
    assert star.unit == "deg"
    assert star.value == pytest.approx(math.degrees(identified.values["alpha_star"]))
    reach = max(5.0 * math.degrees(own.opened.errors["alpha_star"]), 0.3 * star.value)
    assert star.high == pytest.approx(star.value + reach)
    assert [group.added for group in groups if group.name in added] == [True, True]


def test_errors_and_gain_are_those_of_the_window():
    rng, n, window = np.random.default_rng(7), 200, np.arange(200) >= 50
    recorded = {name: rng.standard_normal(n) for name in ("alpha", "q")}
    before, now = ({name: x + sd * rng.standard_normal(n) for name, x in recorded.items()} for sd in (0.3, 0.2))
    alpha, q = scores(recorded, before, now, window, {"alpha": 0.25})
    wrong = (now["alpha"] - recorded["alpha"])[window]
    assert alpha["now"] == pytest.approx(np.linalg.norm(wrong) / np.sqrt(150.0), rel=1e-12)
    assert alpha["within"] == np.count_nonzero(np.abs(wrong) <= 0.25) / 150
    assert alpha["within_before"] < alpha["within"]
    assert (q["within"], q["within_before"]) == (None, None)
    sd = {"alpha": 0.3, "q": 0.5}

    def errors(simulated):
        return [(recorded[name] - simulated[name])[window] / x for name, x in sd.items()]

    gained = sum(norm.logpdf(a).sum() - norm.logpdf(b).sum() for a, b in zip(errors(now), errors(before), strict=True))
    for weight in (1.0, 25.0):
        assert gain(zip(errors(before), errors(now), strict=True), weight) == pytest.approx(gained / weight, rel=1e-12)


SENT = '{"id": 3, "manoeuvre": 1, "window": [2, 5], "values": {"CLa": 3.5}, "off": ["a"], "added": ["b", "b"], "fan": true, "export": null}'  # noqa: E501


def test_what_the_page_sends_is_read():
    assert read_asked(SENT) == Asked(3, 1, (2.0, 5.0), {"CLa": 3.5}, ("a",), ("b", "b"), True)


@pytest.mark.parametrize(("old", "new"), [
    ("3.5", "NaN"), ("3.5", '"x"'), ("null", '"../../etc"'), ("[2, 5]", "[2]"), ("null}", "null"),
    ('"id": 3', '"i": 3'),
])  # fmt: skip
def test_what_it_never_sends_is_one_sentence(old, new):
    text = SENT.replace(old, new)
    assert text != SENT
    with pytest.raises(InputError, match=r"the page sent what it never sends .*; load it again"):
        read_asked(text)


def asked(port, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", path, headers={name.replace("_", "-"): x for name, x in headers.items()})
    answer = connection.getresponse()
    found = answer.status, answer.read().decode("utf-8", "replace") if answer.status != 101 else ""
    connection.close()
    return found


def test_other_hosts_are_refused_and_the_page_names_none(served):
    own = f"127.0.0.1:{served.port}"
    status, html = asked(served.port, Host=own)
    assert status == 200
    assert asked(served.port, Host=f"localhost:{served.port}")[0] == 200
    for host in ("example.com", f"example.com:{served.port}", "127.0.0.1", f"{own}.example.com", "127.0.0.1:1"):
        for path in ("/", "/ws", "/static/js/bokeh.min.js", "/metadata"):
            assert asked(served.port, path, Host=host)[0] == 403, host
    assert "http://" not in html.replace(f"http://{own}", "")
    assert "https://" not in html
    assert "cdn." not in html


def test_a_websocket_of_another_origin_is_refused(served, monkeypatch):
    monkeypatch.setenv("BOKEH_ALLOW_WS_ORIGIN", "example.com,127.0.0.1:1")
    for origin in ("http://example.com", "http://127.0.0.1:1", "null", "https://127.0.0.1.example.com"):
        assert asked(served.port, "/ws", Origin=origin, **UPGRADE)[0] == 403


def test_it_listens_on_this_machine_alone_and_a_taken_port_is_one_sentence(served):
    own = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
    for address in own - {"127.0.0.1"}:
        with socket.socket() as other:
            other.settimeout(5.0)
            assert other.connect_ex((address, served.port)) != 0
    with pytest.raises(InputError, match=rf"port {served.port} cannot be used \(it is taken\); give another --port"):
        PageServer(lambda _: None, served.port)
