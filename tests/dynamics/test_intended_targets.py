"""Known fault rates per intended target are recovered from data that only holds recorded landings."""

import numpy as np
import pytest

from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.dynamics.models import EnsembleConfig, fit_success, fit_target, intended_targets, latent_target, softmax
from shuttle_marl.dynamics.modules import GOOD, SPECS, NetworkSpec
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import SHOTS
from tests.dynamics.rows import plain_rows

N = 40_000
# Of the shuttle aimed at each area: out, and short of the net (recorded in a front area, wherever it was aimed).
OUT = np.array([0.03, 0.00, 0.03, 0.02, 0.00, 0.02, 0.08, 0.03, 0.08])
SHORT = np.array([0.08, 0.03, 0.08, 0.07, 0.02, 0.06, 0.09, 0.05, 0.07])


def simulated() -> tuple[Rows, np.ndarray]:
    """Strokes whose targets depend on the incoming area, and the true targets."""
    rng = np.random.default_rng(5)
    incoming, shot = rng.integers(0, N_AREAS, N), rng.integers(2, 10, N)
    # In each context players prefer some targets; without such differences nothing could tell short faults apart.
    preference = rng.dirichlet(np.full(N_AREAS, 0.2), (10, N_AREAS)).cumsum(axis=-1)
    target = np.minimum((preference[shot, incoming] < rng.random(N)[:, None]).sum(axis=1), N_AREAS - 1)
    u = rng.random(N)
    out, short = u < OUT[target], (u >= OUT[target]) & (u < (OUT + SHORT)[target])
    landing = np.where(short, rng.integers(0, 3, N), target)
    codes = {"incoming_area": incoming, "incoming_shot": shot, "shot": np.full(N, SHOTS.index("drop")), "area": landing}
    reason = np.where(out, REASONS.index("out"), np.where(short, REASONS.index("net"), REASONS.index("returned")))
    rows = plain_rows(
        N,
        codes={name: code.astype(np.int16) for name, code in codes.items()},
        outcome=np.where(out | short, Outcome.FAULT, Outcome.RETURNED).astype(np.int8),
        reason=reason.astype(np.int8),
        match=(np.arange(N) // 600).astype(np.int32),
        matches=tuple(str(i) for i in range(N // 600)),
    )
    return rows, target


@pytest.mark.slow
def test_fault_rates_per_intended_target_are_recovered(monkeypatch: pytest.MonkeyPatch) -> None:
    # The networks of the game, small and without shrinkage: what is tested is the treatment of the targets.
    context = ("incoming_shot", "incoming_area")
    small = {
        "target": NetworkSpec(inputs=context, crosses=(context,), outputs=N_AREAS, hidden=24, members=2),
        "success": NetworkSpec(inputs=("area",), crosses=(), outputs=3, hidden=16, members=2),
    }
    for name, spec in small.items():
        monkeypatch.setitem(SPECS, name, spec)
    config = EnsembleConfig(epochs=12, batch=512, learning_rate=1e-2, decay=0.0, decay_linear=0.0, dropout=0.0)
    rows, target = simulated()
    fault = rows.outcome == Outcome.FAULT
    truth = OUT + SHORT
    # The naive fit reads the recorded landing as the target.
    naive = np.array([fault[rows.codes["area"] == a].mean() for a in range(N_AREAS)])

    known = np.zeros((N, N_AREAS))
    seen = np.flatnonzero(~latent_target(rows))
    known[seen, rows.codes["area"][seen]] = 1
    aims = fit_target(rows, known, config, seed=1)

    def shares() -> np.ndarray:
        return softmax(aims.logits(rows.codes)).mean(axis=0)

    success = fit_success(rows, shares(), config, seed=2)
    for _ in range(3):
        soft = intended_targets(aims, success, rows)
        aims = fit_target(rows, soft, config, seed=3)
        success = fit_success(rows, shares(), config, seed=4)
    found = np.stack([softmax(success.logits(rows.with_area(a))) for a in range(N_AREAS)], axis=2)
    missed = 1 - found[..., GOOD].mean(axis=0)
    recovered = np.array([missed[target == a, a].mean() for a in range(N_AREAS)])

    assert np.abs(naive - truth).mean() > 0.03, "the naive fit must be wrong for this test to mean anything"
    assert np.abs(recovered - truth).mean() < 0.012
    assert np.abs(recovered - truth).mean() < np.abs(naive - truth).mean() / 3
    # The order of front corners and middle, which the naive fit exaggerates, and back corners, which it hides.
    assert recovered[[6, 8]].min() > recovered[[3, 4, 5]].max()
