"""The table: every contender's numbers, and where a peer is ahead of us, by how much and why."""

from __future__ import annotations

import math
from dataclasses import dataclass

SAME = 1e-2  # nats within which two optima are one: a hundredth of what a standard deviation costs, and less
AHEAD = 1.05  # a peer is ahead where it is better by this factor
TARGET_ESS = 400  # as in bayes_aero.inference.results, which this file does without
FAR_APART = 0.3  # standard deviations between two means from which the draws are not of one posterior, or too few


@dataclass(frozen=True)
class Metric:
    """A column: its key, heading, format, whether more is better, and why a peer may be ahead in it."""

    key: str
    heading: str
    form: str
    more: bool = False
    why: str = ""  # empty: shown, but whether we lead is judged by what follows from it


@dataclass(frozen=True)
class Block:
    """A part of the table; its first contender is the one of ours that peers are compared with."""

    title: str
    contenders: tuple[str, ...]
    metrics: tuple[Metric, ...]
    sized: bool = False


FIRST = Metric("first", "first call, s", ".3g", why="ours is compiled in its first call, once a process")
MEMORY = Metric("memory", "peak, MiB", ".0f", why="JAX, its compiler and our own imports are loaded")
WARM = Metric("warm", "warm, s", ".3g", why="not explained yet")

COST = Metric("cost", "above the best, nats", ".1e", why="it is nearer the optimum")
DRAWS = (
    Metric("first", "first run, s", ".3g"),
    Metric("warm", "warm, s", ".3g"),
    Metric("ess", "least ESS", ".0f", more=True),
    Metric("rhat", "worst R-hat", ".3f"),
    Metric("rate", "ESS a second", ".3g", more=True, why="not explained yet"),
    Metric("free", "the same, burn-in free", ".3g", more=True, why="not explained yet"),
    MEMORY,
)

BLOCKS = {
    "fits": Block(
        "Maximum likelihood of the stall model",
        (
            "bayes_aero", "bayes_aero, with both bounds", "scipy least_squares, trf", "scipy least_squares, lm",
        ),
        (FIRST, WARM, COST, MEMORY),
    ),
    "samplers": Block(
        "Posterior of the stall model, white noise",
        ("bayes_aero, emcee", "bayes_aero, NUTS", "emcee"),
        DRAWS,
    ),
    "processes": Block(
        "Exact GP of CL over alpha, elevator, q and V",
        ("bayes_aero", "scikit-learn", "tinygp"),
        (
            FIRST, WARM,
            Metric("value", "log marginal likelihood", ".3f", more=True),
            Metric("cost", "below the best, nats", ".1e", why="another local optimum of the same likelihood"),
            MEMORY,
        ),
        sized=True,
    ),
    "jet": Block(
        "Output error of a small jet, 600 samples, 11 parameters",
        (
            "bayes_aero", "scipy least_squares, trf", "scipy least_squares, lm", "aeroid, its differences",
            "aeroid, JAX gradient", "the same, kept compiled by us",
        ),
        (FIRST, WARM, COST, MEMORY),
    ),
}  # fmt: skip

WHY = {  # of one contender, before what is said of its metric
    ("tinygp", "warm"): "with few samples the calls cost more than the matrices, and ours are two searches in Python, "
    "one inside the other",
    ("the same, kept compiled by us", "warm"): "it has 11 unknowns and known weights, ours 15 and finds the weights",
}

SAYS = {
    "fits": """All start from the card and end at one optimum; peers are given its residual covariance as weights, which
ours has to find. Cost: (n/2) log det R above the best of the table.""",
    "samplers": """Same log-density and ball of starts; ours runs until its targets (ESS 400, R-hat 1.01) are met, peers
a fixed number of steps. In `burn-in free` the peers' burn-in of five autocorrelation times costs no time; ours counts.
Ours runs its ensembles and chains on all cores, a peer on one.""",
    "processes": """Same kernel, start, data and stop of L-BFGS-B; maximum marginal likelihood without priors, evaluated
for all by one textbook formula.""",
    "jet": """SciPy is given the weights of the optimum, aeroid the initial state, too; ours has to find both. With JAX
aeroid compiles in every call, as a user of `identify` has it; in the last row it keeps that, changed from outside.""",
}
NOT_RUN = """GPflow is not raced: it needs TensorFlow. GPJax is not either: its exact GP is the same JAX program as
tinygp's. aeroid has no algebraic model of coefficients, so it
runs on trajectories."""


def page(found: dict[tuple[str, int], dict[str, dict]], facts: dict) -> str:
    """All tables as Markdown."""
    what = f"{facts['manoeuvres']} manoeuvres ({'records given' if facts['of'] else 'simulated'})"
    lines = [
        f"{what}, {facts['samples']} samples, {facts['cores']} cores, Python {facts['python']}, JAX on "
        f"{facts['device']}; models and densities of both sides at most {facts['apart']:.0e} apart. Warm: median of "
        "the runs after the first, their number in brackets (0: the first had to do).",
    ]
    if facts["quick"]:
        lines += ["", "**A quick run: it shows that everything works and says nothing of speed.**"]
    for (block, size), rows in found.items():
        title = BLOCKS[block].title + (f", n = {size}" if size else "")
        lines += ["", f"### {title}", "", *SAYS[block].splitlines(), "", *table(BLOCKS[block], rows)]
    return "\n".join([*lines, "", *NOT_RUN.splitlines()])


def table(block: Block, rows: dict[str, dict]) -> list[str]:
    """The lines of one table."""
    costs = [row["cost"] for row in rows.values() if "cost" in row]
    for row in rows.values():
        if "cost" in row:
            row["cost"] = max(row["cost"] - min(costs), 0.0)
    ours = rows[block.contenders[0]]
    headings = ["", *(m.heading for m in block.metrics), "where we do not lead, and why"]
    lines = ["| " + " | ".join(headings) + " |", "|---" * len(headings) + "|"]
    for name, row in rows.items():
        if "failed" in row:
            cells = ["-"] * len(block.metrics) + [row["failed"]]
        else:
            cells = [shown(m, row) for m in block.metrics] + [ahead(block, name, row, ours)]
        lines.append("| " + " | ".join([name, *cells]) + " |")
    return lines


def shown(metric: Metric, row: dict) -> str:
    """One cell."""
    text = format(row[metric.key], metric.form)
    return f"{text} ({row['runs']})" if metric.key == "warm" else text


def ahead(block: Block, name: str, row: dict, ours: dict) -> str:
    """In which metrics a peer is ahead of our first row, and why; and what makes its row not comparable."""
    if name.startswith("bayes_aero"):
        return ""
    if "failed" in ours:
        return "nothing of ours to compare with"
    said = []
    for metric in block.metrics:
        mine, theirs = ours[metric.key], row[metric.key]
        if not metric.why or (metric.key == "cost" and mine - theirs < SAME):
            continue
        better = theirs / mine if metric.more else mine / theirs if theirs > 0.0 else math.inf
        if better > AHEAD:
            times = f"{better:.1f} x" if math.isfinite(better) else "the best"
            why = WHY.get((name, metric.key), metric.why)
            said.append(f"{metric.heading.split(',')[0]} ({times}): {why}")
    if "mean" in row:
        apart = max(abs(a - b) / s for a, b, s in zip(row["mean"], ours["mean"], ours["sd"], strict=True))
        if apart > FAR_APART:
            said.append(f"its means are {apart:.1f} deviations from ours: its run is too short to compare")
    if "cost" in row and row["cost"] - ours["cost"] > SAME:
        said.append(f"it ends {row['cost'] - ours['cost']:.2g} nats short of ours, in a lesser optimum or before it")
    if row.get("ess", math.inf) < TARGET_ESS:
        said.append(f"its draws miss the ESS of {TARGET_ESS} at which ours stops")
    return "; ".join(said) or "we lead"
