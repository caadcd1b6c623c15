"""Probability of staying inside a tolerance, what structure, flown region and more records make of it: closed forms."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from linear_cards import record_of
from scipy.stats import norm

from bayes_aero.diagnosis.design import Information
from bayes_aero.dynamics.flight import linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.model.observations import join
from bayes_aero.physics.aircraft import FLIGHT, Envelope
from bayes_aero.qualification import Chance, FlightKind, Qualification, RecordBeside, Test, ToleranceVerdict
from bayes_aero.qualification import qualify as job
from bayes_aero.qualification.qualify import OpenTest, Region, Structure, Uncertain
from bayes_aero.report.pages.qualification import further_sentences
from bayes_aero.simulate.demo import TRUTH, simulate_stall

FREE = {"az0": -9.8, "azde": 1.0}
SD, COUNT, N = 0.5, 1000, 60
ERROR = 4.0 * np.sqrt(0.25 / COUNT)  # four standard errors of a probability, at most
DT, PHI = job.BLOCK_SECONDS, 0.9
CERTAIN = 10**9


@pytest.fixture(scope="module")
def flown():
    """az is a constant and an elevator that stands still: whatever differs, differs by a constant."""
    still = np.zeros(N)
    channels = {"alpha": still, "q": still, "elevator": still, "az": np.full(N, -9.8)}
    shipped = read_card("short_period")
    held = tuple((n, {"Zalpha": -1.0, "Mq": -1.0}.get(n, 0.0)) for n in shipped.linear.parameters if n not in FREE)
    card = replace(shipped, linear=replace(shipped.linear, fixed=held))
    records = [record_of(channels, dt=0.2, name=name) for name in ("one", "two")]
    flights = join(records, card, card.linear.inputs)
    dynamics = linear_dynamics(card, flights.lengths)
    return segments(flights, dynamics, outputs=("az",))


def unknown(flown, rng, sd=SD, **more):
    names = flown.dynamics.names
    estimate = np.array([FREE[name] for name in names])
    draws = np.tile(estimate, (COUNT, 1))
    draws[:, names.index("az0")] += sd * rng.standard_normal(COUNT)
    return Uncertain(estimate, draws, **more)


def chance(tests, kind=FlightKind.AGAIN):
    return next(t for t in tests if t.kind is kind)


@pytest.mark.parametrize("band", [0.2, 1.0])
def test_a_constant_error_of_normal_distribution(flown, band):
    """It stays inside +-b with probability 2 Phi(b / sd) - 1, however long the flight."""
    tests = job.qualify(flown, None, unknown(flown, np.random.default_rng(1)), {"az": band}).tests
    found = chance(tests)
    exact = 2.0 * norm.cdf(band / SD) - 1.0
    assert found.chance.value == pytest.approx(exact, abs=ERROR)
    assert found.chances["structure"] == found.chances["parameters"]  # the record has no error
    assert found.recorded.passed
    assert found.recorded.largest < 1e-9
    assert found.within == pytest.approx(exact, abs=ERROR)


def test_white_errors_of_the_structure(flown):
    """White errors of standard deviation s: inside all n samples with the n-th power of 2 Phi(b / s) - 1.

    Means over 0.2 s are single samples here, so all that was left out is in the autoregression.
    """
    rng = np.random.default_rng(2)
    errors = 0.3 * rng.standard_normal((*flown.index.shape, 1))
    size = float(np.sqrt(np.mean(errors[flown.inside] ** 2)))
    given = unknown(flown, rng, sd=0.0, hold_out=(errors, np.zeros(1)))
    band = 0.9
    tests = job.qualify(flown, None, given, {"az": band}).tests
    assert chance(tests).chance.value == 1.0  # flown again: the records have no error
    sizes = size / np.sqrt(rng.chisquare(6, 100_000) / 6)  # two manoeuvres show six sizes
    averaged = float(np.mean((2.0 * norm.cdf(band / sizes) - 1.0) ** N))
    assert chance(tests, FlightKind.NEXT).chance.value == pytest.approx(averaged, abs=ERROR + 0.03)


def test_the_next_flight_has_its_own_parameters_unless_flights_left_out_show_none(flown):
    """Scatter between manoeuvres adds to the estimate's: sqrt(sd^2 + tau^2). Where flights that were left out missed by
    0.1 alone, parameters that miss by 1.3 are the prior's."""
    rng = np.random.default_rng(3)
    given, wider = unknown(flown, rng), unknown(flown, rng, sd=1.3)
    found = job.qualify(flown, None, Uncertain(given.estimate, given.draws, wider.draws), {"az": 1.0})
    following = chance(found.tests, FlightKind.NEXT)
    assert following.chance.value == pytest.approx(2.0 * norm.cdf(1.0 / 1.3) - 1.0, abs=ERROR)
    assert following.recorded is None
    for error, used in ((0.1, False), (2.0, True)):
        left_out = (error * rng.standard_normal((*flown.index.shape, 1)), np.zeros(1))
        few = Uncertain(given.estimate, given.draws[:100], wider.draws[:100], left_out)
        assert job.qualify(flown, None, few, {"az": 1.0}).scattered is used
    assert job.qualify(flown, None, given, {"az": 1.0}).scattered is None


def test_the_same_seed_draws_the_same_flights_with_the_errors_of_a_binomial(flown):
    given = unknown(flown, np.random.default_rng(4), hold_out=(np.ones((*flown.index.shape, 1)), np.zeros(1)))
    few = Uncertain(given.estimate, given.draws[:100], given.draws[:100], given.hold_out)
    one, two, other = (job.qualify(flown, None, few, {"az": 1.0}, seed=seed).tests for seed in (1, 1, 2))
    assert one == two
    assert one != other
    found = Chance.of(300, 400)
    assert found.value == 0.75
    assert found.error == pytest.approx(np.sqrt(0.75 * 0.25 / 400), rel=0.01)
    assert Chance.of(400, 400).error > 0.0


def test_verdicts_need_the_monte_carlo_error_and_the_record():
    def one(passed, within=1.0):
        record = RecordBeside(1.0, within)
        return Test(FlightKind.AGAIN, "m", "az", 1.0, {"parameters": Chance.of(passed, 400)}, 1.0, record)

    def verdict(*tests):
        return Qualification(tests, (), (), (), (), {"az": (1.0, "")}, 400).whole

    assert one(380).chance.verdict is ToleranceVerdict.UNDECIDED  # 0.95, not known to two standard errors
    assert verdict(one(400)) is ToleranceVerdict.PASSES
    assert verdict(one(400), one(380)) is ToleranceVerdict.UNDECIDED
    assert verdict(one(400, within=0.99)) is ToleranceVerdict.UNDECIDED  # the record was outside
    assert verdict(one(400), one(2)) is ToleranceVerdict.FAILS
    assert one(20).chance.verdict is ToleranceVerdict.UNDECIDED


def from_zero(rng, count, n, phi=PHI):
    """Autoregressions of unit innovations that begin at zero, (count, n, 1)."""
    x, rows = np.zeros(count), []
    for _ in range(n):
        x = phi * x + rng.standard_normal(count)
        rows.append(x)
    return np.stack(rows, axis=1)[:, :, None]


def structure(errors, separated=None, explained=0.0):
    w, n, _ = errors.shape
    separated = np.zeros((w, n)) if separated is None else separated
    return Structure.of(errors, separated, np.ones((w, n), bool), np.full(w, DT), np.full(errors.shape[2], explained))


def test_draws_have_the_size_and_the_memory_of_the_errors():
    """The variance from zero is (1 - phi^2t) / (1 - phi^2); 200 series of 300 samples, 3 % of it by their number."""
    errors = from_zero(np.random.default_rng(1), 200, 300)
    found = replace(structure(errors), sizes=CERTAIN)
    drawn = found.draws(4000, np.zeros(300), DT, np.random.default_rng(2))[:, :, 0]
    steady = 1.0 / (1.0 - PHI**2)
    early = sum(PHI ** (2 * k) for k in range(3))  # after three innovations
    spread = 4.0 * np.sqrt(2.0 / 4000)  # four standard errors of a variance
    assert np.var(drawn[:, 2]) == pytest.approx(early, rel=spread + 0.03)
    assert np.var(drawn[:, 200]) == pytest.approx(steady, rel=spread + 0.03)
    assert np.corrcoef(drawn[:, 200], drawn[:, 205])[0, 1] == pytest.approx(PHI**5, abs=4.0 / np.sqrt(4000) + 0.01)


def test_what_is_explained_is_left_out_and_errors_grow_with_separation():
    """Half of the mean square explained: half is left."""
    errors = from_zero(np.random.default_rng(3), 200, 300)
    whole, half = structure(errors), structure(errors, explained=0.5 * float(np.mean(errors**2)))
    assert half.innovation**2 == pytest.approx(0.5 * whole.innovation**2, rel=1e-6)
    assert structure(errors, explained=2.0 * float(np.mean(errors**2))).innovation == 0.0
    # Three times as large in separated flow: a growth of 2.
    rng = np.random.default_rng(4)
    separated = np.repeat((np.arange(300) > 200).astype(float)[None], 100, axis=0)
    errors = rng.standard_normal((100, 300, 1)) * (1.0 + 2.0 * separated[:, :, None])
    found = structure(errors, separated)
    assert found.growth == pytest.approx(2.0, abs=0.1)
    drawn = replace(found, sizes=CERTAIN).draws(2000, separated[0], DT, rng)[:, :, 0]
    assert np.var(drawn[:, 250]) / np.var(drawn[:, 100]) == pytest.approx(9.0, rel=0.3)


def white(sizes=CERTAIN, left=1.0, innovation=1.0):
    """White errors of standard deviation `innovation`."""
    return Structure(np.zeros((1, 3)), np.array([innovation]), np.zeros(1), np.zeros(1), sizes, np.array([left]))


def test_few_sizes_widen_the_tails_and_a_part_of_an_error_repeats():
    """Of nu independent values the size is that of nu over a chi-square: Student's t, of variance nu/(nu-2)."""
    rng = np.random.default_rng(5)
    wide, narrow = (white(sizes).draws(40_000, np.zeros(1), DT, rng)[:, 0, 0] for sizes in (8, CERTAIN))
    assert np.var(narrow) == pytest.approx(1.0, rel=0.03)
    assert np.var(wide) == pytest.approx(8.0 / 6.0, rel=0.06)
    assert structure(np.ones((5, 40, 1))).sizes == 3 * 5
    # Of a constant error b a share w of the square repeats, w uniform: the mean is b E sqrt(w) = 2 b / 3, the mean
    # square b^2 / 2, beside half of that of the random errors.
    own = np.full((40, 1), 5.0)
    drawn = white().draws(40_000, np.zeros(40), DT, np.random.default_rng(6), own)[:, 10, 0]
    assert np.mean(drawn) == pytest.approx(5.0 * 2.0 / 3.0, rel=0.01)
    assert np.mean(drawn**2) == pytest.approx(25.0 / 2.0 + 0.5, rel=0.02)
    none = white(left=0.0, innovation=0.0).draws(10, np.zeros(40), DT, np.random.default_rng(7), own)
    assert not none.any()


def box(k):
    """The corners of [-1, 1]^k."""
    return np.array(list(itertools.product((-1.0, 1.0), repeat=k)))


RNG = np.random.default_rng(0)
FAR = np.array([1e3, 0.5, -1e3])


@pytest.mark.parametrize(("points", "sample", "expected"), [
    *((box(k), x, np.clip(x, -1, 1)) for k in (1, 2, 6) for x in 3.0 * RNG.standard_normal((2, k))),
    *((np.eye(k), np.zeros(k), np.full(k, 1.0 / k)) for k in (2, 3, 6)),  # the standard simplex, 1/sqrt(k) away
    (np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([1.0, 0.0]), [0.5, 0.5]),  # a segment in the plane
    (np.array([[2.0, 3.0]]), np.array([-1.0, 5.0]), [2.0, 3.0]), (box(3), FAR, [1.0, 0.5, -1.0]),
])  # fmt: skip
def test_the_nearest_point_of_a_hull(points, sample, expected):
    assert job.nearest(points, sample) == pytest.approx(expected, abs=1e-6 if sample is FAR else 1e-9)


def channels(**given):
    return {name: np.asarray(x, float) for name, x in given.items()}


def test_a_region_tells_share_distance_time_and_channels():
    """Flown: alpha 0 to 0.2, Mach 0.2 to 0.4, q -0.1 to 0.1. A ramp of alpha leaves it at 0.2 and ends at 0.4."""
    alpha, mach, q = box(3).T
    region = Region.of(channels(alpha=0.1 + 0.1 * alpha, mach=0.3 + 0.1 * mach, q=0.1 * q, elevator=q))
    assert region.channels == ("alpha", "mach", "q")
    n = 101
    ramp = channels(alpha=np.linspace(0.0, 0.4, n), mach=np.full(n, 0.3), q=np.zeros(n))
    found = region.outside("ramp", "recorded", 0.1 * np.arange(n), ramp)
    assert found.distance == pytest.approx(2.0)  # 0.2 rad beyond, of half a range of 0.1 rad
    assert found.time == pytest.approx(10.0)
    assert found.excess == pytest.approx({"alpha": 0.2, "mach": 0.0, "q": 0.0}, abs=1e-9)
    assert found.share == pytest.approx(np.mean(ramp["alpha"] > 0.21), abs=1e-9)  # beyond a tenth of the scale
    within = channels(alpha=np.full(n, 0.15), mach=np.full(n, 0.25), q=np.full(n, 0.05))
    assert region.outside("within", "recorded", 0.1 * np.arange(n), within) is None
    # Sideslip was always zero: two degrees of it are two least scales of a degree outside.
    region = Region.of(channels(alpha=[0.0, 0.2], beta=[0.0, 0.0], airspeed=[80.0, 100.0]))
    assert region.channels == ("alpha", "beta", "airspeed")
    slipping = channels(alpha=[0.1], beta=[np.radians(2.0)], airspeed=[90.0])
    assert region.outside("slip", "recorded", np.zeros(1), slipping).distance == pytest.approx(2.0)


# What more records make of a probability to pass: normal errors in closed form, and what no record decides
DRAWS, SAMPLES = 20000, 3


def constant_error(rng, sd=1.0):
    """Errors of two parameters, the first of which shifts an output by itself; all else of this deviation."""
    errors = rng.standard_normal((DRAWS, 2))
    by_parameters = np.repeat(errors[:, :1], SAMPLES, axis=1)
    rest = np.repeat(sd * rng.standard_normal((DRAWS, 1)), SAMPLES, axis=1)
    return errors, OpenTest(FlightKind.NEXT, "stall", "theta", 2.0, by_parameters, rest)


@pytest.mark.parametrize("information", [(0.0, 0.0), (1.0, 0.0), (0.0, 50.0)])
@pytest.mark.parametrize("rest", [0.0, 0.7])
def test_the_probability_with_more_information_is_that_of_a_narrower_normal(information, rest):
    """sd^2 = 1/(1 + I) + rest^2, and P = 2 Phi(2/sd) - 1; what is known of another parameter changes nothing."""
    errors, test = constant_error(np.random.default_rng(3), rest)
    less = job.shrunk(errors, np.cov(errors, rowvar=False), np.diag(information))
    found = test.probability((less - errors) @ test.slope(errors))
    sd = np.sqrt(1.0 / (1.0 + information[0]) + rest**2)
    assert found == pytest.approx(2.0 * norm.cdf(2.0 / sd) - 1.0, abs=0.01)


def test_a_record_s_precision_is_that_of_its_own_estimates():
    """Least squares under coloured noise: the inverse of (X'X)^-1 X'VX (X'X)^-1."""
    rng = np.random.default_rng(5)
    X = rng.standard_normal((60, 2))
    V = 0.9 ** np.abs(np.subtract.outer(np.arange(60), np.arange(60)))
    told = Information(("b", "a"), X.T @ X, X.T @ V @ X, np.zeros(2))
    bread = np.linalg.inv(X.T @ X)
    scale = np.array([2.0, 0.5])
    own = np.linalg.inv(bread @ X.T @ V @ X @ bread)[::-1, ::-1] * np.outer(scale, scale)
    np.testing.assert_allclose(job.precision_of(told, ("a", "b"), scale), own, rtol=1e-9)


@pytest.fixture(scope="module")
def simulated(card, model):
    return join([simulate_stall(0, card=card)], card, FLIGHT), {name: TRUTH[name] for name in model.names}


def test_points_make_a_tolerance_that_parameters_leave_open_pass(simulated, card, model):
    """The drag at zero lift, known to .02, leaves airspeed open; a record tells it far better."""
    flights, values = simulated
    rng = np.random.default_rng(6)
    errors = np.zeros((4000, len(model.names)))
    errors[:, model.names.index("CD0")] = 0.02 * rng.standard_normal(4000)
    by_parameters = np.repeat(80.0 * errors[:, [model.names.index("CD0")]], SAMPLES, axis=1)
    noise = np.repeat(0.2 * rng.standard_normal((4000, 1)), SAMPLES, axis=1)
    tests = [OpenTest(FlightKind.AGAIN, "stall", "airspeed", 1.5, by_parameters, noise)]
    found = job.further_flights(tests, model.names, errors, flights, model, values, card.envelope)
    (one,) = found.tests
    assert one.present == pytest.approx(2.0 * norm.cdf(1.5 / np.hypot(1.6, 0.2)) - 1.0, abs=0.03)
    assert one.known == 1.0
    assert len(found.points) == 1  # one is enough
    assert found.points[0].expected[0] > 0.95
    assert "V of stall" in further_sentences(found)[1]


def test_what_the_structure_leaves_open_no_record_decides_and_points_need_accelerometers(simulated, model):
    flights, values = simulated

    def further(rest, flights):
        errors, test = constant_error(np.random.default_rng(7), rest)
        wide = np.hstack([errors, np.zeros((DRAWS, len(model.names) - 2))])
        return job.further_flights([test], model.names, wide, flights, model, values, Envelope())

    found = further(1.5, flights)
    assert not found.points
    assert not found.tests[0].decidable
    (sentence,) = further_sentences(found)
    assert "Undecided even if the parameters were known: θ of stall on the next flight." in sentence
    blind = replace(flights, channels={n: x for n, x in flights.channels.items() if n != "az"})
    with pytest.raises(InputError, match="az was not recorded"):
        further(0.0, blind)
