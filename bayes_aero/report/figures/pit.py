"""Calibration of predictions: histograms of the probability integral transform, and quantiles of innovations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectories.results import ProcessNoise
from bayes_aero.inference.identification import Identification, PitResult
from bayes_aero.model.noise import Colour
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, grid_of, housed
from bayes_aero.report.tables.comparison import engine_label
from bayes_aero.report.tables.filtered import CALIBRATION
from bayes_aero.report.text.phrases import SYMBOLS, several

SLIGHT = 0.1  # correlation of neighbours up to which the band's independence is near enough; our choice
CHANCE = 3.0  # deviations of the correlation of independent neighbours


@housed
def pit_histogram(identification: Identification) -> Figure:
    """A panel for each coefficient: density of the values, and the band of independent uniform ones."""
    t = identification.pit
    if t is None:
        raise NotDrawn("no posterior was sampled")
    names = identification.observations.coefficients
    figure, axes = grid_of(len(names), 3, (3.0, 3.2), sharex=True, sharey=True)
    for ax, name, bars, r in zip(axes, names, t.bars, t.correlation, strict=True):
        ax.axhspan(bars.lower, bars.upper, color=COLOURS["prior"], alpha=0.5, lw=0.0, label="band of uniform values")
        ax.axhline(1.0, color=COLOURS["measured"], lw=0.8, ls=":")
        ax.stairs(bars.height, bars.edges, color=COLOURS["mle"], fill=True, alpha=0.45, label="measured samples")
        ax.stairs(bars.height, bars.edges, color=COLOURS["mle"])
        ax.set(title=f"{name}: neighbours correlate {r:+.2f}", xlim=(0.0, 1.0))
        ax.set_xlabel("probability of less than measured [-]")
    axes[0].set_ylim(bottom=0.0)
    axes[0].set_ylabel("density, 1 if calibrated [-]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    figure.suptitle(f"Where measurements fall in the {what_predicts(identification)} ({engine_label(t.engine)})")
    return figure


@housed
def one_step_quantiles(found: ProcessNoise) -> Figure:
    """A panel for each output, and one for all together: quantiles of innovations over those of calibrated ones.

    Raises:
        NotDrawn: the fit did not converge.
    """
    if found.one_step is None:
        raise NotDrawn("the fit with process noise did not converge")
    shown = dict(found.one_step.outputs)
    shown |= {"all together": found.one_step.together} if len(shown) > 1 else {}
    figure, axes = grid_of(len(shown), 4, (2.4, 2.5), sharex=True, sharey=True)
    for ax, (name, one) in zip(axes, shown.items(), strict=True):
        score, value, low, high = one.quantiles.T
        ax.fill_between(score, low, high, color=COLOURS["prior"], alpha=0.5, lw=0.0, label="its 95 % band")
        ax.plot(score, score, color=COLOURS["measured"], lw=0.8, ls=":", label="calibrated")
        ax.plot(score, value, color=COLOURS["after"], marker="o", ms=3.0, label="innovations")
        ax.set_title(f"{SYMBOLS.get(name, name)}: {CALIBRATION[one.calibration]}")
    for ax in axes[-4:]:
        ax.set_xlabel("standard normal [-]")
        ax.tick_params(labelbottom=True)
    for ax in axes[::4]:
        ax.set_ylabel("innovation / predicted sd [-]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    figure.suptitle("Quantiles of innovations, predicted one step ahead")
    return figure


def what_predicts(identification: Identification) -> str:
    """The predictive distribution, in a few words."""
    return "posterior predictive" if identification.noise is Colour.WHITE else "one-step-ahead posterior predictive"


def pit_words(identification: Identification) -> tuple[str, str]:
    """Caption and alternative text of `pit_histogram`."""
    t = identification.pit
    assert t is not None, "the figure was drawn"
    names = identification.observations.coefficients
    listed = several(f"{n} {r:+.2f}" for n, r in zip(names, t.correlation, strict=True))
    if identification.noise is Colour.WHITE:
        how = "White noise predicts each sample by itself"
    else:
        how = "Each sample is predicted from those before it, so its error is an innovation of the noise model"
    outside = several(f"{b.outside} of {len(b.height)} ({n})" for n, b in zip(names, t.bars, strict=True))
    return (
        "Probability that the posterior gives to less than what was measured: flat if the model is calibrated, "
        "∩-shaped if its intervals are mostly too wide (as where buffet enlarges one variance for all samples), "
        "∪-shaped if too narrow, sloped if it is biased. The parameters were fitted to the same samples. "
        f"{how}; neighbours correlate by {listed}. {_independence(t, names)}",
        f"Histograms of the probability integral transform for {several(names)} under the "
        f"{what_predicts(identification)}. Bars outside the 95 % band of uniform values: {outside}. "
        f"Lag-1 correlation of neighbours: {listed}.",
    )


def _independence(t: PitResult, names: Sequence[str]) -> str:
    """Whether neighbours are independent, as the band assumes."""
    limit = max(SLIGHT, CHANCE / np.sqrt(len(t.values)))
    coloured = [n for n, r in zip(names, t.correlation, strict=True) if abs(r) > limit]
    if not coloured:
        return "That is near enough to independence for the band."
    return (
        f"The residuals of {several(coloured)} are coloured: the band takes samples as independent, so it is too "
        "narrow there if neighbours resemble each other, and bars outside it prove little."
    )


FIGURES = {"pit": pit_histogram}
