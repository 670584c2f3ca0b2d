"""Files that would hang, crash or swell: every reader answers in time and in bounded memory."""

from __future__ import annotations

import contextlib
import gzip
import os
import signal
import struct
import subprocess
import sys
import time
import tracemalloc
import zipfile
import zlib

import h5py
import numpy as np
import pytest
import scipy.io
from matrix_files import write_matrix_hdf5
from scipy.sparse import csc_array

from lrbc_cli.errors import DataError
from lrbc_cli.io import common, reader_process
from lrbc_cli.io.frf import read_frf, write_frf
from lrbc_cli.io.hdf5 import tools as hdf5_tools
from lrbc_cli.io.matrices import matrix_market
from lrbc_cli.io.matrices.columns import parsed, read_fixed
from lrbc_cli.io.matrices.read import read_vectors
from lrbc_cli.io.uff import datasets as uff_datasets
from lrbc_cli.model.frf import FrfRecord, FrfSet

#: Seconds that no answer takes on the busiest machine; code that hangs or takes quadratic time needs hours.
NET = 120


# -- HDF5 ---------------------------------------------------------------------------------------------------------------


def foreign(path):
    """A matrix in another program's HDF5 file: its texts have a variable length."""
    write_matrix_hdf5(path, {"K": csc_array(np.diag([1.0, 2.0, 3.0]))})
    with h5py.File(path, "r+"):
        pass
    return path


def hanging(path):
    """The same with one bit flipped: an object of the heap claims 2048 bytes more, and the next one is empty."""
    content = bytearray(foreign(path).read_bytes())
    content[content.index(b"GCOL") + 25] ^= 8
    path.write_bytes(content)
    return path


def start(code, *arguments):
    """A child process, so that a test that fails does not hang."""
    return subprocess.Popen([sys.executable, "-c", code, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


READ = """
import sys
from pathlib import Path
from lrbc_cli.errors import DataError
from lrbc_cli.io import reader_process
from lrbc_cli.io.matrices.read import read_vectors
reader_process.SECONDS = float(sys.argv[1])
print("begins", flush=True)
try:
    read_vectors(Path(sys.argv[2]), "K")
except DataError as error:
    print(error)
except KeyboardInterrupt:
    print("interrupted")
print(reader_process._reader is None)
"""


def finished(child):
    try:
        return child.communicate(timeout=NET)[0]
    finally:
        child.kill()
        child.wait()


def test_a_file_that_hangs_the_library_has_a_deadline(tmp_path):
    found = finished(start(READ, 3, hanging(tmp_path / "k.h5")))
    assert "k.h5: the library of this format does not finish reading this file" in found
    assert "export it again" in found
    assert found.endswith("True\n")


@pytest.mark.skipif(sys.platform == "win32", reason="sends a signal")
def test_ctrl_c_comes_through(tmp_path):
    child = start(READ, 2 * NET, hanging(tmp_path / "k.h5"))
    assert child.stdout.readline() == "begins\n"
    # Long enough to be inside the library; sooner, the answer is the same.
    time.sleep(2.0)
    child.send_signal(signal.SIGINT)
    assert finished(child) == "interrupted\nTrue\n"


class Abort:
    def __reduce__(self):
        return os.abort, ()


def test_a_crash_is_one_error_and_the_next_file_is_read(tmp_path):
    path = foreign(tmp_path / "k.h5")
    with pytest.raises(DataError, match=r"k\.h5: the library of this format crashes on this file"):
        reader_process.read_apart(print, path, Abort())
    assert read_vectors(path, "K").matrix.diagonal().tolist() == [1.0, 2.0, 3.0]


def test_one_process_reads_all_files_wherever_the_caller_is(tmp_path, monkeypatch):
    foreign(tmp_path / "k.h5")
    read_vectors(tmp_path / "k.h5", "K")
    process = reader_process._reader.process.pid
    monkeypatch.chdir(tmp_path)
    assert read_vectors("k.h5", "K").matrix.shape == (3, 3)
    with pytest.raises(DataError, match="no such matrix"):
        read_vectors("k.h5", "Z")
    assert reader_process._reader.process.pid == process


def test_without_a_second_process_files_are_still_read(tmp_path, monkeypatch, caplog):
    # A command that was run before may have made the log quiet.
    caplog.set_level("WARNING", logger="lrbc_cli")
    monkeypatch.setattr(reader_process, "_reader", None)
    monkeypatch.setattr(reader_process, "_told", [])
    monkeypatch.setattr(sys, "executable", str(tmp_path / "nothing"))
    for _ in range(2):
        assert read_vectors(foreign(tmp_path / "k.h5"), "K").matrix.shape == (3, 3)
    assert [record.message.partition(":")[0] for record in caplog.records] == ["HDF5 and mesh files are read without a time limit"]


def test_own_files_are_checked_before_they_are_opened(tmp_path, monkeypatch):
    path = tmp_path / "own.h5"
    write_frf(
        path,
        FrfSet(
            source="x",
            records=(FrfRecord(name="mic", frequency_hz=np.array([1.0, 2.0]), values=np.array([1 + 1j, 2j]), quantity="pressure"),),
        ),
    )

    def read():
        return len(read_frf(path).records)

    expected = 1
    monkeypatch.setattr(reader_process, "_running", lambda: pytest.fail("another process for a file of our own"))
    assert read() == expected
    content = path.read_bytes()
    for at in range(100, len(content) - 80, 331):
        path.write_bytes(content[:at] + bytes([content[at] ^ 16]) + content[at + 1 :])
        with pytest.raises(DataError, match="damaged after it was written"):
            read()
    monkeypatch.undo()
    # Changed by its owner, it is a file like any other.
    path.write_bytes(content)
    with h5py.File(path, "r+") as file:
        file.attrs["remark"] = "mine"
    assert read() == expected


@pytest.mark.slow
def test_flipped_bits_give_an_error_or_a_matrix(tmp_path, monkeypatch):
    """Bits near the heap of texts, where the library hangs."""
    monkeypatch.setattr(reader_process, "SECONDS", 3.0)
    content = foreign(tmp_path / "k.h5").read_bytes()
    heap = content.index(b"GCOL")
    for at, bit in ((8, 0), (25, 3), (24, 7), (41, 2)):
        path = tmp_path / f"{at}.h5"
        path.write_bytes(content[: heap + at] + bytes([content[heap + at] ^ (1 << bit)]) + content[heap + at + 1 :])
        with contextlib.suppress(DataError):
            assert read_vectors(path, "K").matrix.diagonal().tolist() == [1.0, 2.0, 3.0]


# -- what unpacks to more than there is room for ------------------------------------------------------------------------


@pytest.fixture
def little_room(monkeypatch):
    """The rule of 256 MB, tried with 1 MB."""
    for module in (common, matrix_market):
        monkeypatch.setattr(module, "ROOM", 1 << 20)


BOMB = 64 << 20


def mtx(path):
    entries = BOMB // 6
    path.write_bytes(gzip.compress(b"%%%%MatrixMarket matrix coordinate real general\n9 9 %d\n" % entries + b"1 1 0\n" * entries))


def mtx_of_blanks(path):
    path.write_bytes(gzip.compress(b"%%MatrixMarket matrix coordinate real general\n9 9 1\n1 1 0\n" + b" " * BOMB))


def mat(path):
    scipy.io.savemat(path, {"K": np.zeros((1024, BOMB // 8192))}, do_compression=True, appendmat=False)


def mat_that_lies(path):
    """The tag of the packed element states 64 bytes."""
    mat(path)
    content = path.read_bytes()
    element = zlib.decompress(content[136:])
    packed = zlib.compress(element[:4] + struct.pack("<I", 64) + element[8:])
    path.write_bytes(content[:128] + struct.pack("<II", 15, len(packed)) + packed)


def mat_of_many(path):
    """No variable needs more than there is room for, all of them do."""
    scipy.io.savemat(path, {f"K{index}": np.zeros((1, 1 << 16)) for index in range(128)}, do_compression=True, appendmat=False)


def npz(path):
    with path.open("wb") as stream:
        np.savez_compressed(stream, K=np.zeros((1024, BOMB // 8192)))


def npz_header(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("K.npy", b"\x93NUMPY\x02\x00" + struct.pack("<I", BOMB) + b" " * BOMB)


@pytest.mark.parametrize("bomb", [mtx, mtx_of_blanks, mat, mat_that_lies, mat_of_many, npz, npz_header])
def test_a_bomb_is_refused_before_it_unpacks(tmp_path, little_room, bomb):
    path = tmp_path / "bomb"
    bomb(path)
    assert path.stat().st_size < BOMB // 500
    tracemalloc.start()
    try:
        with pytest.raises(DataError):
            read_frf(path) if bomb is mat_of_many else read_vectors(path, "K" if "mtx" not in bomb.__name__ else None)
        assert tracemalloc.get_traced_memory()[1] < BOMB // 4
    finally:
        tracemalloc.stop()


def test_a_bomb_in_hdf5_is_refused(tmp_path, little_room):
    with h5py.File(tmp_path / "k.h5", "w") as file:
        node = file.create_dataset("K", data=np.zeros((1024, BOMB // 8192)), compression="gzip")
        with pytest.raises(DataError, match="unpack to far more"):
            hdf5_tools.load(node, tmp_path / "k.h5")


@pytest.mark.parametrize("kind", ["mat", "npz", "mtx"])
def test_what_packs_well_is_read_where_there_is_room(tmp_path, kind):
    """All zeros but the diagonal."""
    path = tmp_path / kind
    matrix = np.diag(np.arange(1.0, 1201.0))
    if kind == "mat":
        scipy.io.savemat(path, {"K": matrix}, do_compression=True, appendmat=False)
    elif kind == "npz":
        with path.open("wb") as stream:
            np.savez_compressed(stream, K=matrix)
    else:
        text = b"\n".join(b"%d" % value for value in matrix.ravel().astype(int))
        path.write_bytes(gzip.compress(b"%%MatrixMarket matrix array real general\n1200 1200\n" + text))
    assert 8 * matrix.size > common.MAX_EXPANSION * path.stat().st_size
    np.testing.assert_array_equal(read_vectors(path).matrix.diagonal(), np.diagonal(matrix))


# -- text that sent patterns into quadratic time ------------------------------------------------------------------------

ROWS = "1,1,2\n2,1,2\n3,1,2\n"


def uff(line):
    """A universal file with this record 6."""
    head = ["    -1", "    58", *["NONE"] * 5, line, "         5         3         1  1.000000e+00  1.000000e+00  0.0"]
    axes = [
        "        18    0    0    0  NONE  Hz",
        "        15    0    0    0  NONE  Pa",
        "        13    0    0    0  NONE  N",
        "         0",
    ]
    return "\n".join([*head, *axes, " 1.0 2.0 3.0 4.0 5.0 6.0", "    -1", ""])


SIX = "    4         1    0         0       NONE       104   0      NONE         1   3"

HOSTILE = {
    "cell.csv": "f,a_real,a_imag\n" + f"1,1,2\n2,{'1' * 400_000}x,2\n" + ROWS,
    "tail.csv": "f,a_real,a_imag\n" + ROWS + f"4,{'1' * 400_000}x,2\n",
    "long.csv": "f,a_real,a_imag\n" + ROWS + f"4,0.{'1' * 400_000},2\n",
    "blanks.csv": f"f,a{' ' * 400_000}b,c\n{ROWS}",
    "brackets.csv": f"f,a{'[' * 400_000},c\n{ROWS}",
    "separators.csv": f"f,a{'_' * 400_000}b,c\n{ROWS}",
    "round.csv": f"f,a{'( ' * 200_000},c\n{ROWS}",
    "six.uff": uff("   4 1 0 0" + " " * 100_000 + "x"),
    "names.uff": uff("   4 1 0 0 " + "a 1 2 " * 20_000 + "x"),
    "digits.uff": uff("   4 1 0 0 NONE " + "1" * 100_000 + " 1 NONE 1 1"),
    "axis.uff": uff(SIX).replace("        18", "1 2 " + "9" * 100_000),
    "valid.uff": uff(SIX),
    "value.uff": uff(SIX).replace("3.0 4.0", "3.0 " + "1" * 400_000),
}

READ_ALL = """
import sys
from pathlib import Path
from lrbc_cli.errors import DataError
from lrbc_cli.io.frf import read_frf
from lrbc_cli.io.matrices.read import read_vectors
for name in sys.argv[1:]:
    try:
        (read_vectors if name.endswith(".txt") else read_frf)(Path(name))
        print(Path(name).name, "read")
    except DataError:
        print(Path(name).name, "refused")
"""


def test_long_runs_take_linear_time(tmp_path):
    """All in one child process: with patterns that go back it would not end this year."""
    files = HOSTILE | {"abaqus.txt": "1" + " " * 2000 + "1" + " " * 2000 + "x", "commas.txt": "1 ,1 ,1 ,1 ," + " " * 4000 + "x"}
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    found = finished(start(READ_ALL, *(tmp_path / name for name in files))).split()
    found = dict(zip(found[::2], found[1::2], strict=True))
    assert set(found) == set(files)
    readable = {"axis.uff", "valid.uff"}
    assert {name for name, answer in found.items() if answer == "read"} == readable


def test_lines_of_many_digits():
    child = start("import sys; from lrbc_cli.campaign.simulate import parse_lines; parse_lines('1' * 100_000 + 'x', (1.0, 2.0))")
    assert "these are not frequency lines" in finished(child)


@pytest.mark.parametrize(
    ("line", "numbers", "names"),
    [
        ("4 1 0 0 NONE 12 3 NONE 1 -3", [4, 12, 3, 1, -3], ["NONE", "NONE"]),
        ("4 1 0 0 my mic 12 0", [4, 12, 0, 0, 0], ["my mic", ""]),
        ("4 1 0 0 12 5 3 7 2 1", [4, 5, 3, 2, 1], ["12", "7"]),
        ("4 1 0 0 12 3 2 1", [4, 12, 3, 2, 1], ["", ""]),
        ("4 1 0 0 12 3", [4, 12, 3, 0, 0], ["", ""]),
        ("4 1 0 0 a 1 2 b 3 4", [4, 1, 2, 3, 4], ["a", "b"]),
    ],
)
def test_record_6_by_words(line, numbers, names):
    assert uff_datasets._free_identification(line.split()) == (numbers, names)


@pytest.mark.parametrize("line", ["4", "4 1 0 0", "4 1 0 0 NONE", "x 1 0 0 a 1 2", "4 1 0 0 a 1 22", f"4 1 0 0 a {'1' * 30} 2"])
def test_record_6_that_is_none(line):
    assert uff_datasets._free_identification(line.split()) is None


@pytest.mark.parametrize("word", ["ab\u017f", "\u0131mag", "magn\u0130tude"])
def test_letters_that_only_look_alike(tmp_path, word):
    """Case-insensitive patterns take the long s for an s."""
    (tmp_path / "a.csv").write_text(f"f,{word}(x),{word}(x)\n{ROWS}", encoding="utf-8")
    assert [record.name for record in read_frf(tmp_path / "a.csv").records] == [f"{word}(x)"]


def test_blanks_are_no_number():
    """Of text of blanks alone numpy makes -1: a matrix with one entry would have had it."""
    assert parsed(b"  \n ").size == 0
    assert parsed(b" 2 \n").tolist() == [2.0]
    found = read_fixed(b" " * 20, 20)
    assert found is None or found.size == 0
