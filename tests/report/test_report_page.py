import base64
import hashlib
import json
import re
import signal
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from fake_campaign import reduction_of, reseal, write_campaign, write_frf

from lrbc_cli.config import load_campaign
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.report import page, write
from lrbc_cli.report.content import Content
from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.html import Markup, resource, tag
from lrbc_cli.report.live import sign, version_of
from lrbc_cli.report.old import outdate
from lrbc_cli.report.parts import tables
from lrbc_cli.report.reading import read_results
from lrbc_cli.report.sections import jobs
from lrbc_cli.report.summary import summary_text
from lrbc_cli.report.write import write_report
from lrbc_cli.results.store import read_job

VOID = {"meta", "br", "hr", "img", "input", "link", "col"}


class Page(HTMLParser):
    """Elements, texts and links of a page; fails where tags are not balanced."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)

    def all(self, name: str) -> list[dict[str, str | None]]:
        return [attributes for element, attributes in self.elements if element == name]


def parsed(output: Path) -> Page:
    return Page((output / "report.html").read_text(encoding="utf-8"))


def test_all_files_are_there(finished):
    for job in ("bolts-00", "bolts-04", "bolts-15"):
        for name in ("profile.png", "map.png", "frf-mic01.png", "frf-mic02.png"):
            assert (finished / job / name).read_bytes().startswith(b"\x89PNG")
    assert {entry.name for entry in (finished / "bolts-20").iterdir()} == {"result.json"}
    assert not [entry for entry in finished.rglob("*") if entry.name.startswith(".")]


def test_page_needs_nothing_from_outside(finished):
    found = parsed(finished)
    text = (finished / "report.html").read_text(encoding="utf-8")
    for _, attributes in found.elements:
        for key in ("src", "href"):
            value = attributes.get(key)
            # Files beside the page are linked, relative to it.
            assert value is None or value.startswith("#") or (finished / unquote(value)).is_file(), value
    assert "@import" not in text
    assert "url(" not in text
    policy = next(entry["content"] for entry in found.all("meta") if entry.get("http-equiv") == "Content-Security-Policy")
    script = re.search(r"<script>(.*?)</script>", text, re.S).group(1)
    assert base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() in policy
    assert "default-src 'none'" in policy


def test_page_is_accessible(finished):
    found = parsed(finished)
    pictures = [entry for entry in found.all("svg") if entry.get("aria-hidden") != "true"]
    # Strip; profiles of all, and again with channels and FRFs in each job; damping; reduced model.
    assert len(pictures) == 1 + 3 + 3 * (1 + 1 + 2) + 1 + 2
    assert all(entry["role"] == "img" and len(entry["aria-label"]) > 20 for entry in pictures)
    assert all(entry.get("scope") in {"col", "row"} for entry in found.all("th"))
    assert len(found.all("caption")) == len(found.all("table"))
    assert found.all("html")[0]["lang"] == "en"
    anchors = {entry["id"] for _, entry in found.elements if entry.get("id")}
    assert {entry["href"][1:] for entry in found.all("a") if entry["href"].startswith("#")} <= anchors


def test_every_section_says_what_it_should(finished):
    text = " ".join(parsed(finished).texts)
    for words in (
        "soundbox-left-edge", "Of 19 bolts known to be removed", "4: B08–B11", "converged", "3.8 → 1.0", "validation", "Exponent p_damp",
        "One frequency line, full model", "1/86.2", "8.5\u00a0×", "23\u202f762", "Measured relative error",
        "the record mic03 holds no line", "SHA-256", "regularisation", "no reduced model with this key",
        "Virtual: nobody measured.", "box 7 · measured by A. Nobody", "Loose bolts in 2 of 4 tested jobs", "3.27", "stated by the paper",
        "reduced to 210 DOFs for 20 to 400 Hz", "S. van Ophem, A. van de Walle, E. Deckers, W. Desmet",
    ):  # fmt: skip
        assert words in text, words


def test_names_cannot_become_markup(tmp_path):
    evil = "<img src=x onerror=alert(1)>\"'&$x_1$"
    write_campaign(tmp_path, (0, 4), responses=(evil, "</script><b>"), used=(evil,), name=evil, groups=(evil,), failed=("x'&y",), lines=40)
    result = tmp_path / "x'&y" / "result.json"
    reseal(result, {**json.loads(result.read_text()), "reason": f"{evil}</td>"})
    write_report(tmp_path)
    found = parsed(tmp_path)
    assert not found.all("img")
    assert len(found.all("script")) == 1
    assert not any(key.startswith("on") for _, attributes in found.elements for key in attributes)
    assert f"{evil}</td>" in found.texts
    assert len(list((tmp_path / "bolts-04").glob("frf-*.png"))) == 2


def test_unchanged_figures_are_left_alone(output):
    write_report(output, workers=1)
    before = {file: file.stat().st_mtime_ns for file in output.rglob("*.png")}
    lines = []
    write_report(output, workers=1, progress=lines.append)
    assert {file: file.stat().st_mtime_ns for file in output.rglob("*.png")} == before
    assert "0 figures drawn, 10 unchanged" in lines
    write_frf(output / "bolts-04" / "frf.csv", 6, ("mic01", "mic02"), 60, False)
    write_report(output, workers=1)
    changed = {file.relative_to(output).as_posix() for file in before if file.stat().st_mtime_ns != before[file]}
    assert changed == {"bolts-04/frf-mic01.png", "bolts-04/frf-mic02.png"}


@pytest.mark.slow
def test_processes_draw_the_same(output, monkeypatch):
    write_report(output, workers=1)
    before = {file: file.read_bytes() for file in output.rglob("*.png")}
    for file in before:
        file.unlink()
    monkeypatch.setattr(write, "_WORTH_PROCESSES", 2)
    write_report(output, workers=2)
    assert {file: file.read_bytes() for file in output.rglob("*.png")} == before


@pytest.fixture
def default_handler():
    """Commands that ran in this process may have left theirs."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("default_handler")
def test_an_interruption_waits_until_the_processes_have_begun():
    """One that loses its parent before it has read what it is to do prints a traceback."""
    done = []

    def interrupted():
        with write._interruption_held_back():
            signal.raise_signal(signal.SIGINT)
            done.append("begun")

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert done == ["begun"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize(
    "options",
    [
        {"counts": (4,), "reference": False, "reduction": False, "truth": False, "damping": False},
        {"counts": (0, 6), "bolts": False, "truth": False, "damping": False},
        {"counts": (0, 4), "groups": ("left_edge", "right_edge"), "band": True, "coherence": True},
        {"counts": (), "failed": ("bolts-20",)},
        {"counts": (4,), "status": "stopped"},
    ],
    ids=["alone", "no bolts", "groups", "all failed", "stopped"],
)
def test_campaigns_of_every_kind(tmp_path, options):
    write_campaign(tmp_path, responses=("mic01",), used=("mic01",), lines=40, **options)
    write_report(tmp_path, workers=1)
    text = " ".join(parsed(tmp_path).texts)
    assert ("Exponent p_damp" in text) == (options.get("damping", True) and bool(options["counts"]))
    assert ("Bolts of bolts-" in text) == (options.get("bolts", True) and bool(options["counts"]))
    assert ("Known removed" in text) == (options.get("truth", True) and bool(options["counts"]))
    assert ("reduction.json is missing" in text) == (not options.get("reduction", True))
    assert not re.search(r"\b(nan|inf|None)\b", (tmp_path / "report.html").read_text(encoding="utf-8"))


@pytest.mark.parametrize("key", [None, "9f2c11ab", "another"])
def test_jobs_of_another_reduced_model_are_named(output, key):
    file = output / "bolts-04" / "result.json"
    result = json.loads(file.read_text(encoding="utf-8"))
    result["provenance"]["certificate"] = None if key is None else {"key": key, "size": 31, "worst": None}
    reseal(file, result)
    write_report(output, workers=1)
    text = " ".join(parsed(output).texts)
    assert ("The results of bolts-04 rest on another reduced model" in text) == (key == "another")


def test_jobs_may_have_responses_of_their_own(output):
    write_frf(output / "bolts-04" / "frf.csv", 4, ("acc1",), 40, False)
    write_report(output, workers=1)
    assert (output / "bolts-04" / "frf-acc1.png").exists()
    options = [entry.get("value") for entry in parsed(output).all("option")]
    assert {"mic01", "mic02", "acc1"} <= set(options)


def test_a_hundred_jobs_are_folded_and_linked(tmp_path, monkeypatch):
    monkeypatch.setattr(write, "_draw_all", lambda tasks, workers, halt, say: (0, 0))
    monkeypatch.setattr(jobs, "_BUDGET", 400_000)
    write_campaign(tmp_path, [4] * 100, responses=("mic01", "mic/2"), used=("mic01",), lines=40, bolts=False)
    write_report(tmp_path)
    found = parsed(tmp_path)
    assert (tmp_path / "report.html").stat().st_size < 4_000_000
    assert len(found.all("details")) > 3
    drawn = [entry for entry in found.all("figure") if entry.get("data-response")]
    links = [unquote(entry["href"]) for entry in found.all("a") if "/frf-" in entry["href"]]
    assert len(set(links)) == 200
    # What stays in the page is shared out among the jobs, used responses first.
    assert {entry["data-response"] for entry in drawn} == {"mic01"}
    assert all(re.fullmatch(r"job-\d{3}/frf-(mic01|mic_2-[0-9a-f]{8})\.png", link) for link in links)


def test_only_the_jobs_named(output):
    write_report(output, jobs=["bolts-04"])
    assert not (output / "bolts-00" / "profile.png").exists()
    with pytest.raises(ConfigError, match="did you mean bolts-04"):
        write_report(output, jobs=["bolts-4"])


def test_jobs_that_have_not_run_are_left_out_unless_named(output):
    (output / "bolts-04" / "result.json").unlink()
    write_report(output, workers=1)
    assert "bolts-04" not in summary_text(output)
    with pytest.raises(DataError, match="missing"):
        write_report(output, jobs=["bolts-04"])
    (output / "bolts-00" / "result.json").unlink()
    with pytest.raises(DataError, match="no job has results yet"):
        write_report(output)


def test_a_file_that_cannot_be_written(output):
    (output / "report.html").mkdir()
    with pytest.raises(DataError, match="cannot be written"):
        write_report(output, workers=1)
    assert not [entry for entry in output.iterdir() if entry.name.startswith(".")]


def test_summary_is_plain_and_compact(finished, output):
    text = summary_text(finished)
    assert text.isascii()
    lines = text.splitlines()
    assert lines[0].split() == ["job", "status", "loose", "bolts", "p_damp", "misfit", "[dB]", "evaluations", "seconds"]
    assert "bolts-04" in lines[2]
    assert "B08, B09, B10, B11" in lines[2]
    assert "0.46" in lines[2]
    assert "3.80 -> 1.00" in lines[2]
    assert lines[-1] == "bolts-20 failed: the record mic03 holds no line inside the band 20 to 400 Hz"
    assert "bolts-00" not in summary_text(output, jobs=["bolts-04"])


def test_costs_add_up(finished):
    done, reduction = [read_job(finished, name) for name in ("bolts-00", "bolts-04", "bolts-15")], reduction_of(finished)
    whole = tables.account(done, reduction)
    assert whole.spent == pytest.approx(8.66 + sum(job.seconds["total"] for job in done))
    assert whole.full == pytest.approx(0.61 * sum(job.line_evaluations for job in done))
    assert whole.speed_up == pytest.approx(whole.full / whole.spent)
    assert tables.account(done, None).full is None
    assert tables.account([], reduction) is None
    assert tables.PAPER["full_total"] == pytest.approx(4.90e3, rel=2e-3)


def test_names_in_a_row_become_ranges():
    order = [f"B{k}" for k in range(1, 10)]
    assert tables.names_of([], order) == "none"
    assert tables.names_of(["B2", "B1"], order) == "B1, B2"
    assert tables.names_of(["B5", "B4", "B3", "B9", "x"], order) == "5: B3–B5, B9, x"
    # What lies between "P6" and "FL" only the order knows, which the page does not show.
    assert tables.names_of(["P5", "P6", "FL", "FR", "B1"], ["P4", "P5", "P6", "FL", "FR", "B1"]) == "5: P5, P6, FL, FR, B1"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (fmt.seconds(4.4e-5), "44\u00a0µs"),
        (fmt.seconds(0.00239), "2.39\u00a0ms"),
        (fmt.seconds(575.58), "576\u00a0s (9.6\u00a0min)"),
        (fmt.seconds(0.0), "0\u00a0µs"),
        (fmt.seconds(None), "–"),
        (fmt.signed(-0.04), "0.0"),
        (fmt.signed(-1.26), "−1.3"),
        (fmt.inverse(1 / 8000), "1/8\u202f000"),
        (fmt.small(4.04e-4), "4.0e−4"),
        (fmt.change(3.84, float("nan")), "3.8 → –"),
    ],
)
def test_numbers(text, expected):
    assert text == expected


def test_only_markup_escapes_escaping():
    assert tag("b", "<i>", Markup("<i></i>"), title='"', class_="x", hidden=True, lang=None) == (
        '<b title="&quot;" class="x" hidden>&lt;i&gt;<i></i></b>'
    )


def test_the_time_can_be_given(output):
    found = read_results(output)
    text = page.render(
        Content(campaign=found.campaign, jobs=found.jobs, reduction=None, profiles={}, frfs=[]), datetime(2026, 3, 1, 12, 30, tzinfo=UTC)
    )
    assert "01 March 2026, 12:30 UTC" in text


def test_each_job_has_a_part_that_its_name_leads_to(finished):
    page = (finished / "report.html").read_text(encoding="utf-8")
    parts = dict(re.findall(r'<article id="(job-\d)" class="job"><h3>([\w-]+) ', page))
    assert [*parts.values()] == ["bolts-00", "bolts-04", "bolts-15", "bolts-20"]
    links = re.findall(r'<a href="#(job-\d)">([\w-]+)</a>', page)
    # In the sentences and in the table.
    assert sorted(links) == sorted([*parts.items()] * 2)
    for anchor, job in list(parts.items())[:3]:
        article = page.split(f'id="{anchor}"')[1].split("</article>")[0]
        for words in ("Identified values", "Misfit by channel", f"Bolts of {job}", f"mic01 · {job}", f"mic02 · {job}"):
            assert words in article, words
        assert ("measured, bolts-00" in article) == (job != "bolts-00")
        assert 'data-name="coherence"' in article


def test_the_rows_of_the_strip_keep_their_labels(finished):
    """The labels are a drawing of their own, which stays where it is while that of the cells is scrolled."""
    page = (finished / "report.html").read_text(encoding="utf-8")
    names, cells = re.findall(r"<svg .*?</svg>", page.split('class="rows"')[1].split("</div>")[0], re.S)
    jobs = ["bolts-00", "bolts-04", "bolts-15"]
    assert re.findall(r">([\w-]+)</text>", names) == jobs
    assert not set(re.findall(r">([\w-]+)</text>", cells)) & {*jobs}
    assert cells.count("<title>") == 3 * 17
    heights = [re.search(r'viewBox="\d+ 0 \d+ (\d+)"', drawing).group(1) for drawing in (names, cells)]
    assert heights[0] == heights[1]
    assert re.search(r"\.rows svg:first-child \{[^}]*position: sticky", page)


@pytest.mark.parametrize("config", sorted(Path(__file__).parents[2].glob("configs/*.yaml")), ids=lambda path: path.stem)
def test_pages_of_samples_say_that_nothing_was_measured(config):
    assert load_campaign(config).description.startswith("Virtual measurements")


def test_every_link_leads_somewhere(finished):
    page = parsed(finished)
    places = {entry["id"] for _, entry in page.elements if "id" in entry}
    links = [str(entry["href"]) for entry in page.all("a")]
    assert {link[1:] for link in links if link.startswith("#")} <= places
    files = {unquote(link) for link in links if not link.startswith("#")}
    assert {file for file in files if not (finished / file).is_file()} == set()
    assert {"bolts-04/profile.png", "bolts-04/profile.csv", "bolts-04/frf.csv", "verdicts.png", "campaign.csv"} <= files


def test_a_page_of_seven_jobs_is_no_large_mail(tmp_path, monkeypatch):
    monkeypatch.setattr(write, "_draw_all", lambda tasks, workers, halt, say: (0, 0))
    write_campaign(tmp_path, evidence=True, coherence=True, calibration=True)
    write_report(tmp_path)
    found = parsed(tmp_path)
    assert len([entry for entry in found.all("figure") if entry.get("data-response")]) == 70
    assert (tmp_path / "report.html").stat().st_size < 6_000_000


def test_links_within_the_page_land_where_they_lead():
    """Guessed heights of figures that are not drawn yet move the target away while the page scrolls to it."""
    sheet = resource("page.css")
    assert "scroll-padding-top: 3.2rem" in sheet
    assert "scroll-behavior" not in sheet
    assert "contain-intrinsic-size" not in sheet


def test_tables_of_bolts_have_room_beside_the_figures_of_their_job(finished):
    """On wide screens: in half of the page beside two figures, else over two columns."""
    sheet, found = resource("page.css"), parsed(finished)
    classes = [entry.get("class") for entry in found.all("div")]
    assert classes.count("judged") == classes.count("overview pair") == 3
    assert ".overview > .judged { grid-column: span 2; }" in sheet
    assert ".overview.pair > .judged { grid-column: 2; grid-row: 1 / span 2; }" in sheet


def test_a_live_page_has_a_version_and_may_load_its_sign(output):
    """The version changes with each page, and if a page is marked as out of date; the last page has none and loads nothing."""
    file = write_report(output, draw=False, live=True)
    page, first = file.read_text(encoding="utf-8"), version_of(file)
    assert "; img-src" in page
    assert "location.reload" in page
    assert f'<p id="live" data-stamp="{first // 2}"' in page
    assert first > 1
    assert first % 2 == 0
    outdate(file, "the disk is full")
    assert version_of(file) == first + 1
    assert f'width="{first + 1}" height="8"' in sign(first + 1, 1007)
    last = write_report(output, draw=False).read_text(encoding="utf-8")
    assert version_of(file) == 1
    assert "img-src" not in last
    assert 'id="live"' not in last
