"""Figures of calibration and coverage studies say what they show, and flag what is outside."""

import numpy as np
import pytest
from calibration import DRAWS, band_of, rank_bands
from interval_coverage import LOOKS, METHODS, coverage_against_colour

from bayes_aero.report.style import save


def test_ranks_outside_their_band_are_said_to_be(tmp_path):
    rng = np.random.default_rng(0)
    even = list(map(int, rng.integers(0, DRAWS + 1, 200)))
    low = list(map(int, rng.integers(0, DRAWS // 2, 200)))
    figure = rank_bands({"CL0": band_of(even), "tau2": band_of(low)})
    assert [ax.get_title() for ax in figure.axes] == ["CL0", "tau2: outside"]
    assert save(figure, tmp_path / "ranks.png").stat().st_size > 5000


def test_coverage_shows_every_method_at_its_colour(tmp_path):
    points = {method: [(0.9, 0.5), (0.0, 0.95)] for method in METHODS}
    figure = coverage_against_colour({6.25: points, 25.0: points})
    left = figure.axes[0]
    assert [t.get_text() for t in left.get_xticklabels()] == ["0", "0.9"]
    lines = [line for line in left.get_lines() if len(line.get_xdata()) == 2 and line.get_label() in str(LOOKS)]
    assert len(lines) == len(METHODS)
    for line in lines:
        assert line.get_ydata() == pytest.approx([0.95, 0.5])
    assert "6.25 samples a second" in left.get_title()
    assert save(figure, tmp_path / "coverage.png").stat().st_size > 5000
