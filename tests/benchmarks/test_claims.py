"""Bounds of counts against SciPy's exact binomial test."""

from dataclasses import replace
from pathlib import Path

import pytest
from scipy.stats import binomtest
from verify import CLAIMS, LEVEL, Claim, Side

README = Path(__file__).parents[2] / "benchmarks" / "README.md"
COUNTS = [(0, 1), (1, 1), (0, 16), (3, 16), (5, 16), (16, 16), (7, 40), (191, 200), (200, 200)]
CLAIM = Claim("named", "", Side.AT_LEAST, 0.95)


@pytest.mark.parametrize(("hits", "of"), COUNTS)
@pytest.mark.parametrize(("side", "alternative"), [
    (Side.AT_MOST, "greater"), (Side.AT_LEAST, "less"), (Side.EQUAL, "two-sided"),
])  # fmt: skip
def test_limits_are_those_of_clopper_and_pearson(hits, of, side, alternative):
    exact = binomtest(hits, of, alternative=alternative).proportion_ci(LEVEL, method="exact")
    assert replace(CLAIM, side=side).limits(hits, of) == pytest.approx((exact.low, exact.high), abs=1e-12)


@pytest.mark.parametrize(("side", "alternative"), [(Side.AT_MOST, "greater"), (Side.AT_LEAST, "less")])
@pytest.mark.parametrize("rate", [0.05, 0.5, 0.95])
def test_a_claim_is_refuted_exactly_where_the_binomial_test_rejects_its_rate(side, alternative, rate):
    claim, verdicts = Claim("", "", side, rate), set()
    for of in (1, 4, 16, 60, 200):
        for hits in range(of + 1):
            rejected = binomtest(hits, of, rate, alternative=alternative).pvalue < 1.0 - LEVEL
            assert claim.holds(hits, of) is not rejected, (hits, of)
            verdicts.add(rejected)
    assert verdicts == {True, False}


def test_an_equality_is_refuted_on_both_sides():
    """Each tail has half of the level: binomial tails of 0.005 around 190 of 200."""
    claim = replace(CLAIM, side=Side.EQUAL)
    for hits in range(201):
        below, above = (binomtest(hits, 200, 0.95, alternative=tail).pvalue for tail in ("less", "greater"))
        assert claim.holds(hits, 200) == (min(below, above) >= 0.005), hits
    assert not claim.holds(200, 200)
    assert not claim.holds(180, 200)


def test_no_trials_refute_nothing_and_every_key_is_a_column_of_its_own():
    assert all(claim.limits(0, 0) == (0.0, 1.0) and claim.holds(0, 0) for claim in CLAIMS)
    assert len({claim.key for claim in CLAIMS}) == len(CLAIMS)


def test_the_documentation_lists_every_claim_with_its_rate():
    text = README.read_text(encoding="utf-8")
    table = {row[0]: row[-1] for row in (line.split(" | ") for line in text.splitlines()) if len(row) == 3}
    for claim in CLAIMS:
        assert table[f"| `{claim.key}`"] == f"{claim.side} {claim.rate:g} |"
