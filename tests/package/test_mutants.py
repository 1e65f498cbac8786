"""The mutation test: which changes it makes, and a small sample of it."""

from tests.mutants import mutants

SOURCE = '''"""A module of 1 page."""
__all__ = ["f", 2]
LIMIT: Final[Literal[3]] = 4
@cache(maxsize=5)
def f(x: "int | 6", *names: str) -> Literal[7]:
    """Eight is 8."""
    if not x <= LIMIT and -x in names:
        raise ValueError(f"{x + 9}", 10)
    x += [True]
    return (
        x
        - g(zip(x, x, strict=False)))
class C:
    @compiled
    def g(self):
        def inner(): return None
        return lambda: "é" + self, 1.5
'''


def test_one_change_each() -> None:
    found = [(mutant.line, mutant.function, mutant.after) for mutant in mutants("m.py", SOURCE)]
    assert found == [
        (3, "", "LIMIT: Final[Literal[3]] = 5"),
        (7, "f", "if (not x <= LIMIT or -x in names):"),
        (7, "f", "if (x <= LIMIT) and -x in names:"),
        (7, "f", "if not (x < LIMIT) and -x in names:"),
        (7, "f", "if not (x > LIMIT) and -x in names:"),
        (7, "f", "if not x <= LIMIT and (-x not in names):"),
        (7, "f", "if not x <= LIMIT and (x) in names:"),
        (9, "f", "x += [False]"),
        (10, "f", "return None"),
        (11, "f", "(x + g(zip(x, x, strict=False))))"),
        (17, "", "return None"),
        (17, "", 'return lambda: "é" + self, 2.5'),
    ]
