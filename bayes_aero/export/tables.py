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
from bayes_aero.export.identified import Identified, Operand, Program, about, meaning, terms, unit
from bayes_aero.model.model import Model

ACCURACY = 1e-4  # of a table's range, of linear interpolation along each axis
MOST_CELLS = 1_000_000
MOST_WITH_DRAWS = 20_000_000
INCIDENCE = "incidence"

Axes = Mapping[str, Float[np.ndarray, " n"]]


@dataclass(frozen=True)
class Gridded:
    """One table over `axes`: the sum of the outputs of `program` with their `signs`; `error` is of interpolation."""

    name: str
    output: str
    signs: tuple[float, ...]
    program: Program
    axes: Axes
    values: Float[np.ndarray, "*n"]
    error: float = 0.0

    def at(self, axes: Axes, inputs: Mapping[str, Any]) -> Float[np.ndarray, "*n"]:
        grid = dict(zip(axes, np.meshgrid(*axes.values(), indexing="ij"), strict=True)) if axes else {}
        given = dict(inputs) | {f"{kind}.{name}": x for name, x in grid.items() for kind in ("signal", "state")}
        summands = self.program.evaluated(given)
        total = sum(sign * summands[str(i)] for i, sign in enumerate(self.signs))
        return np.broadcast_to(np.asarray(total, dtype=float), [len(x) for x in axes.values()]).copy()


def tables_of(identified: Identified) -> Iterator[Gridded]:
    """Tables whose sums are the coefficients and the incidence; the static separation point and its lag."""
    program = program_by_incidence(identified)
    incidences: dict[str, list[Gridded]] = {}
    for output in sorted(program.outputs, key=lambda name: not name.startswith(INCIDENCE)):
        summed = output in identified.exported.coefficients or output.startswith(INCIDENCE)
        parts = tuple(terms(program, output)) if summed else ((1.0, program.outputs[output]),)
        groups: dict[tuple[str, ...], list[tuple[float, Operand]]] = {}
        for sign, operand in parts:
            part = program.giving({"": operand})  # what it depends on decides on its table
            groups.setdefault((*part.inputs_of("signal"), *part.inputs_of("state")), []).append((sign, operand))
        for inputs, summands in groups.items():
            axes = {axis: np.array(_range(identified, axis, incidences)) for axis in inputs}
            part = program.giving({str(i): operand for i, (_, operand) in enumerate(summands)})
            signs = tuple(sign for sign, _ in summands)
            coarse = Gridded("_".join([output, *axes]), output, signs, part, axes, np.zeros(()))
            table = _refined(coarse, identified.inputs)
            if output.startswith(INCIDENCE):
                incidences.setdefault(output, []).append(table)
            yield table


def program_by_incidence(identified: Identified) -> Program:
    """Coefficients at given separation points, the incidence of each point, and the static point at an incidence."""
    probe = _only(identified.exported, Stage.SEPARATION, lambda _v, _s, _a, flow: {"X": flow[INCIDENCE] - 1.0})
    given = _only(identified.exported, Stage.INCIDENCE, lambda _v, s, *_: {INCIDENCE: s[INCIDENCE] - s["alpha"]})
    names = {point: point.replace("X", INCIDENCE) for point in identified.points}

    def outputs(values: Any, signals: Any, aircraft: Any, states: Any) -> dict[str, Any]:
        total = identified.coefficients(values, signals, aircraft, [states[n] for n in identified.points])
        if not identified.separates:
            return total
        total |= dict(zip(names.values(), probe.static_points(values, signals, aircraft), strict=True))
        there = dict(signals) | {INCIDENCE: states[INCIDENCE]}
        total["X_static"] = given.static_points(values, there, aircraft)[0]
        return total | identified.lag(values, signals, aircraft)

    return identified.traced(outputs, (*identified.points, INCIDENCE) if identified.separates else ())


def _only(model: Model, stage: Stage, increments: Any) -> Model:
    """The model with one effect in place of all of a stage."""
    others = tuple(e for e in model.effects if e.stage is not stage)
    example = Example({}, {}, {"X": 0.0}, "stands for all effects of its stage")
    pattern = CATALOGUE["kirchhoff_lift"]
    effect = replace(pattern, name="given", stage=stage, increments=increments, uses=(), channels=(), example=example)
    return replace(model, effects=(*others, effect))


def write_tables(identified: Identified, folder: Path) -> tuple[str, ...]:
    made = list(tables_of(identified))
    root = xr.Dataset(attrs={"about": "\n".join(about(identified)), "sum": "a coefficient is the sum of its tables"})
    tree = xr.DataTree.from_dict({"/": root, **{table.name: _dataset(identified, table) for table in made}})
    write_whole(tree.to_netcdf(engine="h5netcdf"), folder / "tables.nc")
    for table in made:
        grid = np.meshgrid(*table.axes.values(), indexing="ij") if table.axes else []
        columns = {f"{name} [{_unit_of(name)}]": x.ravel() for name, x in zip(table.axes, grid, strict=True)}
        frame = pd.DataFrame(columns | {f"{table.output} [{_unit_of(table.output)}]": table.values.ravel()})
        write_whole(frame.to_csv(index=False, float_format="%.12g"), folder / f"{table.name}.csv")
    return ("tables.nc", *(f"{table.name}.csv" for table in made))


def _refined(table: Gridded, inputs: Mapping[str, Any]) -> Gridded:
    """The table on axes on which linear interpolation is accurate."""
    axes = dict(table.axes)
    while True:
        values = table.at(axes, inputs)
        allowed = max(ACCURACY * float(np.ptp(values)), 1e-12) if values.size else 0.0
        middles = {axis: 0.5 * (x[1:] + x[:-1]) for axis, x in axes.items()}
        errors = {}
        for k, (axis, middle) in enumerate(middles.items()):  # largest half way between each two points of the axis
            low, high = (np.take(values, np.arange(len(middle)) + i, axis=k) for i in (0, 1))
            error = np.abs(table.at(axes | {axis: middle}, inputs) - 0.5 * (low + high))
            errors[axis] = error.max(axis=tuple(i for i in range(error.ndim) if i != k))
        if all(np.all(x <= allowed) for x in errors.values()):
            return replace(table, axes=axes, values=values, error=sum((float(x.max()) for x in errors.values()), 0.0))
        axes = {n: np.sort(np.concatenate([x, middles[n][errors[n] > allowed]])) for n, x in axes.items()}
        if np.prod([len(x) for x in axes.values()]) > MOST_CELLS:
            raise InputError(f"the table of {table.output} has over {MOST_CELLS} points; export --to fmu or jsbsim")


def _range(identified: Identified, axis: str, incidences: Mapping[str, Sequence[Gridded]]) -> tuple[float, float]:
    """What an axis spans: all incidences of any separation point, or what was flown."""
    if axis == INCIDENCE:
        reach = [np.sum([(t.values.min(), t.values.max()) for t in tables], axis=0) for tables in incidences.values()]
        return float(min(low for low, _ in reach)), float(max(high for _, high in reach))
    if axis in identified.points:
        return (0.0, 1.0)
    if axis not in identified.flown:
        raise InputError(f"{identified.name}: the flown range of {axis} is not known; export a result of this version")
    low, high = identified.flown[axis]
    return (low, high) if high > low else (low - 1e-6, high + 1e-6)


def _dataset(identified: Identified, table: Gridded) -> xr.Dataset:
    dims, unit_of, drawn = tuple(table.axes), _unit_of(table.output), identified.draws
    about_table = {"units": unit_of, "output": table.output, "interpolation_error": table.error}
    coords = {n: (n, x, {"units": _unit_of(n), "long_name": meaning(n)}) for n, x in table.axes.items()}
    data: dict[str, Any] = {"value": (dims, table.values, about_table)}
    if drawn is not None:
        if table.values.size * len(drawn.values) > MOST_WITH_DRAWS:
            raise InputError(f"table {table.name} with {len(drawn.values)} draws is too large; give fewer --draws")
        names = [f"parameter.{n}" for n in drawn.names]
        each = [table.at(table.axes, identified.inputs | dict(zip(names, row, strict=True))) for row in drawn.values]
        data["draws"] = (("draw", *dims), np.stack(each), {"units": unit_of, "origin": drawn.origin})
    return xr.Dataset(data, coords=coords)


def _unit_of(name: str) -> str:
    return "rad" if name.startswith(INCIDENCE) else "s" if name == "lag" else unit(name) or "1"
