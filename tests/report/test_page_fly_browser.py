"""The page of a fit to trajectories in a real browser."""

from __future__ import annotations

import pytest
from browsing import (
    RANGES,
    can_be_read_by_everyone,
    drag,
    fits_a_phone,
    has_a_unit_on_every_axis,
    needed,
    opened,
    says_in_words_what_figures_show,
)
from flown_samples import CARD, flight, records

from bayes_aero.jobs.provenance.provenance import provenance
from bayes_aero.report.html.page import write_page
from bayes_aero.report.pages.fly import FlyContext, fly_page

pytestmark = needed


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    found = flight()
    source = provenance(CARD, records(), 0, {"windows": 12.0})
    page = fly_page(found.flown, FlyContext(CARD, records(), source, found.sentences, ("A note.",)))
    return write_page(page, tmp_path_factory.mktemp("fly") / "report.html")


def test_it_draws_in_silence_and_zooms_with_all_axes(browser, report):
    page = opened(browser, report)
    has_a_unit_on_every_axis(page)
    says_in_words_what_figures_show(page, 2)
    can_be_read_by_everyone(page)
    before = page.evaluate(RANGES)
    assert [len(panels) for panels in before] == [4, 4]  # alpha, q, az and the elevator, for either flight
    page.locator("#plot-0").scroll_into_view_if_needed()
    drag(page, "#plot-0", 0.25, 0.5)
    after = page.evaluate(RANGES)
    assert before[0][0][0] < after[0][0][0] < after[0][0][1] < before[0][0][1]
    assert all(panel == after[0][0] for panel in after[0])
    assert after[1] == before[1]
    assert page.heard == []
    page.context.close()


def test_a_phone_shows_all_of_it_without_sideways_scrolling(browser, report):
    phone = opened(browser, report, 390, is_mobile=True, has_touch=True)
    fits_a_phone(phone)
    assert phone.heard == []
    phone.context.close()
