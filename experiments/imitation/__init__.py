"""The imitator: a model that predicts the next stroke of a player from everything that is visible at the hit."""
