"""Small faults that can be put into a Python file, one at a time: what ``dev/tools/mutants.py``
tries the tests with.

Every fault replaces one expression or statement of the syntax tree and leaves the rest of the file
as it is. Messages, documentation, types, imports and decorators are left alone, and so is what is a
matter of choice: the defaults and bounds of declared settings, and the style of pictures.
"""

import ast
import copy
import re
from collections.abc import Iterator
from dataclasses import dataclass

ARITHMETIC = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
}
OTHER_WAY = {
    ast.Lt: ast.Gt,
    ast.Gt: ast.Lt,
    ast.LtE: ast.GtE,
    ast.GtE: ast.LtE,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
EDGE = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
_PAIRS = (
    "min max, minimum maximum, argmin argmax, sin cos, any all, floor ceil, sum mean, zeros ones,"
    " hypot maximum"
)
TWINS = {a: b for pair in _PAIRS.split(", ") for a, b in (pair.split(), pair.split()[::-1])}

_LEFT_ALONE = (ast.Import, ast.ImportFrom, ast.Raise, ast.Assert, ast.JoinedStr)
_STYLE = (
    "alpha",
    "aspect",
    "color",
    "dpi",
    "figsize",
    "fontsize",
    "labelsize",
    "linewidth",
    "lw",
    "mew",
    "ms",
    "pad",
    "shrink",
    "zorder",
)
_NUMBERED = re.compile(r"(.*[A-Za-z_])([01])(.*)")


@dataclass(frozen=True)
class Fault:
    """One changed place."""

    kind: str  #: What was done there.
    line: int  #: Where it begins.
    #: ``before``, ``after``: The lines concerned, without and with the fault, blanks between them
    #: reduced to one.
    before: str
    after: str
    text: str  #: The whole file with the fault.


def faults_of(text: str) -> list[Fault]:
    """All faults that can be put into the text of a file, in the order of the lines."""
    # Two kinds of fault may give the same text, which would be tried twice.
    faults = {
        (fault.line, fault.before, fault.after): fault
        for node, kind, new in _everywhere(ast.parse(text))
        for fault in [_replace(text, node, kind, new)]
    }
    return sorted(faults.values(), key=lambda fault: (fault.line, fault.kind, fault.after))


def changes_something(text: str, fault: Fault) -> bool:
    """Whether the file with the fault can be compiled and is another program."""
    try:
        # Another text can be the same program: brackets leave no trace in the syntax tree.
        return ast.dump(ast.parse(fault.text)) != ast.dump(ast.parse(text))
    except SyntaxError:
        return False


def _replace(text: str, node: ast.expr | ast.stmt, kind: str, new: str) -> Fault:
    lines = text.splitlines(keepends=True)
    first, last = node.lineno - 1, (node.end_lineno or node.lineno) - 1
    # Offsets of the syntax tree count bytes of UTF-8, not letters.
    head = lines[first].encode()[: node.col_offset].decode()
    tail = lines[last].encode()[node.end_col_offset :].decode()
    changed = head + new + tail
    before = " ".join("".join(lines[first : last + 1]).split())
    whole = "".join(lines[:first]) + changed + "".join(lines[last + 1 :])
    return Fault(kind, node.lineno, before, " ".join(changed.split()), whole)


def _everywhere(tree: ast.Module) -> Iterator[tuple[ast.expr | ast.stmt, str, str]]:
    """Nodes to replace, with what kind of fault and by what text."""
    todo: list[tuple[ast.AST, frozenset[str]]] = [(tree, frozenset())]
    while todo:
        node, names = todo.pop()
        if isinstance(node, ast.FunctionDef):
            # A twin of a name (`own0` for `own1`) must exist in the same function: any test would
            # find a NameError.
            names = frozenset(n.id for n in ast.walk(node) if isinstance(n, ast.Name)) | {
                argument.arg for argument in node.args.args
            }
        todo.extend((child, names) for child in reversed(_inner(node)))
        if isinstance(node, ast.expr):
            # Brackets, because the fault stands in the place of an operand whose precedence is not
            # known here.
            for kind, new in _of_expression(node, names):
                yield (
                    node,
                    kind,
                    f"({ast.unparse(new)})" if not isinstance(new, ast.Name) else new.id,
                )
        elif isinstance(node, ast.stmt):
            yield from ((part, kind, new) for part, kind, new in _of_statement(node))


def _inner(node: ast.AST) -> list[ast.AST]:
    """Children in which faults are made."""
    if isinstance(node, ast.ClassDef | ast.FunctionDef):
        defaults = (
            [] if isinstance(node, ast.ClassDef) else [*node.args.defaults, *node.args.kw_defaults]
        )
        return [*filter(None, defaults), *node.body]
    if isinstance(node, ast.AnnAssign):
        declared = "Annotated" in ast.unparse(node.annotation)  # options of configurations
        return [node.value] if node.value and not declared else []
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return []  # documentation
    # Names that a module offers are tested by importing them, and change no result.
    if (
        isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Name)
        and node.targets[0].id == "__all__"
    ):
        return []
    if (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr == "reshape"
    ):
        return [node.func]  # another shape is an error at once
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return []
    if isinstance(node, ast.keyword) and node.arg in ("strict", *_STYLE):
        return []  # strict of zip: a check, not a result
    return [child for child in ast.iter_child_nodes(node) if not isinstance(child, _LEFT_ALONE)]


def _of_expression(node: ast.expr, names: frozenset[str]) -> Iterator[tuple[str, ast.expr]]:
    if isinstance(node, ast.Constant):
        yield from _of_constant(node)
    elif isinstance(node, ast.BinOp) and not _joins_texts(node):
        if type(node.op) in ARITHMETIC:
            yield "arithmetic", ast.BinOp(node.left, ARITHMETIC[type(node.op)](), node.right)
            yield "term dropped", node.left
            if isinstance(node.op, ast.Add | ast.Mult):
                yield "term dropped", node.right
        elif isinstance(node.op, ast.Pow | ast.Mod):
            yield "term dropped", node.left
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        yield "sign dropped", node.operand
    elif isinstance(node, ast.Compare):
        for k, operator in enumerate(node.ops):
            for kind, table in (("comparison", OTHER_WAY), ("edge", EDGE)):
                if type(operator) in table and (kind == "comparison" or _whole(node)):
                    new = copy.deepcopy(node)
                    new.ops[k] = table[type(operator)]()
                    yield kind, new
    elif isinstance(node, ast.BoolOp):
        yield (
            "and / or",
            ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values),
        )
        for k in range(len(node.values)):
            left = [value for i, value in enumerate(node.values) if i != k]
            yield "term dropped", left[0] if len(left) == 1 else ast.BoolOp(node.op, left)
    elif isinstance(node, ast.IfExp):
        yield "condition", ast.IfExp(node.test, node.orelse, node.body)
    elif isinstance(node, ast.Call):
        yield from _of_call(node)
    elif isinstance(node, ast.Subscript) and ast.unparse(node.slice).endswith("::-1"):
        yield "order", node.value
    elif (
        isinstance(node, ast.Name)
        and isinstance(node.ctx, ast.Load)
        and (match := _NUMBERED.fullmatch(node.id))
    ):
        twin = f"{match[1]}{1 - int(match[2])}{match[3]}"
        if twin in names:
            yield "0 / 1", ast.Name(twin, ast.Load())


def _joins_texts(node: ast.BinOp) -> bool:
    """Whether texts or paths are put together: another operator would only raise a TypeError."""
    return any(
        isinstance(side, ast.JoinedStr | ast.Constant) and not _number(side)
        for side in (node.left, node.right)
    )


def _number(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


def _of_constant(node: ast.Constant) -> Iterator[tuple[str, ast.expr]]:
    value = node.value
    if isinstance(value, bool):
        yield "constant", ast.Constant(not value)
    elif isinstance(value, int):
        # One more of an index or a count is another result; one more of a large limit hardly is.
        yield (
            "constant",
            ast.Constant(1 - value if value in (0, 1) else value + 1 if value < 100 else 2 * value),
        )
    elif isinstance(value, float):
        # Twice as much: smaller changes of physical constants would ask for tests of the constants
        # themselves.
        yield "constant", ast.Constant(2.0 * value if value else 1.0)


def _of_call(node: ast.Call) -> Iterator[tuple[str, ast.expr]]:
    name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    if name in TWINS:
        new = copy.deepcopy(node)
        if isinstance(new.func, ast.Attribute):
            new.func.attr = TWINS[name]
        else:
            new.func = ast.Name(TWINS[name], ast.Load())
        yield "function", new
    elif name in ("abs", "sqrt", "clip", "sort", "sorted", "cumsum", "exp", "log") and node.args:
        yield "call dropped", node.args[0]


def _of_statement(node: ast.stmt) -> Iterator[tuple[ast.expr | ast.stmt, str, str]]:
    if isinstance(node, ast.AugAssign):
        yield node, "statement dropped", "pass"
        if isinstance(node.op, ast.Add | ast.Sub):
            other = ast.AugAssign(node.target, ARITHMETIC[type(node.op)](), node.value)
            yield node, "arithmetic", ast.unparse(other)
    elif _can_go(node):
        yield node, "statement dropped", "pass"
    elif isinstance(node, ast.If | ast.While) and "TYPE_CHECKING" not in ast.unparse(node.test):
        yield node.test, "condition", f"(not ({ast.unparse(node.test)}))"


def _can_go(node: ast.stmt) -> bool:
    """Whether a statement can be dropped without leaving a name undefined."""
    if isinstance(node, ast.Assign):
        return isinstance(node.targets[0], ast.Subscript | ast.Attribute)
    return isinstance(node, ast.Break | ast.Continue) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    )


def _whole(node: ast.Compare) -> bool:
    """Whether a comparison is of whole numbers, where < and <= differ for more than one number in a
    million.
    """
    sides = [node.left, *node.comparators]
    return any(
        (
            isinstance(side, ast.Constant)
            and isinstance(side.value, int)
            and not isinstance(side.value, bool)
        )
        or re.search(r"\b(len|ndim|count|races|games|tick|end|size)\b|shape\[", ast.unparse(side))
        for side in sides
    )
