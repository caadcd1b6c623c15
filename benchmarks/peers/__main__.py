"""Against the peers, side by side in one run: the same data, model and stopping accuracy; a Markdown table comes out.

    OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/peers [RECORD ...] [--blocks fits ...] [--out FILE]

Without a record the simulated manoeuvres are used. `--quick` takes a minute and says nothing of speed. Peers come
with the `peers` extra; one that is not installed is told as such. Every contender is a process of its own, one after
the other, so that its peak memory is its own; a peer that does without JAX does not load it. This process imports
nothing but the standard library, for on Linux a child's peak memory begins at that of its parent.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

FITTED = (("first", "first call, s", ".3g"), ("warm", "warm, s", ".3g"), ("cost", "above the best, nats", ".1e"))
MEMORY = ("memory", "peak, MiB", ".0f")
DRAWN = (
    *FITTED[:2], ("ess", "least ESS", ".0f"), ("rhat", "worst R-hat", ".3f"), ("rate", "ESS a second", ".3g"),
    ("free", "the same, burn-in free", ".3g"), MEMORY,
)  # fmt: skip
SCIPY = ("scipy least_squares, trf", "scipy least_squares, lm")
BLOCKS = {  # title, contenders, columns: key, heading, format
    "fits": (
        "Maximum likelihood of the stall model",
        ("bayes_aero", "bayes_aero, with both bounds", *SCIPY),
        (*FITTED, MEMORY),
    ),
    "samplers": (
        "Posterior of the stall model, white noise",
        ("bayes_aero, emcee", "bayes_aero, NUTS", "emcee"),
        DRAWN,
    ),
    "processes": (
        "Exact GP of CL over alpha, elevator, q and V",
        ("bayes_aero", "scikit-learn", "tinygp"),
        (*FITTED, ("value", "log marginal likelihood", ".3f"), MEMORY),
    ),
}


def parsed() -> argparse.Namespace:
    """The command line; `--one` is for the processes that this one starts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("records", nargs="*", type=Path)
    parser.add_argument("--blocks", nargs="+", choices=list(BLOCKS), metavar="BLOCK",
                        help=f"of {', '.join(BLOCKS)}; all of them")  # fmt: skip
    parser.add_argument("--sizes", nargs="+", type=int, default=[500, 1000, 2000], help="samples of the GPs")
    parser.add_argument("--steps", type=int, default=3000, help="of the peers' ensembles")
    parser.add_argument("--repeats", type=int, default=7, help="warm runs, at most")
    parser.add_argument("--seconds", type=float, default=120.0, help="no warm run is begun beyond these")
    parser.add_argument("--quick", action="store_true", help="small sizes, one warm run: shows that everything works")
    parser.add_argument("--out", type=Path, help="where the table goes, too")
    parser.add_argument("--folder", type=Path, help="keeps the prepared data, which a run of the same ones reads again")
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    options.blocks = options.blocks or list(BLOCKS)
    if options.quick:
        options.sizes, options.steps, options.repeats, options.seconds = [60], 60, 1, 5.0
    missing = [str(path) for path in options.records if not path.is_file()]
    if missing:
        parser.error(f"no record at {', '.join(missing)}; give paths of records, or none for the simulated ones")
    return options


def child(options: argparse.Namespace, folder: Path, *one: str) -> dict:
    """What the process of one contender has found; {"failed": why} where it has not."""
    environment = dict(os.environ)
    if options.quick and "JAX_COMPILATION_CACHE_DIR" in environment:
        environment["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    elif not options.quick:
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)  # a first call compiles
    command = [sys.executable, str(Path(__file__).parent), *sys.argv[1:], "--folder", str(folder), "--one", *one]
    done = subprocess.run(command, check=False, stdout=subprocess.PIPE, text=True, env=environment)
    if done.returncode:
        return {"failed": f"ended with code {done.returncode}"}
    return json.loads(done.stdout.splitlines()[-1])


def prepared(options: argparse.Namespace, folder: Path) -> dict:
    """Facts of the data in `folder`, which are put there unless they are there."""
    facts = folder / "facts.json"
    asked = {"of": [str(path) for path in options.records], "sizes": options.sizes, "quick": options.quick}
    if facts.is_file():
        known = json.loads(facts.read_text())
        if asked.items() <= known.items():
            return known
        facts.unlink()
    folder.mkdir(parents=True, exist_ok=True)
    if "failed" in child(options, folder, "prepare", "", "0"):
        sys.exit("The data could not be prepared; see the message above.")
    return json.loads(facts.read_text())


def raced(options: argparse.Namespace, folder: Path) -> dict[tuple[str, int], dict[str, dict]]:
    """The numbers of every contender, by block and size."""
    found: dict[tuple[str, int], dict[str, dict]] = {}
    for block in options.blocks:
        for size in options.sizes if block == "processes" else [0]:
            rows = found[block, size] = {}
            for name in BLOCKS[block][1]:
                print(f"{block} {size or ''}: {name}", file=sys.stderr, flush=True)
                rows[name] = child(options, folder, block, name, str(size))
    return found


def page(found: dict[tuple[str, int], dict[str, dict]], facts: dict) -> str:
    """All tables as Markdown."""
    lines = [
        f"{facts['manoeuvres']} manoeuvres ({'records given' if facts['of'] else 'simulated'}), {facts['samples']} "
        f"samples, {facts['cores']} cores, Python {facts['python']}, JAX on {facts['device']}; models and densities of "
        f"both sides at most {facts['apart']:.0e} apart. Warm: median of the runs after the first, their number in "
        "brackets (0: the first had to do).",
        *(["", "**A quick run: it shows that everything works and says nothing of speed.**"] if facts["quick"] else []),
    ]
    for (block, size), rows in found.items():
        title, _, columns = BLOCKS[block]
        best = min((row["cost"] for row in rows.values() if "cost" in row), default=0.0)
        headings = ["", *(heading for _, heading, _ in columns)]
        lines += ["", f"### {title}{f', n = {size}' if size else ''}", "", f"| {' | '.join(headings)} |"]
        lines.append("|---" * len(headings) + "|")
        for name, row in rows.items():
            cells = [row["failed"]] if "failed" in row else [
                format(row[key] - (best if key == "cost" else 0.0), form) for key, _, form in columns
            ]  # fmt: skip
            if "runs" in row:
                cells[1] += f" ({row['runs']})"
            lines.append(f"| {' | '.join([name, *cells])} |")
    return "\n".join(lines)


def main() -> None:
    options = parsed()
    if options.one:
        from stall import run_one  # the only way to NumPy in this file

        print(json.dumps(run_one(*options.one, options)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        facts = prepared(options, folder)
        found = raced(options, folder)
    facts |= {"cores": os.cpu_count(), "python": platform.python_version()}
    text = page(found, facts)
    print(text)
    if options.out:
        options.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
