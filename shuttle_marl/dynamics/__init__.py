"""Models fitted to matches, and the games compiled from them. Importing this package does not import torch."""
