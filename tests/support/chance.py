"""Find in a test's source whatever makes its outcome a matter of time, load or chance."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import NamedTuple

MARKER = "clock"
"""Tests with this marker watch real time and run alone."""

CLOCKS = frozenset(
    "sleep usleep nanosleep monotonic monotonic_ns perf_counter perf_counter_ns process_time "
    "process_time_ns thread_time thread_time_ns time_ns clock_gettime getrusage utcnow".split()
)
"""Functions that read a clock or sleep, whatever module or object they belong to."""

CLOCKS_OF = {"time": {"time"}, "datetime": {"now", "today"}, "date": {"today"}, "os": {"times"}}
"""More of them, with names that other objects use too."""

CLOCK_IN_TEXT = re.compile(rf"\b(?:{'|'.join(CLOCKS)}|time\.time|datetime\.now)\s*\(")
"""The calls in the source of a script that a test starts."""

DEADLINES = frozenset("timeout timeout_s timeout_sec within_s deadline deadline_s".split())
WAITS = frozenset("wait wait_for join communicate settle settimeout until stay".split())
"""Functions whose numbers are seconds."""

LIMIT_NAME = re.compile(r"(?:PATIENCE|DEADLINE|TIMEOUT|GIVE_UP|END|ANSWER|NOTICED|REST)(?:_\w+)?_S")

SIMULATED = frozenset({"Motion"})
"""Makers of settings whose seconds are the simulation's."""

SEEDED = frozenset("seed Random default_rng Generator SeedSequence RandomState PCG64".split())
CHANCE = frozenset("uuid1 uuid4 urandom SystemRandom token_hex token_bytes token_urlsafe".split())
MAKERS = frozenset("default_rng RandomState Random SeedSequence".split())
"""Makers of random generators; without an argument they take their seed from the system."""


class Finding(NamedTuple):
    """One place, and what is wrong there."""

    line: int
    problem: str


def findings(source: str) -> list[Finding]:
    """Return the clocks, sleeps, deadlines and unseeded draws outside tests marked ``clock``."""
    module = ast.parse(source)
    if any(_is_marked(value) for value in _module_marks(module)):
        return []
    return sorted(set(_walk(module)))


def _module_marks(module: ast.Module) -> Iterator[ast.expr]:
    for node in module.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark":
            yield node.value


def _is_marked(expression: ast.expr) -> bool:
    return any(
        isinstance(node, ast.Attribute) and ast.unparse(node) == f"pytest.mark.{MARKER}"
        for node in ast.walk(expression)
    )


def _walk(node: ast.AST) -> Iterator[Finding]:
    if isinstance(node, ast.FunctionDef | ast.ClassDef) and any(
        _is_marked(decorator) for decorator in node.decorator_list
    ):
        return
    line = getattr(node, "lineno", 0)
    yield from (Finding(line, problem) for problem in _problems(node))
    for child in ast.iter_child_nodes(node):
        yield from _walk(child)


def _problems(node: ast.AST) -> Iterator[str]:
    match node:
        case ast.Attribute(attr=name) if name in CLOCKS or name in CHANCE:
            yield f"{ast.unparse(node)}: {'a clock' if name in CLOCKS else 'chance without a seed'}"
        case ast.Attribute(value=ast.Name(id=owner), attr=name) if name in CLOCKS_OF.get(owner, ()):
            yield f"{ast.unparse(node)}: a clock"
        case ast.Attribute(value=ast.Name(id="random"), attr=name) if name not in SEEDED:
            yield f"{ast.unparse(node)}: a draw from the process's own generator"
        case ast.Attribute(
            value=ast.Attribute(value=ast.Name(id="np" | "numpy"), attr="random"), attr=name
        ) if name not in SEEDED:
            yield f"{ast.unparse(node)}: a draw from the process's own generator"
        case ast.ImportFrom(module="time" | "random" | "secrets" | "uuid", names=names):
            for alias in names:
                if alias.name not in {"Random", "UUID", "struct_time"}:
                    yield f"from {node.module} import {alias.name}: a clock or chance"
        case ast.Call():
            yield from _problems_of_call(node)
        case ast.Constant(value=str(text)) if found := CLOCK_IN_TEXT.search(text):
            yield f"a script calls {found.group(0)})"
        case ast.List(elts=[ast.Constant(value="sleep"), ast.Constant(value=seconds), *_]) | (
            ast.Tuple(elts=[ast.Constant(value="sleep"), ast.Constant(value=seconds), *_])
        ) if seconds != "infinity":
            yield f"sleep {seconds}: a process that ends by itself"
        case ast.Assign(targets=[ast.Name(id=name)]) if LIMIT_NAME.fullmatch(name):
            if _is_number(node.value):
                yield f"{name}: a deadline beside waiting.HANG_S"


def _problems_of_call(call: ast.Call) -> Iterator[str]:
    name = ast.unparse(call.func).rpartition(".")[2]
    for keyword in call.keywords if name not in SIMULATED else ():
        if keyword.arg in DEADLINES and _is_number(keyword.value):
            yield f"{name}({ast.unparse(keyword)}): a deadline beside waiting.HANG_S"
    if name in WAITS:
        for argument in call.args:
            if _is_number(argument):
                yield f"{name}({ast.unparse(argument)}): a deadline beside waiting.HANG_S"
    seeds = [*call.args, *call.keywords]
    if name in MAKERS and not seeds:
        yield f"{name}(): chance without a seed"
    if ast.unparse(call.func) == "Rotation.random" and not any(
        keyword.arg in {"rng", "random_state"} for keyword in call.keywords
    ):
        yield "Rotation.random: chance without a seed"


def _is_number(node: ast.expr) -> bool:
    """Tell whether an expression is made of numbers alone, and not just 0."""
    if not all(
        isinstance(part, ast.Constant | ast.BinOp | ast.UnaryOp | ast.operator | ast.unaryop)
        for part in ast.walk(node)
    ):
        return False
    values = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant)]
    return any(type(value) in (int, float) and value for value in values)
