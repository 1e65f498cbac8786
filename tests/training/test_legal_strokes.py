"""The distribution over legal strokes, and the masks in every loss."""

import numpy as np
import torch
from scipy import stats

from shuttle_marl.env.batched import VersusEnv
from shuttle_marl.game import default_game
from shuttle_marl.training.networks import LegalStrokes, make_actor, tabulated

GAME = default_game()


def masks(states: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(GAME.mask(states))


def test_probabilities_are_those_of_a_softmax_over_the_legal_strokes() -> None:
    rng = np.random.default_rng(0)
    mask = masks(rng.integers(4, GAME.n_states, 64))
    logits = torch.from_numpy(rng.normal(size=(64, GAME.n_strokes)) * 5)
    distribution = LegalStrokes(logits, mask=mask)
    weight = torch.where(mask, logits.exp(), 0.0)
    expected = weight / weight.sum(-1, keepdim=True)
    torch.testing.assert_close(distribution.probs, expected)
    legal = expected > 0
    entropy = -torch.where(legal, expected * expected.clamp_min(1e-300).log(), 0.0).sum(-1)
    torch.testing.assert_close(distribution.entropy(), entropy)
    stroke = expected.argmax(-1)
    torch.testing.assert_close(distribution.log_prob(stroke), expected.gather(-1, stroke[:, None])[:, 0].log())
    assert (distribution.deterministic_sample == stroke).all()


def test_a_million_samples_hold_no_illegal_stroke_and_follow_the_probabilities() -> None:
    torch.manual_seed(1)
    mask = masks(np.random.default_rng(1).integers(4, GAME.n_states, 100))
    # Logits so far apart that rounding would show.
    distribution = LegalStrokes(torch.randn(100, GAME.n_strokes) * 12, mask=mask)
    drawn = distribution.sample((10_000,))
    assert drawn.shape == (10_000, 100)
    assert mask.expand(10_000, -1, -1).gather(-1, drawn[..., None]).all()
    row = int(distribution.entropy().argmax())
    seen = np.bincount(drawn[:, row].numpy(), minlength=GAME.n_strokes)
    expected = distribution.probs[row].double().numpy() * 10_000
    common = expected > 5
    pooled = np.r_[seen[common], seen[~common].sum()], np.r_[expected[common], expected[~common].sum()]
    keep = pooled[1] > 0
    total = pooled[1][keep] / pooled[1][keep].sum() * pooled[0][keep].sum()
    assert stats.chisquare(pooled[0][keep], total).pvalue > 1e-4


def test_the_table_of_an_actor_is_what_it_plays() -> None:
    torch.manual_seed(0)
    actor = make_actor(GAME, width=16, hidden=1)
    table = tabulated(actor, GAME).pair_probabilities()
    state = np.random.default_rng(2).integers(4, GAME.n_states, 50)
    with torch.no_grad():
        seen = {"observation": torch.from_numpy(GAME.observation(state)), "action_mask": masks(state)}
        distribution = actor.get_dist(VersusEnv(50).reset().update(seen))
    for row, s in enumerate(state):
        pairs = slice(GAME.pair_start[s], GAME.pair_start[s + 1])
        expected = distribution.probs[row, GAME.pair_stroke[pairs].astype(np.int64)]
        assert np.abs(table[pairs] - expected.numpy()).max() < 2 / 65535
