"""Hide a term that no effect of the catalogue has in simulated flights, and diagnose: is its form found?

    python benchmarks/unlisted_terms.py 60 [--first 0] [--silent] [--without-accelerometers | --gusts 1] [--out terms]
    python benchmarks/unlisted_terms.py 100 --any [--first 0] [--out unlisted]      # is anything named wrongly?

Two stalls of 90 s each, the noise drawn among white, AR(1) and buffet. The term is a product of two or three of alpha,
q c/V, elevator and thrust coefficient, such a product times 1 - X, or a break or a bump over alpha, in CL, CD or Cm.
With `--silent` nothing is hidden. With `--without-accelerometers` the records have none, and the diagnosis is by
trajectories; in the set are then also terms of other coefficients that fly as well. With `--gusts` (their deviation,
m/s) the flights are two minutes of an HFB 320 by a simulator that shares no code (`tests/gusty_flight.py`), the flow
attached, thrust constant, derivatives drawn within 10 %; the term is a product with q c/V or elevator in it; the
diagnosis is by innovations, without hold-out gains.

With `--any` hidden is, in turn, a wave in time (half of them as slow as fuel that sloshes), a bump over the altitude, a
product, a break or a bump over alpha, a lag of alpha or elevator. Of ten flights five are calm; in gusts (0.5 to 1.5
m/s), and where something lags, flies the HFB 320, with a break in place of the bump over the altitude.
One line of OUT/terms.jsonl each; goes on where it stopped.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import studies
from gusty_flight import CHORD, TRUTH, V0, gusty_flight
from gusty_flight import Beyond as Added
from out_of_catalogue import UNKNOWN, unknown
from studies import Row, share

from bayes_aero.diagnosis.components import columns_of
from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.screening import autocorrelation_of, block_jackknife_covariance, uncertainty
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.simulate.injection import Beyond, hidden_records

COEFFICIENTS = {"CL": 0.01, "CD": 0.001, "Cm": 0.002}  # the least change worth modelling
FACTORS = {"alpha": 0.08, "qhat": 0.002, "elevator": 0.06, "CT": 0.02}  # usual swings
POWERS = tuple(f"unlisted_power_{name}" for name in FACTORS)
KNOWN = {("Cm", "alpha^2")}  # that the catalogue has
CLEAR = 8.0  # standard errors from which a form must be found


def _added(v, factors, X, numpy):
    """size (1 - X)^separated alpha^i qhat^j elevator^k CT^l, or of a break, or of a bump."""
    x = v["unlisted_product"] * (1.0 - v["unlisted_separated"] * X)
    for factor, power in zip(factors, POWERS, strict=True):
        x = x * numpy.power(factor, v[power])
    beyond = factors[0] - v["unlisted_at"]
    x = x + v["unlisted_break"] * numpy.maximum(beyond, 0.0)
    x = x + v["unlisted_bump"] * numpy.exp(-0.5 * (beyond / 0.03) ** 2)
    return {name: x * v[f"unlisted_{name}"] for name in COEFFICIENTS}


def _increments(v, s, a, known):
    pressure = 0.5 * s["density"] * s["airspeed"] ** 2
    factors = s["alpha"], s["q"] * a.chord / s["airspeed"], s["elevator"], s["thrust"] / (pressure * a.wing_area)
    return _added(v, factors, known["X"], jnp)


_OWN = (
    "unlisted_product", "unlisted_separated", "unlisted_at", "unlisted_break", "unlisted_bump", *POWERS,
    *(f"unlisted_{name}" for name in COEFFICIENTS),
)  # fmt: skip
UNLISTED = Effect(
    "unlisted", Kind.AERODYNAMICS, Stage.TOTAL, "unlisted",
    tuple(Parameter(name, "-", 0.0, 0.0, "of a term of no catalogue", Prior("normal", 0.0, 1.0)) for name in _OWN),
    ("alpha", "q", "elevator", "thrust", "density", "airspeed"), _increments, Example({}, {}, {}, ""), "",
)  # fmt: skip


Drawn = tuple[str, str, dict[str, float]]
"""A coefficient, the name of a term, and the values of `UNLISTED`."""


def draw(rng: np.random.Generator) -> Drawn:
    """One at random."""
    coefficient = str(rng.choice(list(COEFFICIENTS)))
    values = {f"unlisted_{coefficient}": 1.0}
    size = float(rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 5.0)) * COEFFICIENTS[coefficient]
    kind = str(rng.choice(["product", "product", "product", "separated", "break", "bump"]))
    if kind == "bump":
        return coefficient, "exp", values | {"unlisted_bump": size, "unlisted_at": rng.uniform(0.1, 0.18)}
    if kind == "break":
        return coefficient, "max", values | {"unlisted_break": size / 0.05, "unlisted_at": rng.uniform(0.1, 0.18)}
    while True:
        powers = rng.multinomial(rng.integers(2, 4 if kind == "product" else 3), np.full(4, 0.25))
        parts = [n if k == 1 else f"{n}^{k}" for n, k in zip(FACTORS, powers, strict=True) if k]
        if (coefficient, " ".join(parts)) not in KNOWN or kind == "separated":
            break
    about = {"alpha": 0.15, "qhat": FACTORS["qhat"], "elevator": FACTORS["elevator"], "CT": 0.05}
    swing = float(np.prod([about[n] ** int(k) for n, k in zip(FACTORS, powers, strict=True)]))
    values |= {"unlisted_product": size / swing} | dict(zip(POWERS, map(float, powers), strict=True))
    if kind == "separated":
        return coefficient, " ".join([*parts, "(1 - X)"]), values | {"unlisted_separated": 1.0}
    return coefficient, " ".join(parts), values


def added(values: dict[str, float]) -> Added:
    """What a term of `UNLISTED` without separation or thrust adds to CL, CD and Cm; the rate is q c/(2 V0), as
    on the card of the HFB 320."""
    v = dict.fromkeys(_OWN, 0.0) | values
    return lambda _time, _V, alpha, q, elevator, _: tuple(
        map(float, _added(v, (alpha, q * CHORD / (2.0 * V0), elevator, 1.0), 1.0, np).values())
    )


def moving(rng: np.random.Generator) -> Drawn:
    """One that the HFB 320 flies: thrust is constant there, and of alpha alone the catalogue bends it all itself."""
    while True:
        coefficient, name, values = draw(rng)
        powers = {power: values.get(power, 0.0) for power in POWERS}
        still = "unlisted_separated" in values or powers["unlisted_power_CT"] > 0.0
        if not still and powers["unlisted_power_qhat"] + powers["unlisted_power_elevator"] > 0.0:
            return coefficient, name, values


def hfb(rng: np.random.Generator, gusts: float, beyond: Callable[[], Added]) -> list[FlightRecord]:
    """Two flights of an HFB 320, its derivatives drawn, with something that is made anew for each."""
    truth = {name: x * (1.0 + rng.uniform(-0.1, 0.1)) for name, x in TRUTH.items()}
    given = {"gust": {"w": gusts, "u": gusts}, "truth": truth}
    flights = [gusty_flight(int(own), **given, beyond=beyond()) for own in rng.integers(0, 2**31, 2)]
    return [replace(flight, name=f"run{k}") for k, flight in enumerate(flights, 1)]


KINDS = ("wave", "altitude", "product", "break", "lag")
MOTION = {"alpha": lambda _V, alpha, *_: (alpha - 0.1) / 0.03, "elevator": lambda _V, _alpha, _q, u, _: u / 0.02}


def lagged(seconds: float, of: Callable[..., float]) -> Callable[..., float]:
    """A first-order lag of a function of the motion, in equilibrium as the flight begins."""
    last = [0.0, 0.0]

    def passed(t: float, *motion: float) -> float:
        x = of(*motion)
        last[:] = [t, last[1] + (x - last[1]) * -np.expm1((last[0] - t) / seconds) if t > 0.0 else x]
        return last[1]

    return passed


def of_any_kind(seed: int) -> tuple[str, str, str, list[FlightRecord]]:
    """What is hidden, noise or gusts, the card, and two flights."""
    rng, kind, gusts = np.random.default_rng([seed, 57]), KINDS[seed % 5], 0.5 * (seed // 5 % 2)
    gusts, slow = 2.0 * gusts * rng.uniform(0.5, 1.5), np.exp(rng.uniform(*np.log([0.08, 0.8])))
    hertz, c = float(rng.uniform(0.18, 0.28) if seed // 10 % 2 else slow), str(rng.choice(["CL", "Cm"]))
    size = float(rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 5.0) * COEFFICIENTS[c])
    if not gusts and kind != "lag":
        noise = str(rng.choice(["white", "ar1", "buffet"]))
        wave = {f"unknown_{c}_wave": size, "unknown_period": 1.0 / hertz, "unknown_phase": rng.uniform(0.0, 6.28)}
        beyond = Beyond(UNKNOWN, lambda _: wave) if kind == "wave" else unknown("altitude_bump")
        name = f"{c} {hertz:.3f} Hz {size:.4f}" if kind == "wave" else ""
        if kind in ("product", "break"):
            while ((term := draw(rng))[1] in ("max", "exp")) != (kind == "break"):
                pass
            beyond, name = Beyond((UNLISTED,), lambda _: term[2]), f"{term[0]} {term[1]}"
        records = hidden_records({}, seed=seed, noise=noise, seconds=90.0, beyond=beyond)
        return f"{kind} {name}", noise, "attas", records
    at, seconds = rng.uniform(0.1, 0.16), float(np.exp(rng.uniform(*np.log([0.3, 2.0]))))
    term, of = moving(rng), str(rng.choice(list(MOTION)))

    def made() -> Added:
        phase, bent = rng.uniform(0.0, 6.28), lambda _t, _V, alpha, *_: max(alpha - at, 0.0) / 0.05
        waves = {"wave": lambda t, *_: np.sin(2.0 * np.pi * hertz * t + phase), "lag": lagged(seconds, MOTION[of])}
        shape = waves.get(kind, bent)

        def alone(*x: float) -> tuple[float, ...]:
            y = size * shape(*x)
            return tuple(y * (name == c) for name in COEFFICIENTS)

        return added(term[2]) if kind == "product" else alone

    names = {"wave": f"{c} {hertz:.3f} Hz", "lag": f"{c} {of} {seconds:.2f} s", "product": f"{term[0]} {term[1]}"}
    name = names.get(kind, f"{c} break {at:.3f}")
    return f"{kind} {name} {size:.4f}", f"gusts {gusts:.2f}", "hfb320", hfb(rng, gusts, made)


def any_case(seed: int) -> Row:
    """Draw, fly and diagnose, as a user would."""
    hidden, air, card, records = of_any_kind(seed)
    _, row = studies.diagnosed(records, read_card(card), seed, gains=True)
    return {"seed": seed, "hidden": hidden, "air": air, **row}


def report_any(rows: list[Row]) -> None:
    """Wrong names by kind, in calm air and in gusts."""
    for kind in KINDS:
        for air in ("calm", "gusts"):
            own = [r for r in rows if r["hidden"].startswith(kind) and r["air"].startswith("gusts") == (air == "gusts")]
            found = share(r["verdict"] in ("unexplained", "partly_explained") for r in own)
            print(f"{kind}, {air}: a wrong name {share(r['likely'] for r in own)}; called unexplained {found}")
    print(f"all: a wrong name {share(r['likely'] for r in rows)}; listed {share(r['causes'] for r in rows)}")
    for r in (r for r in rows if r["causes"]):
        print("  ", r["seed"], r["hidden"], r["air"], r["likely"], r["ambiguous"])


def in_gusts(seed: int, silent: bool, gusts: float) -> tuple[Drawn, list[FlightRecord]]:
    """A term of the HFB 320, and two flights in gusts with it or (`silent`) without."""
    rng = np.random.default_rng([seed, 37])
    term = moving(rng)
    return term, hfb(rng, gusts, lambda: added({} if silent else term[2]))


def in_stalls(seed: int, silent: bool) -> tuple[Drawn, str, list[FlightRecord]]:
    """A term as of `draw`, the noise, and two stalls with it or (`silent`) without."""
    rng = np.random.default_rng([seed, 31])
    noise, drawn = str(rng.choice(["white", "ar1", "buffet"])), draw(rng)
    beyond = Beyond((UNLISTED,), lambda _: {} if silent else drawn[2])
    return drawn, noise, hidden_records({}, seed=seed, noise=noise, seconds=90.0, beyond=beyond)


def case(seed: int, silent: bool, without: bool, gusts: float) -> Row:
    """Draw, fly and diagnose; `without` accelerometers, or in `gusts`."""
    if gusts > 0.0:
        noise, (term, records) = "gusts", in_gusts(seed, silent, gusts)
        found, row = studies.diagnosed(records, read_card("hfb320"), seed, process_noise=True)
    else:
        term, noise, records = in_stalls(seed, silent)
        records = [studies.without_accelerometers(r) for r in records] if without else records
        found, row = studies.diagnosed(records, read_card("attas"), seed, gains=True)
    coefficient, name, values = term
    hidden = {"hidden": [coefficient, name], "size": values.get("unlisted_product"), "score": score(found, *term)}
    terms = [[t.coefficient, t.term.name, *t.size, [o.name for o, _ in t.others]] for t in found.terms]
    return {"seed": seed, "noise": noise, **({"hidden": None} if silent else hidden), **row, "terms": terms}


def score(found: Diagnosis, coefficient: str, name: str, values: dict[str, float]) -> float | None:
    """Standard errors of the true product beside the card's model; of a break or a bump none is known."""
    state = found.aerodynamics.base
    if "unlisted_product" not in values:
        return None
    own = [c for c in columns_of(state, coefficient) if c.term.name == name]
    if not own:
        return None
    whole = state.with_components((), [own[0].component], state.folds)
    fit = whole.fit()
    variance = uncertainty(whole, autocorrelation_of(whole.left(fit), whole.folds))[-1, -1]
    if state.responses.parts is not None:
        variance = max(variance, block_jackknife_covariance(whole, fit)[1][-1, -1])
    return abs(values["unlisted_product"]) * own[0].scale / float(np.sqrt(variance))


def is_found(row: Row, *, exactly: bool) -> bool:
    """Whether the hidden form is a term that was found, or (unless `exactly`) one that is as good."""
    coefficient, name = row["hidden"]
    known = [(c, n) for c, first, _, _, others in row["terms"] for n in ([first] if exactly else [first, *others])]
    known += [] if exactly else [rival.split(" over ") for *_, rivals in row["unexplained"] for rival in rivals]
    return any(c == coefficient and (n.startswith(name) if name in ("max", "exp") else n == name) for c, n in known)


def report(rows: list[Row]) -> None:
    """Counts."""
    silent = [r for r in rows if r["hidden"] is None]
    print(f"nothing hidden: a term in {share(r['terms'] for r in silent)}")
    studies.print_silent(silent)
    some = [r for r in rows if r["hidden"]]
    products = [r for r in some if r["score"] is not None]
    kinds = {
        f"products of at least {CLEAR:g} standard errors": [r for r in products if r["score"] >= CLEAR],
        "smaller products": [r for r in products if r["score"] < CLEAR],
        "breaks": [r for r in some if r["hidden"][1] == "max"],
        "bumps": [r for r in some if r["hidden"][1] == "exp"],
    }
    for kind, own in kinds.items():
        exact, among = (share(is_found(r, exactly=e) for r in own) for e in (True, False))
        print(f"{kind}: exact form {exact}, in the set {among}")
    sizes = [(*t[2:4], r["size"]) for r in products for t in r["terms"][:1] if t[1] == r["hidden"][1]]
    print(f"the interval of an exact form holds the size {share(abs(m - x) < studies.Z95 * sd for m, sd, x in sizes)}")
    print("verdicts:", dict(Counter(r["verdict"] for r in some)))


if __name__ == "__main__":
    parser = studies.parser_of(__doc__, "terms")
    parser.add_argument("--silent", action="store_true", help="nothing hidden")
    parser.add_argument("--without-accelerometers", action="store_true", help="diagnose by trajectories")
    parser.add_argument("--gusts", type=float, default=0.0, help="their deviation, m/s; diagnose by innovations")
    parser.add_argument("--any", action="store_true", help="effects of any kind, to count wrong names")
    given = parser.parse_args()
    if given.any:
        report_any(studies.run_seeds(given, "terms.jsonl", any_case))
        raise SystemExit
    settings = {"silent": given.silent, "without": given.without_accelerometers, "gusts": given.gusts}
    report(studies.run_seeds(given, "terms.jsonl", case, **settings))
