"""The stall: recorded lift and drag with the steady curves, and the separation point with its band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_aero.diagnosis.view.results import Fitted, View
from bayes_aero.inference.identification import Identification, Stall
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import PHONE, NotDrawn, housed, panels

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
    o = identification.observations
    return [
        StallData(
            "",
            COLOURS["mle"],
            np.rad2deg(np.asarray(o.signals["alpha"])),
            np.asarray(o.signals["alpha_dot"]) > 0.0,
            np.asarray(o.measured),
            identification.fitted,
            o.manoeuvre,
            o.dt,
            identification.stall,
        )
    ]


def of_view(view: View) -> list[StallData]:
    """The card's model, and the extended one where there is one; each with the sensors as it corrects them."""
    if not view.stalls:
        raise NotDrawn("the stall was not computed")
    models: list[tuple[str, str, str, Fitted]] = [("card", "card's model", COLOURS["before"], view.card)]
    if "extended" in view.stalls:
        models.append(("extended", "extended model", COLOURS["after"], view.extended))
    return [
        StallData(
            label,
            colour,
            np.rad2deg(fitted.signals["alpha"]),
            fitted.signals["alpha_dot"] > 0.0,
            fitted.signals["measured"],
            fitted.signals["modelled"],
            view.manoeuvre,
            view.seconds,
            view.stalls[key],
        )
        for key, label, colour, fitted in models
    ]


@housed
def stall(identification: Identification) -> Figure:
    """Lift over the angle of attack, where the time was spent, and the polar."""
    return _stall(of_identification(identification))


@housed
def stall_narrow(identification: Identification) -> Figure:
    """`stall` for a phone: one panel below the other."""
    figure, axes = panels(3, 1, (PHONE, 8.4), height_ratios=(4, 1, 3))
    lift, time, polar = axes[:, 0]
    _fill(lift, time, polar, of_identification(identification)[0])
    _keys(figure, [lift], 2)
    return figure


@housed
def stall_models(view: View) -> Figure:
    """The same of the card's model and of the extended one."""
    return _stall(of_view(view))


@housed
def separation(identification: Identification) -> Figure:
    """The separation point over the angle of attack at three rates of it."""
    return _separation(of_identification(identification))


@housed
def separation_models(view: View) -> Figure:
    """The same of the card's model and of the extended one."""
    return _separation(of_view(view))


def _stall(models: list[StallData]) -> Figure:
    rows = len(models)
    figure, axes = panels(2 * rows, 2, (10.5, 5.0 * rows + 0.7), height_ratios=(4, 1) * rows, width_ratios=(3, 2))
    for number, flown in enumerate(models):
        (lift, polar), (time, spare) = axes[2 * number], axes[2 * number + 1]
        spare.remove()
        _fill(lift, time, polar, flown)
    _keys(figure, list(axes[::2, 0]), 3)
    return figure


def _fill(lift: Axes, time: Axes, polar: Axes, flown: StallData) -> None:
    _lift(lift, flown)
    _time_spent(time, flown)
    time.sharex(lift)
    lift.tick_params(labelbottom=False)
    _polar(polar, flown)


def _keys(figure: Figure, axes: list[Axes], columns: int) -> None:
    """One legend for all models."""
    entries: dict[str, Artist] = {}
    for ax in axes:
        handles, labels = ax.get_legend_handles_labels()
        entries = dict(zip(labels, handles, strict=True)) | entries
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=columns)


def _lift(ax: Axes, flown: StallData) -> None:
    s = flown.stall
    for key, mask in (("rising", flown.rising), ("falling", ~flown.rising)):
        ax.plot(
            flown.alpha[mask], flown.measured[mask, 0], ".", ms=2.5, alpha=0.5, color=COLOURS[key],
            label=f"measured, α {key}",
        )  # fmt: skip
    for k in range(int(flown.manoeuvre[-1]) + 1):
        mine = flown.manoeuvre == k
        label = "fitted, as flown" if k == 0 else None
        ax.plot(flown.alpha[mine], flown.modelled[mine, 0], color="#555555", lw=0.5, alpha=0.8, label=label)
    degrees, whose = np.rad2deg(s.alpha), f", {flown.title}" if flown.title else ""
    ax.fill_between(degrees, s.CL[0], s.CL[2], color=flown.colour, label=f"steady flow, 95 % band{whose}", **BAND)
    ax.plot(degrees, s.CL[1], color=flown.colour, lw=1.8, label=f"steady flow (α̇ = 0){whose}")
    _peak(ax, flown)
    ax.set_ylabel("CL [-]")
    ax.set_title(f"Lift{f', {flown.title}' if flown.title else ''}")


def _peak(ax: Axes, flown: StallData) -> None:
    s = flown.stall
    if not s.seen:
        note = (
            "no maximum inside\nthe angles flown" if s.at_edge > 0.5 else "maximum near the edge\nof the angles flown"
        )
        ax.text(0.97, 0.05, note, transform=ax.transAxes, ha="right", fontsize=8.5)
        return
    x, y = np.rad2deg(s.alpha_max.median), s.CL_max.median
    low, high = np.rad2deg([s.alpha_max.low, s.alpha_max.high])
    ax.errorbar(
        x, y, xerr=[[x - low], [high - x]], yerr=[[y - s.CL_max.low], [s.CL_max.high - y]], fmt="o", ms=5.0,
        color="black", mec="white", capsize=3.0, zorder=6, label="CLmax and its angle, 95 %",
    )  # fmt: skip
    ax.text(0.97, 0.05, f"CLmax {y:.3f}\nat {x:.1f} deg", transform=ax.transAxes, ha="right", fontsize=9.5)


def _time_spent(ax: Axes, flown: StallData) -> None:
    edges = np.arange(np.floor(flown.alpha.min()), np.ceil(flown.alpha.max()) + 1.0)
    weights = np.full(len(flown.alpha), flown.seconds)
    ax.hist(flown.alpha, bins=edges, weights=weights, color="#9fb8c9")
    ax.set_xlabel("α [deg]")
    ax.set_ylabel("time [s/deg]")


def _polar(ax: Axes, flown: StallData) -> None:
    s = flown.stall
    for key, mask in (("rising", flown.rising), ("falling", ~flown.rising)):
        ax.plot(flown.measured[mask, 1], flown.measured[mask, 0], ".", ms=2.0, alpha=0.5, color=COLOURS[key])
    ax.plot(s.CD[1], s.CL[1], color=flown.colour, lw=1.8)
    if s.seen:
        at = int(np.argmax(s.CL[1]))
        ax.plot(s.CD[1][at], s.CL[1][at], "o", ms=5.0, color="black", mec="white", zorder=6)
    ax.set_xlabel("CD [-]")
    ax.set_ylabel("CL [-]")
    ax.set_title(f"Drag polar{f', {flown.title}' if flown.title else ''}")


def _separation(models: list[StallData]) -> Figure:
    figure, axes = panels(1, len(models), (6.2 * len(models) if len(models) > 1 else 7.5, 4.2), sharey=True)
    for ax, flown in zip(axes[0], models, strict=True):
        s = flown.stall
        degrees = np.rad2deg(s.alpha)
        for rate, band, key in zip(s.rates, s.X, RATE_COLOURS, strict=True):
            ax.fill_between(degrees, band[0], band[2], color=COLOURS[key], **BAND)
            label = f"α̇ = {np.rad2deg(rate):+.1f} deg/s" if rate else "α̇ = 0 (steady)"
            dash = "--" if rate > 0.0 else "-"
            ax.plot(degrees, band[1], color=COLOURS[key], ls=dash, lw=1.5, label=label)
        ax.plot(flown.alpha, np.full_like(flown.alpha, -0.04), "|", ms=4.0, alpha=0.08, color="black")
        ax.set_xlabel("α [deg]")
        ax.set_ylim(-0.07, 1.05)
        ax.set_title(flown.title or "Separation point")
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 0.08))
    axes[0, 0].set_ylabel("separation point X [-] (1 attached, 0 separated)")
    return figure


FIGURES = {"stall": stall, "stall_narrow": stall_narrow, "separation": separation}
DIAGNOSIS_FIGURES = {"stall_models": stall_models, "separation_models": separation_models}
