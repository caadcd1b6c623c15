"""The seed paper's figures without time: measured against predicted, and the stall hysteresis."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_aero.inference.identification import Identification
from bayes_aero.inference.scores import score
from bayes_aero.physics.coefficient_names import LATERAL
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.time_histories import of_coefficient
from bayes_aero.report.style import NotDrawn, column_width, housed, panels, refuse_many
from bayes_aero.report.tables.predictions import predicted, what_is_shown


def _correlation(identification: Identification, name: str) -> Figure:
    """Measured against predicted on the same points: maximum likelihood and GPR side by side, on one scale."""
    points = predicted(identification, name)
    pairs = [("Maximum likelihood", COLOURS["mle"], points.mle)]
    if points.gp is not None:
        pairs.append(("Gaussian-process regression", COLOURS["gpr"], points.gp))
    size = (4.9 * len(pairs) + 0.2, 5.75)
    figure, axes = panels(1, len(pairs), size, sharex=True, sharey=True)
    both = np.concatenate([points.measured, *(values for _, _, values in pairs)])
    ends = np.array([both.min(), both.max()]) + 0.03 * np.ptp(both) * np.array([-1.0, 1.0])
    for ax, (title, colour, values) in zip(axes[0], pairs, strict=True):
        found = score(points.measured, values)
        ax.plot(ends, ends, color="#555555", lw=0.9, zorder=1)
        ax.scatter(points.measured, values, s=7, color=colour, alpha=0.45, linewidths=0, zorder=2)
        ax.set(xlim=ends, ylim=ends, box_aspect=1.0, xlabel=f"measured {name} [-]", title=title)
        text = f"r = {found.r:.4f}\nRMSE = {found.rmse:.5f}\nn = {len(values)}"
        ax.text(0.04, 0.96, text, transform=ax.transAxes, va="top", linespacing=1.4)
    axes[0, 0].set_ylabel(f"predicted {name} [-]")
    figure.suptitle(f"{name}, measured against predicted:\n{what_is_shown(identification)}")
    return figure


@housed
def hysteresis(identification: Identification) -> Figure:
    """CL against angle of attack, rising and falling separate: measured, maximum likelihood, GPR."""
    o = identification.observations
    if "CL" not in o.coefficients:
        raise NotDrawn("the model has no CL")
    points = predicted(identification, "CL")
    everything = np.arange(o.n)
    sources = [("measured", everything, np.asarray(o.measured)[:, o.coefficients.index("CL")])]
    sources.append(("maximum likelihood", points.index, points.mle))
    if points.gp is not None:
        sources.append(("GPR", points.index, points.gp))
    rows = len(o.names)
    refuse_many(rows)
    size = (4.4 * len(sources), min(3.6, 0.8 * column_width(rows)) * rows + 0.9)
    figure, axes = panels(rows, len(sources), size, sharex=True, sharey=True)
    for number, row in enumerate(axes):
        for ax, (title, index, values) in zip(row, sources, strict=True):
            mine = o.manoeuvre[index] == number
            _loop(ax, identification, index[mine], values[mine])
            ax.set_title(f"{o.names[number]}, {title}")
        row[0].set_ylabel("CL [-]")
    for ax in axes[-1]:
        ax.set_xlabel("α [deg]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, markerscale=4)
    figure.suptitle(f"Stall hysteresis CL(α): {what_is_shown(identification)}")
    return figure


def _loop(ax: Axes, identification: Identification, index: np.ndarray, values: np.ndarray) -> None:
    signals = identification.observations.signals
    alpha = np.rad2deg(np.asarray(signals["alpha"])[index])
    rising = np.asarray(signals["alpha_dot"])[index] > 0.0
    for key, mask in (("rising", rising), ("falling", ~rising)):
        ax.plot(alpha[mask], values[mask], ".", ms=2.0, color=COLOURS[key], alpha=0.7, label=f"α {key}")


FIGURES = {
    "fig4_correlation_CL": of_coefficient(_correlation, "CL"),
    "fig5_stall_hysteresis": hysteresis,
    "fig7_correlation_CD": of_coefficient(_correlation, "CD"),
    "fig9_correlation_Cm": of_coefficient(_correlation, "Cm"),
    **{f"correlation_{name}": of_coefficient(_correlation, name) for name in LATERAL},
}
