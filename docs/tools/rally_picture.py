"""Makes ``docs/images/rally.png``: ``python -m docs.tools.rally_picture``.

Two scripted players play a match; the picture shows the first moment of its deciding game in which a smash comes back
after a long and varied rally.
"""

from typing import Final

import numpy as np
import pygame

from docs.tools.markdown import IMAGES
from shuttle_marl import match_v0
from shuttle_marl.env.snapshot import Snapshot
from shuttle_marl.game.policy import States
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.policy.registry import resolve

PLAYERS: Final = ("defensive", "attacking")
SMASH: Final = SHOTS.index("smash")


def is_lively(moment: Snapshot) -> bool:
    """True for a rally of the deciding game that is worth a picture."""
    if len(moment.by_game) < 3 or min(moment.by_game[-1]) < 8 or not 8 <= len(moment.strokes) <= 13:
        return False
    shots = moment.game.catalogue.shot[[s.stroke for s in moment.strokes]]
    varied = len(set(shots.tolist())) >= 6
    return varied and shots[-1] == SMASH and moment.reason is None


def first_lively_moment(seeds: range) -> np.ndarray:
    """Picture of the first lively moment in matches of these seeds."""
    env = match_v0.env(render_mode="rgb_array")
    game = env.unwrapped.game
    policies = [resolve(name, game) for name in PLAYERS]
    for seed in seeds:
        rng = np.random.default_rng(seed)
        env.reset(seed=seed)
        for agent in env.agent_iter():
            _, _, terminated, truncated, _ = env.last(observe=False)
            if terminated or truncated:
                env.step(None)
                continue
            states = States(game=game, state=np.array([env.unwrapped.state_number], dtype=np.int32))
            probability = policies[env.possible_agents.index(agent)].probabilities(states)[0]
            env.step(rng.choice(len(probability), p=probability))
            if is_lively(env.unwrapped.snapshot()):
                return env.render()
    raise LookupError(f"no lively moment in matches of seeds {seeds}")


if __name__ == "__main__":
    picture = first_lively_moment(range(500))
    pygame.image.save(pygame.surfarray.make_surface(picture.swapaxes(0, 1)), IMAGES / "rally.png")
