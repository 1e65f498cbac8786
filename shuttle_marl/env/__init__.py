"""Environments over the rules of :mod:`shuttle_marl.rally` and :mod:`shuttle_marl.scoring`.

``rally_v0`` and ``match_v0`` are PettingZoo AEC environments; they run on tables and do not import torch.
"""
