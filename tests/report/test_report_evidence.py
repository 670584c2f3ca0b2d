import json
import re
from html import escape, unescape
from pathlib import Path

import numpy as np
import pytest
from fake_campaign import campaign_of, reseal, write_campaign, write_fdac
from fake_campaign import changed as replace
from test_report_page import parsed
from test_report_reading import spoil

from lrbc_cli.errors import DataError
from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing import style
from lrbc_cli.report.drawing.chart import Area, Curve, Marks, Span, Tiles, Word
from lrbc_cli.report.drawing.layout import Line, lay_out, swatch
from lrbc_cli.report.parts import figures, tables
from lrbc_cli.report.parts.calibration import calibration_charts
from lrbc_cli.report.parts.correlation import fdac_chart
from lrbc_cli.report.parts.strip import level_of, map_chart, strip_chart
from lrbc_cli.report.places import along_the_edges
from lrbc_cli.report.summary import summary_text
from lrbc_cli.report.write import write_report
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.model import CalibrationRecord, ReductionRecord
from lrbc_cli.results.store import read, read_job
from lrbc_cli.results.tables import read_fdac, read_frf


@pytest.fixture(scope="session")
def rich(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with all that a result may tell, and its report; read only."""
    folder = tmp_path_factory.mktemp("rich")
    write_campaign(
        folder, (0, 4, 12), responses=("mic01", "mic02"), used=("mic01",), lines=60, evidence=True, unexplained=(12,), calibration=True
    )
    write_report(folder, workers=1)
    return folder


def jobs_of(folder: Path):
    campaign = campaign_of(folder)
    return campaign, [read_job(folder, name) for name in campaign.jobs]


def test_a_bolt_has_one_probability_on_the_page(rich: Path, tmp_path: Path) -> None:
    """Being loose and having changed differ, 73 and above 99 % for one bolt: strip, words and tables show the first alike."""
    text = page_text(rich)
    campaign, jobs = jobs_of(rich)
    bolts = {(job.job, bolt.name): bolt for job in jobs if job.explained for bolt in job.observable if bolt.probability_loose is not None}
    unsure = bolts["bolts-04", "B03"]
    assert unsure.probability_loose == 0.4
    assert unsure.probability_changed != pytest.approx(0.4, abs=0.1)
    assert "any change" not in text
    rows = {name: rows_of(text, f"Bolts of {name}") for name in ("bolts-00", "bolts-04")}
    for (job, name), bolt in bolts.items():
        words = tables.sentence(bolt)
        assert f"posterior probability of being loose (change below the threshold) {fmt.probability(bolt.probability_loose)}" in words
        assert escape(words) in text
        (row,) = [row for row in rows[job] if row[0] == name]
        assert row[rows[job][0].index("Probability of being loose")] == fmt.probability(bolt.probability_loose)
    strip_words = [item.text for item in strip_chart(campaign, jobs).panels[0].items if isinstance(item, Word)]
    assert "40" in strip_words
    assert "Number in a cell: posterior probability of being loose (change below the threshold), in per cent" in " ".join(
        parsed(rich).texts
    )
    write_campaign(tmp_path, (0, 4), lines=60)
    write_report(tmp_path, workers=1)
    assert "posterior probability" not in (tmp_path / "report.html").read_text(encoding="utf-8")
    spoil(tmp_path / "bolts-04" / "result.json", "bolts", 3, "probability_changed", value=1.5)
    with pytest.raises(DataError, match="less than or equal to 1"):
        read_job(tmp_path, "bolts-04")


# -- outside, not validated ---------------------------------------------------------------------------------------------


def test_bolts_outside_are_grey_and_have_no_number(rich: Path) -> None:
    """In judged jobs, the reference job and unexplained ones alike."""
    campaign, jobs = jobs_of(rich)
    cells = {}
    for item in strip_chart(campaign, jobs).panels[0].items:
        if isinstance(item, Tiles):
            cells |= dict.fromkeys((name.split(",")[0] + name.split(",")[1].split(":")[0] for name in item.names), item.role)
    for job in jobs:
        assert job.names("outside") == ["B01", "B17"]
        assert len(job.observable) == 15
        for bolt in job.bolts:
            assert (cells[f"{job.job} {bolt.name}"] == "outside") == bolt.outside
        for bolt in (job.bolts[0], job.bolts[-1]):
            words = tables.sentence(bolt)
            assert words.startswith(f"{bolt.name}: outside, not observable, known to be in place, no term within half a pitch")
            assert "%" not in words
            assert "decades" not in words
        marks = {name: item.role for item in map_chart(job).panels[0].items if isinstance(item, Marks) for name in item.names}
        assert {role for name, role in marks.items() if name.startswith(("B01", "B17"))} == {"outside-dot"}
        spans = {
            item.role: item for item in figures.profile_chart(job, figures.profile_scales([job])).panels[0].items if isinstance(item, Span)
        }
        assert len(spans["outside-stripe"].edges) == 2
        rows = {row[0]: row[1:] for row in rows_of(page_text(rich), f"Bolts of {job.job}")}
        for name in ("B01", "B17"):
            assert rows[name][0].split() == ["n/c", "outside"]
            assert not any(character.isdigit() for cell in rows[name][:-1] for character in cell)
    assert "outside: not observable" in [label for *_, label in figures.profile_chart(jobs[0], figures.profile_scales(jobs)).legend()]


def test_bolts_outside_are_counted_apart(rich: Path) -> None:
    _, jobs = jobs_of(rich)
    assert tables.loose_of(jobs[1]) == "4 of 15 judged loose, 1 inconclusive, 2 outside"
    assert tables.hits(jobs) == (
        "Of 4 bolts known to be removed, 4 are judged loose, 0 inconclusive, 0 tight. "
        "Of 26 bolts known to be in place, 25 are judged tight, 1 inconclusive, 0 loose. Outside (not observable): 4."
    )
    page = parsed(rich)
    text = " ".join(page.texts)
    assert "4 of 15 judged loose, 1 inconclusive, 2 outside" in text
    assert "n/c outside: no term reaches it, not observable" in text
    rows = rows_of(page_text(rich), "Results job by job")
    head = [cell.split()[0] for cell in rows[0]]
    assert head.index("Outside") == head.index("Inconclusive") + 1
    assert [row[head.index("Inconclusive")] for row in rows[1:]] == ["none", "B03", "–"]
    assert [row[head.index("Outside")] for row in rows[1:]] == ["B01, B17"] * 3


def page_text(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def rows_of(page: str, caption: str) -> list[list[str]]:
    """Texts of the cells of a table, heading first."""
    body = page[page.index(caption) :].split("</table>")[0]
    rows = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.S) for row in re.findall(r"<tr[^>]*>(.*?)</tr>", body, re.S)]
    return [[unescape(re.sub(r"<[^>]*>", " ", cell)).strip() for cell in row] for row in rows]


def head_of(page: str) -> str:
    return re.sub(r"<[^>]*>", " ", page.split("<header>")[1].split("</header>")[0])


def test_the_head_takes_no_job_for_clear(rich: Path, tmp_path: Path) -> None:
    """One of three has loose bolts, one has no verdict; bolts outside are no open ones."""
    head = head_of(page_text(rich))
    assert "Loose bolts in 1 of 3 tested jobs. bolts-04: B08 to B11. Jobs without verdict: 1, with inconclusive bolts: 1." in head
    assert "B08–B11 in 1 of 3 tested jobs, 4 of 4 observable bolts known to be removed were found" in re.sub(r"\s+", " ", head)
    assert "1 of 30 verdicts" in head
    assert "1 job without verdict, outside, never observable: B01, B17" in head
    for job in jobs_of(rich)[1]:
        assert job.sentence.removeprefix(job.job) in head
    write_campaign(
        tmp_path, (0, 4), responses=("mic01",), used=("mic01",), lines=40, evidence=True, unexplained=(0, 4), failed=("bolts-20",)
    )
    write_report(tmp_path, workers=1)
    head = head_of(page_text(tmp_path))
    assert "No verdict in 3 tested jobs. " in head
    assert "check first" not in head
    assert "3 jobs without verdict" in head
    spoil(tmp_path / "bolts-04" / "result.json", "validity", "nearest", value=["B08", "B09"])
    write_report(tmp_path, workers=1)
    page = page_text(tmp_path)
    assert "No verdict in 3 tested jobs. Without verdict, check first: B08, B09." in head_of(page)
    assert "check B08, B09 first (the nearest state has a loss there)" in " ".join(
        cell for row in rows_of(page, "Results job by job") for cell in row
    )
    spoil(tmp_path / "campaign.json", "jobs", value=["bolts-00"])
    spoil(tmp_path / "bolts-00" / "result.json", "status", value="converged")
    write_report(tmp_path, workers=1)
    assert "No loose bolt found in 1 of 1 tested job." in head_of(page_text(tmp_path))


def test_the_first_sentence_is_true_of_the_jobs_that_it_names(tmp_path: Path) -> None:
    """Up to three jobs are named with their bolts, also those that are probably loose; of more jobs, the one with most of them."""
    options = {"responses": ("mic01",), "used": ("mic01",), "lines": 40, "evidence": True}
    write_campaign(tmp_path, (0, 4, 6), **options)
    spoil(tmp_path / "bolts-04" / "result.json", "bolts", 10, "verdict", value="undecided")
    spoil(tmp_path / "bolts-04" / "result.json", "bolts", 10, "probability_loose", value=0.8)
    write_report(tmp_path, draw=False)
    head = head_of(page_text(tmp_path))
    assert "Loose bolts in 2 of 3 tested jobs. bolts-04: B08 to B10, probably B11; bolts-06: B07 to B12." in head
    write_campaign(tmp_path, (0, 4, 6, 10, 8), **options)
    write_report(tmp_path, draw=False)
    head = head_of(page_text(tmp_path))
    assert "Loose bolts in 4 of 5 tested jobs. Most in bolts-10: B05 to B14; the other 3 jobs below." in head


def test_the_mean_misfit_is_that_of_jobs_with_a_verdict(tmp_path: Path) -> None:
    write_campaign(tmp_path, (0, 4, 12), responses=("mic01",), used=("mic01",), lines=40, evidence=True, unexplained=(12,))
    spoil(tmp_path / "bolts-12" / "result.json", "misfit_db", "final", value=18.0)
    write_report(tmp_path, draw=False)
    told = re.search(r"<dt>Misfit of the model</dt>(.*?)</div>", page_text(tmp_path))
    assert told is not None
    assert "→ 1.0 dB" in told[1]
    assert "jobs with a verdict" in told[1]


def test_a_campaign_without_validation_channels_says_so(tmp_path: Path) -> None:
    """Verdicts, marked: no misfit of fitted channels passes for a validation."""
    write_campaign(tmp_path, (0, 4), responses=("mic01", "mic02"), used=("mic01", "mic02"), lines=40, evidence=True)
    write_report(tmp_path, workers=1)
    campaign, jobs = jobs_of(tmp_path)
    assert all(job.explained and not job.validated and job.validity.held_out_db is None for job in jobs)
    page = page_text(tmp_path)
    assert "bolts-00, bolts-04: not validated: the verdicts stand, but are no all-clear" in page
    assert ">passed<" not in page
    rows = rows_of(page, "Model validation")
    head = [re.sub(r"\s+", " ", cell) for cell in rows[0]]
    for row in rows[1:]:
        assert row[head.index("Validation")] == "not validated"
        assert row[head.index("Validation channels [dB]")] == "–"
        assert row[head.index("What was compared")] == "misfit of these channels 1.6 dB"
    assert all("not validated" in row[1] for row in rows_of(page, "Results job by job")[1:])
    assert "Jobs not validated: 2" in page
    assert strip_chart(campaign, jobs).subtitle == "not validated: bolts-00, bolts-04"
    assert "not validated" in figures.changes_of(jobs[1])


def test_validated_jobs_are_not_marked(rich: Path) -> None:
    campaign, jobs = jobs_of(rich)
    assert all(job.validated for job in jobs)
    assert strip_chart(campaign, jobs).subtitle == ""
    assert "not validated" not in page_text(rich)
    assert rows_of(page_text(rich), "Model validation")[1][3] == "1.60"
    assert "Lines per independent line: neighbouring lines share errors" in page_text(rich)


def test_the_starts_are_those_of_the_results(rich: Path, tmp_path: Path) -> None:
    """Per job the start that is kept, and its cost; words beside the table say what the columns are."""
    _, jobs = jobs_of(rich)
    assert "The cost measures how badly the computed FRFs fit" in page_text(rich)
    assert "“over" in page_text(rich)
    rows = rows_of(page_text(rich), "Best fit of each job")
    assert [row[:2] for row in rows[1:]] == [[job.job, "start 0"] for job in jobs]
    for job, row in zip(jobs, rows[1:], strict=True):
        assert row[2] == f"{job.cost.initial:.3f} → {job.optimiser.starts[0].cost:.3f}"
        assert row[3] == str(len(job.optimiser.starts))
    write_campaign(tmp_path, (4,), lines=40)
    spoil(tmp_path / "bolts-04" / "result.json", "optimiser", "starts", value=[])
    write_report(tmp_path, workers=1)
    assert "Best fit of each job" not in page_text(tmp_path)


def test_the_legend_of_the_strip_shows_what_is_drawn(rich: Path) -> None:
    """Hatching and frames in the cells, not the rings of the maps."""
    campaign, jobs = jobs_of(rich)
    roles = {label: role for role, _, label in strip_chart(campaign, jobs).legend()}
    assert roles["hatched: ? inconclusive, – no verdict"] == "hatch"
    assert roles["framed: known to be removed"] == "known"
    for role in ("hatch", "known"):
        assert all(isinstance(shape, Line) for shape in swatch(role, "tiles", 0.0, 6.0))
    # The maps have one scale, also where a job, the reference, has no probabilities.
    scales = [[label for _, kind, label in map_chart(job, jobs).legend() if kind == "tiles"] for job in jobs]
    assert scales[0] == scales[1] == scales[2]
    rings = {label: role for role, _, label in map_chart(jobs[1]).legend()}
    assert rings["ringed: known to be removed"] == "known-dot"
    assert rings["? inconclusive"] == "unsure-dot"


def test_the_time_includes_the_calibration(rich: Path) -> None:
    spent = tables.account(jobs_of(rich)[1], read(rich / "reduction.json", ReductionRecord)).spent
    head = head_of(page_text(rich))
    assert f"calibration {fmt.seconds(31.2)}" in head
    assert fmt.seconds(31.2 + spent) in head


# -- reading ------------------------------------------------------------------------------------------------------------


def test_everything_that_a_result_may_tell_is_read(rich):
    job = read_job(rich, "bolts-04")
    assert job.explained
    assert len(job.notes) == 2
    assert job.validity.passed
    assert (job.validity.held_out_db, job.validity.limit_db) == (1.6, 3.0)
    assert job.noise.correlation_factor == 5.5
    found = job.nuisances
    assert (found.sound_speed_percent.value, found.sound_speed_percent.std) == (-0.21, 0.03)
    assert (found.gain_db["mic02"].value, found.hammer_offset_mm["x"].std) == (0.1, None)
    loose = next(bolt for bolt in job.bolts if bolt.name == "B09")
    assert loose.probability_loose > 0.99
    assert (loose.change_std, loose.threshold) == (0.15, -0.75)
    assert job.correlation.frac_final == 0.83
    assert np.isnan(job.correlation.responses["mic02"].frac_final)
    assert np.isnan(job.correlation.mean_spectrum.peaks[-1].initial_hz)
    assert np.isnan(job.parameters["left_edge"].upper95).any()
    other = read_job(rich, "bolts-12")
    assert not other.explained


def test_older_results_lack_all_of_it(output):
    job = read_job(output, "bolts-04")
    assert (job.validity, job.correlation, job.notes) == (None, None, ())
    assert read_fdac(output / "bolts-04" / "fdac.csv") is None
    assert read(output / "calibration.json", CalibrationRecord) is None


@pytest.mark.parametrize(
    ("keys", "value", "place"),
    [
        (("bolts", 3, "probability_loose"), 1.5, "bolts[3].probability_loose"),
        (("bolts", 3, "change_std"), "wide", "bolts[3].change_std"),
        (("validity", "passed"), "yes", "validity.passed"),
        (("nuisances", "sound_speed_percent"), "fast", "nuisances.sound_speed_percent"),
        (("nuisances", "gain_db", "mic01"), {"of": 3}, "nuisances.gain_db.mic01.value"),
        (("noise", "sigma_db"), [], "noise.sigma_db"),
        (("correlation", "responses", "mic01"), 3, "correlation.responses.mic01"),
        (("correlation", "mean_spectrum", "peaks", 0), {}, "correlation.mean_spectrum.peaks[0].measured_hz"),
        (("notes",), "one", "notes"),
    ],
)
def test_a_wrong_value_is_named(tmp_path, keys, value, place):
    write_campaign(tmp_path, (4,), responses=("mic01",), used=("mic01",), lines=40, evidence=True)
    spoil(tmp_path / "bolts-04" / "result.json", *keys, value=value)
    with pytest.raises(DataError) as caught:
        read_job(tmp_path, "bolts-04")
    assert caught.value.place == place


@pytest.mark.parametrize("damage", ["rows", "column", "order"])
def test_a_damaged_fdac_is_named(tmp_path, damage):
    file = tmp_path / "job" / "fdac.csv"
    file.parent.mkdir()
    write_fdac(file, 5)
    lines = file.read_text().splitlines()
    lines = {"rows": lines[:-1], "column": ["x" + lines[0], *lines[1:]], "order": [lines[0], *lines[:0:-1]]}[damage]
    file.write_text("\n".join(lines))
    with pytest.raises(DataError, match="damaged"):
        read_fdac(file)


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        (("frf",), "../secret.csv", "calibration/frf.csv"),
        (("frf",), "/etc/passwd", "calibration/frf.csv"),
        (("used",), None, "true or false"),
        (("factors",), KeyError, "a value"),
        (("factors",), {}, "at least 1"),
        (("factors", "mass.acoustic", "value"), 2.0e4, "less than or equal to 100"),
        (("factors", "mass.acoustic", "value"), "1", "a number"),
        (("version",), 2, "1"),
    ],
)
def test_a_damaged_calibration_is_named(tmp_path, keys, value, words):
    write_campaign(tmp_path, (4,), responses=("mic01",), used=("mic01",), lines=40, calibration=True)
    spoil(tmp_path / "calibration.json", *keys, value=value)
    with pytest.raises(DataError) as caught:
        read(tmp_path / "calibration.json", CalibrationRecord)
    assert words in str(caught.value.expected)
    assert caught.value.file.endswith("calibration.json")


# -- strip and maps -----------------------------------------------------------------------------------------------------


def test_the_strip_shows_probability_verdict_and_truth(rich):
    campaign, jobs = jobs_of(rich)
    chart = strip_chart(campaign, jobs)
    panel = chart.panels[0]
    # Each bolt of each job has one cell, in its own colour.
    cells = {name: item.role for item in panel.items if isinstance(item, Tiles) for name in item.names}
    assert len(cells) == 3 * 17
    colour = {name.split(":")[0]: role for name, role in cells.items()}
    assert colour["bolts-04, B09"] == f"p{style.PROBABILITIES - 1}"
    assert colour["bolts-00, B09"] == "p0"
    assert colour["bolts-04, B01"] == "outside"
    # Where the model explains nothing, no cell says anything.
    assert {role for name, role in colour.items() if name.startswith("bolts-12")} == {"unknown", "outside"}
    marks = {item.role: item for item in panel.items if isinstance(item, Marks) and item.x.size}
    assert sorted(marks[f"loose-on{style.PROBABILITIES - 1}"].x) == [7.5, 8.5, 9.5, 10.5]
    frames = next(item for item in panel.items if isinstance(item, Curve) and item.role == "known")
    assert np.isnan(frames.x).sum() == 4 + 12
    words = [item.text for item in panel.items if isinstance(item, Word)]
    assert words.count("?") == 1
    assert words.count("–") == 15
    assert words.count("n/c") == 3 * 2
    assert ">99" in words
    assert "bolts-12: no verdict" in chart.alt


def test_verdicts_serve_where_there_is_no_probability(finished):
    campaign, jobs = jobs_of(finished)
    chart = strip_chart(campaign, [job for job in jobs if isinstance(job, JobRecord)])
    assert [text for _, kind, text in chart.legend() if kind == "tiles"][:2] == ["tight", "loose"]
    assert not any(isinstance(item, Word) and item.text not in ("?", "n/c") for item in chart.panels[0].items)
    bolt = jobs[0].bolts[0]
    assert level_of(replace(bolt, verdict="loose")) == style.PROBABILITIES - 1
    assert level_of(replace(bolt, verdict="tight")) == 0
    assert level_of(replace(bolt, verdict="undecided")) is None
    assert level_of(replace(bolt, verdict="undecided", probability_loose=1.0)) == style.PROBABILITIES - 1
    assert strip_chart(campaign, [replace(jobs[0], bolts=())]) is None


def test_bolts_stand_edge_by_edge_in_order(finished):
    job = read_job(finished, "bolts-04")
    names = [bolt.name for bolt in job.bolts]
    shuffled = replace(job, bolts=tuple(job.bolts[k] for k in np.random.default_rng(1).permutation(17)))
    assert along_the_edges([bolt.name for bolt in shuffled.bolts], [shuffled]) == [names]
    edge = job.parameters["left_edge"]
    bare = replace(job, parameters={"left_edge": replace(edge, positions=None)})
    assert along_the_edges(names, [bare]) == [names]
    step = np.array([0.8, 0.0, 0.0])
    aside = replace(edge, positions=edge.positions + step)
    far = tuple(replace(bolt, position=bolt.position + step) if k < 5 else bolt for k, bolt in enumerate(job.bolts))
    assert along_the_edges(names, [replace(job, parameters={"left_edge": edge, "other": aside}, bolts=far)]) == [names[5:], names[:5]]


def test_grey_tells_the_probability_too():
    for colours in ([style.STYLES[f"p{k}"].light for k in range(style.PROBABILITIES)],):
        assert np.all(np.diff([style.luminance(colour) for colour in colours]) < -0.01)
    assert np.all(np.diff([style.luminance(style.STYLES[f"p{k}"].dark) for k in range(style.PROBABILITIES)]) > 0.005)
    for k in range(style.PROBABILITIES):
        for theme in ("light", "dark"):
            back, ink = (style.luminance(getattr(style.STYLES[role], theme)) for role in (f"p{k}", f"on{k}"))
            assert (max(back, ink) + 0.05) / (min(back, ink) + 0.05) > 4.0


def plate(job, sides: int):
    """The job's bolts around a plate, and its edges."""
    t = np.linspace(0, 1, 6)[:-1]
    zero, one = np.zeros_like(t), np.ones_like(t)
    ring = np.concatenate([np.column_stack(side) for side in [(t, zero), (one, t), (1 - t, one), (zero, 1 - t)][:sides]])
    places = np.column_stack([ring * [1.0, 0.7], np.full(len(ring), 0.1)])
    bolts = tuple(replace(job.bolts[k % 17], name=f"N{k:02d}", position=place) for k, place in enumerate(places))
    return replace(job, bolts=bolts, parameters={})


@pytest.mark.parametrize("sides", [1, 2, 4])
def test_the_map_keeps_all_names_inside_and_apart(rich, sides):
    chart = map_chart(plate(read_job(rich, "bolts-04"), sides))
    drawing = lay_out(chart, header=False)
    words = [shape for shape in drawing.frames[0].shapes if getattr(shape, "text", "").startswith("N")]
    assert len(words) == 5 * sides
    boxes = []
    for word in words:
        width = 0.6 * word.size * len(word.text)
        left = word.x - {"middle": 0.5, "start": 0.0, "end": 1.0}[word.anchor] * width
        assert left >= 0
        assert left + width <= drawing.width
        boxes.append((left, left + width, word.y - 7, word.y))
    for k, a in enumerate(boxes):
        assert not any(a[0] < b[1] and b[0] < a[1] and a[2] < b[3] and b[2] < a[3] for b in boxes[:k])
    if sides == 4:
        # Lengths are true in both directions.
        x, y = chart.panels[0].x, chart.panels[0].y
        left, top, right, bottom = drawing.frames[0].box
        assert (right - left) / (x.high - x.low) == pytest.approx((bottom - top) / (y.high - y.low), rel=0.02)


@pytest.mark.parametrize("count", [1, 2])
def test_the_map_of_bolts_at_one_place(rich, count):
    """A structure on one bolt, or on two springs there."""
    job = read_job(rich, "bolts-04")
    chart = map_chart(replace(job, bolts=tuple(replace(bolt, position=np.ones(3)) for bolt in job.bolts[:count]), parameters={}))
    drawing = lay_out(chart, header=False)
    assert drawing.width > drawing.height > 0
    assert all(np.isfinite([axis.low, axis.high]).all() and axis.low < axis.high for axis in (chart.panels[0].x, chart.panels[0].y))


def test_the_map_marks_what_is_known_and_what_is_open(rich):
    job = read_job(rich, "bolts-04")
    items = [item for item in map_chart(job).panels[0].items if isinstance(item, Marks) and item.x.size]
    assert sum(len(item.x) for item in items if item.role == "known") == 4
    assert sum(len(item.x) for item in items if item.role == "unsure") == 1
    assert sum(len(item.x) for item in items if item.role == "outside-dot") == 2
    said = " ".join(name for item in items for name in item.names)
    assert "no term within half a pitch" in said
    assert "decades (loose from −0.75)" in said
    silent = map_chart(read_job(rich, "bolts-12"))
    assert not any(item.role.startswith("p") for item in silent.panels[0].items if isinstance(item, Marks) and item.x.size)
    assert map_chart(replace(job, bolts=())) is None


# -- profile ------------------------------------------------------------------------------------------------------------


def test_open_intervals_reach_the_edge_with_an_arrow(rich):
    job = read_job(rich, "bolts-04")
    group = job.parameters["left_edge"]
    chart = figures.profile_chart(job, figures.profile_scales([job]))
    panel = chart.panels[0]
    arrows = {item.role: item for item in panel.items if isinstance(item, Marks) and item.role.startswith("open")}
    assert set(np.round(arrows["open-up"].x, 9)) <= set(np.round(group.arc_length[np.isnan(group.upper95)], 9))
    np.testing.assert_allclose(arrows["open-down"].x, group.arc_length[[15]])
    assert arrows["open-up"].y.min() > panel.y.high - 0.1
    layers = [item for item in panel.items if isinstance(item, Area) and item.role == "open"]
    assert max(item.high.max() for item in layers) == pytest.approx(panel.y.high)
    band = next(item for item in panel.items if isinstance(item, Area) and item.role == "band")
    assert np.isfinite(band.low).all()
    closed = ~np.isnan(group.upper95)
    np.testing.assert_array_equal(band.high[closed], group.upper95[closed])
    np.testing.assert_array_equal(band.high[~closed], group.log10_effective[~closed])


def test_without_a_verdict_no_bolt_is_marked_loose(rich):
    job = read_job(rich, "bolts-12")
    chart = figures.profile_chart(job, figures.profile_scales([job]))
    assert {item.role for item in chart.panels[0].items if isinstance(item, Span)} == {"undecided", "outside-stripe"}
    assert "no verdict" in chart.subtitle


# -- correlation and calibration ----------------------------------------------------------------------------------------


def test_a_table_without_a_verdict_has_no_colour_of_one(rich):
    articles = (rich / "report.html").read_text(encoding="utf-8").split('class="job">')
    (silent,) = (article for article in articles if article.startswith("<h3>bolts-12 "))
    (told,) = (article for article in articles if article.startswith("<h3>bolts-04 "))
    assert set(re.findall(r'class="verdict (\w+)"', silent)) == {"none", "outside"}
    assert "loose" in re.findall(r'class="verdict (\w+)"', told)


def test_the_maps_of_fdac_hold_every_value_once(rich):
    job, fdac = read_job(rich, "bolts-04"), read_fdac(rich / "bolts-04" / "fdac.csv")
    chart = fdac_chart(job, fdac)
    drawing = lay_out(chart, header=False)
    for panel, frame, values in zip(chart.panels, drawing.frames, (fdac.initial, fdac.updated), strict=True):
        left, top, right, bottom = frame.box
        assert right - left == pytest.approx(bottom - top, abs=0.5)
        tiles = [item for item in panel.items if isinstance(item, Tiles) and len(item.edges)]
        area = sum(np.sum((e[:, 1] - e[:, 0]) * (e[:, 3] - e[:, 2])) for e in (item.edges for item in tiles))
        assert area == pytest.approx((panel.x.high - panel.x.low) * (panel.y.high - panel.y.low))
        for row, column in ((3, 3), (3, 8), (5, 2), (23, 20)):
            x, y = fdac.frequency_hz[column], fdac.frequency_hz[row]
            inside = [item.role for item in tiles for e in item.edges if e[0] < x < e[1] and e[2] < y < e[3]]
            value = values[row, column]
            expected = "unknown" if np.isnan(value) else f"fdac{round((value + 1) / 2 * (style.COSINES - 1))}"
            assert inside == [expected]


def test_calibration_is_read_and_drawn(rich):
    campaign = campaign_of(rich)
    calibration = read(rich / "calibration.json", CalibrationRecord)
    assert calibration.factors["beta.structure"].lower95 is None
    frf = read_frf(rich / calibration.frf)
    assert [chart.subtitle for chart in calibration_charts(calibration, frf, campaign)] == ["used", "validation channel"]
    assert calibration_charts(calibration, None, campaign) == []


def test_the_page_shows_it_all(rich):
    page = parsed(rich)
    text = " ".join(page.texts)
    for words in (
        "bolts-12: the model does not explain the measurement: no verdict", "NOT passed", "sound speed [%]",
        "−0.21 ± 0.03", "gain [dB]", "mic02: values on 300 of 381 lines only", "0.42 → 0.83", "13 → 15 of 15", "FDAC, initial and updated",
        "stiffness.structure", "1.0105 … 1.0137", "open … 0.067", "undetermined", "3.31", "key 5e1b70aa", "All jobs use this model",
        "after calibration", "Peaks of the mean spectrum",
    ):  # fmt: skip
        assert words in text, words
    # The strip comes before every table.
    order = [name for name, entry in page.elements if name in {"table", "svg"} and entry.get("aria-hidden") != "true"]
    assert order[0] == "svg"
    assert not {"nan", "None", "inf"} & set(text.split())
    names = {file.name for file in (rich / "bolts-04").iterdir()}
    assert {"fdac.png", "map.png", "profile.png"} <= names
    assert (rich / "verdicts.png").exists()


def test_a_calibration_that_is_not_used_says_so(tmp_path):
    write_campaign(tmp_path, (4,), responses=("mic01",), used=("mic01",), lines=40, calibration=True)
    spoil(tmp_path / "calibration.json", "used", value=False)
    write_report(tmp_path, workers=1)
    assert "The jobs of this report do NOT use it" in " ".join(parsed(tmp_path).texts)


def test_the_summary_names_the_least_probability(rich):
    lines = summary_text(rich).splitlines()
    assert "(p >= 0.99" in lines[2]
    assert "no verdict: not explained by the model" in lines[3]
    assert summary_text(rich).isascii()


def test_estimates_of_further_nuisances_have_their_own_column(tmp_path):
    write_campaign(tmp_path, (4,), responses=("mic01",), used=("mic01",), lines=40, evidence=True)
    further = {"damping_structure_percent": {"value": 25.0, "std": 4.0}, "chain_db": {"mic01": {"value": 0.5}}, "odd": 3}
    spoil(tmp_path / "bolts-04" / "result.json", "nuisances", value={"sound_speed_percent": {"value": 1.0}} | further)
    write_report(tmp_path, workers=1)
    head, job = rows_of(page_text(tmp_path), "Nuisance parameters")
    assert [" ".join(cell.split()) for cell in head] == ["Job", "sound speed [%]", "damping structure [%]", "chain [dB] mic01"]
    assert job[1:] == ["1.00", "25.00 ± 4.00", "0.50"]


def test_names_in_new_places_cannot_become_markup(tmp_path):
    write_campaign(tmp_path, (4,), responses=("mic01",), used=("mic01",), lines=40, evidence=True, calibration=True)
    evil = "<img src=x>"
    file = tmp_path / "bolts-04" / "result.json"
    spoil(file, "notes", value=[evil])
    spoil(file, "nuisances", value={evil: {"value": 1.0}})
    spoil(file, "bolts", 4, "note", value=evil)
    spoil(file, "bolts", 4, "name", value=evil)
    document = json.loads((tmp_path / "calibration.json").read_text())
    document["factors"][evil] = {"value": 1.0}
    reseal(tmp_path / "calibration.json", document)
    write_report(tmp_path, workers=1)
    assert not parsed(tmp_path).all("img")


@pytest.mark.parametrize(("value", "text"), [(0.0, "<1"), (0.002, "<1"), (0.5, "50"), (0.994, "99"), (0.9999, ">99"), (1.0, ">99")])
def test_no_probability_is_written_as_certain(value, text):
    assert fmt.percent(value) == text


def test_many_bolts_and_jobs_stay_legible(finished):
    campaign, jobs = jobs_of(finished)
    job = next(job for job in jobs if isinstance(job, JobRecord))
    bolts = tuple(replace(job.bolts[k % 17], name=f"bolt-{k:03d}", position=np.array([0.1, 0.01 * k, 0.0])) for k in range(90))
    chart = strip_chart(replace(campaign, bolts=()), [replace(job, job=f"{'long ' * 20}{k}", bolts=bolts) for k in range(40)])
    cell = (chart.width - chart.left) / 90
    ticks = [where for where, _ in chart.panels[0].x.ticks]
    assert np.min(np.diff(ticks)) * cell > 0.55 * 9.0 * len("bolt-000")
    assert chart.left < 220
    assert fmt.shortened("x" * 50, 30) == "x" * 29 + "…"
