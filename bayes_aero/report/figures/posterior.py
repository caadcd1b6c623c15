"""Mixing of the chains and shape of the posterior: trace, rank and pair plots, by arviz_plots."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import arviz_base as azb
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from bayes_aero.inference.identification import Identification
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, arviz_plots, close, housed, quiet_pyplot
from bayes_aero.report.tables.comparison import chosen_posteriors, engine_label, noise_label, ordered, unit_of
from bayes_aero.report.text.phrases import bracket

TRACE_DRAWS = 1000  # per chain: more draws than a panel has pixels only cost time
RANK_DRAWS = 250  # per chain: the band is found by simulation, whose time grows with it
PAIR_DRAWS = 400  # per chain
MOST_PAIRED = 6  # parameters of a figure that chooses them
CHAIN_COLOURS = ["#0072B2", "#E69F00", "#009E73", "#CC79A7"]


def _posterior(identification: Identification, engine: str) -> Posterior:
    if engine not in identification.posteriors:
        raise NotDrawn(f"this run has no posterior by {engine_label(engine)}")
    return identification.posteriors[engine]


def _thinned(posterior: Posterior, names: list[str], most: int) -> xr.DataTree:
    """The posterior group with draws of `names`, thinned evenly to at most `most` a chain."""
    dataset = posterior.tree["posterior"].to_dataset()[names]
    step = max(1, -(-dataset.sizes["draw"] // most))
    thin = dataset.isel(draw=slice(None, None, step))
    values = {name: np.asarray(thin[name].transpose("chain", "draw")) for name in names}
    return azb.from_dict({"posterior": values})


def _draw(kind: str, tree: xr.DataTree, size: tuple[float, float], **options: Any) -> Figure:
    """Call arviz_plots' plot `kind` and take its figure out of pyplot."""
    with quiet_pyplot():
        plots = arviz_plots()
        layout = {"figsize": size, "figsize_units": "inches"}
        collection = getattr(plots, f"plot_{kind}")(tree, backend="matplotlib", figure_kwargs=layout, **options)
        figure = collection.get_viz("figure")
        figure.set_layout_engine("constrained")
        close(figure)
    return figure


def _size(count: int, columns: int) -> tuple[float, float]:
    return 3.7 * min(count, columns), 2.1 * -(-count // columns) + 0.6


def _title(identification: Identification, engine: str, what: str) -> str:
    p = identification.posteriors[engine]
    worst_rhat = max(m.rhat for m in p.marginals.values())
    worst_ess = min(m.ess_bulk for m in p.marginals.values())
    return (
        f"{what}: {engine_label(engine)}, {noise_label(p.noise)} noise, {p.status.name.lower().replace('_', ' ')} "
        f"(worst R-hat {worst_rhat:.3f}, smallest bulk ESS {worst_ess:.0f})"
    )


def _trace(identification: Identification, engine: str) -> Figure:
    posterior = _posterior(identification, engine)
    names = ordered(posterior.names, identification.mle.parameters)
    tree = _thinned(posterior, names, TRACE_DRAWS)
    figure = _draw(
        "trace",
        tree,
        _size(len(names), 4),
        col_wrap=4,
        aes={"color": ["chain"]},
        color=CHAIN_COLOURS,
        visuals={"trace": {"alpha": 0.6, "width": 0.4}, "xlabel": False, "ticklabels": False, "title": False},
    )
    thinned = tree["posterior"].sizes["draw"] < posterior.tree["posterior"].sizes["draw"]
    along = ("draw, walkers end to end" if engine == "emcee" else "draw") + (", thinned [-]" if thinned else " [-]")
    axes = [ax for ax in figure.axes if ax.has_data()]
    for number, (ax, name) in enumerate(zip(axes, names, strict=True)):
        ax.set_ylabel(f"{name} {bracket(unit_of(identification, name))}")
        if number >= len(names) - 4:
            ax.set_xlabel(along)
    figure.suptitle(_title(identification, engine, "Trace"))
    return figure


def _rank(identification: Identification, engine: str) -> Figure:
    posterior = _posterior(identification, engine)
    names = ordered(posterior.names, identification.mle.parameters)
    independent = min(m.ess_bulk for m in posterior.marginals.values())
    chains = posterior.tree["posterior"].sizes["chain"]
    tree = _thinned(posterior, names, min(RANK_DRAWS, max(50, int(independent / chains))))
    figure = _draw("rank", tree, _size(len(names), 4), col_wrap=4, color=CHAIN_COLOURS, visuals={"xlabel": False})
    axes = [ax for ax in figure.axes if ax.has_data()]
    for number, (ax, name) in enumerate(zip(axes, names, strict=True)):
        ax.set_title(name)
        ax.set_ylabel("Δ ECDF [-]" if number % 4 == 0 else "")
        if number >= len(names) - 4:
            ax.set_xlabel("fractional rank [-]")
    figure.suptitle(
        _title(identification, engine, "Rank") + "\nthinned to independent draws; band: 99 % for chains that agree"
    )
    return figure


@housed
def trace_emcee(identification: Identification) -> Figure:
    """Trace of every parameter by emcee, one colour per ensemble."""
    return _trace(identification, "emcee")


@housed
def trace_nuts(identification: Identification) -> Figure:
    """Trace of every parameter by NUTS, one colour per chain."""
    return _trace(identification, "nuts")


@housed
def rank_emcee(identification: Identification) -> Figure:
    """Rank plot (difference of the ECDF of ranks from uniform) of every parameter, one line per ensemble."""
    return _rank(identification, "emcee")


@housed
def rank_nuts(identification: Identification) -> Figure:
    """Rank plot (difference of the ECDF of ranks from uniform) of every parameter, one line per chain."""
    return _rank(identification, "nuts")


@housed
def pair(identification: Identification) -> Figure:
    """Scatter of the model's parameters against each other, marginals on the diagonal, by the first engine there is."""
    engines = chosen_posteriors(identification)
    if not engines:
        raise NotDrawn("this run has no posterior")
    engine, posterior = next(iter(engines.items()))
    names = ordered((n for n in posterior.names if n in identification.mle.names), identification.mle.parameters)
    if len(names) < 2:
        raise NotDrawn("a pair plot needs two parameters")
    figure = _pair(engine, posterior, names)
    _label_matrix(identification, figure, names)
    figure.suptitle(_title(identification, engine, "Posterior of the model's parameters"))
    return figure


@housed
def pair_of(posteriors: Mapping[str, Posterior]) -> Figure:
    """The same of a fit with process noise, by the first sampler: the parameters that vary together the most."""
    if not posteriors:
        raise NotDrawn("there is no posterior")
    engine, posterior = next(iter(posteriors.items()))
    figure = _pair(engine, posterior, posterior.most_correlated(MOST_PAIRED))
    for axis in [axis for axis in figure.axes if not axis.has_data()]:
        axis.remove()
    figure.suptitle(
        f"Posterior with process noise by {engine_label(engine)}: the parameters of the largest correlations"
    )
    return figure


def _pair(engine: str, posterior: Posterior, names: list[str]) -> Figure:
    side = 1.15 * len(names) + 1.0
    style = {"alpha": 0.25, "size": 3.0, "color": COLOURS.get(engine, COLOURS["mle"]), "edgecolor": "none"}
    tree = _thinned(posterior, names, PAIR_DRAWS)
    return _draw("pair", tree, (side, side), visuals={"scatter": style, "dist": {"color": style["color"]}})


def _label_matrix(identification: Identification, figure: Figure, names: list[str]) -> None:
    """Names with units on the outer axes of a lower-triangular pair plot, and tick labels there only."""
    for ax in [ax for ax in figure.axes if not ax.has_data()]:
        ax.remove()
    places = [(row, column) for row in range(len(names)) for column in range(row + 1)]
    for ax, (row, column) in zip(figure.axes, places, strict=True):
        last = row == len(names) - 1
        ax.locator_params(nbins=3)
        ax.tick_params(labelbottom=last, labelleft=column == 0 and row > 0)
        if row == column:
            ax.set_yticks([])
        ax.set_xlabel(f"{names[column]} {bracket(unit_of(identification, names[column]))}" if last else "")
        density = "density" if row == 0 else f"{names[row]} {bracket(unit_of(identification, names[row]))}"
        ax.set_ylabel(density if column == 0 else "")


FIGURES = {
    "trace_emcee": trace_emcee,
    "trace_nuts": trace_nuts,
    "rank_emcee": rank_emcee,
    "rank_nuts": rank_nuts,
    "pair": pair,
}
