"""Pictures of rallies."""

import itertools
import os
import subprocess
import sys

import pytest

from shuttle_marl import match_v0, rally_v0

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


def test_a_window_follows_the_rally_and_can_be_closed(fast, play):
    env = match_v0.env(render_mode="human", max_strokes=30)
    rows = play(env, 0)
    next(rows)
    window = pygame.display.get_surface()
    assert window.get_size() == (1200, 584)
    before = pygame.surfarray.array3d(window)
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
