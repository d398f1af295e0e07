"""Equations are solved in two places: in `jaxcap/fit/solvers` and `jaxcap/fit/linear_solvers` what is minimised in steps, and in
`jaxcap/geometry/linear.py` what has a closed form."""

import ast
import re
from pathlib import Path

import pytest

import jaxcap

PACKAGE = Path(jaxcap.__file__).parent
ROOMS = (PACKAGE / "fit" / "solvers", PACKAGE / "fit" / "linear_solvers")
CLOSED = PACKAGE / "geometry" / "linear.py"
#: what factors or solves by itself
SOLVES = re.compile(
    r"cho_factor|cholesky\(|solve_triangular|spsolve|splu|lsq_linear|lstsq|linalg\.solve|linalg\.inv|cg\("
    r"|linalg\.pinv|nnls|linalg\.qr|optimize import .*(least_squares|curve_fit)|optx\.(least_squares|minimise|root_find)"
)
#: files that may all the same, each with its reason
ALLOWED = {
    "body/symmetry.py": "bodies cannot import fits; optimistix's own Gauss-Newton makes bones of a skeleton equally long",
    "fit/uncertainty.py": "QR makes directions orthonormal, and solves nothing",
}
#: verbs that end in the solution of equations
VERB = re.compile(
    r"^(solve|cho_solve|lstsq|inv|inverse|least_squares|spsolve|factor(ise)?|cg|damped_step)(_|$)"
)
#: names of what damps a step, or bounds it
DAMPING = re.compile(r"damp|lambda|marquardt|trust|step_size|radius", re.IGNORECASE)
#: what may take a damping and solve nothing
ARITHMETIC = {"max", "min", "maximum", "minimum", "where", "float", "asarray", "_replace"}
LOOPS = {"while_loop", "fori_loop", "scan"}


def outside() -> list[Path]:
    found = [
        file
        for file in sorted(PACKAGE.rglob("*.py"))
        if not set(ROOMS) & set(file.parents) and file != CLOSED
    ]
    assert len(found) > 200
    return found


def name_of(call: ast.AST) -> str:
    """The last name of what is called: `solve` of `np.linalg.solve(a, b)`."""
    function = call.func if isinstance(call, ast.Call) else call
    return getattr(function, "attr", getattr(function, "id", ""))


def loops_of(tree: ast.AST) -> list[ast.AST]:
    """Bodies that run again and again: of `for` and `while`, and functions that JAX's loops take."""
    found: list[ast.AST] = [node for node in ast.walk(tree) if isinstance(node, ast.For | ast.While)]
    named = {node.name: node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and name_of(node) in LOOPS:
            found += [named[name_of(one)] for one in node.args if name_of(one) in named]
    return found


def solving(tree: ast.AST) -> set[str]:
    """Names of the functions of a module that solve, themselves or by another one of it."""
    named = {node.name: node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    found: set[str] = set()
    while True:
        more = {name for name, node in named.items() if name not in found and solves(node, found)}
        if not more:
            return found
        found |= more


def solves(node: ast.AST, functions: set[str]) -> bool:
    calls = [one for one in ast.walk(node) if isinstance(one, ast.Call)]
    return any(VERB.match(name_of(one)) or name_of(one) in functions or takes_damping(one) for one in calls)


def takes_damping(call: ast.Call) -> bool:
    """Whether a damping is handed to something that is no arithmetic: it solves elsewhere."""
    given = [*call.args, *(word.value for word in call.keywords)]
    names = [ast.unparse(one) for one in given if isinstance(one, ast.Name | ast.Attribute)]
    return name_of(call) not in ARITHMETIC and any(DAMPING.search(name) for name in names)


def damps(loop: ast.AST) -> bool:
    """Whether a damping is multiplied or divided, by itself or into itself."""
    for node in ast.walk(loop):
        if isinstance(node, ast.AugAssign) and DAMPING.search(ast.unparse(node.target)):
            if isinstance(node.op, ast.Mult | ast.Div):
                return True
        elif isinstance(node, ast.Assign):
            targets, value = node.targets[0], node.value
            pairs = (
                zip(targets.elts, value.elts, strict=False)
                if isinstance(targets, ast.Tuple) and isinstance(value, ast.Tuple)
                else [(targets, value)]
            )
            for target, new in pairs:
                scaled = any(
                    isinstance(part, ast.BinOp)
                    and isinstance(part.op, ast.Mult | ast.Div)
                    and ast.unparse(target) in (ast.unparse(part.left), ast.unparse(part.right))
                    for part in ast.walk(new)
                )
                if scaled and DAMPING.search(ast.unparse(target)):
                    return True
    return False


def damped_loops(source: str) -> list[int]:
    """Lines of loops that solve and scale a damping: minimisers of their own."""
    tree = ast.parse(source)
    functions = solving(tree)
    return [getattr(loop, "lineno", 0) for loop in loops_of(tree) if damps(loop) and solves(loop, functions)]


def test_equations_are_solved_in_the_room_or_in_closed_form():
    found = {
        file.relative_to(PACKAGE).as_posix() for file in outside() if SOLVES.search(file.read_text("utf-8"))
    }
    assert not found - set(ALLOWED), "solve by fit/solvers or by geometry/linear.py"
    assert set(ALLOWED) <= found, "these solve nothing any more; take them off the list"
    assert len(ALLOWED) <= 8


def test_nobody_else_walks_by_a_damping_of_its_own():
    found = {
        file.relative_to(PACKAGE).as_posix(): lines
        for file in outside()
        if (lines := damped_loops(file.read_text("utf-8")))
    }
    assert not found, f"minimise by fit/solvers: {found}"


@pytest.mark.parametrize(
    "source",
    [
        "while cost(x) > enough:\n    x = x + np.linalg.solve(h + damping * one, g)\n    damping *= 10\n",
        "for _ in range(9):\n    c, damping = c + step(damping), max(0.1 * damping, low)\n\ndef step(d):\n    return solve(h + d, g)\n",
        "for _ in range(9):\n    x = equations.step(x, damping)\n    damping /= 5\n",
        "def body(c):\n    x, trust = c\n    trust = where(better(x), 2 * trust, trust / 3)\n    return x - cho_solve(f, g), trust\n"
        "\nlax.while_loop(going, body, start)\n",
    ],
    ids=["while", "by a function", "elsewhere", "in JAX"],
)
def test_a_minimiser_is_told_from_other_loops(source):
    assert damped_loops(source)
    # whatever else a loop scales by is no damping
    assert not damped_loops(re.sub(r"damping|trust", "weight", source))


def test_a_fixed_damping_and_one_that_no_equation_has_are_no_minimisers():
    assert not damped_loops("for g in sides:\n    x = np.linalg.solve(h + damping * one, g)\n")
    assert not damped_loops("for x in springs:\n    damping = max(damping * x, low)\n")
