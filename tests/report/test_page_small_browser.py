"""The pages of the catalogue and of a starter card in a real browser."""

from __future__ import annotations

import numpy as np
import pytest
from browsing import LABELS, can_be_read_by_everyone, fits_a_phone, has_a_unit_on_every_axis, needed, opened

from bayes_aero.flight.card.card import read_card
from bayes_aero.jobs.catalogue.catalogue_page import write_effects
from bayes_aero.jobs.catalogue.known_effects import effect_facts, known_effects
from bayes_aero.jobs.provenance.provenance import provenance
from bayes_aero.report.html.page import write_page
from bayes_aero.report.pages.card import Rest, StarterView, Taken, card_page

pytestmark = needed


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory):
    card = read_card("attas")
    found = [effect_facts(effect, card) for effect in known_effects(card).values()]
    out = tmp_path_factory.mktemp("catalogue")
    assert write_effects(found, "effects", card, out) == ()
    return out / "report.html"


@pytest.fixture(scope="module")
def starter(tmp_path_factory):
    time = np.arange(0.0, 40.0, 0.04)
    taken = [
        Taken("time", "'Time_s'", "s", 1, "the heading", time),
        Taken("alpha", "'AOA_deg'", "deg", 1, "the heading", 5.0 + np.sin(time)),
        Taken("az", "'A_COLUMN_WITH_A_LONG_NAME_<i>'", "g", -1, "its median is 0.999", 1.0 + 0.1 * np.sin(time)),
        Taken("thrust", "'FN'", None, 1, "the heading; " * 9, 900.0 + time, "1 to 9 N is beyond any flight"),
    ]
    view = StarterView("N1.csv", "N1.toml", time, taken, [Rest("'XYZZY'", None, time)], [("mass", "of the flight")])
    return write_page(card_page(view, provenance(None, [], None, {})), tmp_path_factory.mktemp("card") / "report.html")


@pytest.fixture(scope="module")
def untimed(tmp_path_factory):
    """No time was recognised, and one column is shorter than the others."""
    values = np.sin(np.arange(500) / 20.0)
    taken = [Taken("alpha", "'AOA_deg'", "deg", 1, "the heading", values)]
    view = StarterView("N1.csv", "N1.toml", None, taken, [Rest("'T'", None, values[:9])], [("time", "not found")])
    path = tmp_path_factory.mktemp("untimed") / "report.html"
    return write_page(card_page(view, provenance(None, [], None, {})), path)


def test_without_a_time_columns_are_drawn_over_the_number_of_the_sample(browser, untimed):
    page = opened(browser, untimed)
    assert page.heard == []
    named, rest = page.evaluate(LABELS)
    assert named == [["alpha [deg]", "number of the sample [-]"]]
    assert rest[0][1] == "number of the sample [-]"
    assert "over 499 samples" in page.locator("[role=img]").first.get_attribute("aria-label")


@pytest.mark.parametrize("name", ["catalogue", "starter"])
def test_it_is_legible_everywhere_and_calls_nobody(request, browser, name):
    report = request.getfixturevalue(name)
    page, phone = opened(browser, report), opened(browser, report, 390)
    assert page.heard == []
    can_be_read_by_everyone(page)
    assert page.locator(".box.wider").count() == 0
    fits_a_phone(phone)
    if name == "starter":
        has_a_unit_on_every_axis(page)
        assert page.locator("[data-plot]").count() == 2
