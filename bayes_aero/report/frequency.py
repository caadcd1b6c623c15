"""What the page of a fit to trajectories shows of the frequency domain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bayes_aero.diagnosis.result import CausesInBand, TrajectoryFit
from bayes_aero.inference.results import FrequencyFit
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.page import Block, Gallery, bullets
from bayes_aero.report.style import NotDrawn, housed, panels
from bayes_aero.report.tables.table import Column, Estimate, in_brackets
from bayes_aero.report.text.phrases import WORDS, several
from bayes_aero.units import number


def frequency_blocks(flown: TrajectoryFit, figures: Mapping[str, Path]) -> tuple[Block, ...]:
    """Estimates in the band and responses; nothing where no band was asked for."""
    if not flown.frequency:
        return ()
    coherent = several(f"{r.output} over {r.input} {np.median(r.coherence):.2f}" for r in flown.frequency_responses)
    gallery = Gallery(figures, {"bode": (WORDS["captions"]["bode"], f"Bode plots. Median coherence: {coherent}.")})
    said = [sentence for fit in flown.frequency for sentence in frequency_sentences(fit)]
    return (*bullets(said), *gallery("bode"))


# --- Estimates in the frequency domain: columns beside those of the time domain, and what is said of them.

LIMIT = 3.0  # standard errors of a difference from which two values differ


def band_text(fit: FrequencyFit | CausesInBand) -> str:
    """The band for people."""
    return f"{number(fit.band[0], 2)} to {number(fit.band[1], 2)} Hz"


def frequency_columns(names: Sequence[str], fit: FrequencyFit, head: str | None = None) -> list[Column]:
    """Estimates, both standard errors, and differences from the time domain; without `head` not on a terminal."""
    key = f"frequency_{fit.method.replace(' ', '_')}"
    group = f"{fit.method}, {band_text(fit)}"

    def of(sd: np.ndarray) -> list[Estimate | None]:
        found = {n: Estimate.normal(x, s) for n, x, s in zip(fit.names, fit.estimate, sd, strict=True)}
        return [found.get(name) for name in names]

    columns = [
        Column(of(fit.crb), (key, f"{key}_crb"), "Cramér–Rao", group=group),
        Column(of(fit.crb_corrected), ("", f"{key}_crb_corrected"), "corrected", head, "", in_brackets, group=group),
    ]
    if fit.apart:
        apart = [fit.apart.get(name) for name in names]
        columns.append(Column(apart, f"{key}_difference", "difference\n(standard errors)", "diff.", ".1f", group=group))
    return columns


def frequency_sentences(fit: FrequencyFit) -> tuple[str, ...]:
    """What drops out of a fit in a band, and whether it agrees with the time domain."""
    what = f"{fit.method.capitalize()} in the frequency domain, {band_text(fit)}, {fit.lines} frequencies"
    if not fit.converged:
        return (f"{what}: the parameters are not determined there; use a wider band.",)
    gone = f": {several(fit.unseen)} drop{'s' if len(fit.unseen) == 1 else ''} out with bias and drift"
    told = [f"{what}{gone if fit.unseen else ''}."]
    if fit.at_bound:
        told.append(f"In the band {several(fit.at_bound)} went to a bound and stayed there.")
    differ = [f"{name} ({number(x, 2)} standard errors)" for name, x in fit.apart.items() if x > LIMIT]
    if differ:
        told.append(f"Time and frequency domain differ on {several(differ)}: suspect drift or a slow model error.")
    elif fit.apart:
        worst = max(fit.apart, key=lambda name: fit.apart[name])
        told.append(f"Time and frequency domain agree within {number(fit.apart[worst], 2)} standard errors ({worst}).")
    return tuple(told)


# --- Frequency responses of a linear card.

BAND = 1.96  # standard errors
KNOWN = 0.3  # largest standard error, of the value, with which a measured response is shown
DECIBEL = 20.0 / math.log(10.0)  # of a relative change
MOST_RESPONSES = 8


@housed
def bode(found: TrajectoryFit) -> Figure:
    """Measured and modelled frequency responses: magnitude, phase, coherence; a column for each input and output."""
    if not found.frequency_responses:
        raise NotDrawn("no band was asked for")
    if len(found.frequency_responses) > MOST_RESPONSES:
        raise NotDrawn(f"more than {MOST_RESPONSES} responses")
    columns = len(found.frequency_responses)
    figure, axes = panels(3, columns, (2.6 * columns + 1.2, 5.6), sharex=True, sharey="row")
    for (magnitude, phase, coherence), one in zip(axes.T, found.frequency_responses, strict=True):
        f, seen = one.frequency, np.where(one.error < KNOWN * np.abs(one.measured), 1.0, np.nan)
        middle = np.rad2deg(np.unwrap(np.angle(one.modelled)))
        around = middle + np.angle(one.draws / one.modelled, deg=True)
        for axis, low, centre in (
            (magnitude, 20.0 * np.log10(np.abs(one.draws)), 20.0 * np.log10(np.abs(one.modelled))),
            (phase, around, middle),
        ):
            edges = np.percentile(low, [2.5, 97.5], axis=0)
            axis.fill_between(f, *edges, color=COLOURS["after"], alpha=0.25, linewidth=0.0)
            axis.plot(f, centre, color=COLOURS["after"], label="modelled, with 95 % band")
        dots = {"color": COLOURS["measured"], "linestyle": "none", "marker": "o", "markersize": 3.0, "elinewidth": 0.8}
        share = seen * BAND * one.error / np.abs(one.measured)
        magnitude.errorbar(f, seen * 20.0 * np.log10(np.abs(one.measured)), DECIBEL * share, **dots, label="measured")
        phase.errorbar(f, seen * middle + np.angle(one.measured / one.modelled, deg=True), np.rad2deg(share), **dots)
        coherence.plot(f, one.coherence, color=COLOURS["measured"])
        coherence.set_ylim(0.0, 1.05)
        coherence.set_xlabel("frequency [Hz]")
        magnitude.set_xscale("log")
        magnitude.set_title(f"{one.output} / {one.input}".replace(" and ", ",\n"), fontsize=8.5)
    for axis, label in zip(axes[:, 0], ("magnitude [dB, SI]", "phase [deg]", "coherence"), strict=True):
        axis.set_ylabel(label)
    axes[0][0].legend(loc="best", fontsize=7.0)
    return figure


FREQUENCY_FIGURES = {"bode": bode}
"""What a fit of trajectories shows of a band."""
