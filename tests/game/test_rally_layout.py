"""The index tables of a game, on random small games."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.base.arrays import Bools
from shuttle_marl.game import court, default_game
from shuttle_marl.game.layout import GameError, layout
from shuttle_marl.game.recovery import CENTRE, POSITIONS, position_box, position_of
from shuttle_marl.game.tables import ROOT, Game
from tests.exact import exact_games
from tests.exact.exact_games import random_replies, small_catalogue


def random_game(seed: int, rallies: int = 8, density: float = 0.3) -> tuple[Game, Bools]:
    """A game and who may answer what."""
    rng = np.random.default_rng(seed)
    replies = random_replies(rng, small_catalogue(rng, rallies), density)
    return exact_games.random_game(seed, rallies, density), replies


games = st.builds(random_game, st.integers(0, 10_000), st.integers(2, 11), st.floats(0.0, 1.0))


def reachable_edges(game: Game, replies: Bools) -> set[tuple[int, int, int]]:
    """All (own last stroke, incoming stroke, net shots in a row) that play can reach, by walking from the start."""
    n = game.n_strokes
    found: set[tuple[int, int, int]] = set()
    frontier = [(n, n, 0)]
    while frontier:
        edge = frontier.pop()
        if edge not in found:
            found.add(edge)
            for z in np.flatnonzero(replies[edge[1]]).tolist():
                counts = game.counts_duels and "net-shot" in game.catalogue.names[z]
                frontier.append((edge[1], z, min(3, edge[2] + 1) if counts else 0))
    return found


@given(games)
def test_edges_are_exactly_those_that_play_can_reach(made: tuple[Game, Bools]) -> None:
    game, replies = made
    edges = list(zip(game.edge_own.tolist(), game.edge_incoming.tolist(), game.edge_duel.tolist(), strict=True))
    assert edges[0] == (game.n_strokes, game.n_strokes, 0)
    assert len(set(edges)) == len(edges)
    assert set(edges) >= reachable_edges(game, replies)
    # Beyond those, only duels of a length that cannot be reached there: some net shots answer only net shots, others never do.
    assert {edge[2] for edge in set(edges) - reachable_edges(game, replies)} <= {2, 3}


@given(games)
def test_pairs_number_the_legal_strokes_of_each_state_in_order(made: tuple[Game, Bools]) -> None:
    game, replies = made
    height = game.catalogue.height
    row = 0
    for state in range(game.n_states):
        incoming, contact = int(game.incoming(state)), state & 1
        expected = np.flatnonzero(replies[incoming] & (height == contact))
        assert game.legal_strokes(state).tolist() == expected.tolist()
        assert game.legal_count(np.array(state)) == len(expected)
        pairs = slice(row, row + len(expected))
        assert (game.pair_state[pairs] == state).all()
        assert game.pair_stroke[pairs].tolist() == expected.tolist()
        row += len(expected)
    assert row == game.n_pairs
    arrivals = game.arrivals()
    assert (game.contact(arrivals) == [0, 1, 0, 1]).all()
    assert (game.hurried(arrivals) == [0, 0, 1, 1]).all()
    assert (game.own(arrivals) == game.incoming(game.pair_state)[:, None]).all()
    assert (game.incoming(arrivals) == game.pair_stroke[:, None]).all()


@given(games)
def test_masks_and_pair_numbers_agree(made: tuple[Game, Bools]) -> None:
    game, _ = made
    state = np.repeat(np.arange(game.n_states), game.n_strokes).reshape(-1, game.n_strokes)
    stroke = np.broadcast_to(np.arange(game.n_strokes), state.shape)
    pair = game.pair(state, stroke)
    assert ((pair >= 0) == game.mask(np.arange(game.n_states))).all()
    assert pair[pair >= 0].tolist() == list(range(game.n_pairs))
    assert (game.pair_state[pair[pair >= 0]] == state[pair >= 0]).all()
    assert (game.pair_stroke[pair[pair >= 0]] == stroke[pair >= 0]).all()


@given(games)
def test_every_reachable_state_has_a_stroke_and_only_the_start_a_serve(made: tuple[Game, Bools]) -> None:
    game, _ = made
    counts = game.legal_count(np.arange(game.n_states))
    serves_from_above = np.isin(game.base(np.arange(game.n_states)), (1, 3))
    assert (counts[serves_from_above] == 0).all()
    assert (counts[~serves_from_above] > 0).all()
    assert game.catalogue.is_serve[game.legal_strokes(ROOT)].all()
    assert not game.catalogue.is_serve[game.pair_stroke[game.incoming(game.pair_state) < game.n_strokes]].any()


def test_layout_names_a_stroke_without_reply() -> None:
    rng = np.random.default_rng(0)
    catalogue = small_catalogue(rng, 6)
    replies = random_replies(rng, catalogue, 1.0)
    replies[3, catalogue.height == 1] = False
    with pytest.raises(GameError, match=f"no legal reply to {catalogue.names[3]} from contact 1"):
        layout(catalogue, replies)


def test_layout_forgives_a_stroke_without_reply_that_is_never_played() -> None:
    rng = np.random.default_rng(0)
    catalogue = small_catalogue(rng, 6)
    replies = random_replies(rng, catalogue, 1.0)
    replies[:, 3] = False
    replies[3] = False
    assert 3 not in layout(catalogue, replies)["edge_incoming"]


@pytest.mark.parametrize(("row", "stroke", "value"), [(-1, 4, True), (3, 1, True)])
def test_layout_wants_serves_at_the_start_and_only_there(row: int, stroke: int, value: bool) -> None:
    rng = np.random.default_rng(0)
    catalogue = small_catalogue(rng, 6)
    replies = random_replies(rng, catalogue, 0.5)
    replies[row, stroke] = value
    with pytest.raises(GameError, match="serves"):
        layout(catalogue, replies)


def test_shipped_game_has_the_layout_of_its_replies() -> None:
    game = default_game()
    rebuilt = layout(game.catalogue, np.asarray(game.reply_mask.any(axis=1)), duels=game.counts_duels)
    for name, table in rebuilt.items():
        assert (getattr(game, name) == table).all(), name


def test_describe_names_both_strokes_and_the_contact() -> None:
    game, _ = random_game(6)
    assert game.describe(ROOT) == "own none, incoming none, contact below"
    game, _ = random_game(2)
    state = game.n_states - 1
    names = game.catalogue.names
    words = f"own {names[game.own(state)]}, incoming {names[game.incoming(state)]}, contact above, hurried"
    assert game.describe(state) == f"{words}, effort 2 against 2"


def test_areas_are_cut_where_the_data_cut_them() -> None:
    unit = court.LENGTH / 660  # of the data
    x = np.array([-73.6, -73.4, 73.4, 73.6, 0, 0, 0, 0]) * unit
    y = np.array([50, 50, 50, 50, 113.9, 114.1, 275.9, 276.1]) * unit
    assert court.area_of(x, y).tolist() == [0, 1, 1, 2, 1, 4, 4, 7]
    inside = court.in_court(np.array([0.0, 2.6, 0.0, np.nan]), np.array([6.7, 1.0, 6.71, 1.0]))
    assert inside.tolist() == [True, False, False, False]


def test_a_cut_belongs_to_the_inner_area() -> None:
    x = np.array([-court.SIDE_CUT, court.SIDE_CUT, 0.0, 0.0, 9.0, -9.0, np.nan, 0.0])
    y = np.array([0.0, 0.0, court.MIDDLE_CUT, court.BACK_CUT, 9.0, -1.0, 1.0, np.nan])
    assert court.area_of(x, y).tolist() == [1, 1, 1, 4, 8, 0, -1, -1]


def test_boxes_of_areas_tile_the_half() -> None:
    unit = court.LENGTH / 660  # of the data
    across = [(-2.59, -73.5 * unit), (-73.5 * unit, 73.5 * unit), (73.5 * unit, 2.59)]
    along = [(0, 114 * unit), (114 * unit, 276 * unit), (276 * unit, 6.7)]
    boxes = np.array([[across[area % 3], along[area // 3]] for area in range(9)])
    assert np.array([court.area_box(area) for area in range(9)]) == pytest.approx(boxes)
    assert court.area_centre(np.arange(9).reshape(3, 3)) == pytest.approx(boxes.mean(axis=-1).reshape(3, 3, 2))


def test_a_serve_flies_diagonally_between_service_line_and_middle() -> None:
    areas, unit = np.arange(9), court.LENGTH / 660
    assert court.service_area(areas, from_right=True).tolist() == [0, 1, 0, 3, 4, 3, 6, 7, 6]
    assert court.service_area(areas, from_right=False).tolist() == [2, 1, 2, 5, 4, 5, 8, 7, 8]
    side, front, middle = (73.5 * unit, 2.59), (1.98, 114 * unit), (114 * unit, 276 * unit)
    for area, from_right, box in (
        (2, True, ((-2.59, -73.5 * unit), front)), (1, True, ((-73.5 * unit, 0), front)), (0, False, (side, front)),
        (1, False, ((0, 73.5 * unit), front)), (5, False, (side, middle)),
    ):  # fmt: skip
        assert np.array(court.service_box(area, from_right)) == pytest.approx(np.array(box)), (area, from_right)


def test_positions_are_cells_of_the_half() -> None:
    x = np.array([0.56, 0.55, 0.0, -0.55, -0.56, 0.0, 0.0, 0.0, 1.0])
    y = np.array([1.0, 1.0, 3.19, 1.0, 1.0, 3.2, 4.39, 4.4, 6.0])
    assert position_of(x, y).tolist() == [0, 1, 1, 1, 2, 4, 4, 7, 6]
    across, along = [(0.55, 2.59), (-0.55, 0.55), (-2.59, -0.55)], [(-3.2, 0.0), (-4.4, -3.2), (-6.7, -4.4)]
    assert [position_box(position) for position in range(9)] == [(across[p % 3], along[p // 3]) for p in range(9)]
    assert POSITIONS[2:4] == ("front-backhand", "middle-forehand")
    assert CENTRE == 4


@pytest.mark.parametrize("margin", [0.0, 0.25])
def test_lines_belong_to_the_court(margin: float) -> None:
    side, end = court.HALF_WIDTH + margin, court.HALF_LENGTH + margin
    x = np.array([side, -side, 0.0, 0.0, np.nan, 0.0, side + 1e-6, -side - 1e-6, 0.0, 0.0])
    y = np.array([1.0, 1.0, end, -margin, 1.0, np.nan, 1.0, 1.0, end + 1e-6, -margin - 1e-6])
    assert court.in_court(x, y, margin).tolist() == [True] * 4 + [False] * 6
