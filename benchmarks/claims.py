"""What the documentation claims as rates, and the exact binomial bounds that `verify.py` holds counts against.

A claim is refuted where its rate lies outside the Clopper-Pearson limits of the count at `LEVEL`: exactly where the
exact binomial test of that rate, to the side from which the claim can fail, has a p-value below 1 - `LEVEL`.

Source: C. J. Clopper and E. S. Pearson, Biometrika 26, 1934, 404-413.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from scipy.stats import beta

LEVEL = 0.99
# Flights of one round, on which the claims are tried. Another simulator's records differ in length and rate: each
# compiles anew, and takes as long as the others together.
ROUND = {"silence": 3, "one": 3, "identify": 4, "unknown": 1, "other": 1, "other_silence": 1}


class Side(StrEnum):
    """How the true rate may differ from the claimed one."""

    AT_MOST = "at most"
    AT_LEAST = "at least"
    EQUAL = "equal to"


@dataclass(frozen=True)
class Claim:
    """The true rate of `text` is `side` `rate`; `key` is its column of the ledger."""

    key: str
    text: str
    side: Side
    rate: float

    def limits(self, hits: int, of: int) -> tuple[float, float]:
        """Exact limits of the true rate at `LEVEL`, given `hits` of `of` independent trials.

        One-sided (the other limit is 0 or 1) unless the claim is an equality; (0, 1) without trials.
        """
        tail = (1.0 - LEVEL) / (2.0 if self.side is Side.EQUAL else 1.0)
        low = float(beta.ppf(tail, hits, of - hits + 1)) if hits > 0 and self.side is not Side.AT_LEAST else 0.0
        high = float(beta.ppf(1.0 - tail, hits + 1, of - hits)) if hits < of and self.side is not Side.AT_MOST else 1.0
        return low, high

    def holds(self, hits: int, of: int) -> bool:
        """Whether the count is consistent with the claim."""
        low, high = self.limits(hits, of)
        return low <= self.rate <= high

    def bound(self, hits: int, of: int) -> str:
        """The limits in words of the ledger."""
        low, high = self.limits(hits, of)
        if self.side is Side.EQUAL:
            return f"{low:.4f} to {high:.4f}"
        return f">= {low:.4f}" if self.side is Side.AT_MOST else f"<= {high:.4f}"


# The rates are those that the documentation states or implies; benchmarks/README.md says where.
CLAIMS = (
    Claim("false_alarms", "nothing hidden: anything named or called unexplained", Side.AT_MOST, 0.05),
    Claim("named", "one effect of at least 6 standard errors: first or in the ambiguity set", Side.AT_LEAST, 0.97),
    Claim("size_held", "its 95 % interval holds its size", Side.AT_LEAST, 0.95),
    Claim("unexplained", "an effect of no catalogue: called unexplained", Side.AT_LEAST, 0.90),
    Claim("other_false_alarms", "another simulator's aircraft, nothing hidden: any finding", Side.AT_MOST, 0.05),
    Claim("other_named", "another simulator's aircraft, one effect: named first", Side.AT_LEAST, 0.95),
    Claim("other_size_held", "another simulator's aircraft: the 95 % interval holds the size", Side.AT_LEAST, 0.84),
    Claim("bound_held", "corrected 95 % bounds of identify hold a parameter drawn at random", Side.EQUAL, 0.95),
    Claim("posterior_held", "95 % posterior intervals of identify hold the same parameter", Side.EQUAL, 0.95),
)
