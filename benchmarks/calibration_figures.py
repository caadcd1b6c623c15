"""Calibration of posteriors: the ranks' distribution function against the uniform one, parameter by parameter."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure
from ranks import Band

from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import grid_of, housed


@housed
def rank_bands(bands: Mapping[str, Band]) -> Figure:
    """ECDF difference of each parameter's ranks with its simultaneous 95 % band; orange where it leaves the band."""
    figure, axes = grid_of(len(bands), 5, (2.4, 1.7), sharex=True, sharey=True)
    for ax, (name, band) in zip(axes, bands.items(), strict=True):
        colour = COLOURS["mle"] if band.inside else COLOURS["gpr"]
        ax.fill_between(band.at, band.lower, band.upper, color=COLOURS["prior"], alpha=0.5, linewidth=0)
        ax.step(band.at, band.difference, where="post", color=colour)
        ax.set_title(name if band.inside else f"{name}: outside")
        ax.label_outer()
    figure.supxlabel("rank of the truth among posterior draws, as a share [-]")
    figure.supylabel("ECDF minus uniform [-]")
    return figure
