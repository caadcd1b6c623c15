"""What a diagnosis page shows of the next flight test, and of the causes in a band of frequencies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bayes_aero.diagnosis.in_band.result import CausesInBand
from bayes_aero.report.design.in_band import in_band_sentences, in_band_table
from bayes_aero.report.design.points import points_sentences, points_table
from bayes_aero.report.html.page import Block
from bayes_aero.report.html.page_table import page_table
from bayes_aero.report.html.parts import bullets


def test_point_blocks(told: Mapping[str, Any]) -> Iterator[Block]:
    """What to fly next."""
    yield from bullets(points_sentences(told))
    if told and told["points"]:
        yield page_table(points_table(told))


def in_band_blocks(found: CausesInBand | None) -> tuple[Block, ...]:
    """The third witness: sizes in a band of frequencies."""
    table = (page_table(in_band_table(found)),) if found is not None and found.sizes else ()
    return (*bullets(in_band_sentences(found)), *table)
