"""Objective tests of a fitted model's lateral motion: recorded and simulated manoeuvres measured in one way.

A manoeuvre that cannot show a test gives the reason instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.trajectories.motion.flown_modes import flown_mode
from bayes_aero.diagnosis.trajectories.motion.free_response import Swing, still_stretches, swing
from bayes_aero.diagnosis.trajectories.motion.results import Compared
from bayes_aero.flight import tolerances
from bayes_aero.flight.tolerances import ObjectiveTest

CYCLES = 6.0  # of a Dutch roll that the test requires
FOLLOWS, TOLD = 0.15, 0.05  # amplitude of a control over that of sideslip: no free response, and a remark; our choice
RELEASED = 20.0  # s of the spiral test
BANKED = math.radians(5.0)  # rad from which a bank is one to release; our choice
DEFLECTED = math.radians(1.0)  # rad that a control must travel to test its response; our choice
TURNS = math.radians(3.0)  # rad/s of a response; our choice
NEAR = 0.5  # s about a recorded peak in which the simulated one is sought
STEADY, UNMOVED, SLIPS = 3.0, math.radians(1.0), math.radians(2.0)  # s; rad of change; rad of sideslip: our choice
STALLED, AFTER = 0.9, 5.0  # separation point at which the stall begins; s in which the aircraft rolls off
ROLLS_OFF = math.radians(5.0)  # rad; our choice
QUANTITIES = (
    ("period", "period", "s"),
    ("damping_ratio", "damping ratio", "1"),
    ("time_to_half", "time to half or double", "s"),
    ("time_to_double", "time to half or double", "s"),
)

Series = Mapping[str, Float[np.ndarray, " n"]]


@dataclass(frozen=True)
class Manoeuvre:
    """One manoeuvre: time in s, outputs measured and simulated, controls in rad, separation point where the model has
    one."""

    name: str
    time: Float[np.ndarray, " n"]
    measured: Series
    simulated: Series
    controls: Series
    X: Float[np.ndarray, " n"] | None = None

    def lacks(self, *names: str) -> str:
        """Why a test of these outputs is not possible; empty if it is."""
        gone = [n for n in names if n not in self.measured]
        return f"{gone[0]} is not recorded or not simulated" if gone else ""

    def compared(
        self,
        test: ObjectiveTest,
        quantity: str,
        unit: str,
        measured: tuple[float, float],
        simulated: float,
        remark: str = "",
    ) -> Compared:
        """A row: within the limit, or of the same direction where there is none."""
        limit = test.limits[quantity].of(measured[0])
        within = abs(simulated - measured[0]) <= limit if limit else measured[0] * simulated > 0.0
        told = limit or math.nan
        return Compared(
            self.name, test.entry, test.title, quantity, unit, measured, simulated, told, bool(within), remark
        )


def objective_tests(flown: list[Manoeuvre]) -> tuple[tuple[Compared, ...], dict[str, dict[str, tuple[str, ...]]]]:
    """Every test of every manoeuvre, and by test and reason the manoeuvres that cannot show it."""
    rows: list[Compared] = []
    untested: dict[str, dict[str, tuple[str, ...]]] = {}
    for test in tolerances.OBJECTIVE_TESTS:
        for one in flown:
            found = TESTS[test.entry](one)
            if isinstance(found, str):
                reasons = untested.setdefault(test.name, {})
                reasons[found] = (*reasons.get(found, ()), one.name)
            else:
                rows += found
    return tuple(rows), untested


def dutch_roll(one: Manoeuvre) -> list[Compared] | str:
    """Period, damping and the time between peaks of the free response of sideslip."""
    if why := one.lacks("beta"):
        return why
    if not one.controls:
        return "neither aileron nor rudder was recorded"
    stretches = still_stretches(one.time, one.controls)
    if not stretches:
        return "aileron or rudder move all the time"
    names = [n for n in ("beta", "r", "phi") if n in one.measured]
    why = "sideslip does not swing for a cycle while aileron and rudder are still"
    for part in stretches:
        recorded, other = (
            swing(one.time[part], {n: of[n][part] for n in names}) for of in (one.measured, one.simulated)
        )
        if recorded is None:
            continue
        along = {n: recorded.follows(one.time[part], u[part]) for n, u in one.controls.items()}
        most = max(along, key=lambda n: along[n])
        if along[most] <= FOLLOWS:
            moves = f"{most} moves by {along[most]:.0%} of the sideslip" if along[most] > TOLD else ""
            return _swings(one, recorded, other, moves)
        why = "aileron or rudder move with the sideslip"
    return why


def _swings(one: Manoeuvre, recorded: Swing, simulated: Swing | None, moves: str) -> list[Compared] | str:
    if simulated is None:
        return "the record swings freely, and the simulation does not"
    test = tolerances.DUTCH_ROLL
    few = f"{recorded.cycles:.1f} cycles, the test requires {CYCLES:.0f}" if recorded.cycles < CYCLES else ""
    lacks = "; ".join(remark for remark in (few, moves) if remark)
    own, other = (flown_mode(test.title, x.eigenvalue, x.covariance).quantities for x in (recorded, simulated))
    rows = [
        one.compared(test, quantity, unit, own[name], other[name][0], lacks)
        for name, quantity, unit in QUANTITIES
        if name in own and name in other
    ]
    rows[1:] = _either(rows[1:])
    if "phi" in recorded.lag:
        period, lag = other["period"][0], recorded.lag["phi"]
        apart = simulated.lag["phi"] - lag
        apart -= period * round(apart / period)
        rows.append(one.compared(test, "bank after sideslip", "s", (lag, math.nan), lag + apart, lacks))
    return rows


def _either(rows: list[Compared]) -> list[Compared]:
    """Rows of which one suffices."""
    met = [row for row in rows if row.within]
    if not met:
        return rows
    told = f"met by {met[0].quantity}"
    return [
        row if row.within else replace(row, within=True, remark=f"{row.remark}; {told}" if row.remark else told)
        for row in rows
    ]


def spiral(one: Manoeuvre) -> list[Compared] | str:
    """Bank 20 s after the controls were left alone in a turn."""
    if why := one.lacks("phi"):
        return why
    if not one.controls:
        return "neither aileron nor rudder was recorded"
    phi, other = one.measured["phi"], one.simulated["phi"]
    for part in still_stretches(one.time, one.controls, RELEASED):
        end = part.start + int(np.searchsorted(one.time[part], one.time[part.start] + RELEASED))
        if abs(phi[part.start]) >= BANKED:
            trend = (phi[end] - phi[part.start]) * (other[end] - other[part.start]) > 0.0
            test, quantity = tolerances.SPIRAL, "bank after 20 s"
            row = one.compared(test, quantity, "rad", (float(phi[end]), math.nan), float(other[end]))
            return [row if trend else replace(row, within=False, remark="the trend is wrong")]
    return "no bank of 5 deg is left alone for 20 s"


def roll_response(one: Manoeuvre) -> list[Compared] | str:
    """Largest roll rate that the aileron commands."""
    return _peak(one, tolerances.ROLL_RESPONSE, "aileron", "p", "peak roll rate")


def rudder_response(one: Manoeuvre) -> list[Compared] | str:
    """Largest yaw rate that the rudder commands."""
    return _peak(one, tolerances.RUDDER_RESPONSE, "rudder", "r", "peak yaw rate")


def _peak(one: Manoeuvre, test: ObjectiveTest, control: str, rate: str, quantity: str) -> list[Compared] | str:
    if why := one.lacks(rate):
        return why
    own = [u for name, u in one.controls.items() if name.startswith(control)]
    if not any(np.ptp(u) >= DEFLECTED for u in own):
        return f"the {control} does not move by 1 deg"
    x, other = one.measured[rate], one.simulated[rate]
    peak = int(np.argmax(np.abs(x)))
    if abs(x[peak]) < TURNS:
        return f"the {'roll' if rate == 'p' else 'yaw'} rate stays below 3 deg/s"
    near = np.abs(one.time - one.time[peak]) <= NEAR
    direction = math.copysign(1.0, x[peak])
    reached = direction * float(np.max(direction * other[near]))
    return [one.compared(test, quantity, "rad/s", (float(x[peak]), math.nan), reached)]


def steady_sideslip(one: Manoeuvre) -> list[Compared] | str:
    """Means of sideslip and bank over a stretch in which both stay."""
    if why := one.lacks("beta", "phi"):
        return why
    beta, phi = one.measured["beta"], one.measured["phi"]
    count = max(2, round(STEADY / float(np.median(np.diff(one.time)))))
    if len(beta) <= count:
        return "no sideslip of 2 deg stays for 3 s"
    rows = [np.lib.stride_tricks.sliding_window_view(x, count) for x in (beta, phi)]
    stays = np.all([np.ptp(x, axis=1) <= 2.0 * UNMOVED for x in rows], axis=0)
    sizes = np.where(stays, np.abs(rows[0].mean(axis=1)), 0.0)
    first = int(np.argmax(sizes))
    if sizes[first] < SLIPS:
        return "no sideslip of 2 deg stays for 3 s"
    part, test = slice(first, first + count), tolerances.SIDESLIP
    return [
        one.compared(
            test, quantity, "rad", (float(one.measured[n][part].mean()), math.nan), float(one.simulated[n][part].mean())
        )
        for n, quantity in (("beta", "sideslip"), ("phi", "bank"))
    ]


def stall(one: Manoeuvre) -> list[Compared] | str:
    """Bank up to the stall, and the direction in which the aircraft rolls off."""
    if why := one.lacks("phi"):
        return why
    if one.X is None:
        return "the model does not stall"
    stalled = np.flatnonzero(one.X < STALLED)
    if not len(stalled) or stalled[0] < 2:
        return "the flow does not separate, or is separated from the beginning"
    begin, test = int(stalled[0]), tolerances.STALL
    phi, other = one.measured["phi"], one.simulated["phi"]
    worst = int(np.argmax(np.abs(other[:begin] - phi[:begin])))
    rows = [one.compared(test, "bank before the stall", "rad", (float(phi[worst]), math.nan), float(other[worst]))]
    after = np.flatnonzero((one.time >= one.time[begin]) & (one.time <= one.time[begin] + AFTER))
    farthest = int(after[np.argmax(np.abs(phi[after] - phi[begin]))])
    rolled = float(phi[farthest] - phi[begin])
    if abs(rolled) >= ROLLS_OFF:
        rows.append(one.compared(test, "roll-off", "rad", (rolled, math.nan), float(other[farthest] - other[begin])))
    return rows


TESTS: Mapping[str, Callable[[Manoeuvre], list[Compared] | str]] = {
    tolerances.DUTCH_ROLL.entry: dutch_roll,
    tolerances.SPIRAL.entry: spiral,
    tolerances.ROLL_RESPONSE.entry: roll_response,
    tolerances.RUDDER_RESPONSE.entry: rudder_response,
    tolerances.SIDESLIP.entry: steady_sideslip,
    tolerances.STALL.entry: stall,
}
