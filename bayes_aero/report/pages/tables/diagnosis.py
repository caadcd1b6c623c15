"""Tables of a diagnosis for the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayes_aero.diagnosis.result import Cause, Diagnosis
from bayes_aero.diagnosis.settings import ENOUGH
from bayes_aero.diagnosis.view.results import LEVELS, HoldoutScores, View
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.report.html.page import Block, Table, Text
from bayes_aero.report.html.parts import number
from bayes_aero.report.tables.comparison import decimals
from bayes_aero.report.text.diagnosis import probability
from bayes_aero.report.text.phrases import bracket, for_people, several, size_text

PREDICTORS = {
    "card": "card's model",
    "gp": "Gaussian process alone",
    "extended": "extended model",
    "extended_gp": "extended model + Gaussian process of its residuals",
}


def causes(d: Diagnosis) -> Table:
    """Each cause with its meaning, size, probability, rivals and the loss of hold-out prediction without it."""
    asked = any(np.isfinite(c.missed[0]) for c in d.causes)
    head = ["cause", "what it means", "size", "95 % interval", "probability", "p"]
    head += ["hold-out data\nif removed"] if asked else []
    head += ["rivals"]
    rows = []
    for c in d.causes:
        row = [c.name, c.claim, _sizes(c), _intervals(c), probability(c.probability), number(c.p_value, 2)]
        if asked:
            said = f"{-c.missed[0]:+.1f} ± {c.missed[1]:.1f}" if np.isfinite(c.missed[0]) else "–"
            row.append(said if c.confirmed else f"{said} *")
        rows.append((*row, several(c.ambiguous_with) or "–"))
    return Table(
        "Causes, in the order of selection",
        tuple(head),
        tuple(rows),
        words=(1,),
        note="Hold-out data if removed: the change of their log density. *: no significant loss (one-sided, 5 %), "
        "so not "
        "confirmed: named, but not in the extended model.",
    )


def _sizes(c: Cause) -> str:
    several_names = len(c.parameters) > 1
    return "; ".join(
        f"{f'{name} ' if several_names else ''}{size_text(s.mean, s.sd, s.unit).replace('c/V', 'chords')}"
        for name, s in c.parameters.items()
    )


def _intervals(c: Cause) -> str:
    texts = []
    for s in c.parameters.values():
        factor = for_people(s.unit)[1]
        places = decimals(factor * s.sd) if s.sd > 0.0 else 4
        texts.append(f"{factor * s.ci95[0]:.{places}f} to {factor * s.ci95[1]:.{places}f}")
    return "; ".join(texts)


def separating(found: Sequence[Mapping[str, Any]]) -> list[Block]:
    """Which standard manoeuvres would separate rivals."""
    blocks: list[Block] = []
    for one in found:
        if not one["manoeuvres"]:
            blocks.append(Text(f"{str(one['status'])[:1].upper()}{str(one['status'])[1:]}."))
            continue
        rows = tuple(
            (str(m["manoeuvre"]).replace("_", " "), f"{m['standard_errors']:.1f}") for m in one["manoeuvres"][:5]
        )
        blocks += [
            Table(
                f"Manoeuvres that would separate {several(one['effects'])}",
                ("manoeuvre", "separation\n[standard errors]"),
                rows,
                note=f"{ENOUGH:.0f} standard errors or more would be sufficient. "
                f"{str(one['status'])[:1].upper()}{str(one['status'])[1:]}.",
            )
        ]
    return blocks


def by_manoeuvre(unseen: HoldoutScores) -> Table:
    """Both models on each hold-out manoeuvre, and whether the difference is significant."""
    rows = []
    for k, manoeuvre in enumerate(unseen.names):
        before, after = (unseen.scores[model, "hold_out", k] for model in ("card", "extended"))
        for name in NAMES:
            gain = unseen.gains[manoeuvre, name]
            change = f"{gain.r2:+.3f} ± {gain.r2_sd:.3f}", f"{gain.elpd:+.1f} ± {gain.elpd_sd:.1f}"
            rows.append((manoeuvre, name, f"{before[name].r2:.3f}", f"{after[name].r2:.3f}", *change))
    worse = several(f"{name} of {manoeuvre}" for manoeuvre, name in unseen.worse())
    return Table(
        "Hold-out manoeuvres: the card's model and the extended model",
        ("manoeuvre", "coefficient", "R²\ncard", "R²\nextended", "change of R²", "log density\ngained"),
        tuple(rows),
        note="± is one standard error, autocorrelation included. Log density: natural logarithm of the "
        "probability density of the hold-out data; 3 more make them 20 times as probable. R² weighs every sample alike "
        "and depends on the few of the deepest stall; the log density includes the noise growth in separated flow. "
        + (f"The log density decreases significantly (one-sided, 5 %) for {worse}." if worse else NOWHERE_WORSE),
    )


NOWHERE_WORSE = "The log density decreases significantly (one-sided, 5 %) for no manoeuvre."


def moved(view: View) -> Table:
    """The card's own parameters before and after."""
    rows = []
    for name, m in view.moves.items():
        unit, factor = for_people(m.unit)
        before = size_text(factor * m.before, factor * m.sd_before, "1")
        after = size_text(factor * m.after, factor * m.sd_after, "1")
        change = (m.after - m.before) / m.sd_after if m.sd_after > 0.0 else float("nan")
        rows.append((f"{name} {bracket('chords' if unit == 'c/V' else unit)}", before, after, f"{change:+.1f}"))
    return Table(
        "The card's parameters, fitted without and with the causes",
        ("parameter", "card's model", "extended model", "change\n[standard errors]"),
        tuple(rows),
        note="± is one standard error, autocorrelation included.",
    )


def predictors(found: Mapping[str, Any]) -> Table:
    """R2, RMSE and coverage of every predictor on hold-out data."""
    groups, head = [("", 1)], ["predictor"]
    for name in NAMES:
        groups.append((name, 3))
        head += ["R²", "RMSE [-]", "inside\n95 %"]
    rows = []
    for key, row in found.items():
        cells = [PREDICTORS.get(key, key)]
        for name in NAMES:
            s = row.get(name)
            cells += ["–"] * 3 if s is None else [f"{s['r2']:.3f}", f"{s['rmse']:.4f}", f"{s['coverage95']:.0%}"]
        rows.append(tuple(cells))
    return Table(
        "Predictors on hold-out data, 5 Hz means",
        tuple(head),
        tuple(rows),
        tuple(groups),
        note="“Inside 95 %” is the share of samples inside the predictor's 95 % interval; far below 95 % the interval "
        "is too narrow.",
    )


def residuals(view: View) -> Table:
    """Each coefficient's residuals before and after: scores, Theil's parts, autocorrelation."""
    models = [("card's", view.card)] + ([("extended", view.extended)] if view.changed else [])
    found = {label: fitted.composition for label, fitted in models}
    rows = []
    for name in NAMES:
        for label, numbers in found.items():
            n = numbers[name]
            rows.append(
                (
                    f"{name}, {label}",
                    f"{n['r2']:.3f}",
                    f"{n['rmse']:.4f}",
                    f"{n['theil']:.3f}",
                    *(f"{n[f'theil_{part}']:.0%}" for part in ("bias", "variance", "covariance")),
                    f"{n['lag1']:+.2f}",
                )
            )
    return Table(
        "Residuals at the recorded rate, all manoeuvres fitted jointly",
        ("", "R²", "RMSE [-]", "Theil U", "bias", "variance", "covariance", "lag-1\ncorrelation"),
        tuple(rows),
        (("", 4), ("Theil's shares of the squared error", 3), ("", 1)),
        note="A good model leaves covariance only (noise): bias is a constant offset, variance a wrong amplitude.",
    )


def calibration(view: View) -> Table:
    """Share of residuals inside the noise model's bands."""
    models = [("card's", view.card)] + ([("extended", view.extended)] if view.changed else [])
    found = {label: fitted.composition for label, fitted in models}
    rows = tuple(
        (f"{name}, {label}", *(f"{numbers[name]['calibration'][f'{level:g}']:.0%}" for level in LEVELS))
        for name in NAMES
        for label, numbers in found.items()
    )
    return Table(
        "Calibration: share of 5 Hz residuals inside the fitted noise's bands",
        ("", *(f"{level:.0%}".replace("%", " %") for level in LEVELS)),
        rows,
        note="A right noise model shows the heading's share in each column.",
    )
