"""Where windows of a manoeuvre begin."""

from __future__ import annotations

SHORTEST = 0.5  # of a window: a shorter rest at the end of a manoeuvre joins the window before it


def cuts_of(samples: int, dt: float, window: float | None) -> list[int]:
    """Where windows of about `window` s (None: all) of a manoeuvre of so many samples begin."""
    length = samples if window is None else max(2, round(window / dt))
    cuts = list(range(0, samples, length))
    if len(cuts) > 1 and samples - cuts[-1] < SHORTEST * length:
        cuts.pop()
    return cuts
