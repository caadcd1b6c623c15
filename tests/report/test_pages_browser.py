"""Report pages in a real browser: they draw, zoom, print, fit a phone, are legible to all and call nobody."""

import re
from dataclasses import replace

import browsing
import numpy as np
import pandas as pd
import pytest
from report_samples import CARD, flight, records, study_context

from bayes_aero.atomic_write import write_whole
from bayes_aero.jobs.preparing import starter_card
from bayes_aero.jobs.store import provenance
from bayes_aero.report.figures import posterior
from bayes_aero.report.figures.every_figure import draw_all
from bayes_aero.report.page import render, section
from bayes_aero.report.pages.check import card_page
from bayes_aero.report.pages.fly import fly_page
from bayes_aero.report.pages.identification import identification_page
from bayes_aero.report.pages.parts import PageContext
from bayes_aero.report.pages.study import study_page
from bayes_aero.report.pages.trajectories import trajectories

pytestmark = browsing.needed

HOSTILE = """<img src=x onerror=alert(1)>$$x^2$$"'&_a_name_that_is_long_enough_to_leave_a_phone"""
DRAWN = {
    **{stem: posterior.FIGURES[stem] for stem in ("stall", "separation")},
    "forest": posterior.forest,
    "crb_vs_credible": posterior.crb_vs_credible,
}


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
    given = [path for path in simulated.paths if (path.model, path.split) == ("card", "hold_out")]
    page = identification_page(run, source, {path.stem: path for path in drawn}, given)
    flights = section("trajectories", "Trajectories", lambda: trajectories(simulated, card))
    return write_whole(render(replace(page, sections=(*page.sections, flights))), folder / "report.html")


@pytest.fixture
def fresh(browser, report):
    """A page that may be changed."""
    page = browsing.opened(browser, report)
    yield page
    page.context.close()


def test_it_draws_in_silence_and_zooms_with_all_axes(fresh):
    before = fresh.evaluate(browsing.RANGES)
    assert len(before) >= 6  # two manoeuvres, two halves as identified, two flown unseen
    fresh.locator("#plot-0").scroll_into_view_if_needed()
    box, y = fresh.locator("#plot-0").bounding_box(), fresh.evaluate("scrollY")
    fresh.mouse.move(box["x"] + 300.0, box["y"] + 100.0)
    fresh.mouse.wheel(0, 200)  # alone it scrolls the page
    fresh.wait_for_function(f"scrollY > {y + 50}")
    assert fresh.evaluate(browsing.RANGES) == before
    fresh.locator("#plot-0").scroll_into_view_if_needed()
    browsing.drag(fresh, "#plot-0", 0.25, 0.5)
    after = fresh.evaluate(browsing.RANGES)
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
    wider = fresh.evaluate(browsing.RANGES)[0]
    assert wider[0][1] - wider[0][0] > end - start
    assert all(panel == wider[0] for panel in wider)
    assert fresh.heard == []


def test_a_stretch_of_time_fills_its_panels(fresh):
    whole = fresh.evaluate(browsing.HEIGHTS)
    fresh.locator("#plot-0").scroll_into_view_if_needed()
    browsing.drag(fresh, "#plot-0", 0.8, 0.9)
    # Bokeh redraws when the browser has time for it.
    closer = f"({browsing.HEIGHTS})().some(([bottom, top], i) => top - bottom < 0.5 * (whole[i][1] - whole[i][0]))"
    fresh.wait_for_function(f"whole => {closer}", arg=whole)
    heights, seen = fresh.evaluate(browsing.HEIGHTS), fresh.evaluate(browsing.SEEN)
    for (bottom, top), (a, b), (low, high) in zip(heights, whole, seen, strict=True):
        assert bottom <= low <= high <= top
        assert b - a > 0.999 * (top - bottom)
    fresh.locator("#plot-0").locator(".bk-tool-icon-reset").first.click()
    fresh.wait_for_function(f"whole => JSON.stringify(({browsing.HEIGHTS})()) === JSON.stringify(whole)", arg=whole)


def test_it_prints_with_everything_open_and_the_plots_as_drawn(fresh):
    fresh.locator("#plot-0").scroll_into_view_if_needed()
    browsing.drag(fresh, "#plot-0", 0.25, 0.5)
    closed = fresh.evaluate("document.querySelectorAll('details:not([open])').length")
    assert closed >= 3
    fresh.evaluate(
        "addEventListener('beforeprint', () => { "
        "window.closed = document.querySelectorAll('details:not([open])').length })"
    )
    high = "Bokeh.documents.map((d) => d.roots()[0].children.map(([f]) => f.inner_height))"
    heights = fresh.evaluate(high)
    pdf = fresh.pdf(prefer_css_page_size=True)
    assert pdf.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", pdf)) >= 3
    assert fresh.evaluate("window.closed") == 0
    assert fresh.evaluate("document.querySelectorAll('details:not([open])').length") == closed
    assert fresh.evaluate(high) == heights
    fresh.emulate_media(media="print")
    sizes = fresh.evaluate("[...document.querySelectorAll('.still')].map((c) => [c.width, c.height, c.clientHeight])")
    assert len(sizes) == fresh.evaluate("document.querySelectorAll('[data-plot]').length")
    assert all(min(size) > 150 for size in sizes)
    assert all(height < 0.65 * width for width, height, _ in sizes)  # two of them share a sheet
    ink = fresh.evaluate(
        "(() => { const c = document.querySelector('.still'); const d = c.getContext('2d').getImageData(0, 0, c.width, "
        "c.height).data; let n = 0; for (let i = 0; i < d.length; i += 4) "
        "n += d[i + 3] > 0 && d[i] < 128; return n })()"
    )
    assert ink > 2000
    assert not fresh.locator(".bk-Toolbar, .wake").first.is_visible()
    fresh.set_viewport_size({"width": 703, "height": 1047})  # A4 between its margins
    fresh.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true })")
    tables = "[...document.querySelectorAll('.table:not(.broad) table')]"
    ends = fresh.evaluate(f"{tables}.map((t) => t.getBoundingClientRect().right)")
    assert len(ends) >= 5
    assert max(ends) <= 704  # no table is broader than the sheet
    assert fresh.heard == []


@pytest.fixture(scope="module")
def fly_report(tmp_path_factory):
    fit, source = flight(), provenance(CARD, records(), 0, {"windows": 12.0})
    page = fly_page(fit.flown, PageContext(CARD, records(), source, {}, replace(fit, notes=("A note.",))))
    return write_whole(render(page), tmp_path_factory.mktemp("fly") / "report.html")


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    return write_whole(render(study_page(study_context(folder, failed=(2,)))), folder / "report.html")


@pytest.fixture(scope="module")
def starter(tmp_path_factory):
    path, time = tmp_path_factory.mktemp("card") / "N1.csv", np.arange(0.0, 40.0, 0.04)
    columns = {"Time_s": time, "AOA_deg": 5.0 + np.sin(time), "A_COLUMN_WITH_A_LONG_NAME_<i>": time, "FN": 900.0 + time}
    pd.DataFrame(columns | {"NZ_g": 1.0 + 0.1 * np.sin(time)}).to_csv(path, index=False)
    page = card_page(starter_card(path), "N1.csv", "N1.toml", provenance(None, [], None, {}))
    return write_whole(render(page), path.parent / "report.html")


PAGES = {  # how many figures it has at least, and whether they are over time
    "report": (6 + len(DRAWN), True), "fly_report": (2, True), "study": (1, False),
    "starter": (2, True),
}  # fmt: skip


@pytest.mark.parametrize("name", PAGES)
def test_everyone_can_read_a_page_on_a_desk_and_a_phone_and_it_calls_nobody(request, browser, name):
    (figures, over_time), report = PAGES[name], request.getfixturevalue(name)
    page, phone = (
        browsing.opened(browser, report),
        browsing.opened(browser, report, 390, is_mobile=True, has_touch=True),
    )
    browsing.can_be_read_by_everyone(page)
    browsing.says_in_words_what_figures_show(page, figures)
    if over_time:
        browsing.has_a_unit_on_every_axis(page)
        wake = phone.locator(".wake").first  # until it is tapped, a swipe over the plot scrolls the page
        assert wake.is_visible()
        wake.scroll_into_view_if_needed()
        wake.tap()
        assert not wake.is_visible()

    browsing.fits_a_phone(phone)
    assert page.heard == phone.heard == []
    page.context.close()
    phone.context.close()
