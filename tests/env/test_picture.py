"""Pictures of rallies."""

import dataclasses
import itertools
import os
import subprocess
import sys

import numpy as np
import pytest

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.env.snapshot import Snapshot, shot_in_words
from shuttle_marl.game import default_game
from shuttle_marl.game.court import LENGTH, WIDTH
from shuttle_marl.game.rally.stepper import Stroke
from shuttle_marl.game.rules import OUTCOMES
from tests.exact.exact_games import tiring_game

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

pygame = pytest.importorskip("pygame")

from shuttle_marl.env import picture as drawing  # noqa: E402
from shuttle_marl.env.picture import LINE, MAT, PLAYERS, PX, YELLOW, CourtRenderer, px  # noqa: E402


def share_of(picture, colour, tolerance=30):
    return (np.abs(picture.astype(int) - colour).max(axis=-1) <= tolerance).mean()


@pytest.fixture
def fast(monkeypatch):
    for module in (rally_v0, match_v0):
        monkeypatch.setitem(module.raw_env.metadata, "render_fps", 0)


def test_the_court_has_the_proportions_of_the_laws():
    env = rally_v0.env(render_mode="rgb_array", server=0)
    env.reset(seed=0)
    picture = env.render()
    assert picture.dtype == np.uint8
    assert picture.shape == (584, 1200, 3)
    x0, y0 = px((-LENGTH / 2, -WIDTH / 2))
    lines = np.abs(picture.astype(int) - LINE).max(axis=-1) < 60
    rows = np.flatnonzero(lines[:, round(x0) : round(x0 + LENGTH * PX)].mean(axis=1) > 0.9)
    columns = np.flatnonzero(lines[round(y0) : round(y0 + WIDTH * PX)].mean(axis=0) > 0.8)
    assert (columns[-1] - columns[0]) / (rows[-1] - rows[0]) == pytest.approx(LENGTH / WIDTH, rel=0.02)
    assert share_of(picture, MAT) > 0.15


def test_the_picture_changes_with_every_stroke(play):
    env = rally_v0.env(render_mode="rgb_array")
    frames = [env.render() for *_, terminated, _, _, _ in play(env, 11) if not terminated]
    frames.append(env.render())
    assert len(frames) > 3
    assert all((before != after).any() for before, after in itertools.pairwise(frames))


def test_the_picture_tells_the_efforts_where_they_count():
    """A smash changes what stands behind the name of who struck it, and the space for it is there in games of effort alone."""
    env = rally_v0.env(render_mode="rgb_array", game=tiring_game())
    env.reset(seed=1)
    catalogue = env.unwrapped.game.catalogue
    snapshot = env.unwrapped.snapshot()
    stroke = next(i for i, name in enumerate(catalogue.names) if name.startswith("smash"))
    clear = next(i for i, name in enumerate(catalogue.names) if name.startswith("clear"))
    frames = []
    for played in (stroke, clear):
        shown = dataclasses.replace(snapshot, strokes=(Stroke(player=0, stroke=played, outcome=2, p_succ=0.9, p_ret=0.9),))
        frames.append(CourtRenderer("test", fps=2).frame(shown)[20:80, 20:240])
    assert (frames[0] != frames[1]).any()
    assert (frames[0][30:] == frames[1][30:]).all(), "the other player's is as it was"


def test_the_target_of_the_last_stroke_is_marked():
    env = rally_v0.env(render_mode="rgb_array", server=0)
    env.reset(seed=0)
    nothing_yet = share_of(env.render(), YELLOW)
    env.step(0)
    after = env.render()
    assert share_of(after, YELLOW) > 4 * nothing_yet
    assert share_of(after, PLAYERS[0]) > share_of(after, PLAYERS[1]), "the chip has the colour of the striker"


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


def test_without_a_render_mode_nothing_is_drawn():
    env = rally_v0.env()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None


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


def test_the_widest_chip_ends_before_the_list() -> None:
    game = default_game()
    for stroke in range(game.n_strokes):
        for outcome in range(len(OUTCOMES)):
            last = Stroke(0, stroke, outcome, 0.5, 0.5)
            snapshot = Snapshot(
                game=game, names=("a", "b"), title="", strokes=(last,), server=0, striker=None, winner=None, reason=None
            )
            head = drawing.text_width(shot_in_words(game.catalogue, stroke).upper(), drawing._LARGE) + 2 * drawing._PAD
            cells = sum(drawing._cell_width(label, value) for label, value, _ in drawing._cells(snapshot, last))
            assert drawing._CHIP[0] + head + cells < drawing._LIST[0]
