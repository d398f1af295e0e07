"""The journal of a run: exact, and safe against whatever the end of a program leaves; tables."""

import json
import subprocess
import sys

import numpy as np
import pytest

from jaxcap.errors import InputError
from jaxcap.io.archives import journal as journal_module
from jaxcap.io.archives.journal import create_journal, read_header, read_records, resume_journal
from jaxcap.io.table import write_csv, write_json

HEADER = {"sigma0": 0.1, "up": "y", "vertices": None}


def write(path, records):
    with create_journal(path, HEADER, records.shape[1]) as journal:
        for record in records:
            journal.append(record)
    return path.read_bytes()


@pytest.fixture
def records(rng):
    numbers = rng.normal(size=(5, 7))
    numbers[1, :3] = [np.nan, np.inf, -0.0]
    return numbers


def same(a, b) -> bool:
    return a.tobytes() == b.tobytes()


def test_records_come_back_to_the_last_bit(tmp_path, records):
    write(tmp_path / "journal", records)
    with resume_journal(tmp_path / "journal", HEADER, 7) as journal:
        assert same(journal.read(), records)
        assert same(journal.last, records[-1])
        journal.append(records[0])
        assert same(journal.read(slice(2, 4)), np.concatenate([records, records[:1]])[:, 2:4])
    with resume_journal(tmp_path / "journal", HEADER, 7) as journal:
        assert journal.count == len(records) + 1
        assert same(journal.last, records[0])
    assert read_header(tmp_path / "journal") == {**HEADER, "width": 7}


def test_any_end_leaves_the_whole_records(tmp_path, records):
    """Cut at every byte behind the header: so many whole records are there, and it goes on."""
    path = tmp_path / "journal"
    data = write(path, records)
    size = 7 * 8 + 4
    start = len(data) - 5 * size
    for end in range(start, len(data)):
        path.write_bytes(data[:end])
        whole = (end - start) // size
        with resume_journal(path, HEADER, 7) as journal:
            assert same(journal.read(), records[:whole])
            for record in records[whole:]:
                journal.append(record)
        assert path.read_bytes() == data


def test_damaged_record_ends_what_counts(tmp_path, records):
    path = tmp_path / "journal"
    data = bytearray(write(path, records))
    data[-3 * 60 + 20] ^= 1
    path.write_bytes(data)
    with (
        pytest.warns(
            UserWarning,
            match=r"record 2, .* the 2 records after it are computed again\. The damaged journal is kept as journal.damaged",
        ),
        resume_journal(path, HEADER, 7) as journal,
    ):
        assert same(journal.read(), records[:2])
    assert (tmp_path / "journal.damaged").read_bytes() == data


def test_records_are_read_in_blocks(tmp_path, monkeypatch, records):
    """Blocks of two records of 60 bytes, whatever their number, and from any record on."""
    monkeypatch.setattr(journal_module, "BLOCK", 130)
    path = tmp_path / "journal"
    data = write(path, records)
    for after in range(6):
        assert same(read_records(path, after), records[after:])
    for end in range(len(data) - 5 * 60, len(data)):
        path.write_bytes(data[:end])
        assert len(read_records(path)) == 5 - (len(data) - end + 59) // 60
    data = bytearray(data)
    data[-2 * 60 + 20] ^= 1
    path.write_bytes(data)
    assert same(read_records(path, 1), records[1:3])


def test_a_full_disk_names_the_journal(tmp_path, records):
    """A limit on the size of files stops the second record in its middle; resuming writes it anew."""
    path = tmp_path / "journal"
    size = len(write(path, records[:0]))
    script = (
        "import resource, sys, numpy as np\n"
        "from jaxcap.io.archives.journal import resume_journal\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({size + 90}, resource.RLIM_INFINITY))\n"
        f"with resume_journal({str(path)!r}, {HEADER!r}, 7) as journal:\n"
        "    journal.append(np.arange(7.0))\n"
        "    journal.append(np.arange(7.0))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    last = done.stderr.strip().splitlines()[-1]
    assert f"{path}: record 1 cannot be written (File too large); free some disk space" in last
    assert path.stat().st_size == size + 90
    with resume_journal(path, HEADER, 7) as journal:
        assert same(journal.read(), np.arange(7.0)[None])
        journal.append(records[0])
    assert same(read_records(path), np.stack([np.arange(7.0), records[0]]))


def test_what_is_no_journal(tmp_path, records):
    path = tmp_path / "journal"
    data = write(path, records)
    for content in (b"", b"JAXCAPJ1", data[:30], b"x" + data[1:], b"JAXCAPJ1\4\0\0\0null"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="not the journal"):
            resume_journal(path, HEADER, 7)
        assert path.read_bytes() == content


def test_another_header_is_told_by_name(tmp_path, records):
    path = tmp_path / "journal"
    data = write(path, records)
    for changed, words in (({"up": "z"}, "up y, not z"), ({"vertices": 30}, "vertices None, not 30")):
        with pytest.raises(InputError, match=words):
            resume_journal(path, {**HEADER, **changed}, 7)
    with pytest.raises(InputError, match="another version of jaxcap, with 7 numbers"):
        resume_journal(path, HEADER, 9)
    assert path.read_bytes() == data


def test_record_of_another_width(tmp_path, records):
    with (
        create_journal(tmp_path / "journal", HEADER, 6) as journal,
        pytest.raises(ValueError, match="has 7 numbers; expected 6"),
    ):
        journal.append(records[0])


def test_journal_that_cannot_be(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        create_journal(tmp_path / "file" / "journal", HEADER, 3)


def test_tables(tmp_path):
    rows = [
        {"frame": 0, "state": "a, b", "sigma": 0.1 + 0.2},
        {"frame": 1, "state": "c", "sigma": float("nan")},
    ]
    write_csv(tmp_path / "t.csv", rows)
    assert (tmp_path / "t.csv").read_text().splitlines() == [
        "frame,state,sigma", '0,"a, b",0.30000000000000004', "1,c,nan",
    ]  # fmt: skip
    write_json(tmp_path / "t.json", {"rows": rows})
    back = json.loads((tmp_path / "t.json").read_text())["rows"]
    assert back[0] == rows[0]
    assert back[1]["sigma"] is None
