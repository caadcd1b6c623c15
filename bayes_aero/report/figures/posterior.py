"""Figures of the posterior: mixing and shape, calibration of predictions, measured against predicted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import arviz_base as azb
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from bayes_aero.inference.results import score
from bayes_aero.model.observations import Colour
from bayes_aero.physics.aircraft import LATERAL
from bayes_aero.report import style
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.time_histories import of_coefficient, predicted, what_is_shown
from bayes_aero.report.pages import estimates as comparison
from bayes_aero.report.pages.estimates import chosen_posteriors, engine_label, noise_label, ordered, unit_of
from bayes_aero.report.phrases import GREEK, WORDS, bracket, plus_minus, several
from bayes_aero.report.table import NORMAL95, Estimate

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import ProcessNoise
    from bayes_aero.inference.results import Identification, Posterior

TRACE_DRAWS = 1000  # per chain: more draws than a panel has pixels only cost time
RANK_DRAWS = 250  # per chain: the band is found by simulation, whose time grows with it
PAIR_DRAWS = 400  # per chain
MOST_PAIRED = 6  # parameters of a figure that chooses them
CHAIN_COLOURS = ["#0072B2", "#E69F00", "#009E73", "#CC79A7"]


def _thinned(posterior: Posterior, names: list[str], most: int) -> xr.DataTree:
    """The posterior group with draws of `names`, thinned evenly to at most `most` a chain."""
    dataset = posterior.tree["posterior"].to_dataset()[names]
    thin = dataset.isel(draw=slice(None, None, max(1, -(-dataset.sizes["draw"] // most))))
    values = {name: np.asarray(thin[name].transpose("chain", "draw")) for name in names}
    return azb.from_dict({"posterior": values})


def _draw(kind: str, tree: xr.DataTree, size: tuple[float, float], **options: Any) -> Figure:
    """Call arviz_plots' plot `kind` and take its figure out of pyplot."""
    with style.quiet_pyplot():
        plots = style.arviz_plots()
        layout = {"figsize": size, "figsize_units": "inches"}
        collection = getattr(plots, f"plot_{kind}")(tree, backend="matplotlib", figure_kwargs=layout, **options)
        figure = collection.get_viz("figure")
        figure.set_layout_engine(style.MeasuredOnce())
        style.close(figure)
    return figure


def _title(identification: Identification, engine: str, what: str) -> str:
    p = identification.posteriors[engine]
    worst_rhat = max(m.rhat for m in p.marginals.values())
    worst_ess = min(m.ess_bulk for m in p.marginals.values())
    return (
        f"{what}: {engine_label(engine)}, {noise_label(p.noise)} noise, {p.status.name.lower().replace('_', ' ')} "
        f"(worst R-hat {worst_rhat:.3f}, smallest bulk ESS {worst_ess:.0f})"
    )


def _chains(kind: str, engine: str) -> style.Drawing:
    """The plot of `arviz_plots` of every parameter's chains by an engine: traces, or ranks (ECDF less uniform)."""

    def drawn(identification: Identification) -> Figure:
        if engine not in identification.posteriors:
            raise style.NotDrawn(f"this run has no posterior by {engine_label(engine)}")
        posterior = identification.posteriors[engine]
        names, sizes = ordered(posterior.names, identification.mle.parameters), posterior.tree["posterior"].sizes
        size = 3.7 * min(len(names), 4), 2.1 * -(-len(names) // 4) + 0.6
        if kind == "trace":
            tree = _thinned(posterior, names, TRACE_DRAWS)
            how = {"trace": {"alpha": 0.6, "width": 0.4}, "xlabel": False, "ticklabels": False, "title": False}
            figure = _draw("trace", tree, size, col_wrap=4, aes={"color": ["chain"]}, color=CHAIN_COLOURS, visuals=how)
            thinned = ", thinned [-]" if tree["posterior"].sizes["draw"] < sizes["draw"] else " [-]"
            below, title = ("draw, walkers end to end" if engine == "emcee" else "draw") + thinned, "Trace"
        else:
            independent = min(m.ess_bulk for m in posterior.marginals.values())
            tree = _thinned(posterior, names, min(RANK_DRAWS, max(50, int(independent / sizes["chain"]))))
            figure = _draw("rank", tree, size, col_wrap=4, color=CHAIN_COLOURS, visuals={"xlabel": False})
            below, title = "fractional rank [-]", "Rank"
        for number, (ax, name) in enumerate(zip([ax for ax in figure.axes if ax.has_data()], names, strict=True)):
            if kind == "trace":
                ax.set_ylabel(f"{name} {bracket(unit_of(identification, name))}")
            else:
                ax.set_title(name)
                ax.set_ylabel("Δ ECDF [-]" if number % 4 == 0 else "")
            if number >= len(names) - 4:
                ax.set_xlabel(below)
        band = "\nthinned to independent draws; band: 99 % for chains that agree" if kind == "rank" else ""
        figure.suptitle(_title(identification, engine, title) + band)
        return figure

    return style.housed(drawn)


@style.housed
def pair(identification: Identification) -> Figure:
    """Scatter of the model's parameters against each other, marginals on the diagonal, by the first engine there is."""
    engines = chosen_posteriors(identification)
    if not engines:
        raise style.NotDrawn("this run has no posterior")
    engine, posterior = next(iter(engines.items()))
    names = ordered((n for n in posterior.names if n in identification.mle.names), identification.mle.parameters)
    if len(names) < 2:
        raise style.NotDrawn("a pair plot needs two parameters")
    figure = _pair(engine, posterior, names)
    places = [(row, column) for row in range(len(names)) for column in range(row + 1)]
    labels = [f"{name} {bracket(unit_of(identification, name))}" for name in names]
    for ax, (row, column) in zip(figure.axes, places, strict=True):  # a lower triangle, named on its outer axes
        last = row == len(names) - 1
        ax.locator_params(nbins=3)
        ax.tick_params(labelbottom=last, labelleft=column == 0 and row > 0)
        if row == column:
            ax.set_yticks([])
        ax.set_xlabel(labels[column] if last else "")
        ax.set_ylabel(("density" if row == 0 else labels[row]) if column == 0 else "")
    figure.suptitle(_title(identification, engine, "Posterior of the model's parameters"))
    return figure


@style.housed
def pair_of(posteriors: Mapping[str, Posterior]) -> Figure:
    """The same of a fit with process noise, by the first sampler: the parameters that vary together the most."""
    if not posteriors:
        raise style.NotDrawn("there is no posterior")
    engine, posterior = next(iter(posteriors.items()))
    figure = _pair(engine, posterior, posterior.most_correlated(MOST_PAIRED))
    figure.suptitle(
        f"Posterior with process noise by {engine_label(engine)}: the parameters of the largest correlations"
    )
    return figure


def _pair(engine: str, posterior: Posterior, names: list[str]) -> Figure:
    """A matrix of panels without the empty ones."""
    side = 1.15 * len(names) + 1.0
    look = {"alpha": 0.25, "size": 3.0, "color": COLOURS.get(engine, COLOURS["mle"]), "edgecolor": "none"}
    tree = _thinned(posterior, names, PAIR_DRAWS)
    figure = _draw("pair", tree, (side, side), visuals={"scatter": look, "dist": {"color": look["color"]}})
    for ax in [ax for ax in figure.axes if not ax.has_data()]:
        ax.remove()
    return figure


# --- Calibration of predictions: histograms of the probability integral transform, and quantiles of innovations.

SLIGHT = 0.1  # correlation of neighbours up to which the band's independence is near enough; our choice
CHANCE = 3.0  # deviations of the correlation of independent neighbours


@style.housed
def pit_histogram(identification: Identification) -> Figure:
    """A panel for each coefficient: density of the values, and the band of independent uniform ones."""
    t = identification.pit
    if t is None:
        raise style.NotDrawn("no posterior was sampled")
    names = identification.observations.coefficients
    figure, axes = style.grid_of(len(names), 3, (3.0, 3.2), sharex=True, sharey=True)
    for ax, name, bars, r in zip(axes, names, t.bars, t.correlation, strict=True):
        ax.axhspan(bars.lower, bars.upper, color=COLOURS["prior"], alpha=0.5, lw=0.0, label="band of uniform values")
        ax.axhline(1.0, color=COLOURS["measured"], lw=0.8, ls=":")
        ax.stairs(bars.height, bars.edges, color=COLOURS["mle"], fill=True, alpha=0.45, label="measured samples")
        ax.stairs(bars.height, bars.edges, color=COLOURS["mle"])
        ax.set(title=f"{name}: neighbours correlate {r:+.2f}", xlim=(0.0, 1.0))
        ax.set_xlabel("probability of less than measured [-]")
    axes[0].set_ylim(bottom=0.0)
    axes[0].set_ylabel("density, 1 if calibrated [-]")
    style.legend_below(figure, axes[0], 2)
    figure.suptitle(f"Where measurements fall in the {what_predicts(identification)} ({engine_label(t.engine)})")
    return figure


@style.housed
def one_step_quantiles(found: ProcessNoise) -> Figure:
    """A panel for each output, and one for all together: quantiles of innovations over those of calibrated ones."""
    if found.one_step is None:
        raise style.NotDrawn("the fit with process noise did not converge")
    shown = dict(found.one_step.outputs)
    shown |= {"all together": found.one_step.together} if len(shown) > 1 else {}
    figure, axes = style.grid_of(len(shown), 4, (2.4, 2.5), sharex=True, sharey=True)
    for ax, (name, one) in zip(axes, shown.items(), strict=True):
        score, value, low, high = one.quantiles.T
        ax.fill_between(score, low, high, color=COLOURS["prior"], alpha=0.5, lw=0.0, label="its 95 % band")
        ax.plot(score, score, color=COLOURS["measured"], lw=0.8, ls=":", label="calibrated")
        ax.plot(score, value, color=COLOURS["after"], marker="o", ms=3.0, label="innovations")
        ax.set_title(f"{GREEK.get(name, name)}: {one.calibration.value.replace('_', ' ')}")
    for ax in axes[-4:]:
        ax.set_xlabel("standard normal [-]")
        ax.tick_params(labelbottom=True)
    for ax in axes[::4]:
        ax.set_ylabel("innovation / predicted sd [-]")
    style.legend_below(figure, axes[0], 3)
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
    limit = max(SLIGHT, CHANCE / np.sqrt(len(t.values)))
    coloured = [n for n, r in zip(names, t.correlation, strict=True) if abs(r) > limit]
    independence = "That is near enough to independence for the band."
    if coloured:
        independence = (
            f"The residuals of {several(coloured)} are coloured: the band takes samples as independent, so it is too "
            "narrow there if neighbours resemble each other, and bars outside it prove little."
        )
    listed = several(f"{n} {r:+.2f}" for n, r in zip(names, t.correlation, strict=True))
    if identification.noise is Colour.WHITE:
        how = "White noise predicts each sample by itself"
    else:
        how = "Each sample is predicted from those before it, so its error is an innovation of the noise model"
    outside = several(f"{b.outside} of {len(b.height)} ({n})" for n, b in zip(names, t.bars, strict=True))
    return (
        f"{WORDS['captions']['pit']} {how}; neighbours correlate by {listed}. {independence}",
        f"Histograms of the probability integral transform for {several(names)} under the "
        f"{what_predicts(identification)}. Bars outside the 95 % band of uniform values: {outside}. "
        f"Lag-1 correlation of neighbours: {listed}.",
    )


# --- The seed paper's figures without time: measured against predicted, and the stall hysteresis.


def _correlation(identification: Identification, name: str) -> Figure:
    """Measured against predicted on the same points: maximum likelihood and GPR side by side, on one scale."""
    points = predicted(identification, name)
    pairs = [("Maximum likelihood", COLOURS["mle"], points.mle)]
    if points.gp is not None:
        pairs.append(("Gaussian-process regression", COLOURS["gpr"], points.gp))
    size = (4.9 * len(pairs) + 0.2, 5.75)
    figure, axes = style.panels(1, len(pairs), size, sharex=True, sharey=True)
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


@style.housed
def hysteresis(identification: Identification) -> Figure:
    """CL against angle of attack, rising and falling separate: measured, maximum likelihood, GPR."""
    o = identification.observations
    if "CL" not in o.coefficients:
        raise style.NotDrawn("the model has no CL")
    points = predicted(identification, "CL")
    alpha, rising = np.rad2deg(np.asarray(o.signals["alpha"])), np.asarray(o.signals["alpha_dot"]) > 0.0
    sources = [("measured", np.arange(o.n), np.asarray(o.measured)[:, o.coefficients.index("CL")])]
    sources.append(("maximum likelihood", points.index, points.mle))
    if points.gp is not None:
        sources.append(("GPR", points.index, points.gp))
    rows = len(o.names)
    style.refuse_many(rows)
    size = (4.4 * len(sources), min(3.6, 0.8 * style.column_width(rows)) * rows + 0.9)
    figure, axes = style.panels(rows, len(sources), size, sharex=True, sharey=True)
    for number, row in enumerate(axes):
        for ax, (title, index, values) in zip(row, sources, strict=True):
            mine = o.manoeuvre[index] == number
            for key, way in (("rising", rising[index]), ("falling", ~rising[index])):
                x, y = alpha[index][mine & way], values[mine & way]
                ax.plot(x, y, ".", ms=2.0, color=COLOURS[key], alpha=0.7, label=f"α {key}")
            ax.set_title(f"{o.names[number]}, {title}")
        row[0].set_ylabel("CL [-]")
    for ax in axes[-1]:
        ax.set_xlabel("α [deg]")
    style.legend_below(figure, axes[0, 0], 2, markerscale=4)
    figure.suptitle(f"Stall hysteresis CL(α): {what_is_shown(identification)}")
    return figure


# --- Bounds and credible intervals: forest plots, and every standard error as a multiple of the Cramer-Rao bound.

GREY = "#555555"  # of what has no colour of its own
MARKERS = {"crb": "|", "crb_corrected": "s", "white": "D", "emcee": "o", "nuts": "^", "scatter": "*"}


@dataclass(frozen=True)
class ForestLine:
    """One line of a forest panel: an estimate; `inner` is half of a narrower interval, drawn thick."""

    label: str
    colour: str
    estimate: Estimate
    inner: float | None = None


@style.housed
def forest(identification: Identification) -> Figure:
    """Every parameter by every method, with 95 % intervals and numbers; one panel per parameter, in its own unit."""
    table = {}
    for name in ordered(identification.mle.names, identification.mle.parameters):
        found = [(m, m.estimates[name]) for m in comparison.methods(identification) if name in m.estimates]
        table[name] = [ForestLine(m.label, COLOURS.get(m.key, GREY), e) for m, e in found if np.isfinite(e.sd)]
        for manoeuvre, (x, crb, corrected) in comparison.alone(identification, name).items():
            estimate, label = Estimate.normal(x, corrected), f"{manoeuvre} alone, ML"
            table[name].append(ForestLine(label, COLOURS["alone"], estimate, NORMAL95 * crb))
    return _forest(
        identification,
        table,
        "Estimates with 95 % intervals, and estimate ± standard deviation\n"
        "one manoeuvre alone: thick Cramér-Rao, thin corrected bound (the number's ±)",
    )


@style.housed
def next_flight(identification: Identification) -> Figure:
    """Joint fit, manoeuvres alone and pooled, aircraft and next flight, with 95 % intervals; a panel a parameter."""
    found, mle = identification.next_flight, identification.mle
    if found is None:
        raise style.NotDrawn("the manoeuvres were not pooled; ask for the next flight")
    if len(found.manoeuvres) > style.MOST_MANOEUVRES:
        raise style.NotDrawn(f"there are more than {style.MOST_MANOEUVRES} manoeuvres")
    table, bound = {}, comparison.bounds(mle, mle.crb_corrected)
    for name in ordered(found.aircraft, found.parameters):
        joint = bound[name]
        rows = [ForestLine("joint fit", COLOURS["mle"], joint)] if np.isfinite(joint.sd) else []
        for m in found.manoeuvres:
            if name in found.alone[m]:
                rows.append(ForestLine(f"{m} alone", COLOURS["prior"], Estimate.normal(*found.alone[m][name])))
            rows.append(ForestLine(f"{m} pooled", COLOURS["alone"], Estimate.of(found.pooled[m][name])))
        rows.append(ForestLine("aircraft", COLOURS["nuts"], Estimate.of(found.aircraft[name])))
        table[name] = [*rows, ForestLine("next flight", COLOURS["scatter"], Estimate.of(found.following[name]))]
    title = "Manoeuvres alone and pooled, and the next flight\n95 % intervals; numbers: ± standard deviation"
    return _forest(identification, table, title)


def _forest(identification: Identification, table: dict[str, list[ForestLine]], title: str) -> Figure:
    """A panel for each parameter with a line for each of its intervals."""
    labels = list(dict.fromkeys(row.label for rows in table.values() for row in rows))
    columns = min(2, len(table))  # three would not be legible on a page
    figure, axes = style.grid_of(len(table), columns, (5.4, 0.2 * len(labels) + 0.85))
    for number, (ax, (name, rows)) in enumerate(zip(axes, table.items(), strict=True)):
        for row in rows:
            y, (x, sd, low, high), colour = labels.index(row.label), row.estimate, row.colour
            ax.plot([low, high], [y, y], color=colour, lw=1.6, solid_capstyle="butt")
            if row.inner is not None:
                ax.plot([x - row.inner, x + row.inner], [y, y], color=colour, lw=4.0, alpha=0.6)
            ax.plot(x, y, "o", ms=4.0, color=colour, mec="white", mew=0.5)
            beside = {"transform": ax.get_yaxis_transform(), "va": "center", "fontsize": 7.5, "color": "#333333"}
            ax.text(1.02, y, plus_minus(x, sd), **beside)
        if rows:
            ax.axvline(rows[0].estimate.centre, color=COLOURS["crb"], lw=0.8, zorder=0)
        ax.set_yticks(range(len(labels)), [""] * len(labels) if number % columns else labels)
        ax.set_ylim(len(labels) - 0.4, -0.6)
        ax.xaxis.set_major_locator(MaxNLocator(5))
        ax.grid(axis="y", visible=False)
        ax.tick_params(axis="y", length=0)
        ax.set_xlabel(f"{name} {bracket(unit_of(identification, name))}", labelpad=1)
    figure.suptitle(title)
    return figure


@style.housed
def crb_vs_credible(identification: Identification) -> Figure:
    """Each method's standard deviation over the Cramer-Rao one, on a log axis, and the scatter between manoeuvres."""
    names = ordered(identification.mle.names, identification.mle.parameters)
    found = comparison.methods(identification)
    crb, others = found[0], found[1:]
    if not all(np.isfinite(e.sd) for e in crb.estimates.values()):
        raise style.NotDrawn("the Cramér-Rao bounds do not exist: the information matrix is singular")
    figure, axes = style.panels(1, 1, (9.0, 0.36 * len(names) + 2.0))
    ax = axes[0, 0]
    ax.axvline(1.0, color=COLOURS["crb"], lw=1.6, label="Cramér-Rao bound, white residuals")
    rows = np.arange(len(names))
    offsets = np.linspace(-0.24, 0.24, len(others)) if len(others) > 1 else [0.0]
    for method, offset in zip(others, offsets, strict=True):
        ratio = [e.sd / crb.estimates[n].sd if e else np.nan for n, e in zip(names, method.of(names), strict=True)]
        look = {"color": COLOURS.get(method.key, GREY), "ms": 6.0, "mec": "white", "mew": 0.5}
        ax.plot(ratio, rows + offset, MARKERS.get(method.key, "o"), label=method.label, **look)
    between = [comparison.scatter(identification, name) for name in names]
    if any(s is not None for s in between):
        ratio = [s.sd / crb.estimates[n].sd if s else np.nan for s, n in zip(between, names, strict=True)]
        look = {"color": COLOURS["scatter"], "ms": 10.0, "mec": "white", "mew": 0.5, "zorder": 4}
        label = f"sd of {len(identification.alone)} manoeuvres fitted alone"
        ax.plot(ratio, rows, MARKERS["scatter"], label=label, **look)
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    low, high = min(low, 0.7), max(high, 1.5)
    ax.set_xlim(low, high)
    ticks = [m * 10.0**k for k in range(-6, 9) for m in (1, 2, 5)]  # plain numbers
    ax.set_xticks([t for t in ticks if low <= t <= high])
    ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.minorticks_off()
    ax.set_yticks(rows, names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xlabel("standard deviation / Cramér-Rao standard deviation [-]")
    ax.set_title("How much wider than the Cramér-Rao bound?")
    figure.legend(loc="outside lower center", ncols=2)
    return figure


CORRELATIONS = {"CL": "fig4_correlation_CL", "CD": "fig7_correlation_CD", "Cm": "fig9_correlation_Cm"}
CORRELATIONS |= {name: f"correlation_{name}" for name in LATERAL}
"""The figure of a coefficient measured against predicted."""
FIGURES = {f"{kind}_{engine}": _chains(kind, engine) for engine in ("emcee", "nuts") for kind in ("trace", "rank")}
FIGURES |= {"pair": pair, "pit": pit_histogram, "fig5_stall_hysteresis": hysteresis}
FIGURES |= {stem: of_coefficient(_correlation, name) for name, stem in CORRELATIONS.items()}
FIGURES |= {"next_flight": next_flight, "forest": forest, "crb_vs_credible": crb_vs_credible}
