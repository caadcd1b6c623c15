"""The frequency domain: coverage under drift and colour, agreement with the time domain.

    OPENBLAS_NUM_THREADS=1 python benchmarks/frequency_domain.py [--flights 200] [--stalls 40] [--aeroid]

The first table has flights of an exact short period with a multisine: white or coloured noise of the outputs, with and
without drift of the sensors. The second has simulated stalls with coloured disturbances: how far the estimates of both
domains are apart.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from bayes_aero.diagnosis.trajectories.results import Setting
from bayes_aero.diagnosis.trajectories.trajectory_fit import fit_trajectories
from bayes_aero.dynamics.linear import channel_units, linear_dynamics
from bayes_aero.dynamics.simulated.multisines import multisines
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.frequency.bands import coefficients_in_band, linear_in_band
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.likelihood.noise_bias import without_noise_bias
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.simulate.demo import TRUTH, simulate_stall

DT, N, BAND, STALL_BAND = 0.04, 1250, (0.1, 1.5), (0.05, 1.5)
SHORT_PERIOD = {"Zalpha": -0.9, "Zq": 0.0, "Zde": -0.06, "Malpha": -2.1, "Mq": -1.3, "Mde": -3.0}
MAIN = ("Zalpha", "Malpha", "Mq", "Mde")
NOISE, DRIFT = {"alpha": 0.002, "q": 0.003}, {"alpha": 0.03, "q": -0.02}  # rad, rad/s; drift over the record


def short_period(rng: np.random.Generator, colour: float, drift: bool) -> FlightRecord:
    """A flight from trim, two periods of a multisine; noise with this lag-1 correlation."""
    time, k = np.arange(N) * DT, SHORT_PERIOD
    u = 0.03 * multisines(time, 25.0, (0.1, 1.4), 1)[0]
    A = np.array([[k["Zalpha"], 1.0 + k["Zq"]], [k["Malpha"], k["Mq"]]])
    big = np.zeros((4, 4))
    big[:2, :2], big[:2, 2], big[2, 3] = A * DT, np.array([k["Zde"], k["Mde"]]) * DT, 1.0
    step, x = expm(big)[:2], [np.zeros(2)]
    for now, change in zip(u[:-1], np.diff(u), strict=True):
        x.append(step @ [*x[-1], now, change])
    true = {"alpha": np.array(x)[:, 0], "q": np.array(x)[:, 1]}
    channels = {"elevator": u}
    for name, value in true.items():
        white = NOISE[name] * np.sqrt(1.0 - colour**2) * rng.standard_normal(N + 200)
        channels[name] = value + lfilter([1.0], [1.0, -colour], white)[200:] + drift * DRIFT[name] * time / time[-1]
    return FlightRecord.from_arrays("flight", time, channels)


def coverage(flights: int, seed: int) -> None:
    """Share of 95 % intervals (corrected standard errors) with the true value, and the errors in these."""
    card = read_card("attas_short_period")
    units = {name: c.unit for name, c in STANDARD_CHANNELS.items()} | channel_units(card)
    dynamics = linear_dynamics(card)
    print(f"\n| noise | sensors | method | 95 % intervals with the truth | RMS error of {', '.join(MAIN)}, % | "
          "corrected bound over plain |")  # fmt: skip
    print("|---|---|---|---|---|---|")
    for colour in (0.0, 0.9):
        for drift in (False, True):
            rng = np.random.default_rng([seed, round(10 * colour), drift])
            found: dict[str, list] = {}
            for _ in range(flights):
                joined = join([short_period(rng, colour, drift)], card, dynamics.inputs)
                fit = fit_trajectories(joined, dynamics, units, setting=Setting(priors=False)).fit
                (first, second), *_ = linear_in_band(joined, dynamics, BAND)
                fits = (("output error, time", fit, fit.sd_corrected),
                        ("equation error, band", first, first.crb_corrected),
                        ("output error, band", second, second.crb_corrected))  # fmt: skip
                for method, one, sd in fits:
                    at = [one.names.index(name) for name in SHORT_PERIOD]
                    error = one.estimate[at] - np.array(list(SHORT_PERIOD.values()))
                    found.setdefault(method, []).append((error, sd[at], sd[at] / one.crb[at]))
            main, truth = [list(SHORT_PERIOD).index(n) for n in MAIN], np.array([SHORT_PERIOD[n] for n in MAIN])
            for method, rows in found.items():
                error, sd, wider = (np.array(x) for x in zip(*rows, strict=True))
                inside = np.mean(np.abs(error) < 1.96 * sd)
                rms = 100.0 * np.sqrt(np.mean(np.square(error[:, main] / truth)))
                print(f"| {'white' if colour == 0.0 else 'lag-1 0.9'} | {'drift' if drift else 'sound'} | {method} | "
                      f"{inside:.1%} | {rms:.2f} | {np.median(wider):.2f} |", flush=True)  # fmt: skip


def agreement(stalls: int, seed: int) -> None:
    """Both domains on simulated stalls: differences in standard errors, and errors of either."""
    card = read_card("attas")
    model, apart, band, time, wider = Model.from_card(card), [], [], [], []
    for number in range(stalls):
        records = [simulate_stall(i, seed=seed + number) for i in range(2)]
        mle = fit_mle(model, observe(records, card, model), extra_starts=0)
        mle = without_noise_bias(mle, records, card, model)
        fit = coefficients_in_band(records, card, model, mle, STALL_BAND)
        place = [mle.names.index(name) for name in fit.names]
        truth = np.array([TRUTH[name] for name in fit.names])
        apart.append(list(fit.apart.values()))
        band.append((fit.estimate - truth) / fit.crb_corrected)
        time.append(((mle.estimate - np.array([TRUTH[n] for n in mle.names])) / mle.crb_corrected)[place])
        wider.append([np.median(fit.crb_corrected / fit.crb), np.median(mle.crb_corrected / mle.crb)])
    shares = [f"{np.mean(np.abs(x) < 1.96):.1%}" for x in (time, band, apart)]
    print("\n| pairs of stalls | 95 % intervals with the truth, time | band | differences within 1.96 standard "
          "errors | above 3 | corrected over plain bound, time | band |")  # fmt: skip
    print("|---|---|---|---|---|---|---|")
    print(f"| {stalls} | {shares[0]} | {shares[1]} | {shares[2]} | {np.mean(np.array(apart) > 3.0):.1%} | "
          f"{np.median(wider, axis=0)[1]:.1f} | {np.median(wider, axis=0)[0]:.2f} |")  # fmt: skip


def rival(flights: int, seed: int) -> None:
    """The measured response of q to the elevator against the closed form: ours and aeroid 0.5, each with its settings.

    aeroid has no estimates in the frequency domain; it compares responses, one input at a time.
    """
    import aeroid

    card, k = read_card("attas_short_period"), SHORT_PERIOD
    dynamics = linear_dynamics(card)

    def rates(t, x, u, v):  # noqa: ARG001
        return np.array([v["Zalpha"] * x[0] + (1.0 + v["Zq"]) * x[1] + v["Zde"] * u[0],
                         v["Malpha"] * x[0] + v["Mq"] * x[1] + v["Mde"] * u[0]])  # fmt: skip

    model = aeroid.Model(["alpha", "q"], ["elevator"], dict(k), rates)
    print("\n| sensors | program | RMS relative error of q over elevator, 0.2 to 1.2 Hz | frequencies |")
    print("|---|---|---|---|")
    for drift in (False, True):
        rng, errors = np.random.default_rng([seed, 99, drift]), {"bayes_aero": [], "aeroid": []}
        for _ in range(flights):
            record = short_period(rng, 0.0, drift)
            *_, responses = linear_in_band(join([record], card, dynamics.inputs), dynamics, (0.2, 1.2))
            ours = next(r for r in responses if r.output == "q")
            data = aeroid.FlightData(
                record.time, {n: np.asarray(record.channels[n]) for n in ("alpha", "q", "elevator")}
            )
            theirs = aeroid.frequency_response(model, data, k, outputs=["q"], frequency_range=(0.2, 1.2))
            one = theirs.channel("elevator", "q")
            for name, f, measured in (
                ("bayes_aero", ours.frequency, ours.measured),
                ("aeroid", one.frequency, one.magnitude_data * np.exp(1j * one.phase_data)),
            ):
                s = 2j * np.pi * f
                exact = (k["Mde"] * s + k["Malpha"] * k["Zde"] - k["Mde"] * k["Zalpha"]) / (
                    s**2 - (k["Zalpha"] + k["Mq"]) * s + k["Zalpha"] * k["Mq"] - k["Malpha"] * (1.0 + k["Zq"])
                )
                errors[name].append(np.abs(measured / exact - 1.0))
        for name, found in errors.items():
            rms = np.sqrt(np.mean(np.square(found)))
            print(f"| {'drift' if drift else 'sound'} | {name} | {rms:.1%} | {len(found[0])} |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--stalls", type=int, default=40)
    parser.add_argument("--aeroid", action="store_true", help="compare with aeroid (extra `bench`), too")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    coverage(asked.flights, asked.seed)
    agreement(asked.stalls, asked.seed)
    if asked.aeroid:
        rival(asked.flights // 4, asked.seed)


if __name__ == "__main__":
    main()
