"""The fitted models: predictions, and their file (safetensors, never pickle)."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from shuttle_marl.base.arrays import F64, I16, I64, Ints
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import content_hash, parsed, replace_file
from shuttle_marl.base.tensor_files import checked, tensor_bytes
from shuttle_marl.dynamics import modules
from shuttle_marl.dynamics.features import DISCIPLINES, SLOTS, Rows
from shuttle_marl.dynamics.models import log_odds, mean_probabilities
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.shipped import NETWORKS, model_folder, readable
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES


class ModelError(ShuttleError):
    """A model folder that cannot be used."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PlayerChoices:
    """Choices of M players, as shifts of the average player's logits."""

    players: tuple[str, ...]
    style: F64  # [M, 15, 2, 39] shifts for shot type and technique, by incoming shot type and contact height
    area: F64  # [M, 13, 3, 9] shifts for the target, by shot type and technique

    def shifted_choice(self, choice: F64, codes: dict[str, I16], player: Ints) -> F64:
        """``[N, 39]`` probabilities of each row's player, from those of the average player (player -1)."""
        return self._shifted(choice, player, self.style, codes["incoming_shot"], codes["contact"])

    def shifted_targets(self, targets: F64, codes: dict[str, I16], player: Ints) -> F64:
        """``[N, 9]`` probabilities of the targets, likewise."""
        return self._shifted(targets, player, self.area, codes["shot"], codes["technique"])

    def _shifted(self, probabilities: F64, player: Ints, shifts: F64, *cell: I16) -> F64:
        if not self.players:
            return probabilities
        return tilted(probabilities, np.where((player < 0)[:, None], 0.0, shifts[(player, *cell)]))

    def index(self, players: npt.NDArray[np.str_]) -> I64:
        """``[N]`` index of each player, -1 for players without a model."""
        position = {player: i for i, player in enumerate(self.players)}
        return np.array([position.get(player, -1) for player in players.tolist()], dtype=np.int64)


def tilted(probabilities: F64, shift: F64) -> F64:
    """Probabilities ``[..., C]`` whose logits are shifted."""
    z = probabilities * np.exp(shift)
    return np.asarray(z / z.sum(axis=-1, keepdims=True))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FittedModels:
    """The fitted models; those of outcomes are the modules of :mod:`shuttle_marl.dynamics.modules`."""

    m_choice: modules.Ensemble  # what strikers choose: `choice` of `modules.SPECS`
    m_target: modules.Ensemble  # and `target`
    m_succ: modules.MSucc
    m_ret: modules.MRet
    m_contact: modules.MContact
    m_hurried: modules.MHurried
    situations: modules.Situations  # effect of effort and long duels on the log-odds of a fault
    share: F64  # [2] fraction of each discipline in the training strokes, the weights of the average game
    choices: PlayerChoices
    opposite: bool = False  # whether striker and receiver have different hands; both are right-handed otherwise

    @property
    def choosers(self) -> dict[str, modules.Ensemble]:
        """The models of choices by name."""
        return {"choice": self.m_choice, "target": self.m_target}

    @property
    def calibration(self) -> F64:
        """``[5, 2]`` slope and intercept of the log-odds of a fault, return, contact above, and hurried receiver by height."""
        lines = [*(module.line[None] for module in (self.m_succ, self.m_ret, self.m_contact)), self.m_hurried.lines]
        return np.asarray(torch.cat(lines).numpy())

    def targets(self, codes: dict[str, I16]) -> F64:
        """``[N, 9]`` probability of each intended target given state, shot type and technique."""
        return mean_probabilities(self.m_target, codes)

    def choice(self, codes: dict[str, I16]) -> F64:
        """``[N, 13 * 3]`` probability of each shot type and technique given the state."""
        return mean_probabilities(self.m_choice, codes)

    def fault(self, codes: dict[str, I16]) -> F64:
        """``[N]`` probability that the striker faults, for a known target (``area``), at effort 0 and outside of long duels."""
        return modules.in_chunks(lambda part: torch.sigmoid(self.m_succ.fault_logit(part)), codes)

    def returned(self, codes: dict[str, I16]) -> F64:
        """``[N]`` probability that the opponent returns a good stroke."""
        return modules.in_chunks(self.m_ret, codes)

    def above(self, codes: dict[str, I16]) -> F64:
        """``[N]`` probability that a returned stroke is met above the net."""
        return modules.in_chunks(self.m_contact, codes)

    @property
    def knows_hurried(self) -> bool:
        """Whether the strokes of the fit told hurried strikers from others."""
        return bool(self.m_hurried.known)

    def hurried(self, codes: dict[str, I16]) -> F64:
        """``[N, 2]`` probability that who returns a stroke is hurried, if they meet it below and above the net; 0 if unknown."""
        return modules.in_chunks(self.m_hurried, codes)

    def fault_without_target(self, rows: Rows) -> F64:
        """``[N]`` probability of a fault, marginalised over the target."""
        shares = self.targets(rows.codes)
        faults = np.stack([self.fault(rows.with_area(a)) for a in range(N_AREAS)], axis=1)
        return np.asarray((shares * self.situations.mixed(log_odds(faults), self.situations.weights(rows))).sum(axis=1))

    def averaged(self, probability: Callable[[dict[str, I16]], F64], codes: dict[str, I16]) -> F64:
        """``[N, ...]`` mean over the disciplines of a probability, one of the methods above."""
        n = len(codes["contact"])
        found = [
            self.share[discipline] * probability({**codes, "discipline": np.full(n, discipline, dtype=np.int16)})
            for discipline in np.flatnonzero(self.share)
        ]
        return np.asarray(sum(found))

    def save(self, folder: Path) -> str:
        """Write ``networks.safetensors``; returns the SHA-256 of its content."""
        outcomes = {"success": self.m_succ, "return": self.m_ret, "contact": self.m_contact}
        networks = {**self.choosers, **{name: part.network for name, part in outcomes.items()}}
        tensors = {
            f"{name}.{key}": value.half().numpy()
            for name, network in networks.items()
            for key, value in network.state_dict().items()
        }
        tensors |= {
            "ridge": self.m_ret.ridge.weight.numpy(),
            "calibration": self.calibration,
            "share": self.share,
            "effort": self.situations.effort,
            "effort_share": self.situations.effort_share,
            "hurried_share": self.situations.hurried_share,
            "players.style": self.choices.style,
            "players.area": self.choices.area,
        }
        for name, trees in {**{name: part.trees for name, part in outcomes.items()}, **self.m_hurried.known}.items():
            tensors |= {f"trees.{name}.{key}": array for key, array in trees.arrays.items()}
        described = {
            "specs": {name: dataclasses.asdict(n.spec) for name, n in networks.items()},
            "duel": self.situations.duel,
            "duel_share": self.situations.duel_share,
            "players": self.choices.players,
            "disciplines": DISCIPLINES,
        }
        content = tensor_bytes(tensors, {"model": json.dumps(described, sort_keys=True)}, pack=True)
        replace_file(folder / NETWORKS, content)
        return content_hash(content)

    @classmethod
    def load(cls, folder: Path) -> "FittedModels":
        """Read a folder written by :meth:`save`. Raises ModelError: the file is missing, differs from the model card, or is
        invalid. Raises GameError: the model card cannot be read."""
        with readable(folder, NETWORKS, "model", ModelError) as (header, arrays):
            described = parsed(header["model"])
            networks = {name: _network(name, arrays) for name in modules.SPECS}
            players = tuple(map(str, described["players"]))
            m = len(players)
            styles = (m, SLOTS["incoming_shot"], SLOTS["contact"], N_SHOTS * N_TECHNIQUES)
            trees = {
                name: modules.Trees.checked(part)
                for name in (*modules.SPECS, *modules.HURRIED)
                if (part := _part(f"trees.{name}", arrays))
            }
            ridge = modules.Ridge(checked(arrays["ridge"], np.float64, (1 + sum(modules.RIDGE_SIZES),)))
            lines = checked(arrays["calibration"], np.float64, (5, 2))
            return cls(
                m_choice=networks["choice"],
                m_target=networks["target"],
                m_succ=modules.MSucc(networks["success"], trees["success"], lines[0]),
                m_ret=modules.MRet(networks["return"], trees["return"], ridge, lines[1]),
                m_contact=modules.MContact(networks["contact"], trees["contact"], lines[2]),
                m_hurried=modules.MHurried({name: trees[name] for name in modules.HURRIED if name in trees}, lines[3:]),
                situations=_situations(described, arrays),
                share=checked(arrays["share"], np.float64, (len(DISCIPLINES),)),
                choices=PlayerChoices(
                    players=players,
                    style=checked(arrays["players.style"], np.float64, styles),
                    area=checked(arrays["players.area"], np.float64, (m, N_SHOTS, N_TECHNIQUES, N_AREAS)),
                ),
            )


def load_models(name: str = "default") -> FittedModels:
    """The fitted models of a shipped model, or of the model in a folder. Raises GameError: the model does not exist, or its card
    cannot be read. Raises ModelError: its file is missing or invalid."""
    return FittedModels.load(model_folder(name))


def _part(name: str, arrays: dict[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    return {key.removeprefix(f"{name}."): array for key, array in arrays.items() if key.startswith(f"{name}.")}


def _network(name: str, arrays: dict[str, npt.NDArray[Any]]) -> modules.Ensemble:
    """A network from its weights, whose shapes tell the numbers of members and of hidden units."""
    weights = _part(name, arrays)
    _, members, hidden = weights["first"].shape
    with torch.device("meta"):
        network = modules.Ensemble(dataclasses.replace(modules.SPECS[name], members=members, hidden=hidden))
    state = {key: torch.from_numpy(checked(weight, np.float16, weight.shape)).double() for key, weight in weights.items()}
    network.load_state_dict(state, assign=True)
    return network.requires_grad_(False).eval()


def _situations(described: dict[str, Any], arrays: dict[str, npt.NDArray[Any]]) -> modules.Situations:
    duel = checked(np.array([float(described["duel"]), float(described["duel_share"])]), np.float64, (2,))
    effort = checked(arrays["effort"], np.float64, arrays["effort"].shape[:1])
    return modules.Situations(
        effort=effort,
        duel=float(duel[0]),
        effort_share=checked(arrays["effort_share"], np.float64, (SLOTS["own_shot"], len(effort))),
        duel_share=float(duel[1]),
        hurried_share=checked(arrays["hurried_share"], np.float64, (SLOTS["incoming_shot"], SLOTS["shot"])),
    )
