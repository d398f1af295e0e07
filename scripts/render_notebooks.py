"""Run the notebooks and write them with their outputs as `notebooks/NAME.ipynb`.

    python scripts/render_notebooks.py                 # all of them
    python scripts/render_notebooks.py track energy

`notebooks/NAME.py` is the source, in jupytext's percent format. The two are paired: Jupyter with jupytext
keeps both up to date. Numbers may differ in their last digits on other machines. Needs
`pip install -e ".[notebooks]"`.
"""

import argparse
import base64
import io
import os
import sys
import time
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from PIL import Image

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
#: maximum width of pictures in pixels, and their number of colours
WIDTH, COLOURS = 900, 128


def main() -> None:
    """Run the named notebooks, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="names of notebooks; all by default")
    options = parser.parse_args()
    for name in options.names or sorted(path.stem for path in NOTEBOOKS.glob("*.py")):
        begin = time.perf_counter()
        page = render(name)
        sys.stderr.write(f"{page}: {time.perf_counter() - begin:.0f} s\n")


def render(name: str) -> Path:
    """Run one notebook in its folder and write it with small outputs."""
    # pictures of a kernel are inline
    os.environ.pop("MPLBACKEND", None)
    notebook = jupytext.read(NOTEBOOKS / f"{name}.py")
    notebook = NotebookClient(
        notebook, timeout=1800, kernel_name="python3", resources={"metadata": {"path": str(NOTEBOOKS)}}
    ).execute()
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number}"
        cell.metadata.clear()
        if cell.cell_type == "code":
            cell.outputs = [small for output in cell.outputs if (small := shrink_output(output))]
    page = NOTEBOOKS / f"{name}.ipynb"
    page.write_text(nbformat.writes(notebook) + "\n", "utf-8")
    return page


def shrink_output(output: nbformat.NotebookNode) -> nbformat.NotebookNode | None:
    """Keep the picture or the text of an output; drop progress on stderr."""
    if output.output_type == "stream":
        return output if output.name == "stdout" else None
    data = output.get("data", {})
    if "image/png" in data:
        output["data"] = {"image/png": shrink_picture(data["image/png"])}
    elif "text/plain" in data:
        output["data"] = {"text/plain": data["text/plain"]}
    output["metadata"] = {}
    return output


def shrink_picture(encoded: str) -> str:
    """Reduce a PNG in base64 to the maximum width and few colours."""
    target = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(encoded))) as picture:
        share = min(1.0, WIDTH / picture.width)
        size = (round(share * picture.width), round(share * picture.height))
        small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    small.quantize(COLOURS).save(target, "png", optimize=True)
    return base64.b64encode(target.getvalue()).decode()


if __name__ == "__main__":
    main()
