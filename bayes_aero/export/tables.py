"""The model as tables for linear interpolation over the flown region.

A coefficient is a sum of terms that depend on few channels each. Terms of the same channels make one table, so that no
table has all channels of the model as axes. The separation point is a function of the incidence, which is such a sum.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayes_aero.atomic_write import write_whole
from bayes_aero.effect import Example, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.export.identified import Identified, about, meaning, unit
from bayes_aero.export.program import Operand, Program, terms
from bayes_aero.model.model import Model

ACCURACY = 1e-4  # of a table's range, of linear interpolation along each axis
MOST_CELLS = 1_000_000
MOST_WITH_DRAWS = 20_000_000
POINT_RANGE = (0.0, 1.0)
INCIDENCE = "incidence"


@dataclass(frozen=True)
class Gridded:
    """One table: the sum of its `parts` (sign and operand of the program) over `axes`; `error` is of interpolation."""

    name: str
    output: str
    parts: tuple[tuple[float, Operand], ...]
    axes: Mapping[str, Float[np.ndarray, " n"]]
    values: Float[np.ndarray, "*n"]
    error: float


def tables_of(found: Identified) -> Iterator[Gridded]:
    """Tables whose sums are the coefficients and the incidence; the static separation point and its lag.

    Raises:
        InputError: the result does not say where was flown, or a table needs too many points.
    """
    program = program_by_incidence(found)
    reach: dict[str, list[Gridded]] = {}
    for output in sorted(program.outputs, key=lambda name: not name.startswith(INCIDENCE)):
        summed = output in found.exported.coefficients or output.startswith(INCIDENCE)
        parts = tuple(terms(program, output)) if summed else ((1.0, program.outputs[output]),)
        groups: dict[tuple[str, ...], list[tuple[float, Operand]]] = {}
        for sign, operand in parts:
            groups.setdefault(_read_by(program, operand), []).append((sign, operand))
        for inputs, own in groups.items():
            bounds = {axis: _incidences(reach) if axis == INCIDENCE else _range(found, axis) for axis in inputs}
            table = _gridded(found, program, output, bounds, tuple(own))
            reach.setdefault(output, []).append(table)
            yield table


def program_by_incidence(found: Identified) -> Program:
    """Coefficients at given separation points, the incidence of each point, and the static point at an incidence."""
    probe = _only(found.exported, Stage.SEPARATION, lambda _v, _s, _a, known: {"X": known[INCIDENCE] - 1.0})
    given = _only(found.exported, Stage.INCIDENCE, lambda _v, s, *_: {INCIDENCE: s[INCIDENCE] - s["alpha"]})
    names = {point: point.replace("X", INCIDENCE) for point in found.points}

    def outputs(values: Any, signals: Any, aircraft: Any, states: Any) -> dict[str, Any]:
        total = found.coefficients(values, signals, aircraft, [states[n] for n in found.points])
        if not found.separates:
            return total
        total |= dict(zip(names.values(), probe.static_points(values, signals, aircraft), strict=True))
        there = dict(signals) | {INCIDENCE: states[INCIDENCE]}
        total["X_static"] = given.static_points(values, there, aircraft)[0]
        return total | found.lag(values, signals, aircraft)

    return found.traced(outputs, (*found.points, INCIDENCE) if found.separates else ())


def _only(model: Model, stage: Stage, increments: Any) -> Model:
    """The model with one effect in place of all of a stage."""
    others = tuple(e for e in model.effects if e.stage is not stage)
    example = Example({}, {}, {"X": 0.0}, "stands for all effects of its stage")
    pattern = CATALOGUE["kirchhoff_lift"]
    one = replace(pattern, name="given", stage=stage, increments=increments, uses=(), channels=(), example=example)
    return replace(model, effects=(*others, one))


def write_tables(found: Identified, folder: Path) -> tuple[str, ...]:
    """Write tables.nc, and a CSV file of each table; the names of the files."""
    made, files = list(tables_of(found)), []
    sets = {table.name: _dataset(found, table) for table in made}
    root = xr.Dataset(attrs={"about": "\n".join(about(found)), "sum": "a coefficient is the sum of its tables"})
    tree = xr.DataTree.from_dict({"/": root, **sets})
    write_whole(tree.to_netcdf(engine="h5netcdf"), folder / "tables.nc")
    for table in made:
        file = f"{table.name}.csv"
        write_whole(_frame(table).to_csv(index=False, float_format="%.12g"), folder / file)
        files.append(file)
    return ("tables.nc", *files)


def _read_by(program: Program, operand: Operand) -> tuple[str, ...]:
    """Signals and states on which an operand depends, without their kind."""
    part = program.giving({"": operand})
    return (*part.inputs_of("signal"), *part.inputs_of("state"))


def _gridded(
    found: Identified,
    program: Program,
    output: str,
    bounds: Mapping[str, tuple[float, float]],
    parts: tuple[tuple[float, Operand], ...],
) -> Gridded:
    """A table whose axes are refined until linear interpolation is accurate."""
    part = program.giving({str(i): operand for i, (_, operand) in enumerate(parts)})
    name = "_".join([output, *bounds])
    axes = {axis: np.array(x) for axis, x in bounds.items()}
    fixed = found.inputs

    def values() -> Float[np.ndarray, "*n"]:
        return _evaluated(part, parts, axes, fixed)

    while True:
        table = values()
        allowed = max(ACCURACY * float(np.ptp(table)), 1e-12) if table.size else 0.0
        errors = {axis: _errors(part, parts, axes, fixed, table, axis) for axis in axes}
        if all(np.all(x <= allowed) for x in errors.values()):
            return Gridded(name, output, parts, dict(axes), table, sum((float(x.max()) for x in errors.values()), 0.0))
        for axis, error in errors.items():
            between = 0.5 * (axes[axis][1:] + axes[axis][:-1])
            axes[axis] = np.sort(np.concatenate([axes[axis], between[error > allowed]]))
        if np.prod([len(x) for x in axes.values()]) > MOST_CELLS:
            raise InputError(
                f"the table of {output} over {', '.join(bounds)} needs more than {MOST_CELLS} points; export --to "
                "python, fmu or jsbsim instead"
            )


def _evaluated(
    part: Program,
    parts: Sequence[tuple[float, Operand]],
    axes: Mapping[str, Float[np.ndarray, " n"]],
    fixed: Mapping[str, Any],
) -> Float[np.ndarray, "*n"]:
    grid = dict(zip(axes, np.meshgrid(*axes.values(), indexing="ij"), strict=True)) if axes else {}
    given = dict(fixed) | {f"{kind}.{name}": x for name, x in grid.items() for kind in ("signal", "state")}
    terms_by_number = part.evaluated(given)
    total = sum(sign * terms_by_number[str(i)] for i, (sign, _) in enumerate(parts))
    return np.broadcast_to(np.asarray(total, dtype=float), [len(x) for x in axes.values()]).copy()


def _errors(
    part: Program,
    parts: Sequence[tuple[float, Operand]],
    axes: Mapping[str, Float[np.ndarray, " n"]],
    fixed: Mapping[str, Any],
    table: Float[np.ndarray, "*n"],
    axis: str,
) -> Float[np.ndarray, " m"]:
    """Largest error of linear interpolation half way between each two points of an axis."""
    points, k = axes[axis], list(axes).index(axis)
    between = dict(axes) | {axis: 0.5 * (points[1:] + points[:-1])}
    low, high = np.take(table, range(len(points) - 1), axis=k), np.take(table, range(1, len(points)), axis=k)
    error = np.abs(_evaluated(part, parts, between, fixed) - 0.5 * (low + high))
    return error.max(axis=tuple(i for i in range(error.ndim) if i != k))


def _incidences(reach: Mapping[str, Sequence[Gridded]]) -> tuple[float, float]:
    """Lowest and highest incidence of any separation point."""
    sums = [
        [(t.values.min(), t.values.max()) for t in tables] for n, tables in reach.items() if n.startswith(INCIDENCE)
    ]
    low, high = (np.array([np.sum([pair[k] for pair in one]) for one in sums]) for k in (0, 1))
    return float(low.min()), float(high.max())


def _range(found: Identified, axis: str) -> tuple[float, float]:
    if axis in found.points:
        return POINT_RANGE
    if axis not in found.flown:
        raise InputError(
            f"{found.name}: the flown range of {axis} is not known, so tables have no bounds; export a result of "
            "identify, fly or diagnose of this version"
        )
    low, high = found.flown[axis]
    return (low, high) if high > low else (low - 1e-6, high + 1e-6)


def _dataset(found: Identified, table: Gridded) -> xr.Dataset:
    """The table with units, its error, and its values for each draw."""
    dims = tuple(table.axes)
    unit_of = _unit_of(table.output)
    about_table = {"units": unit_of, "output": table.output, "interpolation_error": table.error}
    coords = {n: (n, x, {"units": _unit_of(n), "long_name": meaning(n)}) for n, x in table.axes.items()}
    data: dict[str, Any] = {"value": (dims, table.values, about_table)}
    drawn = found.draws
    if drawn is not None:
        if table.values.size * len(drawn.values) > MOST_WITH_DRAWS:
            raise InputError(f"table {table.name} with {len(drawn.values)} draws is too large; give fewer --draws")
        program = program_by_incidence(found)
        part = program.giving({str(i): operand for i, (_, operand) in enumerate(table.parts)})
        each = [
            _evaluated(
                part,
                table.parts,
                table.axes,
                found.inputs | {f"parameter.{n}": x for n, x in zip(drawn.names, row, strict=True)},
            )
            for row in drawn.values
        ]
        data["draws"] = (("draw", *dims), np.stack(each), {"units": unit_of, "origin": drawn.origin})
    return xr.Dataset(data, coords=coords)


def _unit_of(name: str) -> str:
    if name.startswith(INCIDENCE):
        return "rad"
    return "s" if name == "lag" else unit(name) or "1"


def _frame(table: Gridded) -> pd.DataFrame:
    """A row for each point: axes, with their units, and the value."""
    grid = np.meshgrid(*table.axes.values(), indexing="ij") if table.axes else []
    columns = {f"{name} [{_unit_of(name)}]": x.ravel() for name, x in zip(table.axes, grid, strict=True)}
    return pd.DataFrame(columns | {f"{table.output} [{_unit_of(table.output)}]": table.values.ravel()})
