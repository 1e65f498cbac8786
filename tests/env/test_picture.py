"""Pictures of rallies."""

import itertools
import os
import subprocess
import sys

import numpy as np
import pytest

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.env.picture import CourtRenderer, px
from shuttle_marl.env.snapshot import plan_of
from tests import golden

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

pygame = pytest.importorskip("pygame")


@pytest.fixture
def fast(monkeypatch):
    for module in (rally_v0, match_v0):
        monkeypatch.setitem(module.raw_env.metadata, "render_fps", 0)


def test_the_picture_changes_with_every_stroke(play):
    env = rally_v0.env(render_mode="rgb_array")
    frames = [env.render() for *_, terminated, _, _, _ in play(env, 11) if not terminated]
    frames.append(env.render())
    assert len(frames) > 3
    assert all((before != after).any() for before, after in itertools.pairwise(frames))


@pytest.mark.parametrize("game", ["default", "default:recovery"])
def test_pictures_are_those_that_somebody_looked_at(play, game):
    env = match_v0.env(render_mode="rgb_array", game=game)
    found = {}
    for number, _ in enumerate(itertools.islice(play(env, 11), 12)):
        plan, picture = plan_of(env.unwrapped.snapshot()), env.render().astype(float)
        found[f"{game} {number}"] = [plan.shuttle, plan.bodies, plan.came_from, plan.waited]
        found[f"{game} {number}, picture"] = picture.reshape(8, 70, 12, 75, 3).mean(axis=(1, 3, 4))
    golden.check("drawn_rallies", found, 0.01)


def test_lines_of_the_court_are_those_of_the_laws():
    """Law 1: lines are brighter than the floor 20 cm beside them."""
    env = rally_v0.env(render_mode="rgb_array")
    env.reset(seed=0)
    frame = env.render().astype(int).sum(axis=2)
    for side in (-1, 1):
        along = [((side * x, y), (0.2, 0.0)) for x in (6.7, 5.94, 1.98) for y in (-2.8, 1.3)]
        along += [((x, side * y), (0.0, 0.2)) for x in (-6.3, -4.1, 4.1, 6.3) for y in (2.59, 3.05)]
        along += [((side * 3.2, 0.0), (0.0, 0.2))]
        for at, beside in along:
            (x, y), *floor = (np.rint(px(np.array(at) + k * np.array(beside)) / 2).astype(int) for k in (0, -1, 1))
            assert frame[y, x] > 100 + max(frame[other[1], other[0]] for other in floor), at


def test_a_window_follows_the_rally_and_can_be_closed(fast, play):
    env = match_v0.env(render_mode="human", max_strokes=30)
    rows = play(env, 0)
    next(rows)
    window = pygame.display.get_surface()
    before = pygame.surfarray.array3d(window)
    assert (before.swapaxes(0, 1) == CourtRenderer("", fps=0).frame(env.unwrapped.snapshot())).all()
    next(rows)
    assert (pygame.surfarray.array3d(window) != before).any()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    next(rows)
    assert pygame.display.get_surface() is None
    assert len(list(rows)) > 20, "the match continues without the window"
    env.close()


def test_a_missing_pygame_is_named_with_the_cure():
    code = """
import sys
sys.modules["pygame"] = None
from shuttle_marl import rally_v0
from shuttle_marl.base.errors import ShuttleError
env = rally_v0.env(render_mode="rgb_array")
env.reset(seed=0)
try:
    env.render()
except ShuttleError as error:
    print(error)
text = rally_v0.env(render_mode="ansi")
text.reset(seed=0)
print(text.render())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "need pygame, which is not installed ('ansi' works without); `make install`" in done.stdout
    assert "is to serve" in done.stdout
