"""The page of a study in a real browser."""

from __future__ import annotations

import pytest
from browsing import can_be_read_by_everyone, fits_a_phone, needed, opened, says_in_words_what_figures_show
from study_samples import told

from bayes_aero.report.html.page import write_page
from bayes_aero.report.pages.study import study_page

pytestmark = needed


@pytest.mark.parametrize("width", [1280, 390])
def test_it_is_silent_and_legible_on_a_desk_and_on_a_phone(browser, tmp_path, width):
    report = write_page(study_page(told(tmp_path, failed=(2,))), tmp_path / "report.html")
    page = opened(browser, report, width, is_mobile=width < 400)
    says_in_words_what_figures_show(page, 1)
    can_be_read_by_everyone(page)
    if width < 400:
        fits_a_phone(page)
    assert page.heard == []
    page.context.close()
