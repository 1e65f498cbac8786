"""A model whose game is so small that a tournament on it takes a fraction of a second."""

import pytest

from tests.exact.exact_games import hand_made


@pytest.fixture(scope="session")
def small_model(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Name of a model: a serve, a smash and a lift."""
    folder = tmp_path_factory.mktemp("model")
    hand_made().save(folder / "game.safetensors")
    return str(folder)
