"""FRFs and coherences in ``.npz`` archives of NumPy."""

from __future__ import annotations

import contextlib
import io
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse
from damage import damaged, require_sound
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lrbc_cli.errors import DataError
from lrbc_cli.io import common
from lrbc_cli.io.frf import FORMATS, TextLayout, detect_frf_format, read_coherence, read_frf
from lrbc_cli.io.matrices.read import read_matrix, read_vectors

REUSE_FOLDER = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
HZ = np.array([10.0, 10.5, 11.0, 11.5, 12.0])
H = np.array([1 - 2j, 3 + 4j, 5e-6 - 6e-6j, 1j, -2 + 0.5j])
TWO = np.stack([H, 2 * H], axis=1)
COHERENCE = np.linspace(0.5, 1.0, HZ.size)
GRAVITY = 9.80665


def npz(tmp_path: Path, **arrays: Any) -> Path:
    path = tmp_path / "frf.npz"
    np.savez(path, **arrays)
    return path


def npy(array: Any, pickled: bool = False) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array), allow_pickle=pickled)
    return stream.getvalue()


def header(shape: str, kind: str = "<c16") -> bytes:
    """Header of an array without its values."""
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def zipped(path: Path, members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


# -- what acquisition scripts write --------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(data=st.data())
def test_round_trip(tmp_path: Path, data: st.DataObject) -> None:
    parts, size, count = st.floats(-1e300, 1e300), data.draw(st.integers(2, 6)), data.draw(st.integers(1, 4))
    frequency = np.cumsum(data.draw(st.lists(st.floats(1e-3, 1e3), min_size=size, max_size=size)))
    values = np.array([[complex(data.draw(parts), data.draw(parts)) for _ in range(count)] for _ in range(size)])
    quality = np.array([[data.draw(st.floats(0, 1)) for _ in range(count)] for _ in range(size)])
    names = [
        f"{data.draw(st.text(st.characters(exclude_characters=chr(0), exclude_categories=['Cs', 'Z', 'C']), max_size=8))}{k}"
        for k in range(count)
    ]
    axis, response, coherence = (
        data.draw(st.sampled_from(keys)) for keys in (["frequency", "f", "freq", "frequency_hz"], ["H", "frf"], ["coherence", "coh"])
    )
    given = {axis: frequency, response: values, coherence: quality, "names": names, "unit": "Pa/N", "averages": 5, "date": "today"}
    path = tmp_path / "frf.npz"
    data.draw(st.sampled_from([np.savez, np.savez_compressed]))(
        path, **{key: given[key] for key in data.draw(st.permutations(list(given)))}
    )
    assert detect_frf_format(path) == "npz"
    records = read_frf(path).records
    assert [(r.name, r.quantity, r.number) for r in records] == [(name, "pressure", k + 1) for k, name in enumerate(names)]
    for k, record in enumerate(records):
        np.testing.assert_array_equal(record.frequency_hz, frequency)
        np.testing.assert_array_equal(record.values, values[:, k])
        np.testing.assert_array_equal(record.coherence, quality[:, k])
    found = read_coherence(path)
    assert list(found) == names
    for k, name in enumerate(names):
        np.testing.assert_array_equal(found[name], (frequency, quality[:, k]))


@pytest.mark.parametrize("kind", ["<c8", ">c16"])
def test_outputs_by_inputs(tmp_path: Path, kind: str) -> None:
    cube = np.moveaxis(np.arange(1, 7).reshape(3, 2)[:, :, None] * H, 2, 0).astype(kind)  # lines, outputs, inputs
    quality = np.moveaxis(np.arange(1, 7).reshape(3, 2)[:, :, None] / 6 * COHERENCE, 2, 0)
    records = read_frf(npz(tmp_path, frequency_hz=HZ, H=cube, coherence=quality)).records
    assert [r.name for r in records] == [f"H_{k}" for k in range(1, 7)]
    np.testing.assert_allclose(records[3].values, 4 * H, rtol=1e-6)
    np.testing.assert_allclose(records[3].coherence, 4 / 6 * COHERENCE)


def test_parts_structures_and_bytes(tmp_path: Path) -> None:
    arrays = {
        "run/f": HZ,
        "run/mic01_real": H.real,
        "run/mic01_imag": H.imag,
        "run/names": np.array([b"mic"]),
        "run/units": np.array(b"g/N"),
    }
    (record,) = read_frf(npz(tmp_path, **arrays)).records
    assert (record.name, record.quantity) == ("mic", "acceleration")
    np.testing.assert_allclose(record.values, GRAVITY * H, rtol=1e-15)


def test_names_that_the_campaign_states(tmp_path: Path) -> None:
    path = npz(tmp_path, axis=2e-3 * np.pi * HZ, H=TWO, quality=np.stack([COHERENCE, COHERENCE**2], 1))
    with pytest.raises(DataError, match="no frequency variable was recognised"):
        read_frf(path)
    layout = TextLayout(frequency="axis", frequency_unit="rad/s", coherence="quality", unit="g/N")
    records = read_frf(path, layout).records
    np.testing.assert_allclose(records[1].frequency_hz, 1e-3 * HZ, rtol=1e-15)
    np.testing.assert_allclose(records[1].values, 2 * GRAVITY * H, rtol=1e-15)
    np.testing.assert_allclose(records[1].coherence, COHERENCE**2)
    assert list(read_coherence(path, layout)) == ["H_1", "H_2"]


def test_coherences_alone(tmp_path: Path) -> None:
    path = npz(tmp_path, f=HZ, coh=np.stack([COHERENCE, COHERENCE**2], 1), names=["mic01", "acc1"])
    found = read_coherence(path)
    assert list(found) == ["mic01", "acc1"]
    np.testing.assert_array_equal(found["acc1"][1], COHERENCE**2)
    with pytest.raises(DataError, match="no FRF was recognised"):
        read_frf(path)


# -- what has no FRF or no coherence -------------------------------------------------------------------------------------


def test_every_format_without_coherence_says_so(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="the file contains FRFs, but no coherence") as caught:
        read_coherence(npz(tmp_path, f=HZ, H=TWO))
    assert "format: {coherence: ...}" in caught.value.hint
    with pytest.raises(DataError, match="cannot be distinguished"):
        read_coherence(npz(tmp_path, f=HZ, H=TWO, coh=np.stack([COHERENCE, COHERENCE], 1), names=["mic", "mic"]))


@pytest.mark.parametrize(
    "arrays",
    [
        {},
        {"K": np.eye(3)},
        {"n": 3.0, "K": TWO},
        {"f": HZ, "coh": 0.5},
        {"f": HZ, "coh": np.ones((4, 2))},
        {"f": HZ, "H": H[:4]},
        {"f": HZ, "H": H[:, None][:, :0]},
        {"a.x_values.increment": np.empty(0), "a.y_values.values": H},
        {"f": HZ, "date": np.array(["2024-01-01"], "M8[D]"), "record": np.zeros(3, [("f", "f8"), ("H", "c16")])},
    ],
)
def test_no_frfs_are_one_error(tmp_path: Path, arrays: dict[str, Any]) -> None:
    path = npz(tmp_path, **arrays)
    for read in (read_frf, read_coherence):
        with pytest.raises(DataError) as caught:
            read(path)
        assert str(path) in caught.value.message


def test_a_coherence_of_another_size_is_left_out(tmp_path: Path) -> None:
    """As many values as the FRFs in one long row, which no line of the frequencies fits."""
    result = read_frf(npz(tmp_path, f=HZ, H=TWO, coh=np.ones(2 * HZ.size)))
    assert [record.coherence for record in result.records] == [None, None]
    assert "left out: coh (no FRF)" in result.notes


def test_matrices_are_no_frfs(tmp_path: Path) -> None:
    path = tmp_path / "K.npz"
    scipy.sparse.save_npz(path, scipy.sparse.csr_array(np.eye(3) * 1j))
    with pytest.raises(DataError, match="no FRF was recognised"):
        read_frf(path)
    assert read_matrix(path).matrix.shape == (3, 3)


# -- what is damaged, or swells ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("array", [np.array(["mic01", "acc1"], object), np.array({"rate": 51200}), np.zeros(2, [("name", "O")])])
def test_objects_are_never_loaded(tmp_path: Path, array: Any) -> None:
    for read in (read_frf, read_coherence):
        with pytest.raises(DataError, match="Python objects, which are never loaded") as caught:
            read(npz(tmp_path, f=HZ, H=TWO, names=array))
        assert caught.value.place == "names"
        assert "numpy.array(names, dtype=str)" in caught.value.hint


def test_pickles_are_not_run(tmp_path: Path) -> None:
    class Touch:
        def __reduce__(self) -> Any:
            return Path.touch, (tmp_path / "run",)

    for descr in ("|O", "|V8", "<f8"):
        content = npy(np.array(Touch(), object), pickled=True).replace(b"'|O'", f"'{descr}'".encode())
        path = zipped(tmp_path / "frf.npz", {"f.npy": npy(HZ), "H.npy": npy(H), "names.npy": content})
        with contextlib.suppress(DataError):
            read_frf(path)
    assert not (tmp_path / "run").exists()


BOMB = 64 << 20


def swollen(path: Path) -> None:
    np.savez_compressed(path, f=HZ, H=np.zeros((HZ.size, BOMB // 80), complex))


def of_many(path: Path) -> None:
    """No array needs more than there is room for, all of them do."""
    np.savez_compressed(path, f=HZ, **{f"H{k}": np.zeros((HZ.size, 1 << 12), complex) for k in range(128)})


def of_one_again_and_again(path: Path) -> None:
    """All entries of the directory lead to the same bytes."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("H0.npy", npy(np.zeros(1 << 18)))
        for k in range(1, 256):
            archive.filelist.append(zipfile.ZipInfo(f"H{k}.npy"))
            for key in ("header_offset", "file_size", "compress_size", "CRC"):
                setattr(archive.filelist[-1], key, getattr(archive.filelist[0], key))
            archive.filelist[-1].orig_filename = "H0.npy"


def of_long_header(path: Path) -> None:
    zipped(path, {"H.npy": b"\x93NUMPY\x02\x00" + struct.pack("<I", BOMB) + b" " * BOMB})


def of_stated_size(path: Path) -> None:
    zipped(path, {"f.npy": npy(HZ), "H.npy": header(f"({BOMB}, 2)") + bytes(1000)}, zipfile.ZIP_STORED)


def of_negative_size(path: Path) -> None:
    zipped(path, {"a.npy": header(f"(-{BOMB}, 8)"), "f.npy": npy(HZ), "H.npy": npy(np.zeros((5, BOMB // 80), complex))})


def by_bzip2(path: Path) -> None:
    """Of which zipfile unpacks 4 kB at once, up to gigabytes."""
    zipped(path, {"H.npy": header("(1000,)") + bytes(16000)}, zipfile.ZIP_BZIP2)


def by_lzma(path: Path) -> None:
    zipped(path, {"H.npy": header("(1000,)") + bytes(16000)}, zipfile.ZIP_LZMA)


BOMBS = [swollen, of_many, of_one_again_and_again, of_long_header, of_stated_size, of_negative_size, by_bzip2, by_lzma]


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_bomb_is_refused_before_it_unpacks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bomb: Any) -> None:
    monkeypatch.setattr(common, "ROOM", 1 << 20)
    path = tmp_path / "frf.npz"
    bomb(path)
    assert detect_frf_format(path) == "npz"
    for read in (read_frf, read_coherence):
        tracemalloc.start()
        try:
            with pytest.raises(DataError):
                read(path)
            assert tracemalloc.get_traced_memory()[1] < BOMB // 4
        finally:
            tracemalloc.stop()


@pytest.mark.parametrize(("count", "kind"), [(10**9, "<U0"), (2**24, "|S1")])
def test_millions_of_texts_are_left_out(tmp_path: Path, count: int, kind: str) -> None:
    """As objects of Python they would need a hundred times the memory."""
    content = header(f"({count},)", kind) + bytes(count * int(kind[-1]))
    path = zipped(tmp_path / "frf.npz", {"f.npy": npy(HZ), "H.npy": npy(H), "names.npy": content})
    tracemalloc.start()
    try:
        assert [record.name for record in read_frf(path).records] == ["H"]
        assert tracemalloc.get_traced_memory()[1] < BOMB // 2
    finally:
        tracemalloc.stop()


def test_other_compressions_are_named(tmp_path: Path) -> None:
    by_lzma(tmp_path / "K.npz")
    with pytest.raises(DataError, match="compressed by a method that is not read") as caught:
        read_vectors(tmp_path / "K.npz", "H")
    assert "numpy.savez_compressed" in caught.value.hint


def test_a_changed_value_is_found(tmp_path: Path) -> None:
    """By the checksum of the archive, also where the array is stored as it is."""
    path = npz(tmp_path, f=HZ, H=H)
    content = path.read_bytes()
    at = content.index(HZ.tobytes())
    path.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
    with pytest.raises(DataError, match=r"this \.npz archive cannot be read"):
        read_frf(path)


def test_archives_of_other_files_are_named(tmp_path: Path) -> None:
    path = zipped(tmp_path / "frf.npz", {"[Content_Types].xml": b"<xml/>"})
    with pytest.raises(DataError, match=r"this is a zip archive(.|\n)*unpack it(.|\n)*Content_Types"):
        read_frf(path)
    path.write_bytes(b"PK\x03\x04")
    with pytest.raises(DataError, match="this is an Excel workbook or a zip archive"):
        read_frf(path)


@pytest.fixture(scope="module")
def small_files() -> list[bytes]:
    files = []
    for save in (np.savez, np.savez_compressed):
        stream = io.BytesIO()
        save(stream, f=HZ, H=TWO, coh=np.ones_like(TWO, float), names=["a", "b"], unit="g/N")
        files.append(stream.getvalue())
    return files


@settings(max_examples=200, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(data=st.data())
def test_damage_gives_a_data_error_or_frfs(tmp_path: Path, small_files: list[bytes], data: st.DataObject) -> None:
    path = tmp_path / "damaged"
    path.write_bytes(damaged(data, data.draw(st.sampled_from(small_files))))
    with contextlib.suppress(DataError):
        read_coherence(path)
    with contextlib.suppress(DataError):
        require_sound(read_frf(path).records)


@settings(max_examples=100, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(data=st.data())
def test_any_members_give_a_data_error_or_frfs(tmp_path: Path, data: st.DataObject) -> None:
    """Sound archives whose headers and values are anything."""
    names = st.sampled_from(["f", "H", "coh", "names", "units", "a.f", "a/H", "H_real", "H_imag", "format", "shape", ""])
    shapes = st.sampled_from(["()", "(5,)", "(5, 2)", "(2, 5)", "(1, 5, 1)", "(0,)", "(0, 5)", "(5, 0)", "(-5,)", "(10,)", "5"])
    kinds = st.sampled_from(["<f8", "<c16", ">c8", "<i4", "|b1", "<U3", "|S4", "|O", "<M8[s]", "<U0", "|V0", "<f2", "x"])
    members = {
        f"{name}.npy": header(data.draw(shapes), data.draw(kinds))
        + data.draw(st.binary(max_size=200)).ljust(data.draw(st.integers(0, 200)))
        for name in data.draw(st.lists(names, min_size=1, max_size=6, unique=True))
    }
    if data.draw(st.booleans()):
        members["f.npy"] = npy(HZ)
    path = zipped(tmp_path / "frf.npz", dict(sorted(members.items())))
    for read in (read_frf, read_coherence, read_vectors):
        with contextlib.suppress(DataError), np.errstate(all="ignore"):
            read(path)


def test_the_registry_lists_every_reader() -> None:
    assert list(FORMATS) == ["hdf5", "mat-v5", "npz", "uff", "text"]
    assert all(callable(format.read) and callable(format.coherences) for format in FORMATS.values())
