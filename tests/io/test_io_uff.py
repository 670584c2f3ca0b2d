"""Universal files: those of others, those of this package, damaged ones."""

from __future__ import annotations

import contextlib
import re
import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import pyuff
from damage import BYTES, damaged, require_sound
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lrbc_cli.errors import DataError
from lrbc_cli.io.frf import TextLayout, read_coherence, read_frf, write_frf
from lrbc_cli.io.frf_common import Notes
from lrbc_cli.io.uff.axis import even_axis, restore
from lrbc_cli.io.uff.datasets import read_datasets
from lrbc_cli.io.uff.read import Coherence, _attach
from lrbc_cli.model.frf import FrfRecord, FrfSet

DATA = Path(__file__).parents[1] / "data" / "uff"
REUSE_FOLDER = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
SI, MM, FEET = (1, 1.0, 1.0), (5, 1e3, 1e3), (2, 3.28083989501312334, 0.224808943099710480)


def units(code, length, force):
    return f"    -1\n   164\n{code:10d}{'made up':<20}{2:10d}\n{length:25.17E}{force:25.17E}{1.0:25.17E}\n{0.0:25.17E}\n    -1\n".replace(
        "E+", "D+"
    )


def function(
    values=(1 + 2j, 3 + 4j, 5 + 6j),
    *,
    kind=4,
    response=("mic01", 7, 3),
    reference=("NONE", 9, -3),
    numerator=(12, 0, 0, "Acceleration", "NONE"),
    denominator=(13, 0, 0, "Force", "NONE"),
    abscissa=(18, "Hz"),
    spacing="  1.00000E+01  5.00000E-01",
    ordinate=5,
    count=None,
    body=None,
    id5="NONE",
    eol="\n",
):
    """A dataset 58 as text, one number a field of 13 columns."""
    numbers = [part for value in values for part in ((value.real, value.imag) if ordinate > 4 else (value.real,))]
    lines = ["    -1", "    58", "made up", "NONE", "NONE", "NONE", id5]
    dofs = "".join(f" {name:<10}{node:10d}{direction:4d}" for name, node, direction in (response, reference))
    lines.append(f"{kind:5d}{0:10d}{1:5d}{0:10d}{dofs}")
    lines.append(f"{ordinate:10d}{len(values) if count is None else count:>10}{1:10d}{spacing}{0.0:13.5E}")
    for code, length, force, label, unit in ((abscissa[0], 0, 0, "", abscissa[1]), numerator, denominator, (0, 0, 0, "NONE", "NONE")):
        lines.append(f"{code:10d}{length:5d}{force:5d}{0:5d} {label:<20} {unit:<20}")
    lines += [body] if body is not None else ["".join(f"{x:13.5E}" for x in numbers[i : i + 6]) for i in range(0, len(numbers), 6)]
    return eol.join([*lines, "    -1", ""])


def binary(values, *, order="<", double=True, abscissa=None, abscissa_double=True, stated=None, closing=b"    -1\r\n", form=2):
    """A dataset 58b."""
    letter = "d" if double else "f"
    payload = b""
    for index, value in enumerate(values):
        if abscissa is not None:
            payload += struct.pack(order + ("d" if abscissa_double else "f"), abscissa[index])
        payload += struct.pack(order + 2 * letter, value.real, value.imag)
    text = function(values, ordinate=6 if double else 5, body="", eol="\r\n")
    if abscissa is not None:
        text = text.replace(f"{1:10d}  1.00000E+01", f"{0:10d}  1.00000E+01")
    header = text[: text.index("\r\n\r\n    -1") + 2].split("\r\n", 2)[2]
    size = len(payload) if stated is None else stated
    identifier = f"    58b{1 if order == '<' else 2:6d}{form:6d}{11:12d}{size:12d}{0:6d}{0:6d}{0:12d}{0:12d}\r\n"
    return b"    -1\r\n" + identifier.encode() + header.encode() + payload + closing


def read(tmp_path, content, layout=None):
    path = tmp_path / "measured.uff"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_frf(path, layout)


def record(name="mic01", frequency=None, quantity="pressure", seed=0, **more):
    frequency = np.arange(20.0, 60.0) if frequency is None else np.asarray(frequency, dtype=float)
    generator = np.random.default_rng(seed)
    values = generator.standard_normal(frequency.size) + 1j * generator.standard_normal(frequency.size)
    return FrfRecord(name=name, frequency_hz=frequency, values=values, quantity=quantity, **more)


# --- files of others ---------------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_binary_and_ascii_hold_the_same(tmp_path):
    binary_file = DATA / "Sample_UFF58b_bin.uff"
    (found,), _, notes = read_datasets(binary_file)
    assert not notes
    assert found.values.size == 79_292
    assert (found.function_type, found.response_name, found.response_direction) == (1, "Mic 01", 1)
    assert found.abscissa[1] == 2.0**-16
    reference = pyuff.UFF(str(binary_file)).read_sets(0)
    np.testing.assert_array_equal(found.values, reference["data"])
    text = binary_file.read_bytes()
    header = text[text.index(b"Mic 01.0Scalar") :].split(b"\r\n")[:11]
    rows = [found.values[start : start + 6] for start in range(0, found.values.size, 6)]
    body = "\n".join("".join(f"{x:13.5E}" for x in row) for row in rows)
    path = tmp_path / "ascii.uff"
    path.write_bytes(b"    -1\n    58\n" + b"\n".join(header) + b"\n" + body.encode() + b"\n    -1\n")
    (ascii_found,), _, _ = read_datasets(path)
    np.testing.assert_allclose(ascii_found.values, found.values, rtol=5.1e-6)
    np.testing.assert_array_equal(ascii_found.abscissa, found.abscissa)


def test_binary_in_double_precision():
    (found,), _, _ = read_datasets(DATA / "binary8byte.uff")
    np.testing.assert_allclose(found.values, np.sin(2 * np.pi * 5 * found.abscissa), atol=1e-5)
    assert found.response_name == "sine 5 Hz"
    assert found.abscissa[-1] == pytest.approx(2.49, rel=1e-15)


def test_non_ascii_header():
    result = read_frf(DATA / "non_ascii_header.uff")
    (found,) = result.records
    assert found.quantity == "acceleration"
    np.testing.assert_array_equal(found.frequency_hz, np.arange(6) * 0.1953125)
    assert found.values[1] == -0.0599924 - 0.055326j
    assert result.notes == ("record 1: the increment 1.95313E-01 was read as 0.1953125",)


def test_spectra_and_geometry_are_no_frfs():
    (found,), _, _ = read_datasets(DATA / "sample_dataset58_psd.uff")
    assert found.function_type == 9
    np.testing.assert_array_equal(found.abscissa, np.arange(3201.0))
    assert found.values[1] == 1.255863e-06
    for name, message in (
        ("sample_dataset58_psd.uff", "power spectral density"),
        ("binary8byte.uff", "time response"),
        ("Sample_UFF58b_bin.uff", "time response"),
        ("testlab_161_164_18_15_82.uff", "no dataset 58"),
    ):
        with pytest.raises(DataError, match="contains no FRF") as caught:
            read_frf(DATA / name)
        assert message in str(caught.value)
    functions, _, notes = read_datasets(DATA / "testlab_161_164_18_15_82.uff")
    assert (functions, notes) == ([], [])


# --- axis --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("printed", "meant"),
    [
        ("1.95313E-01", 0.1953125),
        ("1.95312E-01", 0.1953125),
        ("9.76563E-02", 0.09765625),
        ("3.33333E-01", 1 / 3),
        ("6.72913E-01", 44100 / 65536),
        ("7.32422E-01", 48000 / 65536),
        ("1.00000E+00", 1.0),
        ("1.23450E+00", 1.2345),
        ("2.5", 2.5),
        ("0.33", 0.33),
        ("1.953130001E-01", 0.1953130001),
    ],
)
def test_increments_with_six_digits(printed, meant):
    assert restore(printed) == meant


ROUND_STEPS = st.builds(lambda p, q: Fraction(p, q), st.integers(1, 9), st.sampled_from([1, 2, 3, 4, 5, 8, 10, 16, 20, 64, 128]))


@given(step=ROUND_STEPS, first=st.integers(0, 1000))
def test_round_increments_do_not_drift(step, first):
    exact = (first + np.arange(5000)) * float(step)
    axis, _ = even_axis(5000, f"{exact[0]:.5E}", f"{float(step):.5E}")
    np.testing.assert_allclose(axis, exact, rtol=1e-12, atol=6e-6 * exact[0])


# --- units, signs, coherence -------------------------------------------------------------------------------------------------

GRAVITY = 9.80665
FOOT, POUND_FORCE = 0.3048, 4.4482216152605


@pytest.mark.parametrize(
    ("units_dataset", "numerator", "denominator", "response", "factor", "quantity"),
    [
        (SI, (12, 0, 0, "", "NONE"), (13, 0, 0, "", "NONE"), 3, 1.0, "acceleration"),
        (FEET, (12, 0, 0, "", "NONE"), (13, 0, 0, "", "NONE"), 3, FOOT / POUND_FORCE, "acceleration"),
        (FEET, (12, 0, 0, "", "ft/s^2"), (13, 0, 0, "", "lbf"), 3, FOOT / POUND_FORCE, "acceleration"),
        (FEET, (15, 0, 0, "", "NONE"), (13, 0, 0, "", "NONE"), 0, FOOT**-2, "pressure"),
        (MM, (8, 0, 0, "", "NONE"), (13, 0, 0, "", "NONE"), 2, 1.0, "displacement"),
        (MM, (11, 0, 0, "", "NONE"), (13, 0, 0, "", "NONE"), 5, 1e3, "velocity"),
        (MM, (15, 0, 0, "", "NONE"), (13, 0, 0, "", "NONE"), 0, 1e6, "pressure"),
        ((10, 1e3, 1.0), (12, 0, 0, "", "mm/s^2"), (13, 0, 0, "", "N"), 1, 1e-3, "acceleration"),
        ((10, 1e3, 1.0), (1, -2, 1, "", "MPa"), (13, 0, 0, "", "N"), 0, 1e6, "pressure"),
        (None, (12, 0, 0, "", "g"), (13, 0, 0, "", "N"), 3, GRAVITY, "acceleration"),
        (None, (0, 0, 0, "", "g/N"), (0, 0, 0, "", "NONE"), 3, GRAVITY, "acceleration"),
        (None, (1, 0, 0, "", "kPa"), (13, 0, 0, "", "kN"), 0, 1.0, "pressure"),
        (None, (15, 0, 0, "", "sone"), (13, 0, 0, "", "N"), 0, 1.0, "pressure"),
        (None, (0, 0, 0, "", "NONE"), (13, 0, 0, "", "NONE"), 0, 1.0, None),
    ],
)
def test_units(tmp_path, units_dataset, numerator, denominator, response, factor, quantity):
    content = function(numerator=numerator, denominator=denominator, response=("a", 7, response), reference=("NONE", 9, 3))
    result = read(tmp_path, (units(*units_dataset) if units_dataset else "") + content)
    (found,) = result.records
    np.testing.assert_allclose(found.values, factor * np.array([1 + 2j, 3 + 4j, 5 + 6j]), rtol=1e-12)
    assert found.quantity == quantity
    assert (abs(factor - 1) > 1e-12) == any("to give SI" in note for note in result.notes)
    if units_dataset is None and parse_fails(numerator[4]):
        assert any("SI assumed" in note for note in (*result.notes, *result.warnings))


def parse_fails(label):
    return label in ("NONE", "sone")


def test_layout_states_the_unit(tmp_path):
    content = units(*SI) + function(numerator=(12, 0, 0, "", "g"), denominator=(13, 0, 0, "", "N"))
    with pytest.raises(DataError, match="contradict each other"):
        read(tmp_path, content)
    found = read(tmp_path, content, TextLayout(unit="g/N")).records[0]
    np.testing.assert_allclose(found.values[0], -GRAVITY * (1 + 2j), rtol=1e-15)
    assert found.quantity == "acceleration"
    assert read(tmp_path, function(numerator=(0, 0, 0, "", "")), TextLayout(quantity="pressure")).records[0].quantity == "pressure"


@pytest.mark.parametrize(("response", "reference", "sign"), [(3, 3, 1), (-3, 3, -1), (3, -3, -1), (-3, -3, 1), (0, -1, -1)])
def test_directions_carry_signs(tmp_path, response, reference, sign):
    (found,) = read(tmp_path, function(response=("a", 7, response), reference=("b", 9, reference))).records
    assert found.values[0] == sign * (1 + 2j)
    assert (found.response_direction, found.reference_direction) == (abs(response), abs(reference))
    assert (found.name, found.response_node, found.reference_node) == ("a", 7, 9)


COHERENCE = {"kind": 6, "numerator": (0, 0, 0, "", ""), "denominator": (0, 0, 0, "", ""), "ordinate": 2}


def test_what_a_file_says_of_itself(tmp_path):
    content = function(response=("a", 7, 3)) + function(response=("b", 8, 3))
    assert read(tmp_path, content.replace("made up\nNONE", "Cover state-4\n5 hits")).titles == ("Cover state-4", "5 hits")


def test_coherence_belongs_to_the_same_dofs(tmp_path):
    content = (
        function(response=("a", 7, 3)) + function(response=("b", 8, 3)) + function((0.5, 0.6, 0.7), response=("b", 8, -3), **COHERENCE)
    )
    a, b = read(tmp_path, content).records
    assert a.coherence is None
    np.testing.assert_array_equal(b.coherence, [0.5, 0.6, 0.7])
    found = read_coherence(tmp_path / "measured.uff")
    assert set(found) == {"b", (8, 3)}
    np.testing.assert_array_equal(found["b"][0], [10, 10.5, 11])


def test_coherence_by_name_and_by_order(tmp_path):
    nameless = ("NONE", 0, 0)
    content = function(response=("a", 0, 0)) + function((0.1, 0.2, 0.3), response=("b", 0, 0), **COHERENCE)
    content += function(response=("b", 0, 0)) + function((0.4, 0.5, 0.6), response=("a", 0, 0), **COHERENCE)
    a, b = read(tmp_path, content).records
    np.testing.assert_array_equal([a.coherence[0], b.coherence[0]], [0.4, 0.1])
    twice = 2 * function(response=("a", 7, 3)) + function((0.1, 0.2, 0.3), response=("a", 7, 3), **COHERENCE)
    twice += function((0.4, 0.5, 0.6), response=("a", 7, 3), **COHERENCE)
    first, second = read(tmp_path, twice).records
    np.testing.assert_array_equal([first.coherence[0], second.coherence[0]], [0.1, 0.4])
    stray = function(response=nameless) + function((0.1, 0.2, 0.3, 0.4), response=nameless, **COHERENCE)
    result = read(tmp_path, stray)
    assert result.records[0].coherence is None
    assert any("coherence without an FRF" in note for note in result.notes)


def test_other_functions_are_left_out_with_one_note(tmp_path):
    content = (
        function()
        + function(kind=2, ordinate=2)
        + function(kind=2, ordinate=2)
        + function(ordinate=2)
        + function(numerator=(3, 0, 0, "", ""))
    )
    result = read(tmp_path, content)
    assert len(result.records) == 1
    left = "left out: records 2-3 (auto spectrum), record 4 (FRF without phase, real values), record 5 (FRF of strain)"
    assert [note for note in result.notes if "left out" in note] == [left]


@pytest.mark.parametrize(
    ("content", "found", "fix"),
    [
        (2 * function(kind=1, ordinate=2), "records 1-2 (time response)", "average FRFs"),
        (function(kind=9, ordinate=2) + function(kind=2, ordinate=2), "record 1 (power spectral density), record 2 (auto spectrum)", "H1"),
        (function(kind=5), "record 1 (transmissibility)", "over the hammer force"),
        (function(ordinate=2), "record 1 (FRF without phase, real values)", "complex"),
        (function(kind=6, ordinate=2, values=(0.1, 0.2, 0.3)), "coherence only", "export the FRFs with it"),
        ("    -1\n   151\nmodel\n    -1\n" + units(*SI), "no dataset 58, but 151 (header), 164 (units)", "functions"),
    ],
)
def test_what_to_export_instead(tmp_path, content, found, fix):
    with pytest.raises(DataError, match="contains no FRF") as caught:
        read(tmp_path, content)
    assert found in str(caught.value.found)
    assert fix in str(caught.value.hint)


def test_an_frf_without_a_type_is_known_by_its_axes(tmp_path):
    result = read(tmp_path, "    -1\n   151\nmodel\n    -1\n" + function(kind=0) + function(kind=0, denominator=(12, 0, 0, "", "")))
    assert [record.number for record in result.records] == [1]
    assert "record 1: function type 0, read as an FRF because of its axes" in result.notes


@pytest.mark.parametrize(("unit", "factor"), [("Hz", 1.0), ("NONE", 1.0), ("kHz", 1e3), ("rad/s", 1 / (2 * np.pi))])
def test_frequency_units(tmp_path, unit, factor):
    (found,) = read(tmp_path, function(abscissa=(18, unit))).records
    np.testing.assert_allclose(found.frequency_hz, factor * np.array([10, 10.5, 11]), rtol=1e-15)


# --- layouts that differ from the book -----------------------------------------------------------------------------------------


def test_line_ends_and_missing_last_line(tmp_path):
    plain = read(tmp_path, function()).records[0]
    for content in (function(eol="\r\n"), function().rstrip().removesuffix("-1").rstrip(), "\n\n" + function(), function() + "\n \n"):
        np.testing.assert_array_equal(read(tmp_path, content).records[0].values, plain.values)


@pytest.mark.parametrize(
    "body",
    [
        " 1.0000000000000000E+00 -2.0000000000000000E+00\n  3.0000000000000000D+00 -4.0000000000000000D-01",
        "   1.0000000000000000E+00  -2.0000000000000000E+00   3.0000000000000000E+00  -4.0000000000000000E-01",
        " 1.00000E+000-2.00000E+000 3.00000E+000-4.00000E-001",
        " 1. -2 3.0 -.4",
    ],
)
def test_number_formats(tmp_path, body):
    (found,) = read(tmp_path, function(body=body, count=2, ordinate=6, reference=("", 9, 3))).records
    np.testing.assert_array_equal(found.values, [1 - 2j, 3 - 0.4j])


def test_uneven_spacing(tmp_path):
    content = function(body=" 1.00000E+01 1.0 2.0 1.50000E+01 3.0 4.0 3.33000E+01 5.0 6.0").replace(
        f"{1:10d}  1.00000E+01", f"{0:10d}  0.00000E+00"
    )
    result = read(tmp_path, content)
    np.testing.assert_array_equal(result.records[0].frequency_hz, [10, 15, 33.3])
    assert "record 1: uneven spacing, lines taken as given" in result.notes


VALUES = (1 - 2j, 3 + 4.5j, -1 / 8 + 6j)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("abscissa", [None, (1.0, 2.5, 100.0)])
@pytest.mark.parametrize("closing", [b"    -1\r\n", b"\r\n    -1\r\n", b"\n    -1\n", b"    -1", b""])
def test_binary_forms(tmp_path, order, double, abscissa, closing):
    for single_axis in (False, True) if double and abscissa else (not double,):
        content = binary(VALUES, order=order, double=double, abscissa=abscissa, abscissa_double=not single_axis, closing=closing)
        (found,) = read(tmp_path, content).records
        np.testing.assert_array_equal(found.values, -np.array(VALUES))
        np.testing.assert_array_equal(found.frequency_hz, abscissa or (10, 10.5, 11))


@pytest.mark.parametrize("stated", [0, 40, 50, 56])
def test_miscounted_bytes(tmp_path, stated):
    closing = b"\r\n    -1\r\n" if stated == 50 else b"    -1\r\n"
    result = read(tmp_path, binary(VALUES, stated=stated, closing=closing) + binary(VALUES))
    assert len(result.records) == 2
    np.testing.assert_array_equal(result.records[0].values, -np.array(VALUES))
    assert result.notes


def test_bytes_that_look_like_a_closing_line(tmp_path):
    trap = struct.unpack("<2d", b"\n    -1\n\n    -1\n")
    values = (complex(*trap), 1 + 1j)
    result = read(tmp_path, binary(values) + binary(values, order=">"))
    np.testing.assert_array_equal([r.values for r in result.records], -np.array([values, values]))


# --- errors ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (function(body=" 1.0 2.0 nan 4.0 5.0 6.0"), r"record 1, point 2 \(line 14\)"),
        (function() + function(body=" 1.0 2.0\n 3.0 inf\n 5.0 6.0"), r"record 2, point 2 \(line 30\)"),
        (function(body=" 1.0 2.0\n 3.0 ****\n 5.0 6.0"), r"line 15: a value is not a number"),
        (function() + function(body=" 1.0 2.0"), r"record 2 .*6 numbers.*2 numbers"),
        (function(body=" 1.0 2.0 3.0 4.0 5.0 6.0 7.0"), "7 numbers"),
        (function(count=10**9), "1000000000 points"),
        (function(count=0), "record 7 of a function is wrong: number of points\n.*above 0\n.*'0' in"),
        (function(count="many").replace("many", "**********"), r"record 7 .*number of points\n.*\n.*'\*+'"),
        (function(ordinate=5).replace("         5         3", "         9         3"), "record 7 .*ordinate data type\n.*\n.*'9' in"),
        (function().replace(f"{3:10d}{1:10d} ", f"{3:10d}{7:10d} "), "record 7 .*abscissa spacing\n.*\n.*'7' in"),
        (function(spacing="          nan  5.00000E-01"), "record 7 .*abscissa minimum\n.*\n.*'nan' in"),
        (function(spacing="  1.00000E+01 -5.00000E-01"), "record 7 .*abscissa increment\n.*above 0\n.*'-5.00000E-01' in"),
        (function(spacing=""), "record 7 .*abscissa increment"),
        (function(spacing=" -1.00000E+01  5.00000E-01"), "a frequency is wrong"),
        (function(body="9 1 1 8 1 1 7 1 1").replace(f"{1:10d}  1.00000E+01", f"{0:10d}  0.00000E+00"), "do not increase"),
        (function(denominator=(12, 0, 0, "", "NONE")), r"record 1: this is not an FRF over force"),
        (function(denominator=(0, 0, 0, "", "m/s^2")), "not an FRF over force"),
        (function(abscissa=(17, "s")), "not a frequency"),
        (function(numerator=(12, 0, 0, "", "Pa"), denominator=(13, 0, 0, "", "N")), "unit label and data type contradict"),
        (units(*MM) + function(numerator=(0, 0, 0, "", "NONE")), "cannot be determined"),
        (units(1, -1.0, 1.0) + function(), "units .dataset 164. cannot be read"),
        (function(response=("a", 7, 9)), "direction"),
        (function((0.5, 1.5, 0.7), **COHERENCE), "a coherence is wrong"),
        (function((0.5, 0.5, 0.7), **COHERENCE), "coherence only"),
        ("    -1\n    58\nonly\n    -1\n", "header of a function is cut off"),
        ("    -1\n    58\n", "cut off"),
        ("    -1\n   164\n    -1\n", "cannot be read"),
        ("    -1\nhello\n    -1\n", "no table of numbers"),
        (function() + "hello\n", "dataset 2, line 16: a dataset does not start with its number"),
        (binary(VALUES)[:-20], "does not contain the number of values"),
        (binary(VALUES)[:300], "cut off"),
        (binary(VALUES, form=1), "float format 2"),
        (binary(VALUES).replace(b"         3         1", b"999999999         1"), "999999999 points"),
        (binary((1 + 1j, complex(np.nan, 0), 1j)), "record 1, point 2"),
    ],
)
def test_bad_files(tmp_path, content, message):
    with pytest.raises(DataError) as caught:
        read(tmp_path, content)
    text = str(caught.value)
    assert re.search(message, text, re.DOTALL), text
    assert "measured.uff" in text


# --- writer ------------------------------------------------------------------------------------------------------------------


def assert_same(found, expected, rtol=1e-12):
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a.frequency_hz, b.frequency_hz, rtol=1e-12)
        np.testing.assert_allclose(a.values, b.values, rtol=rtol)
        assert (a.name, a.quantity) == (b.name, b.quantity)
        assert (a.response_node, a.response_direction) == (b.response_node, b.response_direction)
        assert (a.reference_node, a.reference_direction) == (b.reference_node, b.reference_direction)
        assert (a.coherence is None) == (b.coherence is None)
        if b.coherence is not None:
            np.testing.assert_allclose(a.coherence, b.coherence, atol=1e-12)


NAMES = st.text("abcXYZ0129-", min_size=1, max_size=25)


@st.composite
def frf_sets(draw):
    records = []
    for index in range(draw(st.integers(1, 4))):
        if draw(st.booleans()):
            frequency = draw(st.integers(0, 50)) + np.arange(draw(st.integers(1, 12))) * float(draw(ROUND_STEPS))
        else:
            frequency = np.array(sorted(draw(st.sets(st.integers(0, 99_999), min_size=1, max_size=9)))) / 100.0
        parts = st.floats(-1e6, 1e6).map(lambda x: 0.0 if abs(x) < 1e-290 else x)
        values = np.array([complex(draw(parts), draw(parts)) for _ in frequency])
        coherence = draw(st.none() | st.just(np.linspace(0, 1, frequency.size)))
        records.append(
            FrfRecord(
                name=draw(NAMES) + str(index),
                frequency_hz=frequency,
                values=values,
                quantity=draw(st.sampled_from(["pressure", "displacement", "velocity", "acceleration", None])),
                response_node=draw(st.none() | st.integers(1, 10**9)),
                response_direction=draw(st.integers(0, 6)),
                reference_node=draw(st.none() | st.integers(1, 10**9)),
                reference_direction=draw(st.integers(0, 6)),
                coherence=coherence,
            )
        )
    return FrfSet(source="drawn", records=tuple(records))


@settings(max_examples=60, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(frf=frf_sets())
def test_round_trip(tmp_path, frf):
    path = tmp_path / "written.uff"
    write_frf(path, frf)
    assert_same(read_frf(path).records, frf.records)


# The library leaves its files open.
careless = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")


@careless
def test_written_files_are_read_by_others(tmp_path):
    frf = FrfSet(
        source="x",
        records=(record(response_node=3, response_direction=2, reference_node=5, reference_direction=3, coherence=np.full(40, 0.5)),),
    )
    path = tmp_path / "written.unv"
    write_frf(path, frf)
    sets = pyuff.UFF(str(path)).read_sets()
    assert [s["type"] for s in sets] == [164, 58, 58]
    assert (sets[0]["units_code"], sets[0]["temp_mode"], sets[0]["length"], sets[0]["force"]) == (1, 2, 1.0, 1.0)
    assert (sets[1]["func_type"], sets[1]["rsp_node"], sets[1]["rsp_dir"], sets[1]["ref_node"], sets[1]["ref_dir"]) == (4, 3, 2, 5, 3)
    assert (sets[1]["ordinate_spec_data_type"], sets[1]["orddenom_spec_data_type"]) == (15, 13)
    np.testing.assert_allclose(sets[1]["data"], frf.records[0].values, rtol=1e-12)
    np.testing.assert_allclose(sets[1]["x"], frf.records[0].frequency_hz, rtol=1e-12)
    np.testing.assert_allclose(sets[2]["data"], 0.5)


@careless
def test_files_written_by_pyuff_are_read(tmp_path):
    for form in (0, 1):
        path = tmp_path / f"form{form}.uff"
        expected = record()
        data = {"type": 58, "func_type": 4, "binary": form, "rsp_ent_name": "mic01"}
        data |= {"rsp_node": 3, "rsp_dir": -3, "ref_node": 5, "ref_dir": 3}
        data |= {"data": expected.values, "x": expected.frequency_hz, "abscissa_spec_data_type": 18, "orddenom_spec_data_type": 13}
        data |= {"ordinate_spec_data_type": 12, "ordinate_axis_units_lab": "m/s^2", "orddenom_axis_units_lab": "N"}
        pyuff.UFF(str(path)).write_sets([data, data], mode="add")
        first, second = read_frf(path).records
        for found in (first, second):
            np.testing.assert_allclose(found.values, -expected.values, rtol=1e-10)
            np.testing.assert_allclose(found.frequency_hz, expected.frequency_hz, rtol=1e-12)
            assert (found.name, found.quantity, found.response_node) == ("mic01", "acceleration", 3)


@careless
def test_units_and_coherence_written_by_pyuff(tmp_path):
    """Header, units in inches and pounds force, an FRF on uneven lines and its coherence."""
    path = tmp_path / "pyuff.uff"
    hz, gamma2 = np.array([10.0, 12.5, 20.0, 41.0]), np.array([0.25, 0.5, 0.75, 1.0])
    H = np.array([1 - 2j, 0.3 + 0.4j, -5 + 1e-3j, 2e-6 - 1e-6j])
    inch, pound = 0.0254, 4.4482216152605
    dofs = {"rsp_ent_name": "acc1", "rsp_node": 12, "rsp_dir": 3, "ref_ent_name": "hammer", "ref_node": 5, "ref_dir": -3}
    axis = {"x": hz, "abscissa_spacing": 0, "abscissa_spec_data_type": 18, "abscissa_axis_units_lab": "Hz", "binary": 0}
    empty = dict.fromkeys(("id1", "id2", "id3", "id4", "id5"), "NONE") | {"ver_num": 0, "load_case_id": 0}
    sets = [
        pyuff.prepare_151(model_name="plate", description="", db_app="", program="acquisition"),
        pyuff.prepare_164(7, "Inch (pound f)", 2, 1 / inch, 1 / pound, 1.0, 0.0),
        pyuff.prepare_58(func_type=4, ordinate_spec_data_type=12, orddenom_spec_data_type=13, data=H, **axis, **dofs, **empty),
        pyuff.prepare_58(func_type=6, ordinate_spec_data_type=0, orddenom_spec_data_type=0, data=gamma2, **axis, **dofs, **empty),
    ]
    pyuff.UFF(str(path)).write_sets(sets, mode="add")
    (found,) = read_frf(path).records
    np.testing.assert_allclose(found.values, -H * inch / pound, rtol=1e-9)
    np.testing.assert_allclose(found.frequency_hz, hz, rtol=1e-12)
    np.testing.assert_allclose(found.coherence, gamma2, rtol=1e-9)
    assert (found.name, found.quantity, found.response_node, found.reference_node) == ("acc1", "acceleration", 12, 5)
    # A file that says itself what its coherence is takes no other word for it.
    with pytest.raises(DataError, match="itself states"):
        read_frf(path, TextLayout(coherence="gamma2"))


def test_frequencies_beyond_six_digits(tmp_path, caplog):
    # A command that was run before may have made the log quiet.
    caplog.set_level("WARNING", logger="lrbc_cli")
    write_frf(tmp_path / "a.uff", FrfSet(source="x", records=(record(frequency=[123.4567891, 150.0, 200.0]),)))
    assert "rounded to the six digits" in caplog.text
    np.testing.assert_allclose(read_frf(tmp_path / "a.uff").records[0].frequency_hz, [123.457, 150, 200], rtol=1e-12)
    with pytest.raises(DataError, match="more digits"):
        write_frf(tmp_path / "b.uff", FrfSet(source="x", records=(record(frequency=[100.0001, 100.0002, 100.01]),)))
    assert not (tmp_path / "b.uff").exists()


@settings(max_examples=150, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(data=st.data())
def test_damage_gives_a_data_error_or_frfs(tmp_path, data):
    sources = [
        (units(*SI) + function() + function((0.5, 0.6, 0.7), **COHERENCE)).encode(),
        binary(VALUES) + binary(VALUES, order=">", abscissa=(1.0, 2.0, 3.0)),
        (DATA / "non_ascii_header.uff").read_bytes(),
    ]
    written = st.sampled_from(b"0123456789 -+.Ee\n\r\0\xff") | BYTES
    content = damaged(data, data.draw(st.sampled_from(sources)), written, most=5)
    with contextlib.suppress(DataError):
        require_sound(read(tmp_path, content).records)


@pytest.mark.parametrize("printed", ["1.79769E+308", "1.23456E+300", "1.23456E-300", "1.0E+999", "inf", "nan"])
def test_an_increment_at_the_end_of_the_numbers_stays_as_it_is(printed: str) -> None:
    assert restore(printed) == pytest.approx(float(printed), nan_ok=True)


def test_a_coherence_on_other_lines_is_told_by_the_number_of_its_record() -> None:
    """Whatever the place of the record reads like."""
    two, three = np.array([1.0, 2.0]), np.array([1.0, 2.0, 3.0])
    record = FrfRecord(name="mic01", frequency_hz=two, values=two + 0j, response_node=7, response_direction=3, place="somewhere", number=4)
    notes = Notes()
    assert (
        _attach([record], [Coherence(name="mic01", dof=(7, 3, 0, 0), frequency_hz=three, values=three / 3, record=5)], notes)[0].coherence
        is None
    )
    assert "record 4: the coherence has different lines; left out" in notes.lines()


@pytest.mark.parametrize(
    ("head", "meant"), [("", "SI assumed"), (units(*SI), "factor 1 to SI taken from dataset 164"), (units(*MM), "factor 1 to SI taken")]
)
@pytest.mark.parametrize(
    ("above", "below", "told"),
    [("EU", "EU", "'EU' over 'EU'"), ("EU", "NONE", "'EU'"), ("NONE", "EU", "'' over 'EU'"), ("m/s^2", "EU", "'m/s^2' over 'EU'")],
)
def test_labels_that_are_not_understood_are_warned_of(tmp_path, above, below, told, head, meant):
    one = function(numerator=(12, 0, 0, "Acceleration", above), denominator=(13, 0, 0, "Force", below))
    (warning,) = read(tmp_path, head + one + one).warnings
    assert warning.startswith(f"records 1-2: unit {told} not understood, {meant}")
    assert "'format: {unit: ...}'" in warning
    assert read(tmp_path, head + one, TextLayout(unit="g/N")).warnings == ()


@pytest.mark.parametrize(("above", "below"), [("V", "V"), ("mV", "mV"), ("NONE", "V"), ("m/s^2", "V"), ("Volts", "N"), ("1", "1")])
def test_channels_without_sensitivities_are_named(tmp_path, above, below):
    """No unit is to be written for them, but sensitivities are to be entered, unless the campaign states a unit."""
    one = function(numerator=(12, 0, 0, "Acceleration", above), denominator=(13, 0, 0, "Force", below))
    found = read(tmp_path, units(*SI) + one)
    (warning,) = found.warnings
    assert "is that of channels that are not calibrated, factor 1 to SI taken from dataset 164. Enter the sensitivities" in warning
    assert "format" not in warning
    assert found.records[0].uncalibrated
    stated = read(tmp_path, one, TextLayout(unit="g/N"))
    assert (stated.warnings, stated.records[0].uncalibrated) == ((), False)


@pytest.mark.parametrize("labels", [("NONE", "NONE"), ("NONE", "N"), ("", ""), ("m/s^2", "NONE"), ("m/s^2", "N"), ("g", "lbf"), ("-", "N")])
def test_labels_that_are_understood_or_missing_are_not_warned_of(tmp_path, labels):
    one = function(numerator=(12, 0, 0, "Acceleration", labels[0]), denominator=(13, 0, 0, "Force", labels[1]))
    assert read(tmp_path, one).warnings == ()
