"""The outcome models as PyTorch modules: what happens to a stroke, from codes of the stroke and its context.

    models, game = load_models(), default_game()
    codes = attributes(codes_of_pairs(game, np.arange(1000), opposite=False))  # code 0 of the discipline: men's singles
    good, returned = models.m_succ(codes), models.m_ret(codes)  # [1000] each

Every module maps ``[N, 15]`` integer codes, in the order of :data:`~shuttle_marl.dynamics.features.SLOTS`, to probabilities in
double precision. The tables of a game are compiled from these modules and nothing else
(:func:`shuttle_marl.dynamics.compiled.pair_probabilities`).
"""

import copy
from collections.abc import Mapping
from typing import Self

import numpy as np
import torch
from torch import Tensor, nn

from shuttle_marl.base.arrays import F64
from shuttle_marl.dynamics.models import GOOD, HURRIED, Ridge
from shuttle_marl.dynamics.network import Ensemble
from shuttle_marl.dynamics.trees import Trees


class _Calibrated(nn.Module):
    """An ensemble of networks, other parts, and the calibration of their common log-odds.

    Args:
        line: ``[2]`` slope and intercept of the calibrated log-odds.
    """

    line: Tensor

    def __init__(self, network: Ensemble, trees: Trees, line: F64) -> None:
        super().__init__()
        self.network, self.trees = network, trees
        self.register_buffer("line", torch.from_numpy(np.array(line)))

    def calibrated(self, members: Tensor) -> Tensor:
        """``[N]`` calibrated log-odds of the mean of the members' probabilities ``[K, N]``."""
        return self.line[0] * torch.logit(members.mean(dim=0), eps=1e-9) + self.line[1]

    def shifted(self, shift: float) -> Self:
        """The module with other log-odds of its event: a fault in :class:`MSucc`."""
        moved = copy.copy(self)
        moved._buffers = {**self._buffers, "line": self.line + torch.tensor([0.0, shift], dtype=self.line.dtype)}
        return moved


class MSucc(_Calibrated):
    """``M_succ``: the probability that a stroke is good."""

    def fault_logit(self, codes: Tensor) -> Tensor:
        """``[N]`` log-odds of a fault, at effort 0 and outside of long duels."""
        good = torch.softmax(self.network(codes), dim=-1)[..., GOOD]
        return self.calibrated(1 - good) + self.trees(codes)

    def forward(self, codes: Tensor, shift: Tensor | float = 0.0) -> Tensor:
        """``[N]`` probabilities.

        Args:
            shift: change of the log-odds of a fault, such as that by effort and long duels
                (:attr:`~shuttle_marl.dynamics.situations.Situations.offsets`).
        """
        return torch.sigmoid(-self.fault_logit(codes) - shift)


class MContact(_Calibrated):
    """The probability that a returned stroke is met above the net."""

    def logit(self, codes: Tensor) -> Tensor:
        """``[K, N]`` log-odds by member of the ensemble, not calibrated: the mean of the parts."""
        return (self.network(codes)[..., 0] + self.trees(codes)) / 2

    def forward(self, codes: Tensor) -> Tensor:
        """``[N]`` probabilities."""
        return torch.sigmoid(self.calibrated(torch.sigmoid(self.logit(codes))))


class MRet(MContact):
    """``M_ret``: the probability that the opponent returns a good stroke."""

    def __init__(self, network: Ensemble, trees: Trees, ridge: Ridge, line: F64) -> None:
        super().__init__(network, trees, line)
        self.ridge = ridge

    def logit(self, codes: Tensor) -> Tensor:
        """``[K, N]`` log-odds by member of the ensemble, not calibrated: the mean of the parts."""
        return (self.network(codes)[..., 0] + self.ridge(codes) + self.trees(codes)) / 3


class MHurried(nn.Module):
    """The probability that who returns a stroke is hurried, by the height at which they meet it.

    Args:
        trees: by name (:data:`~shuttle_marl.dynamics.models.HURRIED`); a height without trees has probability 0.
        lines: ``[2, 2]`` slope and intercept of the calibrated log-odds, by height.
    """

    lines: Tensor

    def __init__(self, trees: Mapping[str, Trees], lines: F64) -> None:
        super().__init__()
        self.known, self.trees = dict(trees), nn.ModuleDict(dict(trees))
        self.register_buffer("lines", torch.from_numpy(np.array(lines)))

    def forward(self, codes: Tensor) -> Tensor:
        """``[N, 2]`` probabilities if the receiver meets the stroke below and above the net."""
        found = torch.zeros(len(codes), len(HURRIED), dtype=self.lines.dtype, device=codes.device)
        for height, name in enumerate(HURRIED):
            if name in self.known:
                found[:, height] = torch.sigmoid(self.lines[height, 0] * self.known[name](codes) + self.lines[height, 1])
        return found
