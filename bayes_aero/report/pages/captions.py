"""Captions and alternative texts of the figures: what each shows, in numbers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayes_aero.diagnosis.result import View
from bayes_aero.inference.results import Identification, Interval, Stall
from bayes_aero.report.figures.diagnosis import telling
from bayes_aero.report.figures.posterior import CORRELATIONS
from bayes_aero.report.html.page import Block, HtmlTable, Text
from bayes_aero.report.tables.comparison import engine_label, methods
from bayes_aero.report.text.identification import next_flight_sentences
from bayes_aero.report.text.phrases import WORDS, plus_minus, several
from bayes_aero.units import number

DEG = 180.0 / np.pi
CAPTIONS = WORDS["captions"]


def diagnosis_alternatives(view: View) -> dict[str, tuple[str, str]]:
    """Caption and alternative text by stem."""
    before, after, best = view.card.composition, view.extended.composition, telling(view)
    what = best.quantity.replace("_", " ")
    lags = several(f"{name} {numbers['lag1']:.2f} and {after[name]['lag1']:.2f}" for name, numbers in before.items())
    errors = several(f"{n} {numbers['rmse']:.4f} and {after[n]['rmse']:.4f}" for n, numbers in before.items())
    leading = {r.stage: several(f"{s.effect} {s.score:.1f}" for s in r.candidate_scores[:3]) for r in view.rankings}
    leaders = "; ".join(f"{stage}: {listed}" for stage, listed in leading.items())
    moves = [(abs(m.after - m.before) / max(m.sd_after, 1e-300), n, m) for n, m in view.moves.items()]
    far = sorted(moves, key=lambda move: -move[0])[:3]
    moved = several(f"{n} from {number(m.before)} to {number(m.after)}" for _, n, m in far)
    change = several(f"{note} with the {label}" for label, _, _, note in best.simulated)
    peaks, apart = [], []
    for label, s in view.stalls.items():
        X, ends = s.X[1][1], [f"{DEG * alpha:.1f} deg" for alpha in s.alpha[[0, -1]]]
        apart.append(f"In steady flow, {label} model: X from {X[0]:.2f} at {ends[0]} to {X[-1]:.2f} at {ends[1]}.")
        peaks.append(
            f"Steady maximum, {label} model: CL {interval(s.CL_max)} at {interval(s.alpha_max, DEG, 1)} deg."
            if s.seen
            else f"The {label} model's steady lift still rises at the edge of the angles flown."
        )
    texts = {
        "found": f"Time history of {what} for {best.manoeuvre}: {change}. Scores of the candidates, leading: "
        f"{leaders}.",
        "ranking": f"Bar chart of candidates' scores. Leading: {leaders}.",
        "gain": f"Bar chart of scores on hold-out data by cause. {gained(view)}",
        "moves": f"Dot plot of parameters before and after. Furthest: {moved}.",
        "residual_profiles": f"Binned residuals of {several(before)} over three channels each. RMSE before and after: "
        f"{errors}.",
        "residual_colour": f"Lag-1 correlation before and after: {lags}.",
        "stall_models": f"Hysteresis loops of CL over angle of attack, and polars. {' '.join(peaks)}",
        "separation_models": f"Separation point over angle of attack. {' '.join(apart)}",
        "measured_simulated": f"Time histories of {several(before)}. {what} of {best.manoeuvre}: {change}.",
    }
    return {stem: (CAPTIONS[stem].format(what, best.manoeuvre), text) for stem, text in texts.items()}


def gained(view: View) -> str:
    """R² of each coefficient on hold-out data before and after, where it changes."""
    if view.unseen_scores is None:
        return ""
    first, last = view.unseen_scores
    pairs = {n: (f"{first[n].r2:.3f}", f"{last[n].r2:.3f}") for n in first if n in last}
    moved = {n: pair for n, pair in pairs.items() if pair[0] != pair[1]}
    return several(f"{n} R² from {before} to {after}" for n, (before, after) in moved.items()) + "." if moved else ""


def identification_alternatives(run: Identification) -> dict[str, tuple[str, str]]:
    """Caption and alternative text of every figure, by stem."""
    mle, found, fitted = run.mle, methods(run), several(run.mle.fit)
    count, crb = f"{len(mle.names)} parameters", found[0].estimates
    wider = {m.label: [e.sd / crb[n].sd for n, e in m.estimates.items() if crb[n].sd > 0.0] for m in found[1:]}
    ratios = "; ".join(f"{label} {np.median(times):.2f} times" for label, times in wider.items() if times)
    estimates = zip(mle.names, mle.estimate, mle.crb_corrected, strict=True)
    numbers = "; ".join(f"{n} {plus_minus(x, sd)}" for n, x, sd in estimates)
    strong = "; ".join(f"{a} and {b} {r:+.2f}" for a, b, r in mle.strong_correlations()[:5]) or "none beyond 0.9"
    texts = {
        "forest": f"Forest plot of {count} by {len(found)} methods and {len(run.alone)} manoeuvres alone. Maximum "
        f"likelihood with corrected standard errors: {numbers}.",
        "next_flight": f"Forest plot of {count}. " + " ".join(next_flight_sentences(run)[:1]),
        "crb_vs_credible": "Dot plot, logarithmic: standard deviation over the Cramér–Rao one, median over parameters: "
        f"{ratios}.",
        "prior_posterior": f"Prior and posterior densities of {count}. The numbers are in the table of parameters.",
        "gp_prior_posterior": "Prior and posterior densities of the hyperparameters of the Gaussian processes of "
        f"{fitted}.",
        "pair": f"Matrix of scatter plots of posterior draws. Strongest correlations: {strong}.",
        "fig2_gpr_fit": "Time histories of measured coefficients and the Gaussian process's predictions; the table "
        "gives the scores.",
    }
    if run.stall is not None:
        s, X, alpha = run.stall, run.stall.X[1][1], DEG * np.asarray(run.observations.signals["alpha"])
        ends = [f"{DEG * angle:.1f} deg" for angle in s.alpha[[0, -1]]]
        what = "The steady lift still rises at the edge of the angles flown."
        if s.seen:
            what = f"The steady maximum is CL {interval(s.CL_max)} at {interval(s.alpha_max, DEG, 1)} deg."
        texts |= {
            "stall": f"Lift coefficient over angles of attack from {alpha.min():.1f} to {alpha.max():.1f} deg, a "
            f"hysteresis loop of measured points beside the fitted model. {what} Right: CL over CD.",
            "separation": f"Separation point over angle of attack. In steady flow X falls from {X[0]:.2f} at {ends[0]} "
            f"to {X[-1]:.2f} at {ends[1]}; at {s.rates[0] * DEG:.1f} deg/s it ends at {s.X[0][1][-1]:.2f}.",
        }
    words = {stem: (CAPTIONS[stem].format(fitted), text) for stem, text in texts.items()}
    for engine, posterior in run.posteriors.items():
        label, marginals = engine_label(engine), posterior.marginals.values()
        sizes = f"largest R-hat {max(m.rhat for m in marginals):.3f}, smallest bulk effective sample size "
        name = f"every parameter by {label}: {sizes}{min(m.ess_bulk for m in marginals):.0f}"
        for kind in ("trace", "rank"):
            words[f"{kind}_{engine}"] = CAPTIONS[kind].format(label), f"{kind.capitalize()} plots of {name}."
    for c, scores in mle.fit.items():
        text = f"Scatter plot of measured and predicted {c}; maximum likelihood on all samples correlates by "
        words[CORRELATIONS[c]] = CAPTIONS["correlation"].format(c), f"{text}{scores.r:.4f}."
    return words


# --- The stall in numbers.

MOST_PLACES = 6  # digits behind the point


def interval(value: Interval, factor: float = 1.0, places: int = 3) -> str:
    """Median and 95 % interval, with more digits where these many show no width."""
    low, middle, high = (factor * x for x in (value.low, value.median, value.high))
    while places < MOST_PLACES and low < high and f"{low:.{places}f}" == f"{high:.{places}f}":
        places += 1
    return f"{middle:.{places}f} ({low:.{places}f} to {high:.{places}f})"


def stall_table(stalls: Mapping[str, Stall], what: str) -> tuple[Block, ...]:
    """CLmax and its angle for each model, with a warning where the record does not show them."""
    rows, warnings = [], []
    for label, s in stalls.items():
        flown = f"{s.alpha[0] * DEG:.1f} to {s.alpha[-1] * DEG:.1f}"
        edge = f"{s.at_edge:.0%}" if s.at_edge in (0.0, 1.0) or s.at_edge >= 0.01 else "< 1%"
        peak, angle = interval(s.CL_max), interval(s.alpha_max, DEG, 1)
        if not s.seen:
            peak = f"at least {peak}"
            angle = "not shown by this record" if s.at_edge > 0.5 else f"at least {angle}"
            text = (
                f"{label[:1].upper() + label[1:]}: for {s.at_edge:.0%} of the draws CL still rises at the edge of the "
                "angles flown, so the record gives a lower limit of CLmax, not the stall angle."
            )
            warnings.append(Text(text, "warning"))
        rows.append((label, peak, angle, flown, edge))
    reference = next(iter(stalls.values())).reference
    shown = (("airspeed", "V", 1.0, "m/s"), ("mach", "Mach", 1.0, ""), ("elevator", "elevator", DEG, "deg"))
    held = [f"{name} {number(reference[key] * x)} {unit}".strip() for key, name, x, unit in shown if key in reference]
    table = HtmlTable(
        "Steady stall: highest lift coefficient and its angle of attack, with 95 % intervals",
        ("model", "CLmax [-]", "at α [deg]", "α flown [deg]", "maximum at\nthe edge"),
        tuple(rows),
        words=(1, 2),
        note=f"Steady means α̇ = 0 and no rotation, and the other inputs as near the largest lift ({', '.join(held)}). "
        f"{what} “Maximum at the edge” is the share of draws whose largest CL is at the last angle flown: the true "
        "maximum then lies beyond the record.",
    )
    return (table, *warnings)
