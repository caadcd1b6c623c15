"""Prior against posterior of the model's parameters and of the GP's hyperparameters."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from arviz_stats.base import array_stats
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, MaxNLocator, NullLocator

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.inference.identification import Identification
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.model.noise import Noise
from bayes_aero.parameter import Parameter
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, grid_of, housed, panels
from bayes_aero.report.tables.comparison import chosen_posteriors, engine_label, noise_label, ordered
from bayes_aero.report.text.phrases import bracket

WIDE, NARROW = 12.0, 4.0  # posterior deviations either side of its mean that a panel spans at most, at least


def _density(draws: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kernel density estimate of draws by arviz_stats, between their 0.1 % and 99.9 % quantiles."""
    low, high = np.quantile(draws, [0.001, 0.999])
    grid, density, _ = array_stats.kde(np.ravel(draws), bw="scott")
    inside = (grid >= low) & (grid <= high)
    return grid[inside], density[inside]


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
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    figure.suptitle(f"Prior against posterior, {noise_label(identification.noise)} noise")
    return figure


def _prior_panel(ax: Axes, parameter: Parameter, shown: dict[str, tuple[str, Posterior]]) -> None:
    """Each posterior's density over its own peak; the prior's over the first posterior's, so that these compare."""
    name = parameter.name
    curves = {}
    for label, (key, posterior) in shown.items():
        if name in posterior.marginals:
            draws = np.asarray(posterior.tree["posterior"][name])
            curves[label] = (key, *_density(draws), posterior.marginals[name])
    main = next(iter(curves.values()))[3]
    prior_sd = float(np.std(np.asarray(next(iter(shown.values()))[1].tree["prior"][name])))
    reach = float(np.clip(2.0 * prior_sd, NARROW * main.sd, WIDE * main.sd))
    low = min(main.mean - reach, *(c[1].min() for c in curves.values()))
    high = max(main.mean + reach, *(c[1].max() for c in curves.values()))
    x = np.linspace(max(low, parameter.bounds[0]), min(high, parameter.bounds[1]), 402)[1:-1]
    prior = np.exp(np.asarray(jax.vmap(parameter.prior.log_density)(jnp.asarray(x))))
    peak = float(next(iter(curves.values()))[2].max())
    ax.fill_between(x, prior / peak, color=COLOURS["prior"], alpha=0.6, lw=0.0, label="prior")
    ax.plot(x, prior / peak, color="#777777", lw=1.0)
    for label, (key, grid, density, _) in curves.items():
        ax.plot(grid, density / density.max(), color=COLOURS.get(key, "#555555"), lw=1.3, label=label)
    ratio = prior_sd / main.sd
    ax.set_title(f"prior sd = {ratio:.{0 if ratio >= 10.0 else 1}f} × posterior sd", fontsize=8.0, color="#333333")
    ax.set_xlabel(f"{name} {bracket(parameter.unit)}", labelpad=1)
    ax.set_ylim(0.0, 1.08)
    ax.set_yticks([0.0, 0.5, 1.0])


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
    size = (4.2 * len(draws) + 0.4, 1.6 * len(hypers) + 1.2)
    figure, axes = panels(len(hypers), len(draws), size)
    for column, (name, (prior, posterior)) in zip(axes.T, draws.items(), strict=True):
        for ax, hyper in zip(column, hypers, strict=True):
            _log_density(ax, prior[hyper], "prior")
            _log_density(ax, posterior[hyper], "gpr")
            ax.set(xscale="log", ylim=(0.0, 1.08), yticks=[0.0, 0.5, 1.0])
            _plain_ticks(ax)
            ax.set_xlabel(f"{hyper} {_hyper_unit(hyper)}", labelpad=1)
        column[0].set_title(f"{name}: k-hat = {float(trees[name].attrs.get('k_hat', np.nan)):.2f}")
    for ax in axes[:, 0]:
        ax.set_ylabel("density / peak [-]")
    figure.align_ylabels(list(axes[:, 0]))
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    figure.suptitle(
        "GP hyperparameters, prior against posterior \n(densities of the logarithm, each over its own peak)"
    )
    return figure


def _flat(tree: xr.DataTree, group: str) -> dict[str, np.ndarray]:
    """Draws by hyperparameter; one with an `input` dimension becomes one per input, as length_scale[alpha]."""
    found: dict[str, np.ndarray] = {}
    for name, values in tree[group].to_dataset().data_vars.items():
        extra = [dim for dim in values.dims if dim not in ("chain", "draw")]
        if not extra:
            found[str(name)] = np.asarray(values).ravel()
        elif extra == ["input"]:
            for label in values.coords["input"].values:
                found[f"{name}[{label}]"] = np.asarray(values.sel(input=label)).ravel()
    return found


def _hyper_unit(hyper: str) -> str:
    """Unit of a hyperparameter in brackets: a length scale has its input's, a slope its inverse, the rest none."""
    kind, _, channel = hyper.rstrip("]").partition("[")
    known = STANDARD_CHANNELS.get(channel)
    unit = known.unit if known else "SI unit"
    if not channel or unit == "1":
        return "[-]"
    return bracket(unit if kind.startswith("length") else f"1/({unit})" if "/" in unit else f"1/{unit}")


def _plain_ticks(ax: Axes) -> None:
    """Few plain numbers on a logarithmic axis of less than a decade, whose powers of ten would run into each other."""
    low, high = ax.get_xlim()
    if high < 10.0 * low:
        ax.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        ax.xaxis.set_major_formatter(FormatStrFormatter("%.3g"))
        ax.xaxis.set_minor_locator(NullLocator())


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


FIGURES = {"prior_posterior": prior_posterior, "gp_prior_posterior": gp_prior_posterior}
