"""A report page in a real browser, and what any of them must be there: legible to all, silent, fit for a phone."""

import re
import shutil
from itertools import pairwise

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needed = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium: apt-get install chromium")

RANGES = """() => Bokeh.documents.map((d) => d.roots()[0].children.map(([f]) => [f.x_range.start, f.x_range.end]))"""
HEIGHTS = """() => Bokeh.documents[0].roots()[0].children.map(([f]) => [f.y_range.start, f.y_range.end])"""
SEEN = """() => Bokeh.documents[0].roots()[0].children.map(([f]) => {
  const {t, y0} = f.renderers.find((r) => r.glyph.type === "Line").data_source.data;
  const y = Array.from(y0).filter((_, k) => t[k] >= f.x_range.start && t[k] <= f.x_range.end);
  return [Math.min(...y), Math.max(...y)] })"""  # least and largest measured value of the stretch that is shown
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


def opened(browser, report, width: int = 1280, **options):
    """The page at a width; what it says to the console or asks of a network is in `page.heard`."""
    page = browser.new_context(viewport={"width": width, "height": 900}, **options).new_page()
    page.heard = []
    page.on("console", lambda m: page.heard.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: page.heard.append(str(error)))
    page.on("dialog", lambda dialog: (page.heard.append("a dialog opened"), dialog.dismiss()))
    page.on("request", lambda r: None if r.url.startswith(("data:", "blob:")) else page.heard.append(r.url))
    page.goto(report.as_uri())
    page.wait_for_function(
        "document.documentElement.dataset.drawn || !document.getElementById('plots')", timeout=30_000
    )
    assert page.heard.count(report.as_uri()) == 1  # the listener hears
    page.heard.remove(report.as_uri())
    return page


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


def has_a_unit_on_every_axis(page) -> None:
    for plot in page.evaluate(LABELS):
        assert all(re.search(r"\[.+\]$", y) for y, _ in plot)
        assert [x for _, x in plot if x] == ["time from start of record [s]"]


def says_in_words_what_figures_show(page, least: int) -> None:
    texts = page.evaluate("[...document.images].map((i) => i.naturalWidth > 0 ? i.alt : '')")
    texts += page.evaluate("[...document.querySelectorAll('[role=img]')].map((e) => e.ariaLabel)")
    assert len(texts) >= least
    assert all(len(text) > 20 for text in texts)


def fits_a_phone(phone) -> None:
    """Everything open, on a screen of 390 pixels."""
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


def can_be_read_by_everyone(page) -> None:
    assert page.get_attribute("html", "lang") == "en"
    levels = page.evaluate("[...document.querySelectorAll('h1, h2, h3, h4')].map((h) => Number(h.tagName[1]))")
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b - a <= 1 for a, b in pairwise(levels))
    assert page.evaluate("[...document.querySelectorAll('th')].every((t) => t.scope)")
    assert page.evaluate(CONTRAST) >= 4.5
