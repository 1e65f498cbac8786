"""The models learned from matches, and the games compiled from them. Importing this does not import torch."""

from shuttle_marl.game.shipped import default_game, load_game, model_folder

__all__ = ["default_game", "load_game", "model_folder"]
