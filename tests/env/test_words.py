"""Rallies in words."""

import numpy as np

from shuttle_marl.env.words import OVER, WAIT, TextRallyEnv, described, text_env, words
from tests.reduced import reduced_game

GAME = reduced_game()


def test_positions_are_described_in_words() -> None:
    assert described(GAME, int(GAME.playable.argmax())) == "You serve."
    later = int(np.flatnonzero((GAME.own(np.arange(GAME.n_states)) < GAME.n_strokes) & GAME.playable)[-1])
    text = described(GAME, later)
    assert text.startswith("Your opponent played: ")
    assert "Your own last stroke was: " in text
    calm = GAME.state_of(*(*GAME.observation(later)[:-1], 0))
    assert text.replace(" You are hurried: late or stretched.", "") == described(GAME, int(calm)) != text
    assert all(GAME.catalogue.names[stroke] in words(GAME, later) for stroke in GAME.legal_strokes(later))


def test_rallies_are_played_in_words() -> None:
    env = TextRallyEnv(opponent="safe", game=GAME)
    seen, _ = env.reset(seed=1)
    rewards, over = [], False
    while not over:
        assert env.observation_space.contains(seen)
        seen, reward, over, _, _ = env.step(f"I play {seen.split('Legal strokes: ')[1].split(', ')[0]}.")
        rewards.append(reward)
    assert (abs(sum(rewards)), seen) == (1, OVER)
    env.reset()
    assert env.step("no idea")[1:3] == (-1, True)


def test_two_players_play_in_words() -> None:
    env, strokes = text_env(game=GAME), 0
    env.reset(seed=1)
    for agent in env.agent_iter():
        seen, _, terminated, truncated, _ = env.last()
        assert env.observe(next(other for other in env.possible_agents if other != agent)) in (OVER, WAIT)
        if terminated or truncated:
            assert seen == OVER
            env.step(None)
        else:
            strokes += 1
            env.step(str(seen).split("Legal strokes: ")[1].split(", ")[0])
    assert strokes > 0
