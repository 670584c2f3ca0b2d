"""FRFs in MATLAB structures and in HDF5 files of any origin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io

from lrbc_cli.errors import DataError
from lrbc_cli.io.frf import TextLayout, read_coherence, read_frf
from lrbc_cli.io.hdf5 import frf

BLOCK = Path(__file__).parents[1] / "data" / "block"
HZ = np.array([10.0, 10.5, 11.0, 11.5, 12.0])
H = np.array([1 - 2j, 3 + 4j, 5e-6 - 6e-6j, 1j, -2 + 0.5j])
COHERENCE = np.linspace(0.5, 1.0, HZ.size)
TWO = np.stack([H, 2 * H], axis=1)
GRAVITY = 9.80665


def mat(tmp_path: Path, packed: bool = True, **variables: Any) -> Path:
    path = tmp_path / "frf.mat"
    scipy.io.savemat(path, variables, do_compression=packed)
    return path


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize(("axis", "values", "quality"), [("f", "H", "coh"), ("freq", "FRF", "coherence"), ("frequency", "H1", "gamma2")])
def test_a_structure(tmp_path: Path, packed: bool, axis: str, values: str, quality: str) -> None:
    fields = {
        axis: HZ[:, None],
        values: TWO,
        quality: np.stack([COHERENCE, COHERENCE**2], axis=1),
        "names": np.array(["mic01", "acc1"], dtype=object),
        "units": np.array(["Pa/N", "g/N"], dtype=object),
    }
    result = read_frf(mat(tmp_path, packed, meas=fields, title="plate", n=3.0))
    mic, acc = result.records
    assert [(r.name, r.quantity, r.number) for r in result.records] == [("mic01", "pressure", 1), ("acc1", "acceleration", 2)]
    np.testing.assert_array_equal(mic.values, H)
    np.testing.assert_allclose(acc.values, 2 * GRAVITY * H, rtol=1e-15)
    np.testing.assert_allclose(acc.coherence, COHERENCE**2)
    np.testing.assert_array_equal(acc.frequency_hz, HZ)


def test_names_as_characters_and_columns_as_rows(tmp_path: Path) -> None:
    path = mat(tmp_path, data={"freq": HZ, "H": TWO.T, "labels": np.array(["mic01", "ac1  "]), "unit": "m/s^2/N"})
    result = read_frf(path)
    assert [(r.name, r.quantity) for r in result.records] == [("mic01", "acceleration"), ("ac1", "acceleration")]
    np.testing.assert_array_equal(result.records[1].values, 2 * H)


def test_outputs_by_inputs(tmp_path: Path) -> None:
    cube = np.arange(1, 7).reshape(3, 2)[:, :, None] * H  # outputs, inputs, lines
    for array in (cube, np.moveaxis(cube, 2, 0)):
        records = read_frf(mat(tmp_path, f=HZ, H=array)).records
        assert [r.name for r in records] == [f"H_{k}" for k in range(1, 7)]
        np.testing.assert_array_equal(records[3].values, 4 * H)


def test_parts_and_several_structures(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="do not increase"):
        read_frf(mat(tmp_path, f=HZ[::-1], H=H))
    path = mat(tmp_path, f=HZ, mic01_real=H.real, mic01_imag=H.imag, mic01_coherence=COHERENCE, acc={"f": 2 * HZ, "H": 3 * H})
    found = {record.name: record for record in read_frf(path).records}
    assert set(found) == {"mic01", "acc"}
    np.testing.assert_array_equal(found["mic01"].values, H)
    np.testing.assert_array_equal(found["acc"].frequency_hz, 2 * HZ)
    assert found["acc"].coherence is None


def test_named_coherence(tmp_path: Path) -> None:
    path = mat(tmp_path, f=HZ, H=H, quality=COHERENCE, temperature=HZ)
    result = read_frf(path)
    assert result.records[0].coherence is None
    assert "left out: quality, temperature (no FRF)" in result.notes
    result = read_frf(path, TextLayout(coherence="quality"))
    np.testing.assert_allclose(result.records[0].coherence, COHERENCE)
    # A file of coherences alone.
    both = {"f": HZ, "coh": np.stack([COHERENCE, COHERENCE], 1), "names": np.array(["a", "b"], object)}
    path = mat(tmp_path, f=HZ, mic01_coherence=COHERENCE, q=both)
    assert set(read_coherence(path)) == {"mic01", "a", "b"}
    with pytest.raises(DataError, match="0 to 1"):
        read_frf(mat(tmp_path, f=HZ, H=H, coh=2 * COHERENCE))


def test_an_array_of_structures(tmp_path: Path) -> None:
    structures = np.zeros((1, 2), dtype=[("f", "O"), ("H", "O"), ("name", "O"), ("coh", "O")])
    for at, (name, factor) in enumerate((("mic01", 1), ("mic02", 2))):
        structures[0, at] = (HZ, factor * H, name, COHERENCE**factor)
    records = read_frf(mat(tmp_path, FRF=structures)).records
    assert [r.name for r in records] == ["mic01", "mic02"]
    np.testing.assert_array_equal(records[1].values, 2 * H)
    np.testing.assert_allclose(records[1].coherence, COHERENCE**2)


def test_simcenter_testlab_structure(tmp_path: Path) -> None:
    """Axis by start, increment and number; several functions in one structure carry a cell of names."""
    axis = {"start_value": HZ[0], "increment": 0.5, "number_of_values": float(HZ.size), "quantity": {"label": "Hz"}}
    one = {"x_values": axis, "y_values": {"values": H, "quantity": {"label": "g/N"}}, "function_record": {"name": "FRF acc1"}}
    names = np.array(["mic01", "mic02"], dtype=object)
    two = {"x_values": axis, "y_values": {"values": TWO, "quantity": {"label": "Pa/N"}}, "function_record": {"name": names}}
    records = read_frf(mat(tmp_path, FRF=one, FRF_1=two)).records
    assert [(r.name, r.quantity) for r in records] == [("FRF acc1", "acceleration"), ("mic01", "pressure"), ("mic02", "pressure")]
    np.testing.assert_allclose(records[0].values, GRAVITY * H, rtol=1e-15)
    np.testing.assert_array_equal(records[2].values, 2 * H)
    np.testing.assert_allclose(records[2].frequency_hz, HZ, rtol=1e-15)


def matlab73(path: Path) -> None:
    """As MATLAB writes v7.3: transposed arrays, complex numbers as compounds, texts as numbers, cells as references."""
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("meas")
        group.attrs["MATLAB_class"] = np.bytes_("struct")

        def put(name: str, values: Any, kind: str = "double") -> h5py.Dataset:
            dataset = file.create_dataset(name, data=values)
            dataset.attrs["MATLAB_class"] = np.bytes_(kind)
            return dataset

        put("meas/f", HZ[None, :])
        compound = np.empty(TWO.T.shape, dtype=[("real", "f8"), ("imag", "f8")])
        compound["real"], compound["imag"] = TWO.T.real, TWO.T.imag
        put("meas/H", compound)
        cells = [put(f"#refs#/{name}", np.array([[ord(c)] for c in name], dtype=np.uint16), "char") for name in ("mic01", "acc1")]
        put("meas/names", np.array([[cell.ref] for cell in cells], dtype=h5py.ref_dtype), "cell")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file")


def test_matlab_73(tmp_path: Path) -> None:
    matlab73(tmp_path / "frf.mat")
    records = read_frf(tmp_path / "frf.mat").records
    assert [record.name for record in records] == ["mic01", "acc1"]
    np.testing.assert_array_equal(records[1].values, 2 * H)


@pytest.mark.parametrize("file", ["matio_v73.mat", "hdf5storage.mat", "matio_v5.mat"])
def test_arrays_of_structures_of_other_programs(file: str) -> None:
    """One structure a response, beside matrices; MATLAB 7.3 keeps each field as references."""
    result = read_frf(BLOCK / file)
    mic, acc = result.records
    assert [(r.name, r.quantity, r.number) for r in result.records] == [("mic01", "pressure", 1), ("acc1", "acceleration", 2)]
    np.testing.assert_allclose(mic.values, H, rtol=1e-15)
    np.testing.assert_allclose(acc.values, 2 * GRAVITY * H, rtol=1e-15)
    np.testing.assert_array_equal(acc.frequency_hz, HZ)
    if file == "hdf5storage.mat":
        np.testing.assert_allclose(acc.coherence, COHERENCE**2)
        assert "left out: K, M (no FRF)" in result.notes


def test_more_data_sets_than_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """None is passed over: it might be the unit."""
    monkeypatch.setattr(frf, "_MOST_OBJECTS", 3)
    with h5py.File(tmp_path / "frf.h5", "w") as file:
        file["H"], file["f"], file["names"], file["units"] = H, HZ, ["mic01"], ["g/N"]
    with pytest.raises(DataError, match="more data sets than are read"):
        frf._read(tmp_path / "frf.h5", TextLayout())


def test_references_that_lead_nowhere_or_in_a_circle(tmp_path: Path) -> None:
    path = tmp_path / "frf.mat"
    with h5py.File(path, "w") as file:
        group = file.create_group("FRF")
        group["f"] = np.array([[h5py.Reference()]], dtype=h5py.ref_dtype)
    with pytest.raises(DataError, match="cannot be read"):
        read_frf(path)
    with h5py.File(path, "w") as file:
        group = file.create_group("FRF")
        group["next"] = np.array([[group.ref], [group.ref]], dtype=h5py.ref_dtype)
        group["f"], group["H"] = HZ, H
    assert any(record.name == "FRF" for record in read_frf(path).records)


@pytest.mark.parametrize("count", [1, 3])
def test_parts_in_the_last_dimension(tmp_path: Path, count: int) -> None:
    """Real arrays (lines, responses, 2) are FRFs where the campaign says what they hold, and nothing is guessed where it does not."""
    path, values = tmp_path / "frf.h5", np.column_stack([TWO, -1j * H])[:, :count]
    names = ["mic01", "mic02", "mic03"][:count]
    arrays = {"real-imag": (values.real, values.imag), "magnitude-phase": (np.abs(values), np.angle(values, deg=True))}
    arrays["db-phase"] = (20 * np.log10(np.abs(values)), np.angle(values, deg=True))
    for representation, parts in arrays.items():
        with h5py.File(path, "w") as file:
            file["run/freq"], file["run/H"], file["run/names"] = HZ, np.stack(parts, axis=-1), names
            file["run/coh"] = np.tile(COHERENCE[:, None], (1, count))
        found = read_frf(path, TextLayout(representation=representation, phase="deg")).records
        assert [record.name for record in found] == names
        for k, record in enumerate(found):
            np.testing.assert_allclose(record.values, values[:, k], rtol=1e-12)
            np.testing.assert_allclose(record.coherence, COHERENCE)
    with pytest.raises(DataError, match="no FRF was recognised") as caught:
        read_frf(path)
    assert "if the last dimension of run.H contains real and imaginary part" in str(caught.value.hint)
    with pytest.raises(DataError, match="unit of the phase is not known"):
        read_frf(path, TextLayout(representation="magnitude-phase"))


def test_parts_in_either_of_two_dimensions(tmp_path: Path) -> None:
    """Where two dimensions are 2 nothing tells the parts from the responses."""
    for axis in (0, 1):
        path = mat(tmp_path, f=HZ, H=np.stack([TWO.real, TWO.imag], axis=axis))
        with pytest.raises(DataError, match="which dimension contains the parts"):
            read_frf(path, TextLayout(representation="real-imag"))
    found = read_frf(mat(tmp_path, f=HZ, H_real=TWO.real, H_imag=TWO.imag), TextLayout(representation="real-imag")).records
    np.testing.assert_allclose([record.values for record in found], TWO.T, rtol=1e-15)


def test_units_that_do_not_fit_the_channels(tmp_path: Path) -> None:
    path = mat(tmp_path, f=HZ, H=TWO, units=np.array(["g/N", "g/N", "Pa/N"], object))
    with pytest.raises(DataError, match="units do not fit the channels") as caught:
        read_frf(path)
    assert (caught.value.expected, caught.value.found) == ("one unit, or 2", "3: g/N, g/N, Pa/N")
    assert len(read_frf(path, TextLayout(unit="g/N")).records) == 2


def test_hdf5_of_any_origin(tmp_path: Path) -> None:
    path = tmp_path / "frf.h5"
    with h5py.File(path, "w") as file:
        file["run/freq"], file["run/frf"] = HZ, TWO
        file["run/frf"].attrs["units"] = "Pa/N"
        file["run/names"] = ["mic01", "mic02"]
        file["run/quality"] = np.stack([COHERENCE, COHERENCE], axis=1)
        file["other"] = h5py.SoftLink("/run/freq")
    result = read_frf(path, TextLayout(coherence="quality"))
    assert [(r.name, r.quantity) for r in result.records] == [("mic01", "pressure"), ("mic02", "pressure")]
    np.testing.assert_array_equal(result.records[1].values, 2 * H)
    np.testing.assert_allclose(result.records[1].coherence, COHERENCE)
    with h5py.File(path, "w") as file:
        file["a"] = np.eye(3)
    with pytest.raises(DataError, match="no FRF was recognised") as caught:
        read_frf(path)
    assert "a (3, 3) f" in str(caught.value.found)


def test_units_of_what_holds_the_arrays(tmp_path: Path) -> None:
    result = read_frf(mat(tmp_path, units="g/N", names=np.array(["a", "b"], object), m={"f": HZ, "H": TWO}))
    assert [r.name for r in result.records] == ["a", "b"]
    np.testing.assert_allclose(result.records[0].values, GRAVITY * H, rtol=1e-15)
    path = mat(tmp_path, units="g/N", m={"f": HZ, "H": H, "units": "m/s^2/N"})
    with pytest.raises(DataError, match="two units are stated") as caught:
        read_frf(path)
    assert caught.value.found == "m/s^2/N (m.units) and g/N (units)"
    np.testing.assert_allclose(read_frf(path, TextLayout(unit="mm/s^2/N")).records[0].values, 1e-3 * H, rtol=1e-15)


def test_attributes_of_groups_and_axes(tmp_path: Path) -> None:
    path = tmp_path / "frf.h5"
    for unit, scale in (("rad/s", 2 * np.pi), ("kHz", 1e-3), ("Hz", 1.0)):
        with h5py.File(path, "w") as file:
            file["acc1/f"], file["acc1/value"] = scale * HZ, H
            file["acc1/f"].attrs["units"], file["acc1"].attrs["unit"] = unit, "g/N"
            file["acc1/value"].attrs["names"] = ["acc1"]
        (found,) = read_frf(path).records
        assert (found.name, found.quantity) == ("acc1", "acceleration")
        np.testing.assert_allclose(found.frequency_hz, HZ, rtol=1e-12)
        np.testing.assert_allclose(found.values, GRAVITY * H, rtol=1e-15)
    for unit in ("rpm", "1/min", "mHz"):
        with h5py.File(path, "a") as file:
            file["acc1/f"].attrs["units"] = unit
        with pytest.raises(DataError, match="unit of the frequencies is not understood"):
            read_frf(path)
        assert len(read_frf(path, TextLayout(frequency_unit="kHz")).records) == 1
    with h5py.File(path, "a") as file:
        file["acc1/f"].attrs["units"] = "Hz"
        file["acc1/value"].attrs["unit"] = "mm/s^2/N"
    with pytest.raises(DataError, match="two units are stated"):
        read_frf(path)


def test_a_named_coherence_that_is_not_there(tmp_path: Path) -> None:
    path = mat(tmp_path, f=HZ, H=H, my_gamma2=COHERENCE)
    for read in (read_frf, read_coherence):
        with pytest.raises(DataError, match="the variable of the coherence was not found") as caught:
            read(path, TextLayout(coherence="my_gama2"))
        assert "my_gamma2" in str(caught.value.found)


def test_an_axis_that_is_not_recognised(tmp_path: Path) -> None:
    path = mat(tmp_path, w=2 * np.pi * HZ, H=TWO)
    with pytest.raises(DataError, match="no frequency variable was recognised") as caught:
        read_frf(path)
    assert "w (1, 5)" in str(caught.value.found)
    assert "format: {frequency: w, frequency_unit: rad/s}" in str(caught.value.hint)
    np.testing.assert_allclose(read_frf(path, TextLayout(frequency="w")).records[0].frequency_hz, HZ, rtol=1e-12)
