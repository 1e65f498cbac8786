"""Points, reasons and times that simulated strokes get, where players wait, and refusals of simulations and pictures."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.base.errors import OptionError
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.data.simulated import (
    BREAK,
    FAULT_MIX,
    FLIGHT,
    INTERVAL,
    SimulatedStrokes,
    SimulationError,
    sample_positions,
    simulate,
)
from shuttle_marl.game import court
from shuttle_marl.game.policy import PolicyError, TabulatedPolicy, from_pair_probabilities
from shuttle_marl.game.stroke import N_SHOTS, SHOTS
from shuttle_marl.reports import charts

RETURNED, OUT, NET, SHORT, LANDED = (REASONS.index(name) for name in ("returned", "out", "net", "short", "landed"))
X_CUTS = (-court.HALF_WIDTH, -court.SIDE_CUT, court.SIDE_CUT, court.HALF_WIDTH)
Y_CUTS = (0.3, court.MIDDLE_CUT, court.BACK_CUT, court.HALF_LENGTH)


def rallies(n: int, length: int, **columns: Any) -> SimulatedStrokes:
    """Rallies of equal length, which end by a winner, of lifts to all areas in turn after short serves, in one game."""
    size = n * length
    stroke = np.tile(np.arange(length) + 1, n)
    usual: dict[str, Any] = {
        "shot": np.where(stroke == 1, 0, SHOTS.index("lift")), "area": np.arange(size) % 9,
        "outcome": np.where(stroke == length, Outcome.WINNER, Outcome.RETURNED), "stroke": stroke,
        "new_game": np.arange(size) == 0, "right": np.arange(size) // length % 2 == 0,
    }  # fmt: skip
    return SimulatedStrokes(**usual | columns)


def drawn(some: SimulatedStrokes, seed: int = 0) -> Any:
    places, reason, frame = sample_positions(some, np.random.default_rng(seed))
    return *(places[name] for name in ("landing", "contact", "striker", "receiver")), reason, frame


def test_good_strokes_land_in_their_area() -> None:
    some = rallies(900, 5)
    landing, contact, _, _, reason, _ = drawn(some)
    assert set(reason[some.outcome == Outcome.RETURNED]) == {RETURNED}
    assert set(reason[some.outcome == Outcome.WINNER]) == {LANDED}
    side, depth, serve = some.area % 3, some.area // 3, some.stroke == 1
    low = np.stack([np.take(X_CUTS, side), np.take(Y_CUTS, depth)], axis=1)
    high = np.stack([np.take(X_CUTS, side + 1), np.take(Y_CUTS, depth + 1)], axis=1)
    low[serve, 1] = np.maximum(low[serve, 1], court.SHORT_SERVICE - 0.05)
    assert (landing >= low + 0.05 - 1e-9).all()
    assert (landing <= high - 0.05 + 1e-9).all()
    for area in range(9):
        here = (some.area == area) & ~serve
        assert landing[here].mean(axis=0) == pytest.approx(((low + high) / 2)[here][0], abs=0.1), "dense towards the centre"
        assert landing[here].std(axis=0) == pytest.approx(((high - low - 0.1)[here][0]) / math.sqrt(24), rel=0.12)
    assert np.isnan(contact[serve]).all()
    np.testing.assert_array_equal(contact[~serve], -landing[np.flatnonzero(~serve) - 1])


def test_out_strokes_land_beyond_the_line_next_to_their_area() -> None:
    some = rallies(3600, 2, outcome=np.tile([Outcome.RETURNED, Outcome.FAULT], 3600), shot=np.tile([1, 1], 3600),
                   area=np.repeat(np.arange(9), 800))  # fmt: skip
    landing, _, _, _, reason, _ = drawn(some)
    out = reason == OUT
    inner = np.isin(some.area, (1, 4))
    fault = some.outcome == Outcome.FAULT
    assert (reason[fault & inner] == NET).all(), "nothing goes out in front of the net"
    assert out[fault & ~inner].all()
    beyond = np.stack([np.abs(landing[:, 0]) - court.HALF_WIDTH, landing[:, 1] - court.HALF_LENGTH], axis=1)
    assert ((beyond[out] > 0).sum(axis=1) == 1).all(), "beyond one line"
    assert beyond[out].max(axis=1).min() >= 0.03 - 1e-9
    assert beyond[out].max() <= 1
    assert np.median(beyond[out].max(axis=1)) == pytest.approx(0.03 + 0.2 * math.log(2), rel=0.1)
    behind = beyond[:, 1] > 0
    assert {int(a): round(float(behind[out & (some.area == a)].mean()), 1) for a in np.unique(some.area[out])} == {
        0: 0, 2: 0, 3: 0, 5: 0, 6: 0.5, 7: 1, 8: 0.5
    }  # fmt: skip
    sideways = out & ~behind
    assert (np.sign(landing[sideways, 0]) == some.area[sideways] % 3 - 1).all()


def test_faults_are_mixed_by_shot_type() -> None:
    n = 30_000
    shot, area = np.repeat(np.arange(N_SHOTS), n // N_SHOTS), np.tile([0, 1, 6], n)[: n // N_SHOTS * N_SHOTS]
    some = rallies(len(shot), 1, shot=shot, area=area, outcome=np.full(len(shot), Outcome.FAULT))
    reason = drawn(some)[4]
    for kind in range(N_SHOTS):
        free, mix = area != 1, FAULT_MIX[kind]
        shares = [(reason[(shot == kind) & free] == each).mean() for each in (OUT, NET, SHORT)]
        assert shares == pytest.approx(mix.tolist(), abs=0.045)
        middle = [(reason[(shot == kind) & ~free] == each).mean() for each in (OUT, NET, SHORT)]
        rest = mix[1:] / mix[1:].sum() if mix[1:].sum() else [1, 0]
        assert middle == pytest.approx([0, *rest], abs=0.06)
    assert FAULT_MIX.sum(axis=1) == pytest.approx(1)


def test_times_are_those_of_flights_pauses_and_intervals() -> None:
    some = rallies(3000, 3, shot=np.tile([0, 4, 5], 3000), new_game=np.arange(9000) % 30 == 0)
    frame = drawn(some)[-1]
    step = np.diff(frame, prepend=0) / 30
    for number in (2, 3):
        assert np.median(step[some.stroke == number]) == pytest.approx(FLIGHT[some.shot[number - 2]], abs=0.03)
    assert np.median(step[some.new_game]) == pytest.approx(INTERVAL, rel=0.08)
    assert np.median(step[(some.stroke == 1) & ~some.new_game]) == pytest.approx(BREAK, rel=0.03)
    logs = np.log(step[some.stroke == 2] / FLIGHT[0])
    assert logs.std() == pytest.approx(0.15, abs=0.015)
    assert step[some.stroke > 1].min() >= 0.2 - 1 / 30


def test_players_stand_where_they_serve_and_come_from_where_they_struck() -> None:
    some = rallies(1200, 4)
    _, contact, striker, receiver, _, frame = drawn(some)
    serve = some.stroke == 1
    side = some.area % 3
    right = np.where(np.where(side == 1, some.right, side == 0), 1.0, -1.0)
    for place, x, y in ((striker, 0.3, -3.1), (receiver, -0.95, 4.0)):
        off = place[serve] - np.stack([x * right[serve], np.full(serve.sum(), y)], axis=1)
        assert off.mean(axis=0) == pytest.approx([0, 0], abs=0.02)
        assert off.std(axis=0) == pytest.approx([0.12, 0.12], abs=0.01)
    rows = np.flatnonzero(~serve)
    reach = np.linalg.norm(striker[rows] - contact[rows], axis=1)
    assert reach.max() <= 1.1 + 0.6, "only who would stand at the net is farther away"
    assert np.median(reach) == pytest.approx(0.7, abs=0.05)
    assert striker[:, 1].max() <= -0.3
    before = rows - 1
    moved = np.linalg.norm(-receiver[rows] - striker[before], axis=1)
    flown = (frame[rows] - frame[before]) / 30
    unclamped = striker[before, 1] < -0.3
    assert (moved <= 1.5 * (flown + 0.05))[unclamped].all()
    away = np.linalg.norm(striker[before] - [0, -3.7], axis=1) > 3
    assert np.median((moved / flown)[away & unclamped]) == pytest.approx(1.5, abs=0.05)


def test_what_cannot_be_simulated_is_refused(bc: TabulatedPolicy) -> None:
    game, p = bc.game, bc.pair_probabilities()
    pair = int(np.flatnonzero(p > 0.1)[0])
    negative, off = p.copy(), p.copy()
    negative[pair], off[pair] = -0.1, p[pair] + 0.05
    for wrong, says in (
        (p[:-1], f"expected {game.n_pairs} probabilities"),
        (negative, "none negative"),
        (off, r"probabilities sum to 1\.05, not 1, in state: "),
    ):
        with pytest.raises(PolicyError, match=says):
            from_pair_probabilities(game, wrong)
    for players, matches, says in (
        ({"a": bc, "b": bc}, 0, "0 matches: expected at least one"),
        ({"a": bc}, 1, "players a: expected at least two of one discipline"),
        ({"an-se-young": bc, "chen-long": bc}, 1, "expected at least two of one discipline"),
    ):
        with pytest.raises(SimulationError, match=says):
            simulate(game, players, matches=matches, seed=0)


def test_pictures_have_formats(tmp_path: Path) -> None:
    for name in ("a.png", "a.svg", "a.pdf"):
        charts.check_format(tmp_path / name)
    for name in ("a.jpg", "a", "a.PNG"):
        with pytest.raises(OptionError, match=r"pictures are written as \.png, \.svg, \.pdf; use one of these suffixes"):
            charts.check_format(tmp_path / name)
