"""Figures of priors against posteriors, of an effect, and of the steady stall."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from arviz_stats.base import array_stats
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.model.observations import Noise
from bayes_aero.parameter import Parameter
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.pages.estimates import chosen_posteriors, engine_label, noise_label, ordered
from bayes_aero.report.phrases import bracket
from bayes_aero.report.style import Drawing, NotDrawn, grid_of, housed, legend_below, panels

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import View
    from bayes_aero.inference.results import Identification, Posterior, Stall

WIDE, NARROW = 12.0, 4.0  # posterior deviations either side of its mean that a panel spans at most, at least


@housed
def prior_posterior(identification: Identification) -> Figure:
    """Prior and posterior density of every parameter; a panel spans the posterior and says how wide the prior is."""
    shown = {engine_label(k): (k, p) for k, p in chosen_posteriors(identification).items()}
    if "white" in identification.posteriors:
        shown["emcee, white noise"] = ("white", identification.posteriors["white"])
    if not chosen_posteriors(identification):
        raise NotDrawn("this run has no posterior")
    parameters = {p.name: p for p in (*identification.model.free, *Noise(identification.noise).parameters)}
    first = next(iter(chosen_posteriors(identification).values()))
    names = ordered((n for n in first.names if n in parameters), parameters.values())
    figure, axes = grid_of(len(names), 4, (3.6, 2.15))
    for number, (ax, name) in enumerate(zip(axes, names, strict=True)):
        _prior_panel(ax, parameters[name], shown)
        if number % 4 == 0:
            ax.set_ylabel("density / peak [-]")
    legend_below(figure, axes[0])
    figure.suptitle(f"Prior against posterior, {noise_label(identification.noise)} noise")
    return figure


def _prior_panel(ax: Axes, parameter: Parameter, shown: dict[str, tuple[str, Posterior]]) -> None:
    """Each posterior's density over its own peak; the prior's over the first posterior's, so that these compare."""
    name, curves = parameter.name, {}
    for label, (key, posterior) in shown.items():
        if name in posterior.marginals:
            draws = np.asarray(posterior.tree["posterior"][name])
            low, high = np.quantile(draws, [0.001, 0.999])
            grid, density, _ = array_stats.kde(np.ravel(draws), bw="scott")
            inside = (grid >= low) & (grid <= high)
            curves[label] = (key, grid[inside], density[inside], posterior.marginals[name])
    _, _, first, main = next(iter(curves.values()))
    prior_sd = float(np.std(np.asarray(next(iter(shown.values()))[1].tree["prior"][name])))
    reach = float(np.clip(2.0 * prior_sd, NARROW * main.sd, WIDE * main.sd))
    low = min(main.mean - reach, *(c[1].min() for c in curves.values()))
    high = max(main.mean + reach, *(c[1].max() for c in curves.values()))
    x = np.linspace(max(low, parameter.bounds[0]), min(high, parameter.bounds[1]), 402)[1:-1]
    prior = np.exp(np.asarray(jax.vmap(parameter.prior.log_density)(jnp.asarray(x)))) / float(first.max())
    ax.fill_between(x, prior, color=COLOURS["prior"], alpha=0.6, lw=0.0, label="prior")
    ax.plot(x, prior, color="#777777", lw=1.0)
    for label, (key, grid, density, _) in curves.items():
        ax.plot(grid, density / density.max(), color=COLOURS.get(key, "#555555"), lw=1.3, label=label)
    ratio = prior_sd / main.sd
    ax.set_title(f"prior sd = {ratio:.{0 if ratio >= 10.0 else 1}f} × posterior sd", fontsize=8.0, color="#333333")
    ax.set_xlabel(f"{name} {bracket(parameter.unit)}", labelpad=1)
    ax.set(ylim=(0.0, 1.08), yticks=[0.0, 0.5, 1.0])


@housed
def gp_prior_posterior(identification: Identification) -> Figure:
    """Prior against posterior of every hyperparameter (log scale): a row each, a column per coefficient."""
    if identification.gp is None:
        raise NotDrawn("this run has no Gaussian process")
    trees = {name: fit.posterior for name, fit in identification.gp.fits.items() if fit.posterior is not None}
    if not trees:
        raise NotDrawn("no Gaussian process has an accepted posterior of its hyperparameters")
    draws = {name: (_flat(tree, "prior"), _flat(tree, "posterior")) for name, tree in trees.items()}
    hypers = list(dict.fromkeys(h for _, posterior in draws.values() for h in posterior))
    figure, axes = panels(len(hypers), len(draws), (4.2 * len(draws) + 0.4, 1.6 * len(hypers) + 1.2))
    for column, (name, (prior, posterior)) in zip(axes.T, draws.items(), strict=True):
        for ax, hyper in zip(column, hypers, strict=True):
            _log_density(ax, prior[hyper], "prior")
            _log_density(ax, posterior[hyper], "gpr")
            ax.set(xscale="log", ylim=(0.0, 1.08), yticks=[0.0, 0.5, 1.0])
            kind, channel = hyper  # a length scale has its input's unit, a slope its inverse
            si = STANDARD_CHANNELS[channel].unit if channel in STANDARD_CHANNELS else "SI unit" if channel else "1"
            inverse = f"1/({si})" if "/" in si else f"1/{si}"
            name_of = f"{kind}[{channel}]" if channel else kind
            ax.set_xlabel(f"{name_of} {bracket(si if kind == 'length_scale' or si == '1' else inverse)}", labelpad=1)
        column[0].set_title(f"{name}: k-hat = {float(trees[name].attrs.get('k_hat', np.nan)):.2f}")
    for ax in axes[:, 0]:
        ax.set_ylabel("density / peak [-]")
    legend_below(figure, axes[0, 0], 2)
    figure.suptitle(
        "GP hyperparameters, prior against posterior \n(densities of the logarithm, each over its own peak)"
    )
    return figure


def _flat(tree: xr.DataTree, group: str) -> dict[tuple[str, str], np.ndarray]:
    """Draws by hyperparameter and input, which is empty for one without."""
    found: dict[tuple[str, str], np.ndarray] = {}
    for name, values in tree[group].to_dataset().data_vars.items():
        extra = [dim for dim in values.dims if dim not in ("chain", "draw")]
        if not extra:
            found[str(name), ""] = np.asarray(values).ravel()
        elif extra == ["input"]:
            for label in values.coords["input"].values:
                found[str(name), str(label)] = np.asarray(values.sel(input=label)).ravel()
    return found


def _log_density(ax: Axes, draws: np.ndarray, key: str) -> None:
    """Density of log10 of draws over its own peak, where it is more than a hundredth of that."""
    logs = np.log10(np.ravel(draws))
    margin = 0.5 * float(np.std(logs))
    grid, density, _ = array_stats.kde(
        logs, bw="scott", bound_correction=False, custom_lims=(logs.min() - margin, logs.max() + margin)
    )
    shown = density > 0.01 * density.max()
    x, y = 10.0 ** grid[shown], density[shown] / density.max()
    label = "prior" if key == "prior" else "posterior"
    ax.fill_between(x, y, color=COLOURS[key], alpha=0.5, lw=0.0, label=label)
    ax.plot(x, y, color=COLOURS[key], lw=1.0)


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


@dataclass(frozen=True)
class StallData:
    """What was flown, beside one model's stall: angles in deg; `modelled` and `measured` are CL, CD, Cm."""

    title: str
    colour: str
    alpha: Float[np.ndarray, " n"]
    rising: Bool[np.ndarray, " n"]
    measured: Float[np.ndarray, "n c"]
    modelled: Float[np.ndarray, "n c"]
    manoeuvre: np.ndarray
    seconds: float
    stall: Stall


def of_identification(identification: Identification) -> list[StallData]:
    """The one model of a run."""
    if identification.stall is None:
        raise NotDrawn("the stall was not computed: that needs a posterior that converged")
    o, fitted = identification.observations, identification.fitted
    alpha, rising = np.rad2deg(np.asarray(o.signals["alpha"])), np.asarray(o.signals["alpha_dot"]) > 0.0
    flown = np.asarray(o.measured), fitted, o.manoeuvre, o.dt, identification.stall
    return [StallData("", COLOURS["mle"], alpha, rising, *flown)]


def of_view(view: View) -> list[StallData]:
    """The card's model, and the extended one where there is one; each with the sensors as it corrects them."""
    if not view.stalls:
        raise NotDrawn("the stall was not computed")
    found = []
    for key, colour, fitted in (("card", "before", view.card), ("extended", "after", view.extended)):
        if key == "card" or key in view.stalls:
            label, s = "card's model" if key == "card" else "extended model", fitted.signals
            flown = s["measured"], s["modelled"], view.manoeuvre, view.seconds, view.stalls[key]
            found.append(StallData(label, COLOURS[colour], np.rad2deg(s["alpha"]), s["alpha_dot"] > 0.0, *flown))
    return found


def _stall(models: list[StallData]) -> Figure:
    """Lift over the angle of attack, where the time was spent, and the polar; a pair of rows for each model."""
    rows = len(models)
    figure, axes = panels(2 * rows, 2, (10.5, 5.0 * rows + 0.7), height_ratios=(4, 1) * rows, width_ratios=(3, 2))
    for number, flown in enumerate(models):
        (lift, polar), (time, spare) = axes[2 * number], axes[2 * number + 1]
        spare.remove()
        s, whose = flown.stall, f", {flown.title}" if flown.title else ""
        dots: dict[str, Any] = {"marker": ".", "ls": "none", "alpha": 0.5}
        for key, mask in (("rising", flown.rising), ("falling", ~flown.rising)):
            dots["color"], CL = COLOURS[key], flown.measured[mask, 0]
            lift.plot(flown.alpha[mask], CL, ms=2.5, label=f"measured, α {key}", **dots)
            polar.plot(flown.measured[mask, 1], CL, ms=2.0, **dots)
        for k in range(int(flown.manoeuvre[-1]) + 1):
            mine = flown.manoeuvre == k
            label = "fitted, as flown" if k == 0 else None
            lift.plot(flown.alpha[mine], flown.modelled[mine, 0], color="#555555", lw=0.5, alpha=0.8, label=label)
        degrees = np.rad2deg(s.alpha)
        lift.fill_between(degrees, s.CL[0], s.CL[2], color=flown.colour, label=f"steady flow, 95 % band{whose}", **BAND)
        lift.plot(degrees, s.CL[1], color=flown.colour, lw=1.8, label=f"steady flow (α̇ = 0){whose}")
        _peak(lift, s)
        lift.set(ylabel="CL [-]", title=f"Lift{whose}")
        edges = np.arange(np.floor(flown.alpha.min()), np.ceil(flown.alpha.max()) + 1.0)
        time.hist(flown.alpha, bins=edges, weights=np.full(len(flown.alpha), flown.seconds), color="#9fb8c9")
        time.set(xlabel="α [deg]", ylabel="time [s/deg]")
        time.sharex(lift)
        lift.tick_params(labelbottom=False)
        polar.plot(s.CD[1], s.CL[1], color=flown.colour, lw=1.8)
        if s.seen:
            at = int(np.argmax(s.CL[1]))
            polar.plot(s.CD[1][at], s.CL[1][at], "o", ms=5.0, color="black", mec="white", zorder=6)
        polar.set(xlabel="CD [-]", ylabel="CL [-]", title=f"Drag polar{whose}")
    entries: dict[str, Artist] = {}  # one legend for all models
    for ax in axes[::2, 0]:
        handles, labels = ax.get_legend_handles_labels()
        entries = dict(zip(labels, handles, strict=True)) | entries
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=3)
    return figure


def _peak(ax: Axes, s: Stall) -> None:
    place = {"transform": ax.transAxes, "ha": "right"}
    if not s.seen:
        where = "inside\nthe angles flown" if s.at_edge > 0.5 else "near the edge\nof the angles flown"
        ax.text(0.97, 0.05, f"{'no maximum' if s.at_edge > 0.5 else 'maximum'} {where}", fontsize=8.5, **place)
        return
    x, y = np.rad2deg(s.alpha_max.median), s.CL_max.median
    low, high = np.rad2deg([s.alpha_max.low, s.alpha_max.high])
    ends = {"xerr": [[x - low], [high - x]], "yerr": [[y - s.CL_max.low], [s.CL_max.high - y]]}
    style = {"fmt": "o", "ms": 5.0, "color": "black", "mec": "white", "capsize": 3.0, "zorder": 6}
    ax.errorbar(x, y, **ends, **style, label="CLmax and its angle, 95 %")
    ax.text(0.97, 0.05, f"CLmax {y:.3f}\nat {x:.1f} deg", fontsize=9.5, **place)


def _separation(models: list[StallData]) -> Figure:
    """The separation point over the angle of attack at three rates of it; a panel for each model."""
    figure, axes = panels(1, len(models), (6.2 * len(models) if len(models) > 1 else 7.5, 4.2), sharey=True)
    for ax, flown in zip(axes[0], models, strict=True):
        s = flown.stall
        degrees = np.rad2deg(s.alpha)
        for rate, band, key in zip(s.rates, s.X, RATE_COLOURS, strict=True):
            ax.fill_between(degrees, band[0], band[2], color=COLOURS[key], **BAND)
            label = f"α̇ = {np.rad2deg(rate):+.1f} deg/s" if rate else "α̇ = 0 (steady)"
            ax.plot(degrees, band[1], color=COLOURS[key], ls="--" if rate > 0.0 else "-", lw=1.5, label=label)
        ax.plot(flown.alpha, np.full_like(flown.alpha, -0.04), "|", ms=4.0, alpha=0.08, color="black")
        ax.set(xlabel="α [deg]", ylim=(-0.07, 1.05), title=flown.title or "Separation point")
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 0.08))
    axes[0, 0].set_ylabel("separation point X [-] (1 attached, 0 separated)")
    return figure


FIGURES: dict[str, Drawing] = {
    "prior_posterior": prior_posterior,
    "gp_prior_posterior": gp_prior_posterior,
    "stall": housed(lambda run: _stall(of_identification(run))),
    "separation": housed(lambda run: _separation(of_identification(run))),
}
DIAGNOSIS_FIGURES: dict[str, Callable[[View], Figure]] = {
    "stall_models": housed(lambda view: _stall(of_view(view))),
    "separation_models": housed(lambda view: _separation(of_view(view))),
}
