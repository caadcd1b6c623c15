"""The live page in a real browser: by keyboard, against the package's own simulation, and without a network."""

import json

import numpy as np
import pytest
from browsing import needed

from bayes_aero.jobs.finished import FORMS
from bayes_aero.model.model import Model

pytestmark = needed
DRAWN = """(name) => { const data = Bokeh.documents[0].get_model_by_name("now").data;
  const [t, y] = ["t", "y"].map((kind) => Array.from(data[`${kind} ${name}`]));
  const n = t.filter((x) => isFinite(x)).length; return [t.slice(0, n), y.slice(0, n)] }"""
FACTOR = {"airspeed": 1.0, "alpha": 180.0 / np.pi, "q": 180.0 / np.pi, "az": 1.0}
FOCUS = """() => { const e = document.activeElement, box = e.getBoundingClientRect(), style = getComputedStyle(e);
  const name = e.ariaLabel || (e.labels && e.labels.length ? e.labels[0].innerText : e.innerText);
  return {id: e.id, tag: e.tagName, name: (name || "").trim(), outline: style.outlineStyle === "none" ? 0 :
    parseFloat(style.outlineWidth), seen: box.width > 0 && box.bottom > 0 && box.top < innerHeight} }"""


@pytest.fixture
def page(browser, served):
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.heard, page.asked = [], []
    page.on("console", lambda m: page.heard.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: page.heard.append(str(error)))
    page.on("request", lambda r: page.asked.append(r.url))
    page.on("websocket", lambda w: page.asked.append(w.url))
    page.goto(served.url)
    page.wait_for_function("document.documentElement.dataset.answered === '0'", timeout=60_000)
    yield page
    context.close()


def answered(page, act):
    """Do something, and wait until its last answer is drawn."""
    act()
    page.wait_for_function(
        "Number(document.documentElement.dataset.answered) === explore.state.id && explore.state.id > 0", timeout=60_000
    )


def drawn(page, name):
    return np.array(page.evaluate(DRAWN, name)[1])


def agree(page, expected):
    for name, factor in FACTOR.items():
        y = factor * expected[name]
        np.testing.assert_allclose(drawn(page, name), y, rtol=0.0, atol=1e-9 * np.ptp(y), err_msg=name)


def test_sliders_and_effects_fly_the_manoeuvre_again_by_keyboard(page, served, packaged, card, model):
    agree(page, packaged(model))
    page.locator("#range-CLa").focus()
    answered(page, lambda: page.keyboard.press("ArrowRight"))
    moved = page.evaluate("explore.state.values.CLa")
    told = json.loads((served.folder / "trajectories.json").read_text())
    assert moved > told["parameters"]["CLa"]["estimate"]
    page.locator("#value-Cmde").fill("-1.25")
    answered(page, lambda: page.keyboard.press("Enter"))
    agree(page, packaged(model, CLa=moved, Cmde=-1.25))
    answered(page, lambda: page.get_by_role("button", name="reset CLa", exact=True).click())
    agree(page, packaged(model, Cmde=-1.25))
    answered(page, lambda: page.get_by_role("button", name="reset all").click())
    page.get_by_role("checkbox", name="separated_moment").focus()
    answered(page, lambda: page.keyboard.press("Space"))
    agree(page, packaged(Model.of([e for e in card.effects if e != "separated_moment"], card.fixed)))
    assert page.locator("#range-CmX").is_disabled()
    answered(page, lambda: page.get_by_role("button", name="reset all").click())
    page.locator("#add").select_option("mass_scale")
    answered(page, lambda: page.locator("#adding").click())
    page.locator("#value-mass_scale").fill("1.04")
    answered(page, lambda: page.keyboard.press("Enter"))
    agree(page, packaged(model.extended("mass_scale"), mass_scale=1.04))
    answered(page, lambda: page.get_by_role("button", name="remove mass_scale").click())
    agree(page, packaged(model))
    assert page.heard == []


def test_the_window_cuts_the_plots_and_the_errors_and_a_zoom_is_one(page, packaged, model, simulator):
    time = simulator.time(0)
    begin, end = round(time[0]) + 8.0, round(time[0]) + 20.0
    page.locator("#from").fill(f"{begin}")
    page.locator("#from").press("Tab")
    page.locator("#to").fill(f"{end}")
    answered(page, lambda: page.keyboard.press("Enter"))
    inside = (time >= begin) & (time <= end)
    np.testing.assert_allclose(page.evaluate(DRAWN, "alpha")[0], time[inside], atol=1e-9)
    wrong = np.rad2deg(packaged(model)["alpha"] - simulator.recorded(0)["alpha"])[inside]
    cells = page.locator("#scores tr.now").first.locator("td").all_inner_texts()
    heads = page.locator("#scores thead th").all_inner_texts()
    assert float(cells[heads.index("α [deg]")]) == pytest.approx(np.sqrt(np.mean(wrong**2)), rel=5e-4)
    answered(page, lambda: page.locator("#whole").click())
    assert len(drawn(page, "alpha")) == len(time)
    box = page.locator(".plot").first.bounding_box()
    left, width = box["x"] + 70.0, box["width"] - 90.0
    page.mouse.move(left + 0.3 * width, box["y"] + 50.0)
    page.mouse.down()
    page.mouse.move(left + 0.6 * width, box["y"] + 50.0, steps=5)
    answered(page, lambda: (page.mouse.up(), page.wait_for_timeout(300)))
    begin, end = page.evaluate("explore.state.window")
    assert 0.2 < (begin - time[0]) / (time[-1] - time[0]) < 0.4
    assert 0.5 < (end - time[0]) / (time[-1] - time[0]) < 0.7
    assert page.locator("#from").input_value() == f"{begin:.2f}".rstrip("0").rstrip(".")


def test_the_fan_is_drawn_and_says_where_its_draws_come_from_and_nothing_leaves_this_machine(page, served):
    answered(page, lambda: page.locator("#fan").check())
    assert page.locator("#said").inner_text().startswith("40 draws: normal distribution of the estimates")
    count = "Bokeh.documents[0].get_model_by_name('fan-alpha').data.xs.length"
    assert page.evaluate(count) == 40
    answered(page, lambda: page.locator("#fan").uncheck())
    assert page.evaluate(count) == 0
    assert any(url.startswith(f"ws://127.0.0.1:{served.port}/") for url in page.asked)
    own = (f"http://127.0.0.1:{served.port}/", f"ws://127.0.0.1:{served.port}/", "data:", "blob:")
    assert [url for url in page.asked if not url.startswith(own)] == []
    assert page.heard == []
    answered(page, lambda: page.evaluate("explore.state.values = {CLa: 'x'}; document.getElementById('whole').click()"))
    assert "load it again" in page.locator("#error").inner_text()


def test_an_export_has_the_values_of_the_page_and_overwrites_nothing(page, served):
    page.locator("#value-CLa").fill("3.75")
    answered(page, lambda: page.keyboard.press("Enter"))
    answered(page, lambda: page.get_by_role("checkbox", name="mach_lift").uncheck())
    page.locator("#form").select_option("jsbsim")
    for name in ("attas_jsbsim", "attas_jsbsim_2"):
        answered(page, lambda: page.locator("#export").click())
        folder = served.folder / "exports" / name
        assert f"Exported to {folder}: " in page.locator("#exported").inner_text()
        facts = json.loads((folder / "export.json").read_text())
        told = json.loads((served.folder / "trajectories.json").read_text())["parameters"]
        found = {name: p["value"] for name, p in facts["parameters"].items()}
        assert found["CLa"] == 3.75
        assert "CLaM" not in found
        others = found.keys() - {"CLa"}
        assert {name: found[name] for name in others} == {name: told[name]["estimate"] for name in others}
        assert any("CLa = 3.75 (was" in source and "mach_lift off" in source for source in facts["sources"])
    assert page.locator("#form option").all_inner_texts() == list(FORMS)


def test_every_control_is_reached_by_tab_in_order_with_a_name(page):
    seen = []
    page.evaluate("document.body.focus()")
    for _ in range(60):
        page.keyboard.press("Tab")
        seen.append(page.evaluate(FOCUS))
    ids = [control["id"] for control in seen]
    order = ["manoeuvre", "from", "to", "whole", "fan", "reset", "add", "adding", "form", "export"]
    order += ["on-attached_lift", "range-CL0", "value-CL0", "range-CLa", "value-CLa", "on-mach_lift", "range-CLaM"]
    assert [i for i in ids if i in order] == order
    controls = [control for control in seen if control["tag"] in ("INPUT", "SELECT", "BUTTON", "SUMMARY")]
    assert len(controls) > 40
    assert all(control["name"] and control["seen"] and control["outline"] >= 2.0 for control in controls)
