"""Table and figure of `seed_rivals.py`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from bayes_aero.inference.validation import KINDS
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import housed, panels


def table(rows: Sequence[dict]) -> None:
    """A line for each split and method: medians over initialisations, and the worst over the best of them."""
    print("CL / CD / Cm of all that was held out; seconds of the processor for one training")
    print(
        "| split | method | r | RMSE, 1e-3 | worst over best RMSE | log score | in 95 % | s | choosing | of GPR, MAP |"
    )
    print("|" + "---|" * 10)
    for kind in KINDS:
        of = {name: [r for r in rows if (r["split"], r["method"]) == (kind, name)] for name in methods_named(rows)}
        base = np.median([r["seconds"] for r in of["GPR, MAP"]])
        for name, own in of.items():
            if not own:
                continue
            each = {k: np.array([[r[c][k] for c in NAMES] for r in own]) for k in ("r", "rmse", "log", "coverage")}
            middle = {k: np.median(x, axis=0) for k, x in each.items()}
            worst = each["rmse"].max(axis=0) / each["rmse"].min(axis=0)
            seconds, choosing = (np.median([r[k] for r in own]) for k in ("seconds", "choosing"))
            cells = [kind, name, _three(middle["r"], ".3f"), _three(1e3 * middle["rmse"], ".1f")]
            cells += [_three(worst, ".2f") if len(own) > 1 else "-", f"{middle['log'].sum():.2f}"]
            cells += [_three(100.0 * middle["coverage"], ".0f"), f"{seconds:.2g}"]
            cells += [f"{choosing / seconds:.0%}", f"{seconds / base:.2g} x"]
            print("| " + " | ".join(cells) + " |")


def _three(values: Float[np.ndarray, " c"], digits: str) -> str:
    return " / ".join(format(x, digits) for x in values)


def methods_named(rows: Sequence[dict]) -> list[str]:
    return list(dict.fromkeys(r["method"] for r in rows))


@housed
def spread(rows: Sequence[dict]) -> Figure:
    """Hold-out error of every initialisation over that of maximum likelihood on the same split."""
    figure, axes = panels(1, len(NAMES), (11.0, 4.6), sharey=True)
    names = methods_named(rows)
    looks = dict(zip(KINDS, ((COLOURS["gpr"], "o"), (COLOURS["emcee"], "s"), (COLOURS["mle"], "D")), strict=True))
    for ax, coefficient in zip(axes[0], NAMES, strict=True):
        for offset, (kind, (colour, marker)) in zip((-0.22, 0.0, 0.22), looks.items(), strict=True):
            own = [r for r in rows if r["split"] == kind]
            base = np.median([r[coefficient]["rmse"] for r in own if r["method"] == "maximum likelihood"])
            x = [r[coefficient]["rmse"] / base for r in own]
            y = [names.index(r["method"]) + offset for r in own]
            ax.plot(x, y, marker, ms=4.0, mfc="none", color=colour, label=f"{kind} split")
        ax.axvline(1.0, color=COLOURS["measured"], lw=0.8, ls=":")
        ax.set(xscale="log", title=coefficient, xlabel="RMSE over that of maximum likelihood [-]")
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter(NullFormatter())
    axes[0, 0].set_yticks(range(len(names)), names)
    axes[0, 0].invert_yaxis()
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
