"""Mutants of a source file: one expression is changed, as physics is got wrong.

A sign, a term, a factor, a constant by two percent or by one, < and <=, two arguments, sine and
cosine, an axis. What says nothing of the physics is left alone: messages, checks that raise,
readers and writers, drawing, annotations, guards near zero.

A mutant is named by file, function, operator and the text around it, so that the name survives
when lines move.
"""

import ast
import random
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

MODULE = "<module>"
# A divisor's guard or an infinity, not a number of the physics.
_GUARD, _HUGE = 1e-6, 1e12
_LEAST_TEXT = 12
_KERNELS = re.compile(r"compiled|inlined|merged|njit|kernel")
_NOT_PHYSICS = re.compile(
    r"^_?(plot|draw|show|write|read|load|save|told|explain|refuse|warn|in_words|to_xarray|shapes?_of_array"
    r"|require|check)(_|$)|^__(repr|post_init|str)__$|^_repr_"
)
_NEVER_INSIDE = {
    "Column",
    "Table",
    "require_number",
    "watch",
    "progress",
    "cast",
    "compile_and_keep",
    "isinstance",
    "getattr",
    "hasattr",
}
# Their first two arguments may be exchanged.
_SYMMETRIC = {"max", "min", "maximum", "minimum", "hypot", "larger", "smaller", "gcd", "zip"}
_SYMMETRIC |= {
    "corrcoef",
    "spearmanr",
    "isclose",
    "allclose",
    "array_equal",
    "fmax",
    "fmin",
    "logical_and",
    "logical_or",
}
_SWAPPED_OPERATORS: dict[type, tuple[str, type]] = {
    ast.Add: ("add_subtract", ast.Sub),
    ast.Sub: ("add_subtract", ast.Add),
    ast.Mult: ("multiply_divide", ast.Div),
    ast.Div: ("multiply_divide", ast.Mult),
}
_SWAPPED_COMPARISONS: dict[type, type] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
}
_SWAPPED_NAMES = {"sin": "cos", "cos": "sin"}
# Most of these break a program at once; they are drawn less often.
_CRUDE, _CRUDE_SHARE = ("off_by_one", "arguments"), 0.3


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Attributes
    ----------
    file : path from the root of the tree
    function : qualified name, or `MODULE`
    before, after : source text around the change
    place : 1st and last line, both counted from 1, and columns in bytes, of what `text` replaces
    is_kernel : whether the function is compiled, so that no profiler sees it called
    is_constant : whether it stands outside of all functions
    """

    file: str
    function: str
    operator: str
    before: str
    after: str
    occurrence: int
    place: tuple[int, int, int, int]
    text: str
    is_kernel: bool
    is_constant: bool

    @property
    def name(self) -> str:
        """Name that survives when lines move."""
        nth = f" #{self.occurrence}" if self.occurrence > 1 else ""
        return f"{self.file}::{self.function}::{self.operator}::{self.before} -> {self.after}{nth}"

    def applied(self, source: str) -> str:
        """Return the source with the change."""
        first, left, last, right = self.place
        lines = source.encode().splitlines(keepends=True)
        head, tail = lines[first - 1][:left], lines[last - 1][right:]
        lines[first - 1 : last] = [head + self.text.encode() + tail]
        return b"".join(lines).decode()


@dataclass(frozen=True)
class _Site:
    node: ast.expr | ast.AugAssign
    above: tuple[ast.AST, ...]  # from the module down to the parent
    function: str
    is_kernel: bool


def mutants_of(root: Path, file: str) -> list[Mutant]:
    """Return every mutant of a source file, in the order of its text."""
    tree = ast.parse((root / file).read_text(encoding="utf-8"))
    seen: dict[str, int] = defaultdict(int)
    found = []
    for site in _sites(tree, (), MODULE, False):
        for operator, new in _changes(site):
            before, after = _shown(site, new)
            key = f"{site.function}::{operator}::{before}::{after}"
            seen[key] += 1
            node = site.node
            assert node.end_lineno is not None
            assert node.end_col_offset is not None
            place = (node.lineno, node.col_offset, node.end_lineno, node.end_col_offset)
            text = ast.unparse(new) if isinstance(new, ast.stmt) else f"({ast.unparse(new)})"
            is_constant = not any(isinstance(one, ast.FunctionDef) for one in site.above)
            found.append(
                Mutant(
                    file, site.function, operator, before, after, seen[key], place, text,
                    site.is_kernel, is_constant,
                )
            )  # fmt: skip
    return found


def drawn(mutants: Iterable[Mutant], count: int, seed: int) -> list[Mutant]:
    """Draw mutants in turns over the functions, so that none has many before each has one.

    A mutant's lot and its function's turn depend on their names and the seed alone.
    """
    by_function: dict[str, list[Mutant]] = defaultdict(list)
    for one in mutants:
        by_function[f"{one.file}::{one.function}"].append(one)
    lots = []
    for name, some in by_function.items():
        turn = random.Random(f"{seed} {name}").random()
        ordered = sorted(some, key=lambda one: _lot(one, seed), reverse=True)
        lots += [(n, turn, name, one) for n, one in enumerate(ordered)]
    return [one for *_, one in sorted(lots, key=lambda lot: lot[:3])[:count]]


def _lot(one: Mutant, seed: int) -> float:
    share = _CRUDE_SHARE if one.operator in _CRUDE else 1.0
    return float(random.Random(f"{seed} {one.name}").random() ** (1.0 / share))


# ---- where ---------------------------------------------------------------------------------------


def _sites(
    node: ast.AST, above: tuple[ast.AST, ...], function: str, is_kernel: bool
) -> Iterator[_Site]:
    """Yield what may be changed below a node, outside of what says nothing of the physics."""
    if _is_left_alone(node):
        return
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        inner = node.name if function == MODULE else f"{function}.{node.name}"
        # What is defined within a function belongs to it.
        if not any(isinstance(one, ast.FunctionDef) for one in above):
            function = inner
        if isinstance(node, ast.FunctionDef):
            is_kernel = is_kernel or any(
                _KERNELS.search(ast.unparse(one)) for one in node.decorator_list
            )
    elif isinstance(node, ast.expr | ast.AugAssign):
        yield _Site(node, above, function, is_kernel)
    for child in _children(node):
        yield from _sites(child, (*above, node), function, is_kernel)


def _is_left_alone(node: ast.AST) -> bool:
    """Tell whether a node says nothing of the physics: messages, checks, drawing, docstrings."""
    match node:
        case ast.Raise() | ast.Assert() | ast.Import() | ast.ImportFrom() | ast.JoinedStr():
            alone = True
        case ast.Expr():
            alone = isinstance(node.value, ast.Constant)
        case ast.ClassDef():
            alone = node.name.endswith("Error")
        case ast.FunctionDef():
            alone = _NOT_PHYSICS.search(node.name) is not None
        case ast.If():
            alone = any(isinstance(line, ast.Raise) for line in node.body) and not node.orelse
            alone |= "__name__" in ast.unparse(node.test)
        case ast.Call():
            name = _called(node)
            alone = name in _NEVER_INSIDE or name.endswith("Error")
        case _:
            alone = False
    return alone


def _children(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the parts of a node that are run with data: no annotations, no decorators."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "bases", "type_comment"):
            continue
        yield from (
            one
            for one in (value if isinstance(value, list) else [value])
            if isinstance(one, ast.AST)
        )


def _called(node: ast.Call) -> str:
    if isinstance(node.func, ast.Attribute):
        return node.func.attr
    return node.func.id if isinstance(node.func, ast.Name) else ""


# ---- what ----------------------------------------------------------------------------------------


def _changes(site: _Site) -> Iterator[tuple[str, ast.expr | ast.AugAssign]]:
    """Yield the operators that fit an expression, and what each makes of it."""
    node = site.node
    if isinstance(node, ast.AugAssign):
        if type(node.op) in _SWAPPED_OPERATORS:
            name, other = _SWAPPED_OPERATORS[type(node.op)]
            yield name, ast.AugAssign(node.target, other(), node.value)
    elif isinstance(node, ast.BinOp):
        yield from _of_operation(node)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield ("axis", ast.Constant(0)) if _is_axis(site.above[-1]) else ("sign", node.operand)
    elif isinstance(node, ast.Constant) and not any(map(_is_axis, site.above[-2:-1])):
        yield from _of_constant(node, site.above[-1])
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in _SWAPPED_COMPARISONS:
        first = _SWAPPED_COMPARISONS[type(node.ops[0])]()
        yield "comparison", ast.Compare(node.left, [first, *node.ops[1:]], node.comparators)
    elif isinstance(node, ast.Call):
        yield from _of_call(node)


def _is_axis(node: ast.AST) -> bool:
    return isinstance(node, ast.keyword) and node.arg == "axis"


def _of_operation(node: ast.BinOp) -> Iterator[tuple[str, ast.expr]]:
    if any(
        isinstance(side, ast.JoinedStr | ast.List | ast.Tuple) for side in (node.left, node.right)
    ):
        return
    if any(
        isinstance(s, ast.Constant) and isinstance(s.value, str) for s in (node.left, node.right)
    ):
        return
    if type(node.op) in _SWAPPED_OPERATORS:
        name, other = _SWAPPED_OPERATORS[type(node.op)]
        yield name, ast.BinOp(node.left, other(), node.right)
        dropped = "drop_term" if name == "add_subtract" else "drop_factor"
        yield dropped, node.left


def _of_constant(node: ast.Constant, parent: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    value = node.value
    if isinstance(value, bool) or not isinstance(value, int | float):
        return
    if _is_axis(parent):
        yield "axis", ast.Constant(1 if value == 0 else 0)
    elif isinstance(value, float) and _GUARD < abs(value) < _HUGE:
        yield "constant", ast.Constant(float(f"{value * 1.02:.12g}"))
    elif isinstance(value, int) and abs(value) < _HUGE:
        yield "off_by_one", ast.Constant(value + 1 if value < 2 else value - 1)


def _of_call(node: ast.Call) -> Iterator[tuple[str, ast.expr]]:
    name, arguments = _called(node), node.args
    if name in _SWAPPED_NAMES:
        yield (
            "sine_cosine",
            ast.Call(_renamed(node.func, _SWAPPED_NAMES[name]), arguments, node.keywords),
        )
    if len(arguments) < 2 or name in _SYMMETRIC:
        return
    one, other = arguments[:2]
    if isinstance(one, ast.Starred) or isinstance(other, ast.Starred):
        return
    if isinstance(one, ast.Constant) and isinstance(one.value, str):  # a title, a name
        return
    # A number in the place of an array fails at once, whatever the tests are worth.
    if type(one) is type(other) and ast.unparse(one) != ast.unparse(other):
        yield "arguments", ast.Call(node.func, [other, one, *arguments[2:]], node.keywords)


def _renamed(function: ast.expr, name: str) -> ast.expr:
    if isinstance(function, ast.Attribute):
        return ast.Attribute(function.value, name, ast.Load())
    return ast.Name(name, ast.Load())


def _shown(site: _Site, new: ast.expr | ast.AugAssign) -> tuple[str, str]:
    """Return the text of the smallest expression around a change that is worth reading."""
    whole, at = site.node, len(site.above)
    around: ast.AST = whole
    while at and len(ast.unparse(around)) < _LEAST_TEXT:
        parent = site.above[at - 1]
        if not isinstance(parent, ast.expr | ast.keyword | ast.Assign | ast.Return | ast.AugAssign):
            break
        around, at = parent, at - 1
    before = ast.unparse(around)
    if around is whole:
        return _line(before), _line(ast.unparse(new))
    parent, old = site.above[-1], site.node
    _exchange(parent, old, new)
    after = ast.unparse(around)
    _exchange(parent, new, old)
    return _line(before), _line(after)


def _exchange(parent: ast.AST, old: ast.AST, new: ast.AST) -> None:
    for name, value in ast.iter_fields(parent):
        if value is old:
            setattr(parent, name, new)
        elif isinstance(value, list):
            value[:] = [new if one is old else one for one in value]


def _line(text: str) -> str:
    return " ".join(text.split())
