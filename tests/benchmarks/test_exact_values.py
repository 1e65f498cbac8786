"""The benchmark of the exact solvers measures what it says; how fast anything is, is not tested."""

from benchmarks import exact_values
from tests.reduced import reduced_game


def test_thirty_policies_differ() -> None:
    policies = exact_values.thirty_policies(reduced_game())
    assert len({policy.cumulative.tobytes() for policy in policies}) == len(policies) == 30
