"""What `mkdocs` needs to make a site of pages that also read well where they lie.

Links out of `docs` become links inside of the site: figures of `assets` and notebooks are taken along, other
files are named without a link, and a function with its file, ``[`solve`](../jaxcap/fit/solve.py)``, leads to its own
reference. Pages of the reference say which parts of the package they are of, `<!-- names of energy -->`, and get the
public names from there.
"""

import posixpath
import re
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import jaxcap
from jaxcap.lazy_imports import read_stub

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
#: a function with its file, any other link, and where names are to stand
FUNCTION = re.compile(r"\[`([\w.]+)`\]\((?:\.\./)+(jaxcap/[\w/]+)\.py\)")
LINK = re.compile(r"(!?\[[^\]]*\])\((\.\.?/[^)#\s]+)(#[^)\s]*)?\)")
NAMES = re.compile(r"<!-- names of ([\w ,]+) -->")
#: functions of the papers that are not among the public names have a page of their own
PAPERS = "reference/papers.md"


def on_files(files: "Files", config: "MkDocsConfig") -> "Files":
    """Add figures, notebooks, and the page of functions that only the papers' tables name."""
    from mkdocs.structure.files import File

    for path in sorted((ROOT / "assets").iterdir()):
        if path.suffix in (".png", ".webp"):
            files.append(File.generated(config, f"assets/{path.name}", abs_src_path=str(path)))
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        content, pictures = notebook_page(path)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=content))
        for name, picture in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=picture))
    content = "# Functions of the papers\n\nWhat the tables of equations name and `import jaxcap` does not bring.\n\n"
    content += "\n".join(f"::: {name}\n" for name in paper_functions())
    files.append(File.generated(config, PAPERS, content=content))
    return files


def notebook_page(path: Path) -> tuple[str, dict[str, bytes]]:
    """Convert an executed notebook to Markdown and its pictures by their names."""
    from nbconvert import MarkdownExporter

    content, resources = MarkdownExporter().from_filename(
        str(path), resources={"output_files_dir": f"{path.stem}_files", "unique_key": path.stem}
    )
    return content, resources["outputs"]


def on_page_markdown(markdown: str, page: "Page", config: "MkDocsConfig", files: "Files") -> str:
    """Rewrite the links and lists of one page."""
    del config
    where = page.file.src_uri
    folder = posixpath.dirname(where)
    if where.startswith("notebooks/"):
        # links are from the folder of notebooks in the checkout
        folder = "../notebooks"
    markdown = FUNCTION.sub(lambda found: f"[`{found[1]}`][{dotted(found[2])}.{found[1]}]", markdown)

    def inside(found: re.Match) -> str:
        target = posixpath.normpath(posixpath.join("docs", folder, found[2]))
        uri = site_path(target)
        if uri is not None and files.get_file_from_path(uri):
            return f"{found[1]}({posixpath.relpath(uri, posixpath.dirname(where) or '.')}{found[3] or ''})"
        if target.startswith("docs/"):
            return found[0]
        return found[1].strip("[]")

    markdown = LINK.sub(inside, markdown)
    return NAMES.sub(lambda found: "\n".join(f"::: jaxcap.{n}\n" for n in names_of(found[1])), markdown)


def site_path(target: str) -> str | None:
    """Find the path of a file of the checkout in the site; None if it is not part of it."""
    if target.startswith("docs/"):
        return target.removeprefix("docs/")
    if re.fullmatch(r"notebooks/\w+\.(py|ipynb)", target):
        return target.rsplit(".", 1)[0] + ".md"
    return target if target.startswith("assets/") else None


def dotted(path: str) -> str:
    return path.replace("/", ".").removesuffix(".__init__")


def public_names() -> dict[str, str]:
    """Map each public name to the part of the package that lists it, `limits` for `limits.Cone`: its namespace, or for names
    of `jaxcap` itself that of its module."""
    found, namespaces = {}, []
    for name, (module, attribute) in read_stub(ROOT / "jaxcap" / "__init__.pyi").items():
        if attribute:
            found[name] = module.split(".")[1]
        elif (ROOT / "jaxcap" / name).is_dir():
            namespaces.append(name)
    for space in namespaces:
        found |= {f"{space}.{name}": space for name in read_stub(ROOT / "jaxcap" / space / "__init__.pyi")}
    return found


def names_of(wings: str) -> list[str]:
    """List the public names of some parts of the package: `body, geometry`."""
    wanted = [wing.strip() for wing in wings.split(",")]
    return [name for name, wing in public_names().items() if wing in wanted]


def paper_functions() -> list[str]:
    """List the full names of functions in the papers' tables that are not public."""
    found_names = (attrgetter(name)(jaxcap) for name in public_names())
    # modules among them, such as geometry.rotation, have no name of a definition
    public = {f"{it.__module__}.{it.__qualname__}" for it in found_names if hasattr(it, "__qualname__")}
    found: dict[str, None] = {}
    for name in functions_of(sorted((ROOT / "docs").rglob("*.md"))):
        if name not in public:
            found[name] = None
    return sorted(found)


def functions_of(pages: list[Path]) -> Iterator[str]:
    """List the full names of all functions that pages link to by their files."""
    for page in pages:
        for name, path in FUNCTION.findall(page.read_text()):
            yield f"{dotted(path)}.{name}"
