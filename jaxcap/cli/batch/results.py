"""The table of results of a batch: a row of JSON for each job, which is the journal of a stopped batch, too."""

import contextlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...io.system.atomic import DISK_FULL_ERRORS, atomic_path, write_text
from ...io.table import json_text

Row = dict[str, Any]


def read_rows(path: Path) -> dict[str, Row]:
    """Read the last row of each job, by the key of the job; a row that was torn by the end of the program is left out.

    **Raises:** `InputError` if the file is no table of results.
    """
    rows: dict[str, Row] = {}
    try:
        lines = path.read_text("utf-8").split("\n") if path.exists() else []
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a table of results.") from None
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line) if line.strip() else None
        except (ValueError, RecursionError):
            if number == len(lines):
                break
            row = False
        if row is None:
            continue
        if not (isinstance(row, dict) and {"key", "status"} <= set(row)):
            raise InputError(
                f"{path}:{number}: this line is no row of a table of results; give another file with -o."
            )
        rows[str(row["key"])] = row
    return rows


class ResultTable:
    """The table of results in a file: rows are appended as jobs end."""

    def __init__(self, path: Path):
        """Open a table, with the rows of earlier runs. Raises `InputError` if it is invalid or cannot be written."""
        self.path = path
        receipts = _read_receipts(receipts_folder(path))
        self.rows = {**read_rows(path), **receipts}
        # torn and earlier rows go
        self.rewrite()
        for key in receipts:
            self._remove_receipt(key)

    def append(self, row: Row) -> None:
        """Add the row of a job that ended. Raises `InputError` if it cannot be written."""
        self.rows[row["key"]] = row
        try:
            with open(self.path, "a", encoding="utf-8") as file:
                file.write(_line(row))
        except OSError as error:
            mend = "free some disk space" if error.errno in DISK_FULL_ERRORS else "make its folder writable"
            raise InputError(
                f"{self.path}: a result cannot be written ({error.strerror}); {mend} and run the batch again."
            ) from None
        self._remove_receipt(row["key"])

    def rewrite(self, first: Iterable[str] = ()) -> None:
        """Write the last row of each job, those with the `first` keys before the others. Raises `InputError`."""
        ordered = {key: self.rows[key] for key in first if key in self.rows} | self.rows
        self.rows = {key: self.rows[key] for key in ordered}
        write_text(self.path, "".join(map(_line, self.rows.values())))

    def _remove_receipt(self, key: str) -> None:
        with contextlib.suppress(OSError):
            _receipt(receipts_folder(self.path), key).unlink(missing_ok=True)


def write_parquet(path: Path, rows: Iterable[Row]) -> bool:
    """Write rows as a Parquet table, with a column for each figure; False if pyarrow is not installed. Raises `InputError`."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return False
    flat = [_flat(row) for row in rows]
    names = list(dict.fromkeys(name for row in flat for name in row))
    with atomic_path(path) as temporary:
        columns = {name: [row.get(name) for row in flat] for name in names}
        pyarrow.parquet.write_table(pyarrow.table(columns), temporary)
    return True


def receipts_folder(table: Path) -> Path:
    """Return the folder in which workers leave the rows of finished jobs until they are in the table."""
    return table.with_name(f".{table.name}.receipts")


def read_receipt(folder: str, key: str) -> Row | None:
    """Read the row of a job that a worker finished before it died; None if there is none."""
    try:
        row = json.loads(_receipt(Path(folder), key).read_text("utf-8"))
    except (OSError, ValueError):
        return None
    return row if isinstance(row, dict) and row.get("key") == key else None


def write_receipt(folder: str, row: Row) -> None:
    """Write the row of a finished job, if the worker sees the folder of receipts."""
    if Path(folder).is_dir():
        with contextlib.suppress(InputError):
            write_text(_receipt(Path(folder), row["key"]), _line(row))


def _read_receipts(folder: Path) -> dict[str, Row]:
    """Read the receipts that a stopped batch left."""
    rows = {}
    for path in folder.glob("*.json") if folder.is_dir() else ():
        row = read_receipt(str(folder), path.stem)
        if row is not None:
            rows[path.stem] = row
    return rows


def _receipt(folder: Path, key: str) -> Path:
    return folder / f"{key}.json"


def _line(row: Mapping[str, Any]) -> str:
    return json_text(row) + "\n"


def _flat(row: Row) -> Row:
    """Return a row for a table of columns: a column for each value and figure, JSON for lists."""
    flat: Row = {}
    for name, value in row.items():
        if name in ("values", "figures"):
            flat.update({f"{name}.{each}": item for each, item in value.items()})
        else:
            flat[name] = json.dumps(value) if isinstance(value, (list, dict)) else value
    return flat
