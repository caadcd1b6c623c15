"""Figures of posterior and prior, calibration, measured against predicted, the stall, channels of effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.physics.aircraft import LATERAL
from bayes_aero.report import style
from bayes_aero.report.figures.time_histories import predicted, what_is_shown
from bayes_aero.report.pages import estimates as comparison
from bayes_aero.report.pages.estimates import chosen_posteriors, label_of, ordered, unit_of
from bayes_aero.report.phrases import bracket, plus_minus
from bayes_aero.report.plots import COLOURS, MODELS
from bayes_aero.report.table import Estimate

if TYPE_CHECKING:  # xarray and pandas take most of a second to load, and no quick answer needs them
    import xarray as xr

    from bayes_aero.diagnosis.result import View
    from bayes_aero.inference.results import Identification, Posterior, Stall

TRACE_DRAWS = 1000  # per chain: more draws than a panel has pixels only cost time
RANK_DRAWS = 250  # per chain: the band is found by simulation, whose time grows with it
PAIR_DRAWS = 400  # per chain
MOST_PAIRED = 6  # parameters of a figure that chooses them
CHAIN_COLOURS = ["#0072B2", "#E69F00", "#009E73", "#CC79A7"]
GREY = "#555555"  # of what has no colour of its own
MARKERS = {"crb_corrected": "s", "white": "D", "emcee": "o", "nuts": "^"}
CORRELATIONS = {"CL": "fig4_correlation_CL", "CD": "fig7_correlation_CD", "Cm": "fig9_correlation_Cm"}
CORRELATIONS |= {name: f"correlation_{name}" for name in LATERAL}

WIDE, NARROW = 12.0, 4.0  # posterior deviations either side of its mean that a panel spans at most, at least


def _thinned(posterior: Posterior, names: list[str], most: int) -> xr.DataTree:
    """The posterior group with draws of `names`, thinned evenly to at most `most` a chain."""
    from arviz_base import from_dict

    dataset = posterior.tree["posterior"].to_dataset()[names]
    thin = dataset.isel(draw=slice(None, None, max(1, -(-dataset.sizes["draw"] // most))))
    values = {name: np.asarray(thin[name].transpose("chain", "draw")) for name in names}
    return from_dict({"posterior": values})


def _draw(kind: str, tree: xr.DataTree, size: tuple[float, float], **options: Any) -> Figure:
    with style.arviz_plots() as plots:
        layout = {"figsize": size, "figsize_units": "inches"}
        collection = getattr(plots, f"plot_{kind}")(tree, backend="matplotlib", figure_kwargs=layout, **options)
        figure = collection.get_viz("figure")
        figure.set_layout_engine("constrained")
        style.close(figure)
    return figure


def _chains(identification: Identification, kind: str, engine: str) -> Figure:
    """The plot of `arviz_plots` of every parameter's chains by an engine: traces, or ranks (ECDF less uniform)."""
    if engine not in identification.posteriors:
        raise style.NotDrawn(f"this run has no posterior by {label_of(engine)}")
    posterior = identification.posteriors[engine]
    status = posterior.status.name.lower().replace("_", " ")
    about = f"{kind.capitalize()}: {label_of(engine)}, {label_of(posterior.noise)} noise, {status}"
    names, chains = ordered(posterior.names, identification.mle.parameters), posterior.tree["posterior"].sizes["chain"]
    size: tuple[float, float] = 3.7 * min(len(names), 4), 2.1 * -(-len(names) // 4) + 0.6
    if kind == "trace":
        below = "draw, walkers end to end, thinned [-]" if engine == "emcee" else "draw, thinned [-]"
        how = {"trace": {"alpha": 0.6, "width": 0.4}, "xlabel": False, "ticklabels": False, "title": False}
        look = {"aes": {"color": ["chain"]}, "visuals": how}
        most = TRACE_DRAWS
    else:
        below, look = "fractional rank [-]", {"visuals": {"xlabel": False}}
        independent = min(m.ess_bulk for m in posterior.marginals.values())
        most = min(RANK_DRAWS, max(50, int(independent / chains)))
        about += "\nthinned to independent draws; band: 99 % for chains that agree"
    figure = _draw(kind, _thinned(posterior, names, most), size, col_wrap=4, color=CHAIN_COLOURS, **look)
    for number, (ax, name) in enumerate(zip([ax for ax in figure.axes if ax.has_data()], names, strict=True)):
        if kind == "trace":
            ax.set_ylabel(f"{name} {bracket(unit_of(identification, name))}")
        else:
            ax.set_title(name)
            ax.set_ylabel("Δ ECDF [-]" if number % 4 == 0 else "")
        if number >= len(names) - 4:
            ax.set_xlabel(below)
    figure.suptitle(about)
    return figure


@style.housed
def pair_of(posteriors: Mapping[str, Posterior]) -> Figure:
    """Scatter, by the first sampler, of the parameters that vary together the most, marginals on the diagonal."""
    engine, posterior = next(iter(style.needed(posteriors, "this run has no posterior").items()))
    names = posterior.most_correlated(MOST_PAIRED)
    if len(names) < 2:
        raise style.NotDrawn("a pair plot needs two parameters")
    side = 1.15 * len(names) + 1.0
    look = {"alpha": 0.25, "size": 3.0, "color": COLOURS.get(engine, COLOURS["mle"]), "edgecolor": "none"}
    tree = _thinned(posterior, names, PAIR_DRAWS)
    figure = _draw("pair", tree, (side, side), visuals={"scatter": look, "dist": {"color": look["color"]}})
    for ax in [ax for ax in figure.axes if not ax.has_data()]:
        ax.remove()
    places = [(row, column) for row in range(len(names)) for column in range(row + 1)]
    for ax, (row, column) in zip(figure.axes, places, strict=True):  # a lower triangle, named on its outer axes
        last = row == len(names) - 1
        ax.locator_params(nbins=3)
        ax.tick_params(labelbottom=last, labelleft=column == 0 and row > 0)
        if row == column:
            ax.set_yticks([])
        ax.set_xlabel(f"{names[column]} [SI]" if last else "")
        ax.set_ylabel(("density" if row == 0 else f"{names[row]} [SI]") if column == 0 else "")
    figure.suptitle(f"Posterior by {label_of(engine)}: the parameters of the largest correlations")
    return figure


@style.housed
def pit_histogram(identification: Identification) -> Figure:
    """A panel for each coefficient: density of the values, and the band of independent uniform ones."""
    t = style.needed(identification.pit, "no posterior was sampled")
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
    what = "posterior predictive" if identification.noise == "white" else "one-step-ahead posterior predictive"
    figure.suptitle(f"Where measurements fall in the {what} ({label_of(t.engine)})")
    return figure


# --- The seed paper's figures without time: measured against predicted, and the stall hysteresis.


def _correlation(identification: Identification, name: str) -> Figure:
    """Measured against predicted on the same points: maximum likelihood and GPR side by side, on one scale."""
    points = predicted(identification, name)
    pairs = {"Maximum likelihood": "mle", "Gaussian-process regression": "gp"}
    pairs = {title: key for title, key in pairs.items() if key in points}
    figure, axes = style.panels(1, len(pairs), (4.9 * len(pairs) + 0.2, 5.75), sharex=True, sharey=True)
    both = points[["measured", *pairs.values()]].to_numpy()
    ends = np.array([both.min(), both.max()]) + 0.03 * np.ptp(both) * np.array([-1.0, 1.0])
    for ax, (title, key) in zip(axes[0], pairs.items(), strict=True):
        r, rmse = points.measured.corr(points[key]), np.sqrt(np.mean((points.measured - points[key]) ** 2))
        colour = COLOURS["mle" if key == "mle" else "gpr"]
        ax.plot(ends, ends, color=GREY, lw=0.9, zorder=1)
        ax.scatter(points.measured, points[key], s=7, color=colour, alpha=0.45, linewidths=0, zorder=2)
        ax.set(xlim=ends, ylim=ends, box_aspect=1.0, xlabel=f"measured {name} [-]", title=title)
        text = f"r = {r:.4f}\nRMSE = {rmse:.5f}\nn = {len(points)}"
        ax.text(0.04, 0.96, text, transform=ax.transAxes, va="top", linespacing=1.4)
    axes[0, 0].set_ylabel(f"predicted {name} [-]")
    figure.suptitle(f"{name}, measured against predicted:\n{what_is_shown(identification)}")
    return figure


@style.housed
def hysteresis(identification: Identification) -> Figure:
    """CL against angle of attack, rising and falling separate: measured, maximum likelihood, GPR."""
    from pandas import Series

    o, points = identification.observations, predicted(identification, "CL")
    alpha, rising = np.rad2deg(np.asarray(o.signals["alpha"])), np.asarray(o.signals["alpha_dot"]) > 0.0
    measured = Series(np.asarray(o.measured)[:, o.coefficients.index("CL")])
    sources = {"measured": measured, "maximum likelihood": points.mle}
    sources |= {"GPR": points.gp} if "gp" in points else {}
    rows = len(o.names)
    style.refuse_many(rows)
    size = (4.4 * len(sources), min(3.6, 0.8 * style.column_width(rows)) * rows + 0.9)
    figure, axes = style.panels(rows, len(sources), size, sharex=True, sharey=True)
    for number, row in enumerate(axes):
        for ax, (title, values) in zip(row, sources.items(), strict=True):
            mine = values[o.manoeuvre[values.index] == number]
            for key, way in (("rising", rising[mine.index]), ("falling", ~rising[mine.index])):
                look = {"color": COLOURS[key], "label": f"α {key}", "ms": 2.0, "alpha": 0.7}
                ax.plot(alpha[mine.index][way], mine[way], ".", **look)
            ax.set_title(f"{o.names[number]}, {title}")
        row[0].set_ylabel("CL [-]")
    for ax in axes[-1]:
        ax.set_xlabel("α [deg]")
    style.legend_below(figure, axes[0, 0], 2, markerscale=4)
    figure.suptitle(f"Stall hysteresis CL(α): {what_is_shown(identification)}")
    return figure


@style.housed
def forest(identification: Identification) -> Figure:
    """Every parameter by every method, with 95 % intervals and numbers; one panel per parameter, in its own unit."""
    table: dict[str, list[tuple[str, str, Estimate]]] = {}  # label, role of the colour, estimate
    for name in ordered(identification.mle.names, identification.mle.parameters):
        every = [(m, m.estimates[name]) for m in comparison.methods(identification) if name in m.estimates]
        table[name] = [(m.label, m.key, e) for m, e in every if np.isfinite(e.sd)]
        for manoeuvre, (x, _, corrected) in comparison.alone(identification, name).items():
            table[name].append((f"{manoeuvre} alone, ML", "alone", Estimate.normal(x, corrected)))
    labels = list(dict.fromkeys(label for lines in table.values() for label, *_ in lines))
    columns = min(2, len(table))  # three would not be legible on a page
    figure, axes = style.grid_of(len(table), columns, (5.4, 0.2 * len(labels) + 0.85))
    for number, (ax, (name, lines)) in enumerate(zip(axes, table.items(), strict=True)):
        for label, key, (x, sd, low, high) in lines:
            y, colour = labels.index(label), COLOURS.get(key, GREY)
            ax.plot([low, high], [y, y], color=colour, lw=1.6, solid_capstyle="butt")
            ax.plot(x, y, "o", ms=4.0, color=colour, mec="white", mew=0.5)
            beside = {"transform": ax.get_yaxis_transform(), "va": "center", "fontsize": 7.5, "color": "#333333"}
            ax.text(1.02, y, plus_minus(x, sd), **beside)
        if lines:
            ax.axvline(lines[0][2].centre, color=COLOURS["crb"], lw=0.8, zorder=0)
        ax.set_yticks(range(len(labels)), [""] * len(labels) if number % columns else labels)
        ax.set_ylim(len(labels) - 0.4, -0.6)
        ax.xaxis.set_major_locator(MaxNLocator(5))
        ax.grid(axis="y", visible=False)
        ax.tick_params(axis="y", length=0)
        ax.set_xlabel(f"{name} {bracket(unit_of(identification, name))}", labelpad=1)
    note = "one manoeuvre alone: corrected bound"
    figure.suptitle(f"Estimates with 95 % intervals, and estimate ± standard deviation\n{note}")
    return figure


@style.housed
def crb_vs_credible(identification: Identification) -> Figure:
    """Each method's standard deviation over the Cramer-Rao one, on a log axis, and the scatter between manoeuvres."""
    names = ordered(identification.mle.names, identification.mle.parameters)
    crb, *others = comparison.methods(identification)
    if not all(np.isfinite(e.sd) for e in crb.estimates.values()):
        raise style.NotDrawn("the Cramér-Rao bounds do not exist: the information matrix is singular")
    figure, axes = style.panels(1, 1, (9.0, 0.36 * len(names) + 2.0))
    ax, rows = axes[0, 0], np.arange(len(names))
    ax.axvline(1.0, color=COLOURS["crb"], lw=1.6, label="Cramér-Rao bound, white residuals")
    look: dict[str, Any] = {"ls": "none", "mec": "white", "mew": 0.5}
    for method, offset in zip(others, np.linspace(-0.24, 0.24, len(others)), strict=True):
        ratio, marker = [method.over(crb).get(n, np.nan) for n in names], MARKERS.get(method.key, "o")
        colour = COLOURS.get(method.key, GREY)
        ax.plot(ratio, rows + offset, marker=marker, color=colour, ms=6.0, label=method.label, **look)
    between = {n: comparison.scatter(identification, n) for n in names}
    if any(between.values()):
        ratio = [s[0] / crb.estimates[n].sd if s else np.nan for n, s in between.items()]
        label = f"sd of {len(identification.alone)} manoeuvres fitted alone"
        ax.plot(ratio, rows, marker="*", color=COLOURS["scatter"], ms=10.0, zorder=4, label=label, **look)
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    ax.set_xlim(min(low, 0.7), max(high, 1.5))
    ax.set_yticks(rows, names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xlabel("standard deviation / Cramér-Rao standard deviation [-]")
    ax.set_title("How much wider than the Cramér-Rao bound?")
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def _densities(ax: Axes, prior: np.ndarray, posteriors: Mapping[str, tuple[str, np.ndarray]], *, log: bool) -> float:
    """Densities of draws (of their logarithms), posteriors by label with colour; the ratio of prior and posterior sd.

    A posterior's is over its own peak, the prior's over that of the first posterior, so that these two compare.
    """
    from arviz_stats.base import array_stats

    size = {label: (key, np.log10(x.ravel()) if log else x.ravel()) for label, (key, x) in posteriors.items()}
    main, of_prior = next(iter(size.values()))[1], np.log10(prior.ravel()) if log else prior.ravel()
    sd, ends, peak = float(np.std(main)), [], 0.0
    for label, (key, draws) in size.items():
        grid, density, _ = array_stats.kde(draws, bw="scott")
        peak, tails = peak or float(density.max()), np.quantile(draws, [0.001, 0.999])
        shown = (grid >= tails[0]) & (grid <= tails[1])
        x, y = 10.0 ** grid[shown] if log else grid[shown], density[shown] / density.max()
        ax.plot(x, y, color=COLOURS.get(key, "#555555"), lw=1.3, label=label)
        ends += list(tails)
    grid, density, _ = array_stats.kde(of_prior, bw="scott")
    x = 10.0**grid if log else grid
    ax.fill_between(x, density / peak, color=COLOURS["prior"], alpha=0.6, lw=0.0, label="prior")
    reach = float(np.clip(2.0 * np.std(of_prior), NARROW * sd, WIDE * sd))
    low, high = min(np.mean(main) - reach, *ends), max(np.mean(main) + reach, *ends)
    ax.set(xlim=(10.0**low, 10.0**high) if log else (low, high), ylim=(0.0, 1.08), yticks=[0.0, 0.5, 1.0])
    return float(np.std(of_prior)) / sd


@style.housed
def prior_posterior(identification: Identification) -> Figure:
    """Prior and posterior density of every parameter; a panel spans the posterior and says how wide the prior is."""
    chosen = style.needed(chosen_posteriors(identification), "this run has no posterior")
    shown = {label_of(key): (key, p) for key, p in chosen.items()}
    if "white" in identification.posteriors:
        shown["emcee, white noise"] = ("white", identification.posteriors["white"])
    first = next(iter(chosen.values()))
    names = ordered(first.names, identification.model.free)
    figure, axes = style.grid_of(len(names), 4, (3.6, 2.15))
    for number, (ax, name) in enumerate(zip(axes, names, strict=True)):
        having = {label: (key, p.tree["posterior"]) for label, (key, p) in shown.items() if name in p.marginals}
        draws = {label: (key, np.asarray(tree[name])) for label, (key, tree) in having.items()}
        ratio = _densities(ax, np.asarray(first.tree["prior"][name]), draws, log=False)
        ax.set_title(f"prior sd = {ratio:.{0 if ratio >= 10.0 else 1}f} × posterior sd", fontsize=8.0, color="#333333")
        ax.set_xlabel(f"{name} {bracket(unit_of(identification, name))}", labelpad=1)
        if number % 4 == 0:
            ax.set_ylabel("density / peak [-]")
    style.legend_below(figure, axes[0])
    figure.suptitle(f"Prior against posterior, {label_of(identification.noise)} noise")
    return figure


@style.housed
def gp_prior_posterior(identification: Identification) -> Figure:
    """Prior against posterior of every hyperparameter (log scale): a row each, a column per coefficient."""
    gp = style.needed(identification.gp, "this run has no Gaussian process")
    trees = {name: fit.posterior for name, fit in gp.fits.items() if fit.posterior is not None}
    style.needed(trees, "no Gaussian process has an accepted posterior of its hyperparameters")
    draws = {
        name: (_hyperparameters(tree, "prior"), _hyperparameters(tree, "posterior")) for name, tree in trees.items()
    }
    hypers = list(dict.fromkeys(h for _, posterior in draws.values() for h in posterior))
    figure, axes = style.panels(len(hypers), len(draws), (4.2 * len(draws) + 0.4, 1.6 * len(hypers) + 1.2))
    for column, (name, (prior, posterior)) in zip(axes.T, draws.items(), strict=True):
        column[0].set_title(f"{name}: k-hat = {float(trees[name].attrs.get('k_hat', np.nan)):.2f}")
        for ax, (kind, channel) in zip(column, hypers, strict=True):
            ax.set_xscale("log")
            _densities(ax, prior[kind, channel], {"posterior": ("gpr", posterior[kind, channel])}, log=True)
            # a length scale has its input's unit, a slope its inverse
            si = STANDARD_CHANNELS[channel].unit if channel in STANDARD_CHANNELS else "SI unit" if channel else "1"
            inverse = f"1/({si})" if "/" in si else f"1/{si}"
            unit = si if kind == "length_scale" or si == "1" else inverse
            ax.set_xlabel(f"{f'{kind}[{channel}]' if channel else kind} {bracket(unit)}", labelpad=1)
    for ax in axes[:, 0]:
        ax.set_ylabel("density / peak [-]")
    style.legend_below(figure, axes[0, 0])
    figure.suptitle("GP hyperparameters, prior against posterior\n(densities of the logarithm)")
    return figure


def _hyperparameters(tree: xr.DataTree, group: str) -> dict[tuple[str, str], np.ndarray]:
    draws = {}
    for name, values in tree[group].to_dataset().data_vars.items():
        if "input" in values.dims:
            draws |= {(str(name), str(x)): values.sel(input=x).values for x in values.coords["input"].values}
        else:
            draws[str(name), ""] = values.values
    return draws


# --- The stall: recorded lift and drag with the steady curves, and the separation point with its band.

BAND: dict[str, Any] = {"alpha": 0.25, "lw": 0.0}
RATE_COLOURS = ("falling", "measured", "rising")
StallModel = tuple[str, str, Mapping[str, Any], "Stall"]
"""Title, colour, what was flown (alpha, alpha_dot, measured and modelled coefficients) and the stall of a model."""


def _of_run(run: Identification) -> tuple[list[StallModel], np.ndarray, float]:
    """The one model of a run, the manoeuvre of each sample, and the interval of samples."""
    stall = style.needed(run.stall, "the stall was not computed: that needs a posterior that converged")
    o = run.observations
    flown = {"alpha": o.signals["alpha"], "alpha_dot": o.signals["alpha_dot"], "measured": o.measured}
    return [("", COLOURS["mle"], flown | {"modelled": run.fitted}, stall)], o.manoeuvre, o.dt


def _of_view(view: View) -> tuple[list[StallModel], np.ndarray, float]:
    """The same of the card's model and, where there is one, the extended one, with the sensors as it corrects them."""
    style.needed(view.stalls, "the stall was not computed")
    both = ("card", COLOURS["before"], view.card), ("extended", COLOURS["after"], view.extended)
    models = [(MODELS[key], colour, m.signals, view.stalls[key]) for key, colour, m in both if key in view.stalls]
    return models, view.manoeuvre, view.seconds


def _stall(models: Sequence[StallModel], manoeuvre: np.ndarray, seconds: float) -> Figure:
    """Lift over the angle of attack, where the time was spent, and the polar; a pair of rows for each model."""
    rows = len(models)
    figure, axes = style.panels(2 * rows, 2, (10.5, 5.0 * rows + 0.7), height_ratios=(4, 1) * rows, width_ratios=(3, 2))
    for number, (title, colour, flown, s) in enumerate(models):
        (lift, polar), (time, spare) = axes[2 * number], axes[2 * number + 1]
        spare.remove()
        whose, alpha = f", {title}" if title else "", np.rad2deg(flown["alpha"])
        measured = np.asarray(flown["measured"])
        rising, degrees = np.asarray(flown["alpha_dot"]) > 0.0, np.rad2deg(s.alpha)
        for key, mask in (("rising", rising), ("falling", ~rising)):
            dots: dict[str, Any] = {"marker": ".", "ls": "none", "alpha": 0.5, "color": COLOURS[key]}
            lift.plot(alpha[mask], measured[mask, 0], ms=2.5, label=f"measured, α {key}", **dots)
            polar.plot(measured[mask, 1], measured[mask, 0], ms=2.0, **dots)
        for k in range(int(manoeuvre[-1]) + 1):
            mine, label = manoeuvre == k, None if k else "fitted, as flown"
            lift.plot(alpha[mine], flown["modelled"][mine, 0], color="#555555", lw=0.5, alpha=0.8, label=label)
        lift.fill_between(degrees, s.CL[0], s.CL[2], color=colour, label=f"steady flow, 95 % band{whose}", **BAND)
        lift.plot(degrees, s.CL[1], color=colour, lw=1.8, label=f"steady flow (α̇ = 0){whose}")
        polar.plot(s.CD[1], s.CL[1], color=colour, lw=1.8)
        place = {"x": 0.97, "y": 0.05, "transform": lift.transAxes, "ha": "right", "fontsize": 9.0}
        if s.seen:
            x, y = np.rad2deg(s.alpha_max.median), s.CL_max.median
            low, high = np.rad2deg([s.alpha_max.low, s.alpha_max.high])
            ends = {"xerr": [[x - low], [high - x]], "yerr": [[y - s.CL_max.low], [s.CL_max.high - y]]}
            look = {"fmt": "o", "ms": 5.0, "color": "black", "mec": "white", "capsize": 3.0, "zorder": 6}
            lift.errorbar(x, y, **ends, **look, label="CLmax and its angle, 95 %")
            lift.text(s=f"CLmax {y:.3f}\nat {x:.1f} deg", **place)
        else:
            lift.text(s=f"{s.at_edge:.0%} of the draws have their\nmaximum at the edge of the angles flown", **place)
        lift.set(ylabel="CL [-]", title=f"Lift{whose}")
        lift.tick_params(labelbottom=False)
        edges = np.arange(np.floor(alpha.min()), np.ceil(alpha.max()) + 1.0)
        time.hist(alpha, bins=edges, weights=np.full(len(alpha), seconds), color=COLOURS["candidate"])
        time.set(xlabel="α [deg]", ylabel="time [s/deg]")
        time.sharex(lift)
        polar.set(xlabel="CD [-]", ylabel="CL [-]", title=f"Drag polar{whose}")
    entries: dict[str, Any] = {}  # one legend for all models
    for ax in axes[::2, 0]:
        handles, labels = ax.get_legend_handles_labels()
        entries = dict(zip(labels, handles, strict=True)) | entries
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=3)
    return figure


def _separation(models: Sequence[StallModel], *_: Any) -> Figure:
    """The separation point over the angle of attack at three rates of it; a panel for each model."""
    figure, axes = style.panels(1, len(models), (6.2 * len(models) if len(models) > 1 else 7.5, 4.2), sharey=True)
    for ax, (title, _colour, flown, s) in zip(axes[0], models, strict=True):
        degrees, alpha = np.rad2deg(s.alpha), np.rad2deg(np.asarray(flown["alpha"]))
        for rate, band, key in zip(s.rates, s.X, RATE_COLOURS, strict=True):
            ax.fill_between(degrees, band[0], band[2], color=COLOURS[key], **BAND)
            label = f"α̇ = {np.rad2deg(rate):+.1f} deg/s" if rate else "α̇ = 0 (steady)"
            ax.plot(degrees, band[1], color=COLOURS[key], ls="--" if rate > 0.0 else "-", lw=1.5, label=label)
        ax.plot(alpha, np.full_like(alpha, -0.04), "|", ms=4.0, alpha=0.08, color="black")
        ax.set(xlabel="α [deg]", ylim=(-0.07, 1.05), title=title or "Separation point")
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 0.08))
    axes[0, 0].set_ylabel("separation point X [-] (1 attached, 0 separated)")
    return figure


FIGURES: dict[str, style.Drawing] = {
    "pair": lambda run: pair_of(chosen_posteriors(run)),
    "pit": pit_histogram, "fig5_stall_hysteresis": hysteresis, "forest": forest, "crb_vs_credible": crb_vs_credible,
    "prior_posterior": prior_posterior, "gp_prior_posterior": gp_prior_posterior,
    "stall": style.housed(lambda run: _stall(*_of_run(run))),
    "separation": style.housed(lambda run: _separation(*_of_run(run))),
}  # fmt: skip
FIGURES |= {stem: style.housed(partial(_correlation, name=name)) for name, stem in CORRELATIONS.items()}
for kind, engine in product(("trace", "rank"), ("emcee", "nuts")):
    FIGURES[f"{kind}_{engine}"] = style.housed(partial(_chains, kind=kind, engine=engine))
DIAGNOSIS_FIGURES: dict[str, Callable[[View], Figure]] = {
    "stall_models": style.housed(lambda view: _stall(*_of_view(view))),
    "separation_models": style.housed(lambda view: _separation(*_of_view(view))),
}
