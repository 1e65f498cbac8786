"""Tables of policies in a folder, one file each, named by the hash of its table."""

from collections.abc import Collection
from pathlib import Path

import zstandard

from shuttle_marl.base.files import problem, read_file, replace_file
from shuttle_marl.game.policy import PolicyError, TabulatedPolicy
from shuttle_marl.game.tables import Game


def policy_file(folder: Path, digest: str) -> Path:
    """File of the policy of a hash."""
    return folder / f"{digest}.zst"


class StoredPolicies:
    """Tables of policies in a folder."""

    def __init__(self, folder: Path, game: Game) -> None:
        self.folder, self.game = folder, game

    def save(self, policy: TabulatedPolicy) -> str:
        """Save a policy unless it exists, and return its hash."""
        path = policy_file(self.folder, policy.hash)
        if not path.exists():
            replace_file(path, policy.packed())
        return policy.hash

    def read(self, digest: str) -> TabulatedPolicy:
        """Read the policy of a hash.

        Raises:
            PolicyError: it is missing, damaged, of another game, or does not have this hash.
        """
        path = policy_file(self.folder, digest)
        try:
            policy = TabulatedPolicy.unpacked(read_file(path, 4 * self.game.n_pairs), self.game, str(path))
        except (OSError, ValueError, zstandard.ZstdError) as error:
            raise PolicyError(f"{path}: the policy cannot be read ({problem(error)}); run again what wrote it") from error
        if policy.hash != digest:
            raise PolicyError(f"{path}: the table was changed: its hash is {policy.hash[:12]}; run again what wrote it")
        return policy

    def prune(self, retained: Collection[str]) -> None:
        """Delete all policies except those of the given hashes."""
        for path in self.folder.glob("*.zst"):
            if path.stem not in retained:
                path.unlink(missing_ok=True)
