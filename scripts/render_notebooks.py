"""Run the notebooks and write what they show as `notebooks/rendered/NAME.md` with pictures beside.

    python scripts/render_notebooks.py                 # all of them
    python scripts/render_notebooks.py track energy

A notebook is a text, `notebooks/NAME.py` in jupytext's percent format; this makes a page of it that a browser shows
without running anything. Numbers may differ in their last digits on other machines. Needs `pip install -e ".[notebooks]"`.
"""

import argparse
import base64
import io
import os
import shutil
import sys
import time
from pathlib import Path

import jupytext
from nbclient import NotebookClient
from PIL import Image

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
#: pixels that pictures are wide at most, and their colours
WIDE, COLOURS = 900, 128


def main() -> None:
    """Run notebooks, and write their pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="names of the notebooks; all by default")
    options = parser.parse_args()
    for name in options.names or sorted(path.stem for path in NOTEBOOKS.glob("*.py")):
        begin = time.perf_counter()
        page = render(name)
        sys.stderr.write(f"{page}: {time.perf_counter() - begin:.0f} s\n")


def render(name: str) -> Path:
    """Run one notebook in its folder, and return its page."""
    # a kernel's pictures come inline
    os.environ.pop("MPLBACKEND", None)
    notebook = jupytext.read(NOTEBOOKS / f"{name}.py")
    notebook = NotebookClient(
        notebook, timeout=1800, kernel_name="python3", resources={"metadata": {"path": str(NOTEBOOKS)}}
    ).execute()
    folder = NOTEBOOKS / "rendered"
    folder.mkdir(exist_ok=True)
    pictures = folder / name
    shutil.rmtree(pictures, ignore_errors=True)
    parts, count = [], 0
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            # links are from the notebook's folder, and the page lies one deeper
            parts.append(cell.source.replace("](../", "](../../"))
            continue
        parts.append(f"```python\n{cell.source}\n```")
        told = ""
        for output in cell.outputs:
            if output.output_type == "stream" and output.name == "stdout":
                told += output.text
                continue
            data = output.get("data", {})
            if "image/png" in data:
                parts, told = said(parts, told), ""
                pictures.mkdir(exist_ok=True)
                shrink(base64.b64decode(data["image/png"]), pictures / f"{count}.png")
                parts.append(f"![]({name}/{count}.png)")
                count += 1
            elif "text/plain" in data:
                told += data["text/plain"] + "\n"
        parts = said(parts, told)
    page = folder / f"{name}.md"
    page.write_text("\n\n".join(parts) + "\n", "utf-8")
    return page


def said(parts: list[str], told: str) -> list[str]:
    """Append the printed output of a cell, if there is any."""
    return [*parts, f"```text\n{told.rstrip()}\n```"] if told.strip() else parts


def shrink(png: bytes, target: Path) -> None:
    """Reduce a picture to a largest width in pixels and few colours."""
    with Image.open(io.BytesIO(png)) as picture:
        share = min(1.0, WIDE / picture.width)
        size = (round(share * picture.width), round(share * picture.height))
        small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    small.quantize(COLOURS).save(target, optimize=True)


if __name__ == "__main__":
    main()
