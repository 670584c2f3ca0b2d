"""FRFs in text: what is found out, what can be told, and errors."""

from __future__ import annotations

import contextlib
import csv
import io
import re

import numpy as np
import pytest
from damage import BYTES, damaged, require_sound
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.frf import TextLayout, read_coherence, read_frf, write_frf
from lrbc_cli.model.frf import FrfRecord, FrfSet

REUSE_FOLDER = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
FREQUENCY = np.array([10.0, 10.5, 11.0, 11.5])
H = np.array([1 - 2j, 0.3 + 0.4j, -5 + 1e-3j, 2e-6 - 1e-6j])
MAGNITUDE, DECIBEL, DEGREES, RADIANS = np.abs(H), 20 * np.log10(np.abs(H)), np.rad2deg(np.angle(H)), np.angle(H)


def table(header, columns, delimiter=",", decimal="."):
    rows = [delimiter.join(f"{x:.17g}" for x in row).replace(".", "·") for row in zip(*columns, strict=True)]
    return "\n".join([*header, *(row.replace("·", decimal) for row in rows), ""])


def read(tmp_path, text, layout=None, encoding="utf-8"):
    path = tmp_path / "frf.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return read_frf(path, layout)


REAL_IMAG, MAG_DEG, DB_DEG, MAG_RAD = (
    (FREQUENCY, H.real, H.imag),
    (FREQUENCY, MAGNITUDE, DEGREES),
    (FREQUENCY, DECIBEL, DEGREES),
    (FREQUENCY, MAGNITUDE, RADIANS),
)


@pytest.mark.parametrize(
    ("delimiter", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", "."), (" ", ","), ("   ", ".")]
)
@pytest.mark.parametrize(
    "header", [["f{0}a_real{0}a_imag"], [], ["Measurement of 3.4.2024", "", "f{0}a_real{0}a_imag"], ["# f{0}a_real{0}a_imag"]]
)
def test_separators_are_found_out(tmp_path, delimiter, decimal, header):
    result = read(tmp_path, table([line.format(delimiter) for line in header], REAL_IMAG, delimiter, decimal))
    (found,) = result.records
    np.testing.assert_array_equal(found.frequency_hz, FREQUENCY)
    np.testing.assert_array_equal(found.values, H)
    assert found.name == ("a" if header else "")
    assert header or found.place == "column 2"
    assert any(f"decimal {'point' if decimal == '.' else 'comma'}" in note for note in result.notes)


@pytest.mark.parametrize(
    ("header", "columns", "name"),
    [
        ("frequency_hz,mic01_real,mic01_imag", REAL_IMAG, "mic01"),
        ("Frequency [Hz],Re(mic01),Im(mic01)", REAL_IMAG, "mic01"),
        ("Freq,mic01 Real,mic01 Imaginary", REAL_IMAG, "mic01"),
        ("Hz,Real,Imag", REAL_IMAG, ""),
        ("f,mic01_mag,mic01_phase_deg", MAG_DEG, "mic01"),
        ("f,mic01_mag,mic01_phase_rad", MAG_RAD, "mic01"),
        ("f,Magnitude (m/s^2/N),Phase (deg)", MAG_DEG, ""),
        ("f,mic01 Amplitude,mic01 Phase [rad]", MAG_RAD, "mic01"),
        ("f,mic01 Magnitude [dB],mic01 Phase [°]", DB_DEG, "mic01"),
        ("f,mic01_dB,mic01_phase", DB_DEG, "mic01"),
        ("f,mic01_dB,mic01_deg", DB_DEG, "mic01"),
        ("f,mic01 (dB),mic01 (deg)", DB_DEG, "mic01"),
        ("f,mic01_mag,mic01_rad", MAG_RAD, "mic01"),
        ("f,mic01_abs,mic01_phase", MAG_RAD, "mic01"),
        ("f,mic01_abs,mic01_phase", MAG_DEG, "mic01"),
    ],
)
def test_headers_are_understood(tmp_path, header, columns, name):
    (found,) = read(tmp_path, table([header], columns)).records
    np.testing.assert_allclose(found.values, H, rtol=1e-12)
    assert found.name == name


def test_units_row_and_quantity(tmp_path):
    text = table(["Frequency;a_real;a_imag", "Hz;mm/s^2/N;mm/s^2/N"], REAL_IMAG, ";", ",")
    result = read(tmp_path, text)
    np.testing.assert_allclose(result.records[0].values, 1e-3 * H, rtol=1e-15)
    assert result.records[0].quantity == "acceleration"
    assert any("0.001" in note for note in result.notes)
    found = read(tmp_path, text, TextLayout(unit="g")).records[0]
    np.testing.assert_allclose(found.values, 9.80665 * H, rtol=1e-15)
    assert read(tmp_path, table(["f,a_real [Pa],a_imag [Pa]"], REAL_IMAG)).records[0].quantity == "pressure"
    assert read(tmp_path, table(["f,a_real,a_imag"], REAL_IMAG)).records[0].quantity is None
    assert read(tmp_path, table(["f,a_real,a_imag"], REAL_IMAG), TextLayout(quantity="velocity")).records[0].quantity == "velocity"
    with pytest.raises(DataError, match="do not fit"):
        read(tmp_path, text, TextLayout(quantity="pressure"))


@pytest.mark.parametrize(("header", "factor"), [("f [kHz],a_real,a_imag", 1e3), ("omega_rad/s,a_real,a_imag", 1 / (2 * np.pi))])
def test_frequency_units(tmp_path, header, factor):
    np.testing.assert_allclose(read(tmp_path, table([header], REAL_IMAG)).records[0].frequency_hz, factor * FREQUENCY, rtol=1e-15)


def test_everything_can_be_told(tmp_path):
    text = table(["title", "1;2;3;4"], (np.arange(4.0), DEGREES, FREQUENCY / 1e3, DECIBEL), ";", ",")
    layout = TextLayout(
        delimiter=";",
        decimal=",",
        skip=2,
        frequency=3,
        frequency_unit="kHz",
        representation="db-phase",
        phase="deg",
        unit="Pa/N",
        columns={"mic": (4, 2)},
    )
    (found,) = read(tmp_path, text, layout).records
    np.testing.assert_allclose(found.values, H, rtol=1e-12)
    np.testing.assert_allclose(found.frequency_hz, FREQUENCY, rtol=1e-15)
    assert (found.name, found.quantity) == ("mic", "pressure")
    named = TextLayout(frequency="F", columns={"a": ("x", "y"), "b": ("y", "x")})
    a, b = read(tmp_path, table(["x,F,y"], (H.real, FREQUENCY, H.imag)), named).records
    np.testing.assert_array_equal(b.values, 1j * np.conj(a.values))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("eol", ["\n", "\r\n", "\r"])
def test_encodings_and_line_ends(tmp_path, encoding, eol):
    text = table(["Prüfling", "f,ä_real,ä_imag"], REAL_IMAG).replace("\n", eol)
    path = tmp_path / "frf.txt"
    path.write_bytes(text.encode(encoding))
    (found,) = read_frf(path).records
    assert found.name == "ä"
    np.testing.assert_array_equal(found.values, H)


@pytest.mark.parametrize("first", ["0,NaN,NaN", "0,,", "0,inf,-inf", "0,NaN,NaN\n5,,\n7,nan,1"])
def test_unusable_first_lines_are_left_out(tmp_path, first):
    result = read(tmp_path, table(["f,a_real,a_imag", first], REAL_IMAG))
    np.testing.assert_array_equal(result.records[0].frequency_hz, FREQUENCY)
    assert any("of numbers (empty or not finite)" in note for note in result.notes)


def test_several_records_and_leftovers(tmp_path):
    text = table(
        ["f,a_real,a_imag,temperature,b_real,b_imag,b_coherence,c_real"],
        (*REAL_IMAG, FREQUENCY, H.imag, H.real, [0.1, 0.2, 0.3, 1.0], H.real),
    )
    result = read(tmp_path, text)
    assert [found.name for found in result.records] == ["a", "b"]
    np.testing.assert_array_equal(result.records[1].coherence, [0.1, 0.2, 0.3, 1.0])
    assert result.records[0].coherence is None
    assert any("temperature, c" in note for note in result.notes)


@pytest.mark.parametrize("column", ["gamma2", 4])
def test_a_named_coherence(tmp_path, column):
    path = tmp_path / "frf.csv"
    quality = [0.1, 0.2, 0.3, 1.0]
    np.savetxt(path, np.column_stack([*REAL_IMAG, quality]), delimiter=",", header="f,a_real,a_imag,gamma2", comments="")
    found = read_frf(path, TextLayout(coherence=column)).records[0]
    np.testing.assert_allclose(found.values, H, rtol=1e-15)
    np.testing.assert_array_equal(found.coherence, quality)
    assert read_frf(path).records[0].coherence is None
    (key, (frequency, values)) = next(iter(read_coherence(path, TextLayout(coherence=column)).items()))
    assert key == ""
    np.testing.assert_array_equal([frequency, values], [FREQUENCY, quality])
    with pytest.raises(DataError, match="no such column"):
        read_frf(path, TextLayout(coherence="gama2"))
    two = table(["f,a_real,a_imag,b_real,b_imag,gamma2"], (*REAL_IMAG, *REAL_IMAG[1:], quality))
    with pytest.raises(DataError, match="not clear which FRF") as caught:
        read(tmp_path, two, TextLayout(coherence="gamma2"))
    assert caught.value.found == "a, b"


def test_coherence_of_text(tmp_path):
    path = tmp_path / "coherence.csv"
    path.write_text("f;a;b\n1;0.5;0.6\n2;0.7;1\n")
    found = read_coherence(path)
    assert set(found) == {"a", "b"}
    np.testing.assert_array_equal(found["b"], [[1, 2], [0.6, 1.0]])
    path.write_text("f;a_coherence;b\n1;0.5;7\n2;0.7;7\n")
    assert set(read_coherence(path)) == {"a"}
    path.write_text("f;a\n1;0.5\n2;1.7\n")
    with pytest.raises(DataError, match="coherence is wrong"):
        read_coherence(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello\nworld\n", "no table of numbers"),
        ("f,a_real,a_imag\n1,2,3\n2,3,nan\n3,4,5\n", "line 3, column a_imag"),
        ("f,a_real,a_imag\n1,2,3\n2,x,1\n3,4,5\n", "line 3: a line does not fit"),
        ("f,a_real,a_imag\n1,2,3\n2,1\n3,4,5\n4,5,6\n", "line 3: a line does not fit"),
        ("f,a_real,a_imag\n1,2,3\n1,2,1\n", "do not increase"),
        ("f,a_real,a_imag\n2,2,3\n1,2,1\n", "do not increase"),
        ("f,a_real,a_imag\n-1,2,3\n1,2,1\n", "a frequency is wrong"),
        ("f,a\n1,2\n2,3\n", "cannot be paired"),
        ("f,a_real,b_imag\n1,2,3\n2,3,4\n", "cannot be paired"),
        ("f,a_real,a_real,a_imag\n1,2,3,4\n2,3,4,5\n", "same part"),
        ("f,a_real,a_imag,a_coherence\n1,2,3,4\n2,3,4,5\n", "coherence is wrong"),
    ],
)
def test_errors_name_the_place(tmp_path, text, message):
    with pytest.raises(DataError, match=message) as caught:
        read(tmp_path, text)
    assert "frf.txt" in str(caught.value)


def test_wrong_columns_in_the_layout(tmp_path):
    text = table(["f,a_real,a_imag"], REAL_IMAG)
    for layout in (TextLayout(frequency="F"), TextLayout(frequency=9), TextLayout(columns={"a": ("x", "a_imag")})):
        with pytest.raises(DataError, match="no such column"):
            read(tmp_path, text, layout)


@pytest.mark.parametrize(
    "wrong",
    [
        {"delimiter": ",", "decimal": ","},
        {"unit": "furlong"},
        {"unit": "s"},
        {"unit": "Pa/N", "quantity": "velocity"},
    ],
)
def test_a_wrong_layout_is_an_error_of_the_campaign_file(wrong):
    with pytest.raises(ConfigError):
        TextLayout(**wrong)


NAMES = st.text("abzAZ019-. ", min_size=1, max_size=12).map(lambda name: f"p{name}q") | st.sampled_from(
    ["a,b", 'say "x"', "a_b", "Re x", "ä"]
)


@st.composite
def frf_sets(draw):
    frequency = np.array(sorted(draw(st.sets(st.floats(0, 1e4), min_size=1, max_size=12))))
    parts = st.floats(allow_nan=False, allow_infinity=False)
    records = []
    for name in draw(st.lists(NAMES, min_size=1, max_size=4, unique_by=str.strip)):
        values = np.array([complex(draw(parts), draw(parts)) for _ in frequency])
        records.append(
            FrfRecord(
                name=name, frequency_hz=frequency, values=values, coherence=draw(st.none() | st.just(np.linspace(0, 1, frequency.size)))
            )
        )
    return FrfSet(source="drawn", records=tuple(records))


@settings(max_examples=80, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(frf=frf_sets())
def test_round_trip_is_exact(tmp_path, frf):
    path = tmp_path / "written.csv"
    write_frf(path, frf)
    assert path.read_text(encoding="utf-8").startswith("frequency_hz,")
    found = read_frf(path).records
    assert [a.name for a in found] == [b.name for b in frf.records]
    for a, b in zip(found, frf.records, strict=True):
        np.testing.assert_array_equal(a.frequency_hz, b.frequency_hz)
        np.testing.assert_array_equal(a.values, b.values)
        np.testing.assert_array_equal(a.coherence, b.coherence)


def test_what_csv_cannot_hold(tmp_path):
    a, b = FrfRecord(name="a", frequency_hz=FREQUENCY, values=H), FrfRecord(name="a", frequency_hz=FREQUENCY, values=H)
    for records in (
        (a, b),
        (FrfRecord(name="", frequency_hz=FREQUENCY, values=H),),
        (a, FrfRecord(name="b", frequency_hz=FREQUENCY[1:], values=H[1:])),
        (),
    ):
        with pytest.raises(DataError):
            write_frf(tmp_path / "x.csv", FrfSet(source="x", records=records))
        assert not (tmp_path / "x.csv").exists()


def test_negative_magnitudes_are_refused(tmp_path):
    text = "frequency_hz,a_mag,a_phase_deg\n10,0.5,30\n20,-0.4,40\n30,0,0\n"
    with pytest.raises(DataError, match=r"line 3, column a_mag: a magnitude is negative(.|\n)*-0.4 \(1 such lines\)(.|\n)*db-phase"):
        read(tmp_path, text.encode())
    assert read(tmp_path, text.replace("-0.4", "0.4").encode()).warnings == ()
    # dB may be negative.
    in_db = read(tmp_path, text.replace("a_mag", "a_db").encode()).records[0]
    assert in_db.values[1] == pytest.approx(10 ** (-0.02) * np.exp(1j * np.deg2rad(40)))


def test_columns_between_0_and_1_may_be_coherences(tmp_path):
    columns = (FREQUENCY, *(np.full(FREQUENCY.size, value) for value in (0.9, 0.95, 1.0)))
    with pytest.raises(DataError, match="cannot be paired") as caught:
        read(tmp_path, table(["f,a,b,c"], columns))
    assert caught.value.hint.startswith("check whether these are coherences")
    assert caught.value.hint.endswith("else give the pairs under 'format: {columns: {NAME: [first, second]}}' of the job")


def test_a_last_line_without_an_end_is_told(tmp_path):
    text = "frequency_hz,a_real,a_imag\n10,0.5,30\n20,0.4,4"
    (warning,) = read(tmp_path, text.encode()).warnings
    assert "the last line has no line break" in warning


@settings(max_examples=100, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(data=st.data())
def test_damage_gives_a_data_error_or_frfs(tmp_path, data):
    sources = [table(["frequency_hz,a_real,a_imag"], REAL_IMAG), table(["f;a [dB];a_phase", "Hz;dB;deg"], DB_DEG, ";", ",")]
    written = st.sampled_from(b'0123456789 -+.,;Ee\n\r"\0\xff') | BYTES
    content = damaged(data, data.draw(st.sampled_from(sources)).encode(), written, most=5)
    with contextlib.suppress(DataError):
        require_sound(read(tmp_path, content).records)


def resonant(noise=0.02, lines=400):
    """FRFs of three modes at two points, with noise: (frequencies, values), (lines,) and (lines, 2)."""
    frequency = np.linspace(20.0, 400.0, lines)
    own, shapes = np.array([60.0, 150.0, 290.0]), np.array([[1.0, 1.0, 1.0], [1.0, -0.7, 0.9]])
    modes = -(frequency[:, None] ** 2) / (own**2 - frequency[:, None] ** 2 + 0.02j * own * frequency[:, None])
    rng = np.random.default_rng(3)
    values = modes @ shapes.T
    return frequency, values * (1 + noise * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)))


def polar(frequency, values, phases, db=False):
    magnitudes = 20 * np.log10(np.abs(values)) if db else np.abs(values)
    columns = [column for k in range(values.shape[1]) for column in (magnitudes[:, k], phases[:, k])]
    return table([f"f,a_{'db' if db else 'mag'},a_phase,b_{'db' if db else 'mag'},b_phase"], [frequency, *columns])


@pytest.mark.parametrize("db", [False, True])
@pytest.mark.parametrize("every", [1, 8])
@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("kind", ["deg", "deg 0 to 360", "deg unwrapped", "rad", "rad unwrapped"])
def test_values_decide_the_unit_of_phases_without_one(tmp_path, kind, noise, every, db):
    """Unwrapped radians beyond one turn were read as degrees, with a note only."""
    frequency, values = resonant(noise)
    frequency, values = frequency[::every], values[::every]
    angle = np.unwrap(np.angle(values), axis=0) + 2 * np.pi if "unwrapped" in kind else np.angle(values)
    phases = angle if kind.startswith("rad") else np.degrees(angle)
    found = read(tmp_path, polar(frequency, values, phases % 360 if "360" in kind else phases, db))
    for record, expected in zip(found.records, values.T, strict=True):
        np.testing.assert_allclose(record.values, expected, rtol=1e-9)
    assert found.warnings == ()


def test_all_phases_of_a_table_are_in_the_same_unit(tmp_path):
    """A column of degrees that stays within one turn in radians was read as radians beside one that does not."""
    frequency, values = resonant()
    values[:, 1] = 1.0 + 0.05 * values[:, 1] / np.abs(values[:, 1]).max()
    found = read(tmp_path, polar(frequency, values, np.angle(values, deg=True)))
    np.testing.assert_allclose(found.records[1].values, values[:, 1], rtol=1e-9)


@pytest.mark.parametrize(
    ("magnitude", "phase", "unit"),
    [
        (np.ones(6), np.array([0.0, 1.0, 2.5, 4.5, 7.0, 9.0]), "deg"),
        (np.ones(6), np.array([0.0, 0.2, 0.1, 0.3, 0.5, 0.4]), "rad"),
        (np.exp(0.1 * np.arange(6.0)), np.degrees(0.015 * np.arange(6.0)), "rad"),
        (np.exp(np.arange(2.0)), np.array([8.0, 9.0]), "deg"),
        # Radians that were unwrapped before lines were left out.
        (np.exp(np.array([0.0, 1.5, 0.0, 3.0, 2.0, 0.0])), np.array([0.0, 2.0, -4.0, -9.0, -6.0, -7.0]), "deg"),
    ],
)
def test_a_unit_of_phases_that_the_values_do_not_decide_is_warned_of(tmp_path, magnitude, phase, unit):
    found = read(tmp_path, polar(np.arange(10.0, 10.0 + phase.size), magnitude[:, None] * np.ones(2), phase[:, None] * np.ones(2)))
    (warning,) = found.warnings
    assert f"read as {unit}" in warning
    assert {"'format: {phase: deg}'", "'format: {phase: rad}'"} == set(re.findall(r"'format: {phase: [a-z]+}'", warning))
    np.testing.assert_allclose(np.angle(found.records[0].values), np.angle(np.exp(1j * (phase if unit == "rad" else np.radians(phase)))))
    assert read(tmp_path, (tmp_path / "frf.txt").read_text(), TextLayout(phase="deg")).warnings == ()


@pytest.mark.parametrize("quoting", [csv.QUOTE_ALL, csv.QUOTE_MINIMAL])
@pytest.mark.parametrize("header", [["Frequenz", "a Realteil", "a Imaginärteil"], []])
def test_quoted_decimal_commas_between_commas(tmp_path, quoting, header):
    """The comma was called both decimal sign and separator, although quotes distinguish them."""
    rows = [[f"{value:.17g}".replace(".", ",") for value in row] for row in zip(*REAL_IMAG, strict=True)]
    text = io.StringIO()
    csv.writer(text, quoting=quoting).writerows([*([header] if header else []), *rows, ["12", "3", "0"]])
    for layout in (None, TextLayout(decimal=",")):
        result = read(tmp_path, text.getvalue(), layout)
        np.testing.assert_array_equal(result.records[0].values, [*H, 3.0])
    assert "columns separated by comma, decimal comma" in result.notes
    # A cell is named as it stands in the file.
    with pytest.raises(DataError, match=r"line \d, column(.|\n)*-1,5e999"):
        read(tmp_path, text.getvalue().replace('"-5"', "-5").replace("-5,", '"-1,5e999",', 1))


def test_a_line_in_quotes_is_divided(tmp_path):
    rows = table(["f,a_real,a_imag"], REAL_IMAG).splitlines()
    np.testing.assert_array_equal(read(tmp_path, "\n".join(f'"{row}"' for row in rows) + "\n").records[0].values, H)


def test_commas_without_quotes_are_not_both_signs(tmp_path):
    with pytest.raises(DataError):
        read(tmp_path, "f,a_real,a_imag\n10,1,5,2,5\n20,2,5,3,5\n", TextLayout(decimal=","))


@pytest.mark.parametrize("words", ["Betrag Winkel", "Magnitude Angle", "Modulo Angolo"])
def test_a_phase_may_be_called_an_angle(tmp_path, words):
    """`acc1 Winkel in °` was not paired with `acc1 Betrag`."""
    first, second = words.split()
    (found,) = read(tmp_path, table([f"Frequenz in Hz;acc1 {first} in mm/s²/N;acc1 {second} in °"], MAG_DEG, ";", ",")).records
    assert found.name == "acc1"
    np.testing.assert_allclose(found.values, 1e-3 * H, rtol=1e-12)


def test_a_decimal_comma_between_commas_with_numbers_of_any_length(tmp_path):
    """Without trailing zeros lines have different numbers of cells; a line was to be corrected, or skipped."""
    rows = ["f,acc1_real,acc1_imag,acc2_real,acc2_imag"]
    rows += [f"{f},-0,0{f}7,0,{f},0,3,-0,2{f}" if f != 17 else "17,2,0,5,0,3,-0,25" for f in range(10, 30)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(rows) + "\n")
    with pytest.raises(DataError, match="the comma is both decimal sign and column separator"):
        read_frf(path)


def test_decimal_points_that_a_spreadsheet_took_for_thousands(tmp_path):
    hz = np.arange(10, 60)
    values = 1.5 + 0.4 * np.sin(hz)
    path = tmp_path / "a.csv"

    def written(cells):
        path.write_text("hz,a_real,a_imag\n" + "".join(f"{f},{cell},0.1234\n" for f, cell in zip(hz, cells, strict=True)))
        return read_frf(path).records[0].values.real.tolist()

    right = [f"{value:.4g}" for value in values]
    lost = [cell.replace(".", "") if k in (7, 20, 33) else cell for k, cell in enumerate(right)]
    with pytest.raises(DataError, match="decimal points are missing") as refused:
        written(lost)
    assert "line 9, column a_real: decimal points are missing" in str(refused.value)
    assert f"as {right[6]} and {right[8]} before and after" in str(refused.value.expected)
    assert f"'{lost[7]}', and 2 such cells more" in str(refused.value.found)
    # Large numbers have no decimal sign where few digits are written, but large neighbours.
    assert max(written([f"{1000.0 * value:.4g}" for value in values])) > 1000.0
    assert max(written([f"{value:.4g}" for value in 3000.0 * np.exp(-0.5 * ((hz - 35.0) / 4.0) ** 2)])) == 3000.0
    # One cell may be anything.
    assert max(written([cell.replace(".", "") if k == 7 else cell for k, cell in enumerate(right)])) > 100.0
