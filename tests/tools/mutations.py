"""Mutations of source code: one change each, of an operator, a number, a truth value, a returned value, or a check that raises.

Decorators, annotations, ``__all__``, error messages, assigned limits, and numbers of animation (:data:`ANIMATION`) stay.
"""

import ast
import copy
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from tests.tools.instrumentation import is_compiled

ROOT: Final = Path(__file__).resolve().parents[2]
OPERATORS: Final = {
    **{"Lt": "LtE GtE", "LtE": "Lt Gt", "Gt": "GtE LtE", "GtE": "Gt Lt", "Eq": "NotEq", "NotEq": "Eq", "Is": "IsNot"},
    **{"IsNot": "Is", "In": "NotIn", "NotIn": "In", "And": "Or", "Or": "And", "Add": "Sub", "Sub": "Add", "Mult": "Div"},
    **{"Div": "Mult", "FloorDiv": "Mult", "Mod": "FloorDiv", "Pow": "Mult", "BitAnd": "BitOr", "BitOr": "BitAnd"},
    **{"BitXor": "BitAnd", "LShift": "RShift", "RShift": "LShift"},
}
"""Classes of :mod:`ast` that replace an operator, one at a time."""
ANIMATION: Final = ("shuttle_marl/court/scene/", "shuttle_marl/court/staging/", "shuttle_marl/court/")
"""Where a number is how something looks."""


@dataclasses.dataclass(frozen=True)
class Mutant:
    """One change of a file.

    Attributes:
        file: path in the repository.
        function: qualified name of the innermost function around the change; empty if there is none or it is compiled.
        line: number of the first changed line.
        before, after: source lines without and with the change.
        guard: whether the change is one of a guard.
        lines: numbers of the changed lines, from 0, the last excluded; ``new``: what stands there instead.
    """

    file: str
    function: str
    line: int
    before: str
    after: str
    guard: bool
    lines: tuple[int, int] = dataclasses.field(repr=False)
    new: bytes = dataclasses.field(repr=False)

    def source(self) -> bytes:
        """Content of the changed file."""
        old, (first, last) = (ROOT / self.file).read_bytes().splitlines(keepends=True), self.lines
        return b"".join([*old[:first], self.new, *old[last:]])


def variants(node: ast.AST) -> Iterator[ast.AST]:
    """Copies of a node with one change of its own."""

    def changed(**fields: Any) -> ast.AST:
        new = copy.copy(node)
        vars(new).update(fields)
        return new

    def is_sequence(x: ast.AST) -> bool:  # other operators would only raise TypeError
        return isinstance(x, ast.JoinedStr | ast.List | ast.Tuple) or (isinstance(x, ast.Constant) and isinstance(x.value, str))

    def others(op: ast.AST) -> list[Any]:
        return [getattr(ast, name)() for name in OPERATORS.get(type(op).__name__, "").split()]

    match node:
        case ast.Compare(ops=ops):
            yield from (changed(ops=[*ops[:at], op, *ops[at + 1 :]]) for at in range(len(ops)) for op in others(ops[at]))
        case ast.BinOp(op=op) | ast.AugAssign(op=op) | ast.BoolOp(op=op):
            if not any(map(is_sequence, ast.iter_child_nodes(node))):
                yield from (changed(op=other) for other in others(op))
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield operand
        case ast.Constant(value=bool(value)):
            yield changed(value=not value)
        case ast.Constant(value=int(value) | float(value)):
            yield changed(value=value + 1)
        case ast.Return(value=value) if value is not None and not (isinstance(value, ast.Constant) and value.value is None):
            yield changed(value=ast.Constant(None))


def mutants(file: str, source: str) -> Iterator[Mutant]:
    """All mutants of a file."""
    lines, is_animated = source.encode().splitlines(keepends=True), file.startswith(ANIMATION)

    def visit(node: ast.AST, scope: str, function: str, guard: bool) -> Iterator[Mutant]:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            is_function = isinstance(node, ast.FunctionDef)
            function = scope + node.name if is_function and not is_compiled(node) else ""
            scope += f"{node.name}.<locals>." if is_function else f"{node.name}."
            node.decorator_list = []
        elif isinstance(node, ast.expr | ast.Return | ast.AugAssign) and not (is_animated and _is_number(node)):
            yield from (make(node, variant, function, guard) for variant in variants(node))
        if isinstance(node, ast.If) and isinstance(node.body[-1], ast.Raise):
            yield make(node.test, ast.Constant(False), function, True)
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.arguments):  # defaults are computed where the function is defined
                around = function if isinstance(node, ast.Lambda) else ""
                for default in filter(None, (*child.defaults, *child.kw_defaults)):
                    yield from visit(default, scope, around, guard)
            elif not _is_excluded(node, child):
                yield from visit(child, scope, function, guard or _is_guard(node, child))

    def make(node: Any, variant: ast.AST, function: str, guard: bool) -> Mutant:
        first, last = node.lineno - 1, node.end_lineno
        text = ast.unparse(variant) if isinstance(variant, ast.stmt | ast.Constant) else f"({ast.unparse(variant)})"
        head, tail = lines[first][: node.col_offset], lines[last - 1][node.end_col_offset :]
        new = head + text.encode() + tail + b"\n" * (last - 1 - first)  # other lines keep their numbers
        before, after = (b" ".join(x.split()).decode() for x in (b"".join(lines[first:last]), new))
        return Mutant(file, function, node.lineno, before, after, guard, (first, last), new)

    yield from visit(ast.parse(source), "", "", False)


def _is_number(node: ast.AST) -> bool:
    constant = node.operand if isinstance(node, ast.UnaryOp) else node
    return isinstance(constant, ast.Constant) and isinstance(constant.value, int | float) and not isinstance(constant.value, bool)


def _is_guard(node: ast.AST, child: ast.AST) -> bool:
    """Whether a child is the condition of an error."""
    match node:
        case ast.If(test=test, body=[*_, ast.Raise()]):
            return child is test
    return False


def _is_excluded(node: ast.AST, child: ast.AST) -> bool:
    if child in (getattr(node, "annotation", None), getattr(node, "returns", None)):
        return True
    match child:
        case ast.Assign(targets=[ast.Name(id="__all__")]) | ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.AnnAssign(target=ast.Name(id=name)) | ast.Assign(targets=[ast.Name(id=name)]):
            return name.lstrip("_").startswith(("MAX", "MOST", "LEAST", "MIN", "LONGEST", "LIMIT"))
        case ast.Raise() | ast.JoinedStr() | ast.keyword(arg="strict") | ast.Call(func=ast.Attribute(value=ast.Name(id="_LOG"))):
            return True
    return False
