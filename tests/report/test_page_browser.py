"""The report page in a real browser: it draws, zooms, prints, fits a phone, is legible to all and calls nobody."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from itertools import pairwise

import pytest

from bayes_aero.report import figures_comparison, figures_stall
from bayes_aero.report.figures import draw_all
from bayes_aero.report.page import section, write_page
from bayes_aero.report.page_identification import identification_page
from bayes_aero.report.page_trajectories import trajectories
from bayes_aero.studies.provenance import provenance

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium: apt-get install chromium")

HOSTILE = """<img src=x onerror=alert(1)>$$x^2$$"'&_a_name_that_is_long_enough_to_leave_a_phone"""
DRAWN = {
    "stall": figures_stall.stall,
    "separation": figures_stall.separation,
    "forest": figures_comparison.forest,
    "crb_vs_credible": figures_comparison.crb_vs_credible,
}
RANGES = """() => Bokeh.documents.map((d) => d.roots()[0].children.map(([f]) => [f.x_range.start, f.x_range.end]))"""
LABELS = """() => Bokeh.documents.map((d) => d.roots()[0].children.map(([f]) =>
    [f.left[0].axis_label, f.below[0].visible ? f.below[0].axis_label : null]))"""
CONTRAST = """() => {
  const light = (c) => { const [r, g, b] = c.match(/[0-9.]+/g).slice(0, 3).map((x) => { x /= 255;
    return x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4 }); return 0.2126 * r + 0.7152 * g + 0.0722 * b };
  const behind = (e) => { for (; e; e = e.parentElement) { const c = getComputedStyle(e).backgroundColor;
    if (!/, 0(\\.\\d+)?\\)$/.test(c)) return c } return "rgb(255, 255, 255)" };
  return Math.min(...[...document.querySelectorAll("p, li, td, th, dt, dd, figcaption, summary, a, h1, h2, h3")]
    .filter((e) => e.innerText && e.checkVisibility() && !e.classList.contains("skip")).map((e) => {
      const [a, b] = [light(getComputedStyle(e).color), light(behind(e))];
      return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05) })) }"""


@pytest.fixture(scope="module")
def report(full, simulated, card, tmp_path_factory):
    """A page with everything that can be on one, its names hostile."""
    names = (HOSTILE, "plain")
    run = replace(
        full,
        observations=replace(full.observations, names=names),
        records=tuple(replace(record, name=name) for record, name in zip(full.records, names, strict=True)),
        alone=dict(zip(names, full.alone.values(), strict=True)),
    )
    folder = tmp_path_factory.mktemp("page")
    drawn, failed = draw_all(DRAWN, run, folder / "figures")
    assert not failed
    source = provenance(run.card, run.records, 0, {"noise": "ar1"})
    page = identification_page(run, source, {path.stem: path for path in drawn})
    flights = section("trajectories", "Trajectories", lambda: trajectories(simulated, card))
    return write_page(replace(page, sections=(*page.sections, flights)), folder / "report.html")


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


def opened(browser, report, width: int = 1280, **options):
    """The page at a width; what it says to the console or asks of a network is in `page.heard`."""
    page = browser.new_context(viewport={"width": width, "height": 900}, **options).new_page()
    page.heard = []
    page.on("console", lambda m: page.heard.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: page.heard.append(str(error)))
    page.on("dialog", lambda dialog: (page.heard.append("a dialog opened"), dialog.dismiss()))
    page.on("request", lambda r: None if r.url.startswith(("data:", "blob:")) else page.heard.append(r.url))
    page.goto(report.as_uri())
    page.wait_for_function("document.documentElement.dataset.drawn", timeout=30_000)
    assert page.heard.count(report.as_uri()) == 1  # the listener hears
    page.heard.remove(report.as_uri())
    return page


@pytest.fixture(scope="module")
def desk(browser, report):
    """A page that is only looked at."""
    page = opened(browser, report)
    yield page
    page.context.close()


@pytest.fixture
def fresh(browser, report):
    """A page that may be changed."""
    page = opened(browser, report)
    yield page
    page.context.close()


@pytest.fixture
def phone(browser, report):
    """The same on a phone."""
    page = opened(browser, report, 390, is_mobile=True, has_touch=True)
    yield page
    page.context.close()


def drag(page, plot: str, begin: float, end: float) -> None:
    """Across the first panel of a plot, from one share of its width to another."""
    box = page.locator(plot).bounding_box()
    y = box["y"] + 100.0
    left, width = box["x"] + 80.0, box["width"] - 100.0
    page.mouse.move(left + begin * width, y)
    page.mouse.down()
    page.mouse.move(left + end * width, y, steps=5)
    page.mouse.up()
    page.wait_for_timeout(200)


def test_it_draws_in_silence_and_zooms_with_all_axes(fresh):
    before = fresh.evaluate(RANGES)
    assert len(before) >= 4  # two manoeuvres, two halves flown unseen
    fresh.locator("#plot-0").scroll_into_view_if_needed()
    drag(fresh, "#plot-0", 0.25, 0.5)
    after = fresh.evaluate(RANGES)
    (start, end) = after[0][0]
    (left, right) = before[0][0]
    assert left < start < end < right
    assert (end - start) / (right - left) == pytest.approx(0.25, abs=0.03)
    assert all(panel == [start, end] for panel in after[0])  # linked
    assert after[1:] == before[1:]  # the other manoeuvre is not
    fresh.keyboard.down("Control")
    fresh.mouse.wheel(0, 300)
    fresh.keyboard.up("Control")
    fresh.wait_for_timeout(300)
    wider = fresh.evaluate(RANGES)[0]
    assert wider[0][1] - wider[0][0] > end - start
    assert all(panel == wider[0] for panel in wider)
    assert fresh.heard == []


def test_a_wheel_alone_scrolls_the_page(fresh):
    fresh.locator("#plot-0").scroll_into_view_if_needed()
    box, before = fresh.locator("#plot-0").bounding_box(), fresh.evaluate(RANGES)
    fresh.mouse.move(box["x"] + 300.0, box["y"] + 100.0)
    y = fresh.evaluate("scrollY")
    fresh.mouse.wheel(0, 200)
    fresh.wait_for_function(f"scrollY > {y + 50}")
    assert fresh.evaluate(RANGES) == before


def test_every_axis_has_its_unit(desk):
    for plot in desk.evaluate(LABELS):
        assert all(re.search(r"\[.+\]$", y) for y, _ in plot)
        assert [x for _, x in plot if x] == ["time from start of record [s]"]


def test_every_figure_says_in_words_what_it_shows(desk):
    texts = desk.evaluate("[...document.images].map((i) => i.naturalWidth > 0 ? i.alt : '')")
    texts += desk.evaluate("[...document.querySelectorAll('[role=img]')].map((e) => e.ariaLabel)")
    assert len(texts) >= 4 + len(DRAWN)
    assert all(len(text) > 40 and re.search(r"\d", text) for text in texts)


def test_hostile_names_are_only_names(desk):
    assert desk.get_by_role("heading", name=HOSTILE, exact=True).count() == 1
    assert desk.evaluate("document.querySelectorAll('script').length") == 3
    assert desk.heard == []


def test_a_phone_shows_all_of_it_without_sideways_scrolling(phone):
    phone.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true })")
    assert phone.evaluate("document.documentElement.scrollWidth") <= 390
    beyond = phone.evaluate(
        "[...document.querySelectorAll('main *, header *')].filter((e) => !e.closest('.box') && e.checkVisibility() && "
        "e.getBoundingClientRect().right > 391).map((e) => e.outerHTML.slice(0, 80))"
    )
    assert beyond == []
    assert phone.evaluate("[...document.querySelectorAll('table')].every((t) => t.closest('.box').clientWidth <= 390)")
    small = phone.evaluate(
        "Math.min(...[...document.querySelectorAll('td, p, li')].map((e) => parseFloat(getComputedStyle(e).fontSize)))"
    )
    assert small >= 12.0
    wake = phone.locator(".wake").first  # until it is tapped, a swipe over the plot scrolls the page
    assert wake.is_visible()
    wake.scroll_into_view_if_needed()
    wake.tap()
    assert not wake.is_visible()
    assert phone.heard == []


def test_it_can_be_read_by_everyone(desk):
    assert desk.get_attribute("html", "lang") == "en"
    levels = desk.evaluate("[...document.querySelectorAll('h1, h2, h3, h4')].map((h) => Number(h.tagName[1]))")
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b - a <= 1 for a, b in pairwise(levels))
    assert desk.evaluate("[...document.querySelectorAll('th')].every((t) => t.scope)")
    assert desk.evaluate(CONTRAST) >= 4.5


def test_it_prints_with_everything_open_and_the_plots_as_drawn(fresh):
    fresh.locator("#plot-0").scroll_into_view_if_needed()
    drag(fresh, "#plot-0", 0.25, 0.5)
    closed = fresh.evaluate("document.querySelectorAll('details:not([open])').length")
    assert closed >= 3
    fresh.evaluate(
        "addEventListener('beforeprint', () => { "
        "window.closed = document.querySelectorAll('details:not([open])').length })"
    )
    pdf = fresh.pdf(prefer_css_page_size=True)
    assert pdf.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", pdf)) >= 3
    assert fresh.evaluate("window.closed") == 0
    assert fresh.evaluate("document.querySelectorAll('details:not([open])').length") == closed
    fresh.emulate_media(media="print")
    sizes = fresh.evaluate("[...document.querySelectorAll('.still')].map((c) => [c.width, c.height, c.clientHeight])")
    assert len(sizes) == fresh.evaluate("document.querySelectorAll('[data-plot]').length")
    assert all(min(size) > 150 for size in sizes)
    ink = fresh.evaluate(
        "(() => { const c = document.querySelector('.still'); const d = c.getContext('2d').getImageData(0, 0, c.width, "
        "c.height).data; let n = 0; for (let i = 0; i < d.length; i += 4) "
        "n += d[i + 3] > 0 && d[i] < 128; return n })()"
    )
    assert ink > 2000
    assert not fresh.locator(".bk-Toolbar, .wake").first.is_visible()
    assert fresh.heard == []
