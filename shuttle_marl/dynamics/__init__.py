"""The models learned from matches, and the games compiled from them. Importing this does not import torch."""
