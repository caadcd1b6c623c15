"""What is chosen on the page: handed on as shown, scored in a window, served to this machine alone."""

import http.client
import math
import shutil
import socket

import numpy as np
import pytest
from scipy.stats import norm

from bayes_aero.errors import InputError
from bayes_aero.explore.opened import Choice, chosen_model, export_chosen, flown_model, groups_of, open_result
from bayes_aero.explore.page import Asked, gain, read_asked, scores
from bayes_aero.explore.server import PageServer
from bayes_aero.explore.simulator import Simulator
from bayes_aero.export.identified import python_source
from bayes_aero.jobs.export import FORMS

CHOICES = {
    "moved": Choice({"CLa": 3.9}),
    "attached": Choice(off=frozenset({"flow_separation", "reattachment_hysteresis"})),
    "lagged": Choice({"tau1": 9.0}, added=("separation_lag",)),
    "lag off": Choice({"tau1": 9.0}, frozenset({"separation_lag"}), ("separation_lag",)),
    "sensor": Choice({"alpha_bias": 0.01}, frozenset({"mach_lift"}), ("alpha_bias", "alpha_dot_moment")),
}


@pytest.fixture(scope="module")
def own(results, tmp_path_factory):
    """A simulator of a result that may be written to."""
    folder = tmp_path_factory.mktemp("handed") / "flown"
    shutil.copytree(results.flown, folder)
    return Simulator(open_result(str(folder), None, [results.folder]))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", CHOICES)
def test_every_form_takes_every_choice(own, form, name):
    values = own.fly(0, CHOICES[name]).values
    folder, files = export_chosen(own.opened, CHOICES[name], values, form)
    assert folder.parent == own.opened.folder / "exports"
    assert all((folder / file).stat().st_size > 0 for file in files)


@pytest.mark.parametrize("name", ["moved", "attached", "sensor"])
def test_the_exported_function_has_the_coefficients_of_the_page(own, name):
    """The function of an FMU at single samples of the corrected record, against the model that is flown."""
    choice = CHOICES[name]
    values = own.fly(0, choice).values
    chosen, exported = chosen_model(own.opened, choice, values), {}
    exec(compile(python_source(chosen), "exported.py", "exec"), exported)
    flown, flights = flown_model(own.opened.identified.model, choice), own.flights
    arrays = {name: np.asarray(x) for name, x in values.items()}
    channels = flights.with_slopes(flown.corrected(arrays, flights.channels, flights.aircraft))
    for k in (100, 300, 500):
        signals = {name: np.asarray(x)[k] for name, x in channels.items()}
        expected = flown.flow(arrays, signals, flights.aircraft)
        told = exported["aerodynamics"](**{name: float(signals[name]) for name in chosen.signals})
        for c in ("CL", "CD", "Cm"):
            assert told[c] == pytest.approx(float(expected[c]), rel=1e-9, abs=1e-12), (c, k)


def test_a_folder_that_cannot_be_made_is_one_sentence(own):
    blocked = own.opened.folder / "exports"
    shutil.rmtree(blocked, ignore_errors=True)
    blocked.write_text("a file")
    with pytest.raises(InputError, match=r"cannot write .*exports"):
        export_chosen(own.opened, Choice(), own.fly(0, Choice()).values, "jsbsim")
    blocked.unlink()


def test_sliders_hold_the_estimate_within_the_bounds(own):
    identified = own.opened.identified
    groups = groups_of(identified.model, identified.values, own.opened.errors, ("separation_lag", "mass_scale"))
    sliders = {s.name: s for group in groups for s in group.sliders}
    bounds = {p.name: p.bounds for p in identified.model.extended("mass_scale").parameters}
    for s in sliders.values():
        assert math.isfinite(s.low)
        assert math.isfinite(s.high)
        assert s.low <= s.value <= s.high
        assert s.low < s.high
        assert s.low / s.factor >= bounds[s.name][0] - 1e-12
        assert s.high / s.factor <= bounds[s.name][1] + 1e-12
    star = sliders["alpha_star"]
    assert star.unit == "deg"
    assert star.value == pytest.approx(math.degrees(identified.values["alpha_star"]))
    reach = max(5.0 * math.degrees(own.opened.errors["alpha_star"]), 0.3 * star.value)
    assert star.high == pytest.approx(star.value + reach)
    assert [group.added for group in groups if group.name in ("separation_lag", "mass_scale")] == [True, True]


N = 200
RNG = np.random.default_rng(7)
WINDOW = np.arange(N) >= 50
RECORDED = {"alpha": RNG.standard_normal(N), "q": RNG.standard_normal(N)}
BEFORE = {name: x + 0.3 * RNG.standard_normal(N) for name, x in RECORDED.items()}
NOW = {name: x + 0.2 * RNG.standard_normal(N) for name, x in RECORDED.items()}


def test_errors_and_gain_are_those_of_the_window():
    alpha, q = scores(RECORDED, BEFORE, NOW, WINDOW, {"alpha": 0.25})
    wrong = (NOW["alpha"] - RECORDED["alpha"])[50:]
    assert alpha.now == pytest.approx(np.linalg.norm(wrong) / np.sqrt(150.0), rel=1e-12)
    assert alpha.within == np.count_nonzero(np.abs(wrong) <= 0.25) / 150
    assert alpha.within_before < alpha.within
    assert (q.within, q.within_before) == (None, None)
    sd = {"alpha": 0.3, "q": 0.5}

    def density(simulated):
        return sum(norm.logpdf((RECORDED[n] - simulated[n])[WINDOW], scale=x).sum() for n, x in sd.items())

    assert gain(RECORDED, BEFORE, NOW, WINDOW, sd, 1.0) == pytest.approx(density(NOW) - density(BEFORE), rel=1e-12)
    assert gain(RECORDED, BEFORE, NOW, WINDOW, sd, 25.0) == pytest.approx((density(NOW) - density(BEFORE)) / 25.0)
    assert gain(RECORDED, BEFORE, BEFORE, WINDOW, sd, 1.0) == 0.0


SENT = '{"id": 3, "manoeuvre": 1, "window": [2, 5], "values": {"CLa": 3.5}, "off": ["a"], "added": ["b", "b"], "fan": true, "export": null}'  # noqa: E501


def test_what_the_page_sends_is_read():
    assert read_asked(SENT) == Asked(3, 1, (2.0, 5.0), {"CLa": 3.5}, ("a",), ("b",), True, "")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("3.5", "NaN"), ("3.5", '"x"'), ("null", '"../../etc"'), ("[2, 5]", "[2]"), ("null}", "null"),
        ('"id": 3', '"i": 3'),
    ],
)  # fmt: skip
def test_what_it_never_sends_is_one_sentence(old, new):
    text = SENT.replace(old, new)
    assert text != SENT
    with pytest.raises(InputError, match=r"the page sent what it never sends .*; load it again"):
        read_asked(text)


UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",  # of RFC 6455
    "Sec-WebSocket-Protocol": "bokeh, none",
}


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


@pytest.mark.parametrize(
    "origin", ["http://example.com", "http://127.0.0.1:1", "null", "https://127.0.0.1.example.com"]
)
def test_a_websocket_of_another_origin_is_refused(served, origin, monkeypatch):
    monkeypatch.setenv("BOKEH_ALLOW_WS_ORIGIN", "example.com,127.0.0.1:1")
    assert asked(served.port, "/ws", Origin=origin, **UPGRADE)[0] == 403


def test_it_listens_on_this_machine_alone_and_a_taken_port_is_one_sentence(served):
    own = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
    for address in own - {"127.0.0.1"}:
        with socket.socket() as other:
            other.settimeout(5.0)
            assert other.connect_ex((address, served.port)) != 0
    with pytest.raises(InputError, match=rf"port {served.port} cannot be used \(it is taken\); give another --port"):
        PageServer(lambda _: None, served.port)
