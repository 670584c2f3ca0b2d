"""Text files laid out as the usual analysers write them, in several languages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lrbc_cli.errors import DataError
from lrbc_cli.io.frf import TextLayout, detect_frf_format, read_frf
from lrbc_cli.io.text.header import heading, split_unit
from lrbc_cli.io.units import decibel

HZ = np.array([0.5, 1.0, 1.5, 2.0])
H = np.array([1 - 2j, 0.3 + 0.4j, -5 + 1e-3j, 2e-2 - 1e-2j])
G = np.array([2 + 1j, -0.25 - 4j, 3 + 2j, 1e-1 + 1e-2j])
STANDARD_GRAVITY = 9.80665


def rows(*columns: np.ndarray, delimiter: str = ";", decimal: str = ",") -> list[str]:
    return [delimiter.join(f"{x:.12g}".replace(".", decimal) for x in row) for row in zip(*columns, strict=True)]


def write(tmp_path: Path, lines: list[str], encoding: str = "cp1252") -> Path:
    path = tmp_path / "frf.txt"
    path.write_bytes("\r\n".join([*lines, ""]).encode(encoding))
    return path


def test_german_testlab_like_csv(tmp_path: Path) -> None:
    lines = [
        "Titel;FRF Platte",
        "Datum;12.03.2024 14:05",
        "Prüfer;M. Müller",
        "",
        ";mic01:S/hammer:+Z;;acc1:+Z/hammer:+Z;",
        "Frequenz;Realteil;Imaginärteil;Realteil;Imaginärteil",
        "Hz;Pa/N;Pa/N;(m/s²)/N;(m/s²)/N",
        "0;-1,#IND;-1,#IND;1,2;0",
        *rows(HZ, H.real, H.imag, G.real, G.imag),
    ]
    result = read_frf(write(tmp_path, lines))
    mic, acc = result.records
    assert [(r.name, r.quantity, r.number) for r in result.records] == [
        ("mic01:S/hammer:+Z", "pressure", 1),
        ("acc1:+Z/hammer:+Z", "acceleration", 2),
    ]
    np.testing.assert_allclose(mic.values, H, rtol=1e-11)
    np.testing.assert_allclose(acc.values, G, rtol=1e-11)
    np.testing.assert_array_equal(mic.frequency_hz, HZ)
    assert "left out: the first line of numbers (empty or not finite)" in result.notes
    assert result.warnings == ()


def test_pulse_like_text(tmp_path: Path) -> None:
    """Index, frequency, real and imaginary part under a header of keys, without column names."""
    lines = [
        "Header Size:\t9",
        "Version:\t10",
        "Decimal Symbol:\t.",
        "Data Type:\tComplex",
        "X-Axis size:\t4",
        "X-Axis type:\tFrequency",
        "X-Axis unit:\tHz",
        "AmplitudeUnit:\t(m/s²)/N",
        "Title1:\tFrequency Response H1(acc1,hammer) - Input",
        "",
        *rows(np.arange(1.0, 5.0), HZ, H.real, H.imag, delimiter="\t", decimal="."),
    ]
    (found,) = read_frf(write(tmp_path, lines)).records
    np.testing.assert_array_equal(found.frequency_hz, HZ)
    np.testing.assert_allclose(found.values, H, rtol=1e-11)
    assert (found.name, found.quantity) == ("", "acceleration")


def block(title: str, unit: str, kind: str, *columns: np.ndarray, size: int = HZ.size) -> list[str]:
    """One function of a PULSE file."""
    return [
        f"Data Type:\t{kind}",
        f"X-Axis size:\t{size}",
        "X-Axis type:\tFrequency",
        "X-Axis unit:\tHz",
        f"AmplitudeUnit:\t{unit}",
        f"Title1:\t{title}",
        "Title2:\tWorking : Input : Input : FFT Analyzer",
        "",
        *rows(np.arange(1.0, 5.0), HZ, *columns, delimiter="\t", decimal="."),
    ]


PULSE = ["Header Size:\t8", "Version:\t10", "Decimal Symbol:\t."]
OTHER_DB = np.linspace(-20.0, -10.0, 4)


@pytest.mark.parametrize("again", [[], PULSE], ids=["one head", "a head each"])
def test_several_functions_in_one_pulse_file(tmp_path: Path, again: list[str]) -> None:
    """One below the other, each with its own unit and axis; coherences belong to the FRF of the same signals."""
    gamma2 = np.linspace(0.4, 1.0, 4)
    lines = [
        *PULSE,
        *block("Frequency Response H1(acc1,hammer) - Input", "g/N", "Complex", H.real, H.imag),
        *again,
        *block("Autospectrum(acc1) - Input", "g^2/Hz", "Real", OTHER_DB),
        *again,
        *block("Coherence(mic01,hammer) - Input", "", "Real", gamma2),
        *again,
        *block("Frequency Response H1(mic01,hammer) - Input", "Pa/N", "Complex", G.real, G.imag),
    ]
    result = read_frf(write(tmp_path, lines))
    acc, mic = result.records
    assert [(r.name, r.quantity, r.number) for r in result.records] == [("acc1", "acceleration", 1), ("mic01", "pressure", 4)]
    np.testing.assert_allclose(acc.values, STANDARD_GRAVITY * H, rtol=1e-11)
    np.testing.assert_allclose(mic.values, G, rtol=1e-11)
    np.testing.assert_array_equal(mic.frequency_hz, HZ)
    np.testing.assert_allclose(mic.coherence, gamma2, rtol=1e-11)
    assert acc.coherence is None
    assert "left out: record 2 (Autospectrum(acc1) - Input)" in result.notes
    assert "4 functions, one below the other" in result.notes
    # A lone FRF with its coherence is called by its file, as one without.
    frf, quality = (
        ("Frequency Response H1(mic01,hammer)", "Pa/N", "Complex", G.real, G.imag),
        ("Coherence(mic01,hammer)", "", "Real", gamma2),
    )
    (lone,) = read_frf(write(tmp_path, [*PULSE, *block(*frf), *again, *block(*quality)])).records
    assert lone.name == ""
    np.testing.assert_allclose(lone.coherence, gamma2, rtol=1e-11)


def test_pulse_files_that_cannot_be_trusted(tmp_path: Path) -> None:
    first = block("Frequency Response H1(acc1,hammer) - Input", "g/N", "Complex", H.real, H.imag)
    second = block("Frequency Response H1(acc2,hammer) - Input", "g/N", "Complex", G.real, G.imag)
    with pytest.raises(DataError, match="a function is not complete") as caught:
        read_frf(write(tmp_path, [*PULSE, *first[:-1], *second]))
    assert (caught.value.place, caught.value.found) == ("lines 1 to 14", 3)
    broken = [*PULSE, *first, *second]
    broken[-2] = broken[-2].replace("\t", "\t****", 1)
    with pytest.raises(DataError, match=f"line {len(broken) - 1}: a line does not fit"):
        read_frf(write(tmp_path, broken))
    spectra = block("Autospectrum(acc1) - Input", "g^2/Hz", "Real", OTHER_DB)
    with pytest.raises(DataError, match="contains no FRF") as caught:
        read_frf(write(tmp_path, [*PULSE, *spectra, *spectra]))
    assert caught.value.found == "records 1-2 (Autospectrum(acc1) - Input)"
    # Cross spectra are complex too.
    cross = block("Cross Spectrum(acc1,hammer) - Input", "g*N", "Complex", H.real, H.imag)
    result = read_frf(write(tmp_path, [*PULSE, *cross, *second]))
    assert [record.number for record in result.records] == [2]
    np.testing.assert_allclose(result.records[0].values, STANDARD_GRAVITY * G, rtol=1e-11)


@pytest.mark.parametrize("count", [1, 3])
def test_axis_unit_of_pulse_functions(tmp_path: Path, count: int) -> None:
    """``X-Axis unit:`` converts as a heading does; one that is not understood is refused unless the campaign says which it is."""

    def functions(unit: str, scale: float) -> Path:
        lines = list(PULSE)
        for number in range(count):
            head = block(f"Frequency Response H1(acc{number},hammer)", "Pa/N", "Complex")[:-4]
            head = [line.replace("unit:\tHz", f"unit:\t{unit}") for line in head]
            lines += [*head, *rows(np.arange(1.0, 5.0), scale * HZ, H.real, H.imag, delimiter="\t", decimal=".")]
        return write(tmp_path, lines)

    for unit, scale in (("Hz", 1.0), ("kHz", 1e-3), ("rad/s", 2 * np.pi), ("s^-1", 1.0)):
        found = read_frf(functions(unit, scale)).records
        assert len(found) == count
        for record in found:
            np.testing.assert_allclose(record.frequency_hz, HZ, rtol=1e-11)
    for unit in ("rpm", "mHz", "Orders"):
        with pytest.raises(DataError, match="unit of the frequencies is not understood") as caught:
            read_frf(functions(unit, 1.0))
        assert caught.value.found == unit
        assert read_frf(functions(unit, 1.0), TextLayout(frequency_unit="Hz")).records[0].frequency_hz[0] == HZ[0]


@pytest.mark.parametrize("lone", [True, False])
@pytest.mark.parametrize(
    ("kind", "unit", "columns"),
    [
        ("Real/Imaginary", "g/N", (H.real, H.imag)),
        ("Imaginary/Real", "g/N", (H.imag, H.real)),
        ("Magnitude/Phase", "g/N", (np.abs(H), np.angle(H))),
        ("Magnitude/Phase", "g/N", (np.abs(H), np.angle(H, deg=True))),
        ("Amplitude - Phase (deg)", "g/N", (np.abs(H), 1e-3 * np.angle(H, deg=True))),
        ("Magnitude and Phase", "dB/1 g/N", (20.0 * np.log10(np.abs(H)), np.angle(H, deg=True))),
        ("dB/Phase", "g/N", (20.0 * np.log10(np.abs(H)), np.angle(H, deg=True))),
    ],
)
def test_pulse_functions_are_what_their_data_type_says(
    tmp_path: Path, kind: str, unit: str, columns: tuple[np.ndarray, np.ndarray], lone: bool
) -> None:
    """A magnitude with its phase was taken for a real and an imaginary part."""
    lines = [*PULSE, *block("Frequency Response H1(acc1,hammer) - Input", unit, kind, *columns)]
    if not lone:
        lines += block("Frequency Response H1(mic01,hammer) - Input", "Pa/N", "Complex", G.real, G.imag)
    first, *others = read_frf(write(tmp_path, lines)).records
    expected = H if "(deg)" not in kind else np.abs(H) * np.exp(1e-3j * np.angle(H))
    np.testing.assert_allclose(first.values, STANDARD_GRAVITY * expected, rtol=1e-9)
    assert first.quantity == "acceleration"
    for other in others:
        np.testing.assert_allclose(other.values, G, rtol=1e-11)
    if unit.startswith("dB"):
        return
    # The campaign's word holds.
    (told, *_) = read_frf(write(tmp_path, lines), TextLayout(representation="real-imag", unit="g/N")).records
    np.testing.assert_allclose(told.values, STANDARD_GRAVITY * (columns[0] + 1j * columns[1]), rtol=1e-9)


def test_the_campaign_says_what_titles_say_wrongly(tmp_path: Path) -> None:
    """Magnitudes and phases in a template for real and imaginary parts."""
    hz = np.arange(10.0, 50.0)
    H = np.exp(0.1j * hz) * hz
    rows = [f"{f:g},{abs(v):.12g},{np.rad2deg(np.angle(v)):.12g}" for f, v in zip(hz, H, strict=True)]
    path = write(tmp_path, ["frequency_hz,a1_real,a1_imag", *rows])
    (told,) = read_frf(path, TextLayout(representation="magnitude-phase")).records
    np.testing.assert_allclose(told.values, H, rtol=1e-9)


@pytest.mark.parametrize(("kind", "part"), [("Magnitude", "magnitude"), ("Amplitude", "magnitude"), ("Phase", "phase"), ("dB", "db")])
def test_a_pulse_function_of_one_part_is_no_frf(tmp_path: Path, kind: str, part: str) -> None:
    """Its frequencies were taken as real parts."""
    title = "Frequency Response H1(acc1,hammer) - Input"
    lines = [*PULSE, *block(title, "g/N", kind, np.abs(H))]
    with pytest.raises(DataError, match="contains no FRF") as caught:
        read_frf(write(tmp_path, lines))
    assert caught.value.found == f"record 1 ({title}, {part} only)"
    lines += block("Frequency Response H1(mic01,hammer) - Input", "Pa/N", "Complex", G.real, G.imag)
    (found,) = read_frf(write(tmp_path, lines)).records
    np.testing.assert_allclose(found.values, G, rtol=1e-11)


def test_units_of_pulse_functions(tmp_path: Path) -> None:
    """What is not understood is a warning, an inverse FRF refused, a spectrum left out; the campaign's word holds."""

    def functions(*units: str) -> Path:
        titles = (f"Frequency Response H1(acc{number},hammer)" for number in range(len(units)))
        return write(
            tmp_path, [*PULSE, *(line for t, u in zip(titles, units, strict=True) for line in block(t, u, "Complex", H.real, H.imag))]
        )

    for units in (["furlong/N"], ["furlong/N", "g/N"]):
        result = read_frf(functions(*units))
        assert result.warnings == ("unit 'furlong/N' not understood, SI assumed: set 'format: {unit: ...}' of the job",)
        np.testing.assert_allclose(result.records[0].values, H, rtol=1e-11)
    volts = read_frf(functions("V/V"))
    assert "unit 'V/V' is that of channels that are not calibrated, SI assumed" in volts.warnings[0]
    assert volts.records[0].uncalibrated
    for units in (["N/g"], ["g/N", "N/(m/s²)"]):
        with pytest.raises(DataError, match="this is not the unit of an FRF") as caught:
            read_frf(functions(*units))
        assert caught.value.found == units[-1]
    for unit in ("m/s^2", "g", "Pa", "N"):
        result = read_frf(functions("g/N", unit))
        assert [record.number for record in result.records] == [1]
        assert f"left out: record 2 (Frequency Response H1(acc1,hammer) in {unit}, not over a force)" in result.notes
        with pytest.raises(DataError, match="contains no FRF"):
            read_frf(functions(unit))
    (found,) = read_frf(functions("m/s^2"), TextLayout(unit="g/N")).records
    np.testing.assert_allclose(found.values, STANDARD_GRAVITY * H, rtol=1e-11)
    # A lone function of real values is no FRF either: its frequencies were taken as real parts.
    with pytest.raises(DataError, match="contains no FRF"):
        read_frf(write(tmp_path, [*PULSE, *block("Autospectrum(acc1)", "g^2", "Real", OTHER_DB)]))


def test_french_module_and_phase(tmp_path: Path) -> None:
    db = 20 * np.log10(np.abs(H))
    lines = [
        "Essai : réponse en fréquence",
        "Fréquence (Hz);Module acc1 (dB re 1 g/N);Phase acc1 (degrés);Cohérence acc1",
        *rows(HZ, db, np.rad2deg(np.angle(H)), np.linspace(0.5, 1.0, 4)),
    ]
    (found,) = read_frf(write(tmp_path, lines)).records
    assert (found.name, found.quantity) == ("acc1", "acceleration")
    np.testing.assert_allclose(found.values, STANDARD_GRAVITY * H, rtol=1e-9)
    np.testing.assert_allclose(found.coherence, np.linspace(0.5, 1.0, 4))
    lines[1] = "Fréquence;Partie réelle ((m/s²)/N);Partie imaginaire ((m/s²)/N)"
    (found,) = read_frf(write(tmp_path, [*lines[:2], *rows(HZ, H.real, H.imag)])).records
    assert (found.name, found.quantity) == ("", "acceleration")
    np.testing.assert_allclose(found.values, H, rtol=1e-11)


@pytest.mark.parametrize(
    ("header", "name", "factor", "quantity"),
    [
        ("Frequenz / Hz;Realteil / (m/s²)/N;Imaginärteil / (m/s²)/N", "", 1.0, "acceleration"),
        ("Frequenz in Hz;Re(mic01) in Pa/N;Im(mic01) in Pa/N", "mic01", 1.0, "pressure"),
        ("Frequency [Hz];mic01 (Real) [mPa/N];mic01 (Imag) [mPa/N]", "mic01", 1e-3, "pressure"),
        ("Frequency;Real (m/s2)/N;Imaginary (m/s2)/N", "", 1.0, "acceleration"),
        ("Frequency;acc1 [Real];acc1 [Imag.]", "acc1", 1.0, None),
        ("Freq. (Hz);Real part acc1 (g/N);Imaginary part acc1 (g/N)", "acc1", STANDARD_GRAVITY, "acceleration"),
        ("Frequenz;H1 acc1 - Realteil [mm/s^2/N];H1 acc1 - Imaginaerteil [mm/s^2/N]", "H1 acc1", 1e-3, "acceleration"),
        ("FREQUENZ;REALTEIL;IMAGINÄRTEIL", "", 1.0, None),
        ("Fréquence;Réel ms⁻²/N;Imaginaire ms⁻²/N", "", 1.0, "acceleration"),
        ("Frequenza;Parte reale;Parte immaginaria", "", 1.0, None),
    ],
)
def test_words_and_units(tmp_path: Path, header: str, name: str, factor: float, quantity: str | None) -> None:
    (found,) = read_frf(write(tmp_path, [header, *rows(HZ, H.real, H.imag)], "utf-8")).records
    assert (found.name, found.quantity) == (name, quantity)
    np.testing.assert_allclose(found.values, factor * H, rtol=1e-11)


@pytest.mark.parametrize(
    "header",
    [
        ["Frequenz [Hz];Betrag [Pa/N];Phase [Grad]"],
        ["Frequenz;Amplitude;Phasenwinkel", "Hz;Pa/N;°"],
        ["Frequency;|mic01|;Arg(mic01)", "Hz;Pa/N;deg"],
        ["Fréquence;Module;Phase (°)", "Hz;Pa/N;°"],
        [";mic01;", "Hz;Betrag;Phase"],
        ["Frequenz;Betrag;Phase", "Hz;mic01;mic01"],
    ],
)
def test_magnitude_and_phase(tmp_path: Path, header: list[str]) -> None:
    (found,) = read_frf(write(tmp_path, [*header, *rows(HZ, np.abs(H), np.rad2deg(np.angle(H)))])).records
    np.testing.assert_allclose(found.values, H, rtol=1e-9)
    assert found.name in ("", "mic01")


def test_decibels_with_a_reference(tmp_path: Path) -> None:
    db = 20 * np.log10(np.abs(H))
    lines = ["Frequenz;Pegel [dB re 20 uPa/N];Phase [rad]", *rows(HZ, db, np.angle(H))]
    (found,) = read_frf(write(tmp_path, lines)).records
    np.testing.assert_allclose(found.values, 20e-6 * H, rtol=1e-9)
    assert found.quantity == "pressure"
    # A magnitude that the campaign calls dB.
    lines[0] = "Frequenz;Betrag;Phase"
    (found,) = read_frf(write(tmp_path, lines), TextLayout(representation="db-phase", phase="rad")).records
    np.testing.assert_allclose(found.values, H, rtol=1e-9)


def test_a_frequency_before_each_frf_and_parts_without_names(tmp_path: Path) -> None:
    columns = (HZ, H.real, H.imag, HZ, G.real, G.imag)
    lines = ["Frequenz;Realteil;Imaginärteil;Frequenz;Realteil;Imaginärteil", *rows(*columns)]
    first, second = read_frf(write(tmp_path, lines)).records
    assert [(r.name, r.number, r.place) for r in (first, second)] == [("", 1, "column Realteil"), ("", 2, "column Realteil")]
    np.testing.assert_allclose(second.values, G, rtol=1e-11)
    # Values on another axis are no FRFs on the first.
    with pytest.raises(DataError, match=r"column 4: another frequency axis"):
        read_frf(write(tmp_path, [lines[0], *rows(HZ, H.real, H.imag, HZ + 1, G.real, G.imag)]))


def test_units_that_are_not_understood_are_warned_of(tmp_path: Path) -> None:
    lines = ["Frequency [Hz];acc1_real [EU/N];acc1_imag [EU/N]", *rows(HZ, H.real, H.imag)]
    assert read_frf(write(tmp_path, lines)).warnings == ("unit 'EU/N' not understood, SI assumed: set 'format: {unit: ...}' of the job",)
    assert read_frf(write(tmp_path, lines), TextLayout(unit="g/N")).warnings == ()


def test_headings() -> None:
    assert split_unit("acc 1 (1)") == ("acc 1 (1)", "")
    assert split_unit("FRF mic01 g/N") == ("FRF mic01", "g/N")
    assert split_unit("a/b") == ("a/b", "")
    assert decibel("dB re 2e-5 Pa/N") == (2e-5, "Pa/N")
    assert decibel("dB") == (1.0, "")
    assert decibel("dBm") is None
    assert heading("Realteil").name == ""
    # What is no word of a part stays a name.
    for cell in ("really", "imagine", "Phasenraum", "temperature", "model"):
        assert (heading(cell).name, heading(cell).part) == (cell, None)


@pytest.mark.parametrize(
    ("start", "words"),
    [(b"PK\x03\x04", "Excel"), (b"TDSm", "TDMS"), (b"RIFF", "sound"), (b"\xd0\xcf\x11\xe0", "Excel"), (b"%%MatrixMarket matrix", "matrix")],
)
def test_files_of_other_programs_are_named(tmp_path: Path, start: bytes, words: str) -> None:
    path = tmp_path / "frf.bin"
    path.write_bytes(start + bytes(range(200)) * 3)
    with pytest.raises(DataError, match=words):
        detect_frf_format(path)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("Zeit [s];acc1 [m/s^2];hammer [N]", "this is a time history(.|\\n)*H1"),
        ("Frequency [Hz];acc1;acc2", "cannot be paired(.|\\n)*acc1, acc2"),
        ("Frequency [Hz];acc1 [g^2/Hz];acc1 [g^2/Hz]", "not the unit of an FRF(.|\\n)*not spectra"),
        ("Frequenz;mic01 Betrag;mic02 Betrag", "magnitudes without a phase(.|\\n)*real and imaginary"),
    ],
)
def test_what_is_no_frf_is_told_as_such(tmp_path: Path, header: str, message: str) -> None:
    with pytest.raises(DataError, match=message):
        read_frf(write(tmp_path, [header, *rows(HZ, H.real, H.imag)]))


@pytest.mark.parametrize(
    "header",
    [
        ["Frequency;acc1;acc1;acc2;acc2", "Hz;g/N;deg;g/N;deg"],
        ["Frequency [Hz];acc1 [g/N];acc1 [°];acc2 [g/N];acc2 [°]"],
        ["Frequency;acc1;;acc2;", "Hz;g/N;deg;g/N;deg"],
    ],
)
def test_a_column_in_degrees_is_a_phase(tmp_path: Path, header: list[str]) -> None:
    columns = [part for values in (H, G) for part in (np.abs(values), np.rad2deg(np.angle(values)))]
    first, second = read_frf(write(tmp_path, [*header, *rows(HZ, *columns)])).records
    assert (first.name, second.name, second.quantity) == ("acc1", "acc2", "acceleration")
    np.testing.assert_allclose(first.values, STANDARD_GRAVITY * H, rtol=1e-9)
    np.testing.assert_allclose(second.values, STANDARD_GRAVITY * G, rtol=1e-9)


def test_units_tell_decibels_and_radians(tmp_path: Path) -> None:
    lines = ["f;acc1 (dB);acc1 (rad)", *rows(HZ, 20 * np.log10(np.abs(H)), np.angle(H))]
    (found,) = read_frf(write(tmp_path, lines)).records
    np.testing.assert_allclose(found.values, H, rtol=1e-9)
    # Chosen columns are what their headings say, too.
    (found,) = read_frf(write(tmp_path, lines), TextLayout(columns={"a": (2, 3)})).records
    np.testing.assert_allclose(found.values, H, rtol=1e-9)


@pytest.mark.parametrize("name", ["omega", "w", "ω", "Omega (1/s)", "Kreisfrequenz", "f_rad_s"])
def test_omega_is_in_radians_a_second(tmp_path: Path, name: str) -> None:
    path = write(tmp_path, [f"{name};a_real;a_imag", *rows(2 * np.pi * HZ, H.real, H.imag)], "utf-8")
    result = read_frf(path)
    np.testing.assert_allclose(result.records[0].frequency_hz, HZ, rtol=1e-9)
    assert any("converted from rad/s to Hz" in note for note in result.notes)
    np.testing.assert_allclose(read_frf(path, TextLayout(frequency_unit="Hz")).records[0].frequency_hz, 2 * np.pi * HZ, rtol=1e-9)


def test_parts_of_different_units_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path, ["f;a Real [g/N];a Imag [m/s²/N]", *rows(HZ, H.real, H.imag)])
    with pytest.raises(DataError, match="different units") as caught:
        read_frf(path)
    assert caught.value.found == "g/N and m/s²/N"
    (found,) = read_frf(path, TextLayout(unit="m/s^2/N")).records
    np.testing.assert_allclose(found.values, H, rtol=1e-11)


@pytest.mark.parametrize("unit", ["g/g", "m/m", "(m/s²)/(m/s²)", "mg/g"])
def test_a_transmissibility_is_no_frf(tmp_path: Path, unit: str) -> None:
    path = write(tmp_path, [f"f;a Real [{unit}];a Imag [{unit}]", *rows(HZ, H.real, H.imag)])
    with pytest.raises(DataError, match="this is a transmissibility"):
        read_frf(path)


def test_each_pair_is_read_as_what_it_is(tmp_path: Path) -> None:
    header = "f;a Real;a Imag;b Betrag;b Phase [°];c Real;c Imag"
    lines = [header, *rows(HZ, H.real, H.imag, np.abs(G), np.rad2deg(np.angle(G)), G.real, G.imag)]
    result = read_frf(write(tmp_path, lines))
    assert [(r.name, r.number) for r in result.records] == [("a", 1), ("b", 2), ("c", 3)]
    for record, values in zip(result.records, (H, G, G), strict=True):
        np.testing.assert_allclose(record.values, values, rtol=1e-9)
    assert {"2 FRFs, real-imag", "1 FRF, magnitude-phase"} <= set(result.notes)


@pytest.mark.parametrize(("form", "decimal"), [("{:.12g}{:+.12g}j", "."), ("({:.12g}{:+.12g}i)", "."), ("{:.12g} {:+.12g}*j", ",")])
def test_complex_cells(tmp_path: Path, form: str, decimal: str) -> None:
    coherence = np.linspace(0.5, 1.0, 4)
    body = [
        ";".join([f"{f:g}", *(form.format(z.real, z.imag) for z in (a, b)), f"{c:.12g}"]).replace(".", decimal)
        for f, a, b, c in zip(HZ, H, G, coherence, strict=True)
    ]
    result = read_frf(write(tmp_path, ["Frequenz;acc1;acc2;acc1_coherence", "Hz;g/N;g/N;", *body]))
    assert [r.name for r in result.records] == ["acc1", "acc2"]
    np.testing.assert_allclose(result.records[0].values, STANDARD_GRAVITY * H, rtol=1e-9)
    np.testing.assert_allclose(result.records[1].values, STANDARD_GRAVITY * G, rtol=1e-9)
    np.testing.assert_allclose(result.records[0].coherence, coherence)


def test_complex_cells_of_another_form_are_told(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no table of numbers") as caught:
        read_frf(write(tmp_path, ["f;acc1", "10;1+i*2", "11;2+i*3"]))
    assert "export real and imaginary part in two columns" in str(caught.value.hint)


def test_messages_show_the_cell(tmp_path: Path) -> None:
    lines = ["f;a_real;a_imag;b_real;b_imag", *rows(HZ, H.real, H.imag, G.real, G.imag)]
    for cell, found in (("", "nothing (an empty cell)"), ("****", "'****' in column 4"), ("NaN", "NaN")):
        cells = lines[3].split(";")
        cells[3] = cell
        with pytest.raises(DataError) as caught:
            read_frf(write(tmp_path, [*lines[:3], ";".join(cells), lines[4]]))
        assert caught.value.found == found
        assert "line 4" in str(caught.value)


def test_an_empty_column_is_told_as_such(tmp_path: Path) -> None:
    lines = ["f;b_real;b_imag;a_real;a_imag", "10;;;1;2", "20;;;1;2", "30;;;1;2"]
    with pytest.raises(DataError, match="the column b_real is empty") as caught:
        read_frf(write(tmp_path, lines))
    assert "lines 2 to 4" in str(caught.value)
    assert "remove both columns of this FRF" in str(caught.value.hint)


@pytest.mark.parametrize("cell", ["1.234,5", "-1.234.567,5", "1'234.5", "1\u00a0234,5"])
def test_thousands_separators_are_named(tmp_path: Path, cell: str) -> None:
    """In every line, and in one alone."""
    fix = "has thousands separators: export without them"
    with pytest.raises(DataError) as caught:
        read_frf(write(tmp_path, ["f;a_real;a_imag", *(f"{hz};{cell};0,5" for hz in range(10, 50, 10))]))
    assert caught.value.place == "line 2"
    assert fix in str(caught.value.hint)
    lines = [f"{hz};0,25;0,5" for hz in range(10, 50, 10)]
    with pytest.raises(DataError) as caught:
        read_frf(write(tmp_path, ["f;a_real;a_imag", *lines, f"50;{cell};0,5", "60;0,25;0,5"]))
    assert "line 6" in str(caught.value)
    assert fix in str(caught.value.hint)


def test_a_coherence_in_per_cent(tmp_path: Path) -> None:
    for factor, fix in ((100.0, "probably in per cent: divide all values by 100"), (-1.0, "check whether this is the coherence")):
        values = rows(HZ, H.real, H.imag, factor * np.full(HZ.size, 0.98))
        with pytest.raises(DataError, match="a coherence is wrong") as caught:
            read_frf(write(tmp_path, ["f;a_real;a_imag;a_coherence", *values]))
        assert fix in str(caught.value.hint)
