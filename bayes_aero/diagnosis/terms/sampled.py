"""The library's terms in one coefficient as a sampled posterior over their sets: a witness beside forward selection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.screening.autocorrelation import Autocorrelation, autocorrelation_of
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.structure.components import with_components
from bayes_aero.diagnosis.terms.columns import Column, columns_of
from bayes_aero.diagnosis.terms.forms import Structure
from bayes_aero.diagnosis.terms.result import FoundTerm, SampledSet, SampledTerms
from bayes_aero.inference.posterior.posterior import PosteriorStatus
from bayes_aero.inference.posterior.spike_and_slab import Columns, SelectionDraws, sample_sets
from bayes_aero.inference.variance.autoregression import ORDER

OWN = 1e-8  # least share of a column that the model's parameters leave: below it is rounding
EXPECTED = 1.0  # terms, before the flights: one form for one structure; our choice
TOLD = 0.1  # least probability of a set that is reported
SETS = 5  # that are reported


def sampled_terms(structure: Structure, terms: Sequence[FoundTerm], *, seed: int) -> SampledTerms:
    """The posterior over sets of terms of a coefficient in which structure is left.

    Args:
        structure: where its form was sought; the colour of the noise is that of what all descriptions leave.
        terms: by forward selection.
        seed: of the chains.
    """
    state, coefficient = structure.state, structure.coefficient
    found = [one for one in terms if one.coefficient == coefficient]
    columns = columns_of(state, coefficient)
    whole = with_components(state, (), (*structure.own, *structure.others), state.folds)
    colour = autocorrelation_of(whole.left(whole.fit()), state.folds)
    data, kept = regression(with_components(state, (), structure.others, state.folds), columns, colour)
    columns = [columns[j] for j in kept]
    drawn = sample_sets(data, seed=seed)
    names = [c.term.name for c in columns]
    as_good = {f.term.name: [f.term.name, *(o.name for o, _ in f.others)] for f in found}
    at = {name: [names.index(n) for n in members if n in names] for name, members in as_good.items()}
    probabilities = drawn.probabilities(len(columns))
    return SampledTerms(
        coefficient=coefficient,
        sets=_sets(drawn, columns, np.asarray(data.gram), [j for own in at.values() for j in own], state),
        found={n: (float(probabilities[own[:1]].sum()), drawn.probability(*own)) for n, own in at.items()},
        count=float((drawn.members >= 0).sum(axis=2).mean()),
        status=drawn.status.value,
        rhat=drawn.rhat,
        ess=drawn.ess,
        divergent=drawn.divergent,
        reliable=drawn.status is PosteriorStatus.CONVERGED,
    )


def regression(state: SelectionState, columns: Sequence[Column], colour: Autocorrelation) -> tuple[Columns, list[int]]:
    """Residual and terms whitened by the colour of the noise, the model's parameters integrated out under their priors;
    and which columns are more than rounding then.

    Generalised least squares: innovations of residual and columns under the autoregression, of unit deviation.
    """
    base = state.columns()
    terms = np.concatenate([c.component.basis for c in columns], axis=2) / state.noise_growth[:, :, None]
    residual = (state.residual / state.noise_growth)[:, :, None]
    white = _innovations(np.concatenate([residual, state.scaled[:, :, base], terms], axis=2), state, colour)
    y, B, X = white[:, 0], white[:, 1 : len(base) + 1], white[:, len(base) + 1 :]
    root = np.sqrt(state.precision[base] / state.variance_inflation)  # a whitened likelihood counts once, as priors do
    y = np.append(y, root * state.mean[base])
    B, X = np.concatenate([B, np.diag(root)]), np.concatenate([X, np.zeros((len(base), X.shape[1]))])
    Q = np.linalg.qr(B / np.maximum(np.linalg.norm(B, axis=0), 1e-300))[0]
    before = np.sum(X**2, axis=0)
    y, X = y - Q @ (Q.T @ y), X - Q @ (Q.T @ X)
    own = np.sum(X**2, axis=0)
    kept = [int(j) for j in np.flatnonzero(own > OWN * before)]
    X = X[:, kept] / np.sqrt(own[kept])
    prior = 0.5 ** np.array([columns[j].term.cost for j in kept], float)
    log_odds = np.log(EXPECTED * prior / prior.sum())
    count = float(len(white))
    return Columns(X.T @ X, X.T @ y, float(y @ y), count, log_odds, float(np.sqrt(count))), kept


def _innovations(
    series: Float[np.ndarray, "m c k"], state: SelectionState, colour: Autocorrelation
) -> Float[np.ndarray, "n k"]:
    """What the autoregression of each output does not predict within folds, over its deviation; outputs in a row."""
    found = []
    for fold in state.folds:
        for c, (phi, sigma) in enumerate(zip(colour.phi, colour.sigma, strict=True)):
            x = series[fold, c]
            past = sum(p * x[ORDER - 1 - i : len(x) - 1 - i] for i, p in enumerate(phi))
            found.append((x[ORDER:] - past) / max(float(sigma), 1e-300))
    return np.concatenate(found)


def _sets(
    drawn: SelectionDraws,
    columns: Sequence[Column],
    gram: Float[np.ndarray, "p p"],
    known: Sequence[int],
    state: SelectionState,
) -> tuple[SampledSet, ...]:
    """The most probable term with those that follow it, then the most probable of the others, and so on."""
    probabilities = drawn.probabilities(len(columns))
    left, found = np.ones(len(columns), bool), []
    while len(found) < SETS and left.any():
        first = int(np.argmax(np.where(left, probabilities, -1.0)))
        own = np.flatnonzero(left & (np.abs(gram[first]) >= state.settings.correlated))
        left[own] = False
        left[first] = False
        probability = drawn.probability(*own.tolist())
        if probability < TOLD:
            break
        order = own[np.argsort(-probabilities[own], kind="stable")]
        terms = tuple((columns[j].term, float(probabilities[j])) for j in order)
        found.append(SampledSet(terms, probability, bool(set(own.tolist()) & set(known))))
    return tuple(sorted(found, key=lambda one: -one.probability))
