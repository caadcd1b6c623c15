"""Coverage: the share of true values inside 95 % intervals, against the autocorrelation of the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import housed, panels

LOOKS = {
    "CRB": ("Cramér–Rao", COLOURS["crb"], "o"),
    "corrected CRB": ("Cramér–Rao, corrected", COLOURS["crb_corrected"], "s"),
    "white posterior": ("posterior, white noise", COLOURS["white"], "v"),
    "AR(1) posterior": ("posterior, AR(1) noise", COLOURS["emcee"], "D"),
}


@housed
def coverage_against_colour(shares: Mapping[float, Mapping[str, Sequence[tuple[float, float]]]]) -> Figure:
    """`shares[rate][method]` holds (lag-1 correlation, share covered); one panel for each sample rate in Hz."""
    figure, axes = panels(1, len(shares), (4.6 * len(shares), 3.9), sharey=True)
    for ax, (rate, methods) in zip(axes[0], shares.items(), strict=True):
        ax.axhline(0.95, color=COLOURS["measured"], lw=0.8, ls=":")
        for method, points in methods.items():
            label, colour, marker = LOOKS[method]
            rho, share = np.array(sorted(points)).T
            ax.plot(range(len(rho)), share, marker=marker, color=colour, label=label)
            ax.set_xticks(range(len(rho)), [f"{r:.3g}" for r in rho])
        ax.set(xlabel="noise: correlation of neighbouring samples [-]", title=f"{rate:.3g} samples a second")
        ax.set_ylim(0.0, 1.02)
    axes[0, 0].set_ylabel("truths inside 95 % intervals [-]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure
