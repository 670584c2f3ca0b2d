"""One measurement under two names, whatever its digits, units and lines; and two measurements of one state, which are two."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns import Folder, frame
from hypothesis import given
from hypothesis import strategies as st

from lrbc_cli.campaign.identification.compared import copies
from lrbc_cli.campaign.identification.compared.copies import Earlier, Levels, copied_responses, copied_text, pasted
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.updating.statistics.model import ValidationChannels

LIMITS = ValidationChannels()


def measured(seed: int, noise: float, lines: int = 200) -> Measurement:
    """Two responses of three modes, with noise relative to their rms."""
    hz = np.linspace(20.0, 400.0, lines)
    modes = np.array([60.0, 170.0, 310.0])
    values = np.stack([sum(a / (f**2 - hz**2 + 0.04j * f * hz) for a, f in zip(s, modes, strict=True)) for s in ((1, 2, 3), (2, -1, 1))], 1)
    rng = np.random.default_rng(seed)
    values = values + noise * np.sqrt(np.mean(np.abs(values) ** 2, axis=0)) * (
        rng.normal(size=values.shape) + 1j * rng.normal(size=values.shape)
    )
    return Measurement(
        frequency_hz=hz, values=values, coherence=np.full(values.shape, np.nan), notes=(), warnings=(), records=(), hashes={}
    )


def changed(one: Measurement, values: np.ndarray, rows: slice = slice(None)) -> Measurement:
    return Measurement(
        frequency_hz=one.frequency_hz[rows],
        values=values[rows],
        coherence=one.coherence[rows],
        notes=(),
        warnings=(),
        records=(),
        hashes={},
    )


def rounded(values: np.ndarray, digits: int) -> np.ndarray:
    part = np.vectorize(lambda x: float(f"{x:.{digits}g}"))
    return part(values.real) + 1j * part(values.imag)


@given(digits=st.integers(3, 9), factor=st.sampled_from([1.0, 1.01, -9.81, 1e-3j]), first=st.integers(0, 40), every=st.integers(1, 3))
def test_a_copy_is_known(digits: int, factor: complex, first: int, every: int) -> None:
    one = measured(1, 0.003)
    copy = changed(one, factor * rounded(one.values, digits), slice(first, None, every))
    assert copied_responses(copy, one, LIMITS).tolist() == [0, 1]
    assert copied_responses(one, copy, LIMITS).tolist() == [0, 1]


@given(st.integers(2, 10_000), st.sampled_from([0.001, 0.003, 0.03]))
def test_two_measurements_of_one_state_are_two(seed: int, noise: float) -> None:
    assert not copied_responses(measured(seed, noise), measured(1, noise), LIMITS).size


def test_one_response_of_an_earlier_measurement() -> None:
    one, two = measured(1, 0.003), measured(2, 0.003)
    mixed = two.values.copy()
    mixed[:, 1] = one.values[:, 1]
    assert copied_responses(changed(two, mixed), one, LIMITS).tolist() == [1]
    few = slice(0, LIMITS.least_common - 1)
    assert not copied_responses(changed(one, one.values, few), one, LIMITS).size
    assert not copied_responses(changed(one, one.values * np.nan), one, LIMITS).size


def test_frfs_over_a_response_are_no_frfs_over_the_hammer() -> None:
    """The reference of the analyser is constant; another response beside it is none of its copies."""
    one = measured(3, 0.01)
    over = changed(one, one.values / one.values[:, [0]] * (1.0 + 1e-9))
    (text,) = pasted(over, ["a1", "a2"], LIMITS)
    assert text.startswith("a1 is the same number at all lines: the FRFs of this job were probably computed over this channel")
    # Of a single sensor, at two hammer points, beside others.
    wide = np.column_stack([np.ones((200, 2), dtype=complex), one.values])
    (both,) = pasted(replace(one, values=wide), ["a1-h1", "a1-h2", "a2-h1", "a2-h2"], LIMITS)
    assert both.startswith("a1-h1, a1-h2 are the same number at all lines")
    assert list(pasted(changed(one, np.ones((200, 2), dtype=complex)), ["a1", "a2"], LIMITS)) == []
    assert list(pasted(one, ["a1", "a2"], LIMITS)) == []


def gapped(one: Measurement, response: int, rows: slice) -> Measurement:
    values = one.values.copy()
    values[rows, response] = np.nan
    return changed(one, values)


def test_among_many_the_same_ones_are_found_with_few_comparisons(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if each were compared with each; copies with other lines, factors, digits, gaps and missing responses among them."""
    jobs = {f"j{k}": measured(k, 0.003) for k in range(30)}
    copy = jobs["j7"]
    jobs |= {
        "scaled": changed(copy, 3.0 * rounded(copy.values, 4)),
        "thinned": changed(copy, copy.values, slice(3, None, 2)),
        "one lost": gapped(copy, 0, slice(None)),
        "gaps": gapped(jobs["j9"], 1, slice(10, 40)),
        "silent": changed(copy, 0.0 * copy.values),
        "other lines": measured(50, 0.003, lines=150),
    }
    names, expected = ["a", "b"], {}
    for k, (name, own) in enumerate(jobs.items()):
        texts = (copied_text(own, other, of, names, LIMITS) for of, other in list(jobs.items())[:k])
        expected[name] = next((text for text in texts if text), "")
    assert [name for name, text in expected.items() if text] == ["scaled", "thinned", "one lost", "gaps"]
    compared, earlier, found = list[str](), Earlier(LIMITS, jobs.__getitem__), dict[str, str]()
    monkeypatch.setattr(copies, "copied_text", lambda *args: compared.append(args[2]) or copied_text(*args))
    for name, own in jobs.items():
        before = len(compared)
        original, found[name] = earlier.copied(own, names)
        assert bool(original) is bool(found[name])
        if name.startswith("j"):
            assert len(compared) == before
        earlier.add(name, Levels.of(own))
    assert found == expected


def test_records_that_two_jobs_share_may_be_those_of_either() -> None:
    own, other = measured(1, 0.01), measured(2, 0.01)
    mixed = replace(own, values=np.column_stack([own.values[:, 0], other.values[:, 1]]))
    for one, name, beside in ((mixed, "other", other), (other, "mixed", mixed)):
        text = copied_text(one, beside, name, ["a", "b"], LIMITS)
        assert text.startswith(f"it has the numbers of the measurement of {name} in b, and others elsewhere")
        assert f"the file of one of the two jobs, this one or {name}, has records of the other" in text


def cells(change: Callable[[np.ndarray], np.ndarray], form: str = "%.9g") -> Callable[[Folder], None]:
    """The measurement of the tight state once more, with other numbers in its cells."""

    def put(folder: Folder) -> None:
        header, *rows = (folder.data / "frf" / "tight.csv").read_text().splitlines()
        values = change(np.array([row.split(",") for row in rows], dtype=float))
        text = "\n".join([header, *(",".join(form % value for value in row) for row in values)])
        (folder.data / "frf" / "loose-2.csv").write_text(text + "\n")

    return put


@pytest.mark.parametrize(
    "put",
    [
        pytest.param(cells(lambda a: a, "%.4g"), id="four digits", marks=pytest.mark.slow),
        pytest.param(cells(lambda a: a * np.r_[1.0, np.full(8, 1.01)]), id="another calibration", marks=pytest.mark.slow),
        pytest.param(cells(lambda a: a[::2]), id="every second line", marks=pytest.mark.slow),
    ],
)
def test_the_tight_state_under_another_name_is_no_all_clear(tmp_path: Path, put: Callable[[Folder], None]) -> None:
    folder = frame(tmp_path / "frame")
    put(folder)
    folder.write(folder.tree() | {"jobs": {name: {"frf": f"data/frf/{name}.csv"} for name in ("tight", "loose-2")}})
    warned = folder.run("check").stdout + folder.run("check").stderr
    assert "job loose-2: it has the numbers of the measurement of tight: check whether another file was meant. Give each" in warned
    done = folder.run("update", "--fail-on-loose")
    assert done.code == 7, done.stdout
    assert "it has the numbers of the measurement of tight" in done.stdout


def test_figures_of_the_coherence_tell_measurements_apart() -> None:
    """Two of one state, and a copy; where it is constant, unknown or below 1 on few lines, nothing is told."""
    rng = np.random.default_rng(8)
    lines, values = np.linspace(20.0, 200.0, 181), np.ones((181, 4), dtype=complex)

    def with_coherence(coherence: np.ndarray) -> Measurement:
        return Measurement(frequency_hz=lines, values=values, coherence=coherence, notes=(), warnings=(), records=(), hashes={})

    def drawn() -> np.ndarray:
        found = 1.0 - 1e-3 * rng.gamma(4.0, 0.25, (181, 4))
        found[:, 1], found[:, 2], found[5:, 3] = 0.99, np.nan, 1.0
        return found

    first, second = drawn(), drawn()
    one, other = with_coherence(first).noise_means(), with_coherence(second).noise_means()
    np.testing.assert_array_equal(one, with_coherence(first.copy()).noise_means())
    assert abs(one[0] - other[0]) > 2e-3
    assert one[0] == pytest.approx(float(np.mean(10.0 * np.log10(1.0 - first[:, 0]))))
    np.testing.assert_array_equal(one[[1, 2, 3, 5, 6, 7]], 0.0)


def test_gaps_do_not_make_every_measurement_likely() -> None:
    """A line without a value in each job: before, all other files were read again for each."""
    read = list[str]()
    jobs = {f"j{k}": measured(k, 0.003) for k in range(12)}
    for own in jobs.values():
        own.values[3, 0] = np.nan

    def again(name: str) -> Measurement:
        read.append(name)
        return jobs[name]

    earlier = Earlier(LIMITS, again)
    for name, own in jobs.items():
        assert earlier.copied(own, ["a", "b"]) == ("", "")
        earlier.add(name, Levels.of(own))
    assert read == []
    copied = changed(jobs["j4"], 1.02 * jobs["j4"].values)
    assert earlier.copied(copied, ["a", "b"])[0] == "j4"
    assert read == ["j4"]


def test_a_dead_channel_has_the_numbers_of_no_other_one() -> None:
    own = measured(1, 0.01)
    own.values[:, 1] = 0.0
    assert list(pasted(own, ["a", "b"], LIMITS)) == []
