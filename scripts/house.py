"""Print how the package is built: files, names and sentences: `python scripts/house.py`; with `--check` fail where docstrings are wrong.

`tests/project/test_house.py` holds the limits. A verb that is missing from `scripts/verbs.txt` is added there.
"""

import ast
import re
import statistics
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).resolve().parents[1]
VERBS = frozenset((ROOT / "scripts" / "verbs.txt").read_text("utf-8").split())
#: words that no other library uses so, outside of code in backticks
PRIVATE = re.compile(
    r"\b(told|tells?|beside|hangs|hang on|at hand|as it were|such as it is)\b", re.IGNORECASE
)
CODE = re.compile(r"`[^`]*`")
Function = ast.FunctionDef | ast.AsyncFunctionDef


def package_files() -> list[Path]:
    """List the Python files of the package."""
    return sorted((ROOT / "jaxcap").rglob("*.py"))


def lines_of_files() -> dict[str, int]:
    """Count the lines of every file of the package."""
    return {name_of(file): len(file.read_text("utf-8").splitlines()) for file in package_files()}


def files_of_folders(top: str) -> dict[str, int]:
    """Count the Python files of every folder."""
    folders = {file.parent for file in (ROOT / top).rglob("*.py")}
    return {name_of(folder): len(list(folder.glob("*.py"))) for folder in sorted(folders)}


def name_of(path: Path) -> str:
    """Name a path from the root of the checkout."""
    return path.relative_to(ROOT).as_posix()


def docstrings() -> Iterator[tuple[str, ast.AST, str]]:
    """Yield the place, the node and the text of every docstring of the package."""
    for file in package_files():
        tree = ast.parse(file.read_text("utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | Function):
                text = ast.get_docstring(node)
                if text:
                    yield f"{name_of(file)}:{getattr(node, 'lineno', 1)}", node, text


def is_property(node: Function) -> bool:
    """Test if a function is an attribute to its callers."""
    return any(
        ast.unparse(each).rpartition(".")[2] in ("property", "cached_property")
        for each in node.decorator_list
    )


def without_verb() -> tuple[list[str], int]:
    """List the functions whose docstring does not begin with an imperative verb, and count all functions."""
    functions = [
        (place, text)
        for place, node, text in docstrings()
        if isinstance(node, Function) and not is_property(node)
    ]
    return [place for place, text in functions if text.split(maxsplit=1)[0].rstrip(",.") not in VERBS], len(
        functions
    )


def help_texts() -> Iterator[tuple[str, str]]:
    """Yield the place and the text of the help of every option: the string after a field, or `help=`."""
    for file in package_files():
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.ClassDef):
                for field, after in pairwise(node.body):
                    if isinstance(field, ast.AnnAssign) and isinstance(after, ast.Expr):
                        yield f"{name_of(file)}:{after.lineno}", "".join(strings_of(after))
            elif isinstance(node, ast.keyword) and node.arg == "help":
                yield f"{name_of(file)}:{node.value.lineno}", "".join(strings_of(node))


def strings_of(node: ast.AST) -> list[str]:
    """List the string constants below a node."""
    constants = (each.value for each in ast.walk(node) if isinstance(each, ast.Constant))
    return [value for value in constants if isinstance(value, str)]


def private_words() -> list[str]:
    """List the docstrings and help texts with private words, and the words."""
    texts = [*((place, text) for place, _, text in docstrings()), *help_texts()]
    found = ((place, PRIVATE.findall(CODE.sub("", text))) for place, text in texts)
    return [f"{place}: {', '.join(words)}" for place, words in found if words]


def import_circles() -> list[list[str]]:
    """List the groups of files of the package that import each other, imports within functions included."""
    files = {name_of(file).removesuffix(".py").removesuffix("/__init__"): file for file in package_files()}
    numbers = {name: number for number, name in enumerate(files)}
    arrows = [
        (numbers[name], numbers[other])
        for name, file in files.items()
        for other in imported_by(name, file)
        if other in numbers and other != name
    ]
    rows, columns = np.array(arrows).T
    graph = coo_array((np.ones(len(rows)), (rows, columns)), (len(files), len(files)))
    _, labels = connected_components(graph, connection="strong")
    groups = (
        [name for name, label in zip(files, labels, strict=True) if label == one]
        for one in range(labels.max() + 1)
    )
    return [group for group in groups if len(group) > 1]


def imported_by(name: str, file: Path) -> Iterator[str]:
    """Yield the files that a file imports, and the members of packages that may be files."""
    package = name if file.name == "__init__.py" else name.rpartition("/")[0]
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            above = package.split("/")[: len(package.split("/")) - node.level + 1]
            target = "/".join([*above, *(node.module or "").split(".")]).rstrip("/")
            yield target
            yield from (f"{target}/{alias.name}" for alias in node.names)


def public_names() -> dict[str, int]:
    """Count the public names of each namespace."""
    import jaxcap as jc

    spaces = {name: getattr(jc, name) for name in jc.__all__ if (ROOT / "jaxcap" / name).is_dir()}
    functions = [name for name in jc.__all__ if name not in spaces]
    return {
        "jaxcap": len(functions),
        **{f"jaxcap.{name}": len(space.__all__) for name, space in spaces.items()},
    }


def main() -> None:
    """Print all of it."""
    lines, folders = lines_of_files(), files_of_folders("jaxcap")
    largest, longest = max(folders, key=folders.__getitem__), max(lines, key=lines.__getitem__)
    verbless, functions = without_verb()
    sys.stdout.write(
        f"{len(lines)} files, {sum(lines.values())} lines; median {statistics.median(lines.values()):g}\n"
        f"longest file: {longest}, {lines[longest]} lines\n"
        f"largest folder: {largest}, {folders[largest]} files\n"
        f"public names: {', '.join(f'{count} in {name}' for name, count in public_names().items())}\n"
        f"docstrings of functions that begin with a verb: {1 - len(verbless) / functions:.1%} of {functions}\n"
        f"docstrings and help texts with private words: {len(private_words())}\n"
    )
    circles = [", ".join(group) for group in import_circles()]
    sys.stdout.write(f"circles of imports: {len(circles)}\n")
    wrong = [*verbless, *private_words(), *circles]
    sys.stdout.writelines(f"  {place}\n" for place in wrong)
    if "--check" in sys.argv[1:] and wrong:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
