"""The game: court, strokes, the rules of a rally and of a match, draws, and the contract of a policy."""
