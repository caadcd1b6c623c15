"""Whether the posterior predicts what was measured: histograms of the probability integral transform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from bayes_aero.inference.identification import Identification
from bayes_aero.inference.posterior.pit import Histogram, histogram, neighbours, pit
from bayes_aero.model.density import Density
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, housed, panels
from bayes_aero.report.tables.comparison import chosen_posteriors, engine_label
from bayes_aero.report.text.phrases import several

SLIGHT = 0.1  # correlation of neighbours up to which the band's independence is near enough; our choice
CHANCE = 3.0  # deviations of the correlation of independent neighbours


@dataclass(frozen=True)
class Transformed:
    """Each coefficient's values (n,) by the first posterior under the chosen noise, their bars and correlation."""

    engine: str
    values: Float[np.ndarray, "n 3"]
    bars: tuple[Histogram, ...]
    correlation: tuple[float, ...]


def transformed(identification: Identification) -> Transformed:
    """The transform of a run's samples; without a posterior there is nothing to draw."""
    found = chosen_posteriors(identification)
    if not found:
        raise NotDrawn("no posterior was sampled")
    engine, posterior = next(iter(found.items()))
    noise = Noise(Colour(posterior.noise))
    density = Density.of(identification.observations, identification.model, noise, identification.mle.bias)
    order = [posterior.names.index(name) for name in density.names]
    values = pit(density, posterior.draws()[:, order])
    columns = [values[:, c] for c in range(len(NAMES))]
    start = np.asarray(density.observations.start)
    return Transformed(
        engine, values, tuple(map(histogram, columns)), tuple(neighbours(column, start) for column in columns)
    )


@housed
def pit_histogram(identification: Identification) -> Figure:
    """A panel for each coefficient: density of the values, and the band of independent uniform ones."""
    t = transformed(identification)
    figure, axes = panels(1, len(NAMES), (9.0, 3.2), sharex=True, sharey=True)
    for ax, name, bars, r in zip(axes[0], NAMES, t.bars, t.correlation, strict=True):
        ax.axhspan(bars.lower, bars.upper, color=COLOURS["prior"], alpha=0.5, lw=0.0, label="band of uniform values")
        ax.axhline(1.0, color=COLOURS["measured"], lw=0.8, ls=":")
        ax.stairs(bars.height, bars.edges, color=COLOURS["mle"], fill=True, alpha=0.45, label="measured samples")
        ax.stairs(bars.height, bars.edges, color=COLOURS["mle"])
        ax.set(title=f"{name}: neighbours correlate {r:+.2f}", xlim=(0.0, 1.0))
        ax.set_xlabel("probability of less than measured [-]")
    axes[0, 0].set_ylim(bottom=0.0)
    axes[0, 0].set_ylabel("density, 1 if calibrated [-]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    figure.suptitle(f"Where measurements fall in the {what_predicts(identification)} ({engine_label(t.engine)})")
    return figure


def what_predicts(identification: Identification) -> str:
    """The distribution that is asked, in a few words."""
    return "posterior predictive" if identification.noise is Colour.WHITE else "one-step-ahead posterior predictive"


def pit_words(identification: Identification) -> tuple[str, str]:
    """Caption and alternative text."""
    t = transformed(identification)
    told = several(f"{n} {r:+.2f}" for n, r in zip(NAMES, t.correlation, strict=True))
    if identification.noise is Colour.WHITE:
        how = "White noise predicts each sample by itself"
    else:
        how = "Each sample is predicted from those before it, so its error is an innovation of the noise model"
    outside = several(f"{b.outside} of {len(b.height)} ({n})" for n, b in zip(NAMES, t.bars, strict=True))
    return (
        "Probability that the posterior gives to less than what was measured: flat if the model is calibrated, "
        "∩-shaped if its intervals are mostly too wide (as where buffet enlarges one variance for all samples), "
        "∪-shaped if too narrow, sloped if it is biased. The parameters were fitted to the same samples. "
        f"{how}; neighbours correlate by {told}. {_independence(t)}",
        f"Histograms of the probability integral transform for CL, CD and Cm under the {what_predicts(identification)}."
        f" Bars outside the 95 % band of uniform values: {outside}. Lag-1 correlation of neighbours: {told}.",
    )


def _independence(t: Transformed) -> str:
    """Whether the band may be taken at its word."""
    limit = max(SLIGHT, CHANCE / np.sqrt(len(t.values)))
    coloured = [n for n, r in zip(NAMES, t.correlation, strict=True) if abs(r) > limit]
    if not coloured:
        return "That is near enough to independence for the band."
    return (
        f"The residuals of {several(coloured)} are coloured: the band takes samples as independent, so it is too "
        "narrow there if neighbours resemble each other, and bars outside it prove little."
    )


FIGURES = {"pit": pit_histogram}
