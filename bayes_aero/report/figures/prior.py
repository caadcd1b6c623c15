"""Figures of priors against posteriors, of an effect, and of the steady stall."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from arviz_stats.base import array_stats
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.pages.estimates import chosen_posteriors, engine_label, noise_label, ordered, unit_of
from bayes_aero.report.phrases import bracket
from bayes_aero.report.plots import COLOURS, MODELS
from bayes_aero.report.style import Drawing, NotDrawn, grid_of, housed, legend_below, panels

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import View
    from bayes_aero.inference.results import Identification, Stall

WIDE, NARROW = 12.0, 4.0  # posterior deviations either side of its mean that a panel spans at most, at least


def _densities(ax: Axes, prior: np.ndarray, posteriors: Mapping[str, tuple[str, np.ndarray]], *, log: bool) -> float:
    """Densities of draws (of their logarithms), posteriors by label with colour; the ratio of prior and posterior sd.

    A posterior's is over its own peak, the prior's over that of the first posterior, so that these two compare.
    """
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


@housed
def prior_posterior(identification: Identification) -> Figure:
    """Prior and posterior density of every parameter; a panel spans the posterior and says how wide the prior is."""
    chosen = chosen_posteriors(identification)
    if not chosen:
        raise NotDrawn("this run has no posterior")
    shown = {engine_label(key): (key, p) for key, p in chosen.items()}
    if "white" in identification.posteriors:
        shown["emcee, white noise"] = ("white", identification.posteriors["white"])
    first = next(iter(chosen.values()))
    names = ordered(first.names, identification.model.free)
    figure, axes = grid_of(len(names), 4, (3.6, 2.15))
    for number, (ax, name) in enumerate(zip(axes, names, strict=True)):
        draws = {label: (k, p.tree["posterior"][name].values) for label, (k, p) in shown.items() if name in p.marginals}
        ratio = _densities(ax, first.tree["prior"][name].values, draws, log=False)
        ax.set_title(f"prior sd = {ratio:.{0 if ratio >= 10.0 else 1}f} × posterior sd", fontsize=8.0, color="#333333")
        ax.set_xlabel(f"{name} {bracket(unit_of(identification, name))}", labelpad=1)
        if number % 4 == 0:
            ax.set_ylabel("density / peak [-]")
    legend_below(figure, axes[0])
    figure.suptitle(f"Prior against posterior, {noise_label(identification.noise)} noise")
    return figure


@housed
def gp_prior_posterior(identification: Identification) -> Figure:
    """Prior against posterior of every hyperparameter (log scale): a row each, a column per coefficient."""
    if identification.gp is None:
        raise NotDrawn("this run has no Gaussian process")
    trees = {name: fit.posterior for name, fit in identification.gp.fits.items() if fit.posterior is not None}
    if not trees:
        raise NotDrawn("no Gaussian process has an accepted posterior of its hyperparameters")
    draws = {
        name: (_hyperparameters(tree, "prior"), _hyperparameters(tree, "posterior")) for name, tree in trees.items()
    }
    hypers = list(dict.fromkeys(h for _, posterior in draws.values() for h in posterior))
    figure, axes = panels(len(hypers), len(draws), (4.2 * len(draws) + 0.4, 1.6 * len(hypers) + 1.2))
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
    legend_below(figure, axes[0, 0])
    figure.suptitle("GP hyperparameters, prior against posterior\n(densities of the logarithm)")
    return figure


def _hyperparameters(tree: xr.DataTree, group: str) -> dict[tuple[str, str], np.ndarray]:
    """Draws by hyperparameter and input, which is empty for one without."""
    draws = {}
    for name, values in tree[group].to_dataset().data_vars.items():
        if "input" in values.dims:
            draws |= {(str(name), str(x)): values.sel(input=x).values for x in values.coords["input"].values}
        else:
            draws[str(name), ""] = values.values
    return draws


# --- Number of effects that need each recorded channel.

KINDS = ("mle", "gpr", "emcee", "nuts", "crb_corrected", "white")  # roles whose colours kinds of effects take, in turn


def needed(found: Sequence[Mapping[str, Any]]) -> dict[str, Counter[str]]:
    """By channel, the effects that need it by kind; the most needed first."""
    counts: dict[str, Counter[str]] = {}
    for effect in found:
        for channel in effect["needs"]:
            counts.setdefault(channel, Counter())[effect["kind"]] += 1
    return dict(sorted(counts.items(), key=lambda item: (-item[1].total(), item[0])))


@housed
def channels_needed(found: Sequence[Mapping[str, Any]]) -> Figure:
    """A bar for each channel, a colour for each kind of effect; `found` as the catalogue describes them."""
    counts = needed(found)
    if not counts:
        raise NotDrawn("no effect needs a channel")
    kinds = [kind for kind, _ in Counter(effect["kind"] for effect in found).most_common()]
    figure, axes = panels(1, 1, (7.2, 0.9 + 0.2 * len(counts)))
    ax = axes[0, 0]
    rows = range(len(counts))
    begin = [0] * len(counts)
    for number, kind in enumerate(kinds):
        widths = [by_kind[kind] for by_kind in counts.values()]
        if any(widths):
            colour = COLOURS[KINDS[number % len(KINDS)]]
            ax.barh(rows, widths, left=begin, height=0.7, color=colour, label=kind)
            begin = [a + b for a, b in zip(begin, widths, strict=True)]
    for row, total in zip(rows, begin, strict=True):
        ax.text(total + 0.15, row, str(total), va="center", fontsize=8.0)
    ax.set_yticks(rows, [channel.replace("_", " ") for channel in counts])
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("effects that need the channel [-]")
    ax.legend(title="kind of effect", loc="lower right")
    return figure


# --- The stall: recorded lift and drag with the steady curves, and the separation point with its band.

BAND: dict[str, Any] = {"alpha": 0.25, "lw": 0.0}
RATE_COLOURS = ("falling", "measured", "rising")
StallModel = tuple[str, str, Mapping[str, Any], "Stall"]
"""Title, colour, what was flown (alpha, alpha_dot, measured and modelled coefficients) and the stall of a model."""


def _of_run(run: Identification) -> tuple[list[StallModel], np.ndarray, float]:
    """The one model of a run, the manoeuvre of each sample, and the interval of samples."""
    if run.stall is None:
        raise NotDrawn("the stall was not computed: that needs a posterior that converged")
    o = run.observations
    flown = {"alpha": o.signals["alpha"], "alpha_dot": o.signals["alpha_dot"], "measured": o.measured}
    return [("", COLOURS["mle"], flown | {"modelled": run.fitted}, run.stall)], o.manoeuvre, o.dt


def _of_view(view: View) -> tuple[list[StallModel], np.ndarray, float]:
    """The same of the card's model and, where there is one, the extended one, with the sensors as it corrects them."""
    if not view.stalls:
        raise NotDrawn("the stall was not computed")
    both = ("card", COLOURS["before"], view.card), ("extended", COLOURS["after"], view.extended)
    models = [(MODELS[key], colour, m.signals, view.stalls[key]) for key, colour, m in both if key in view.stalls]
    return models, view.manoeuvre, view.seconds


def _stall(models: Sequence[StallModel], manoeuvre: np.ndarray, seconds: float) -> Figure:
    """Lift over the angle of attack, where the time was spent, and the polar; a pair of rows for each model."""
    rows = len(models)
    figure, axes = panels(2 * rows, 2, (10.5, 5.0 * rows + 0.7), height_ratios=(4, 1) * rows, width_ratios=(3, 2))
    for number, (title, colour, flown, s) in enumerate(models):
        (lift, polar), (time, spare) = axes[2 * number], axes[2 * number + 1]
        spare.remove()
        whose, alpha, measured = (
            f", {title}" if title else "",
            np.rad2deg(flown["alpha"]),
            np.asarray(flown["measured"]),
        )
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
    figure, axes = panels(1, len(models), (6.2 * len(models) if len(models) > 1 else 7.5, 4.2), sharey=True)
    for ax, (title, _, flown, s) in zip(axes[0], models, strict=True):
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


FIGURES: dict[str, Drawing] = {
    "prior_posterior": prior_posterior,
    "gp_prior_posterior": gp_prior_posterior,
    "stall": housed(lambda run: _stall(*_of_run(run))),
    "separation": housed(lambda run: _separation(*_of_run(run))),
}
DIAGNOSIS_FIGURES: dict[str, Callable[[View], Figure]] = {
    "stall_models": housed(lambda view: _stall(*_of_view(view))),
    "separation_models": housed(lambda view: _separation(*_of_view(view))),
}
