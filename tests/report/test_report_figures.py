import re
from dataclasses import replace as replace_chart
from importlib.resources import files
from xml.etree import ElementTree

import numpy as np
import pytest
from fake_campaign import campaign_of, reduction_of
from fake_campaign import changed as replace
from hypothesis import given
from hypothesis import strategies as st

from lrbc_cli.report.drawing.chart import Chart, Curve, Marks, Panel, Span, Tiles, decade_axis, linear_axis
from lrbc_cli.report.drawing.format import over_force
from lrbc_cli.report.drawing.layout import lay_out
from lrbc_cli.report.drawing.png import draw, is_current, publish
from lrbc_cli.report.drawing.style import PROBABILITIES, STYLES, css, luminance
from lrbc_cli.report.drawing.svg import path, svg
from lrbc_cli.report.parts import certificate, figures
from lrbc_cli.report.parts.damping import damping_chart
from lrbc_cli.report.parts.lcurve import l_curve_chart
from lrbc_cli.results.job import CornerRecord, LCurveRecord
from lrbc_cli.results.store import read_job
from lrbc_cli.results.tables import Frf, read_frf


def points_of(data: str) -> np.ndarray:
    """Decode path data: absolute starts, relative steps."""
    found = []
    for piece in data.split("M")[1:]:
        numbers = np.array(re.findall(r"-?\d+", piece.replace("h0", "")), dtype=float).reshape(-1, 2)
        found.append(np.cumsum(numbers, axis=0) / 10)
    return np.concatenate(found) if found else np.empty((0, 2))


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6), st.integers(2, 10))
def test_ticks_are_few_round_and_inside(low, width, count):
    axis = linear_axis("x", low, low + width, count)
    values = [tick for tick, _ in axis.ticks]
    assert len(values) <= 2 * count + 2
    slack = 1e-6 * width + 1e-9 * abs(low)
    assert all(axis.low - slack <= tick <= axis.high + slack for tick in values)


@pytest.mark.parametrize(("low", "high"), [(float("nan"), 1.0), (2.0, 2.0), (0.0, 0.0), (-np.inf, np.inf)])
def test_axes_of_nothing_are_still_axes(low, high):
    for axis in (linear_axis("x", low, high), decade_axis("x", low, high)):
        assert axis.high > axis.low
        assert axis.ticks


def test_decades_are_written_as_powers():
    assert [text for _, text in decade_axis("k", -2.0, 2.0).ticks] == ["10⁻²", "10⁻¹", "10⁰", "10¹", "10²"]


def test_path_data_gives_the_points_back():
    points = np.random.default_rng(1).uniform(0, 500, (40, 2))
    points[[0, 7, 20, 21, 39]] = np.nan
    np.testing.assert_allclose(points_of(path(points)), points[~np.isnan(points[:, 0])], atol=0.0501)
    assert path(np.full((3, 2), np.nan)) == ""


def test_drawn_levels_are_those_of_the_file(finished):
    campaign, job, frf = campaign_of(finished), read_job(finished, "bolts-04"), read_frf(finished / "bolts-04" / "frf.csv")
    chart = figures.frf_chart(job, campaign.response("mic01"), frf)
    root = ElementTree.fromstring(svg(chart))
    panel = root.findall(".//g[@class='panel']")[0]
    frame = panel.find("rect")
    left, top, width, height = (float(frame.get(key)) / 10 for key in ("x", "y", "width", "height"))
    (x0, x1), (y0, y1) = ([float(part) for part in panel.get(key).split()] for key in ("data-x", "data-y"))
    drawn = points_of(panel.find("path[@data-name='measured']").get("d"))
    np.testing.assert_allclose(x0 + (drawn[:, 0] - left) / width * (x1 - x0), frf.frequency_hz, atol=0.06 / width * (x1 - x0))
    level = y1 - (drawn[:, 1] - top) / height * (y1 - y0)
    np.testing.assert_allclose(level, frf.responses["mic01"]["measured_db"], atol=0.11 / height * (y1 - y0))


def test_profiles_share_one_scale_and_mark_the_bolts(finished):
    jobs = [read_job(finished, name) for name in ("bolts-00", "bolts-04", "bolts-15")]
    scales = figures.profile_scales(jobs)
    charts = [figures.profile_chart(job, scales) for job in jobs]
    assert len({(chart.panels[0].y.low, chart.panels[0].y.high) for chart in charts}) == 1
    items = charts[1].panels[0].items
    marks = {item.role: item for item in items if isinstance(item, Marks)}
    assert marks["removed"].names == ("B08", "B09", "B10", "B11")
    assert len(marks["tight"].x) == 13
    spans = [item for item in items if isinstance(item, Span) and item.role == "loose"]
    assert len(spans[0].edges) == 4
    for edges, where in zip(spans[0].edges, marks["removed"].x, strict=True):
        assert edges[0] < where < edges[1]
    # B01 and B17 lie beyond the ends of the edge, and are drawn there.
    assert marks["tight"].x.min() == pytest.approx(-0.02)
    assert marks["tight"].x.max() == pytest.approx(0.52)
    assert "B08, B09, B10, B11" in charts[1].alt


def test_each_bolt_stands_at_the_nearest_group(finished):
    job = read_job(finished, "bolts-04")
    edge, aside = job.parameters["left_edge"], np.array([0.8, 0.0, 0.0])
    far = replace(edge, positions=edge.positions + aside)
    moved = [replace(bolt, position=bolt.position + aside) if bolt.name == "B17" else bolt for bolt in job.bolts]
    both = replace(job, parameters={"left_edge": edge, "right_edge": far}, bolts=tuple(moved))
    chart = figures.profile_chart(both, figures.profile_scales([both]))
    names = [{name for item in panel.items if isinstance(item, Marks) for name in item.names} for panel in chart.panels]
    assert names[1] == {"B17"}
    assert len(names[0]) == 16
    # The edges differ in length once the bolts are added, so each panel has its own labels.
    assert chart.panels[0].x != chart.panels[1].x
    assert [getattr(shape, "text", "") for shape in lay_out(chart, header=False).around].count("along the edge [m]") == 2


def test_a_group_without_positions_is_drawn_over_its_terms(finished):
    job = read_job(finished, "bolts-04")
    nowhere = {"positions": None, "arc_length": None, "reference_log10_effective": None}
    bare = replace(job, parameters={"left_edge": replace(job.parameters["left_edge"], **nowhere)})
    chart = figures.profile_chart(bare, figures.profile_scales([bare]))
    assert chart.panels[0].x.label == "term"
    assert not any(isinstance(item, Marks | Span) for item in chart.panels[0].items)


def test_phase_is_wrapped_and_cut():
    wrapped = figures._wrapped(np.array([170.0, 179.0, 181.0, 190.0, 360.0, -200.0]))
    np.testing.assert_allclose(wrapped, [170, 179, np.nan, -170, 0, 160], equal_nan=True)


def test_thinning_keeps_peaks_and_notches():
    frequency = np.linspace(20, 400, 9001)
    level = np.sin(frequency)
    level[1234], level[5678] = 90.0, -90.0
    level[100:200] = np.nan
    x, columns = figures._thinned(frequency, {"measured_db": level})
    assert len(x) < 3000
    assert {90.0, -90.0} <= set(columns["measured_db"])
    assert x[0] == 20
    assert x[-1] == 400


def test_doubtful_lines_are_runs_of_low_coherence():
    x = np.arange(10.0)
    low = np.array([1, 0, 0, 1, 1, 1, 0, 0, 0, 1], dtype=bool)
    np.testing.assert_allclose(figures._runs(x, low), [[-0.5, 0.5], [2.5, 5.5], [8.5, 9.5]])


def test_infinite_and_missing_values_are_drawn_without_harm(finished, tmp_path):
    job = read_job(finished, "bolts-04")
    edge = job.parameters["left_edge"]
    values = edge.log10_effective.copy()
    values[:3] = [np.inf, -np.inf, np.nan]
    wild = {"log10_effective": values, "upper95": np.full(31, np.inf), "reference_log10_effective": np.full(31, np.nan)}
    odd = replace(job, parameters={"left_edge": replace(edge, **wild)})
    chart = figures.profile_chart(odd, figures.profile_scales([odd]))
    ElementTree.fromstring(svg(chart))
    assert draw(chart, tmp_path / "profile.png")


def test_reduction_charts_stand_zero_errors(finished):
    reduction = reduction_of(finished)
    line = replace(reduction.certificate.held_out[0], errors={"free": 0.0, "random": 1e-5})
    step = replace(reduction.trace[0], estimate=np.zeros_like(reduction.trace[0].estimate))
    odd = replace(reduction, certificate=replace(reduction.certificate, held_out=(line,)), trace=(step,))
    for chart in (certificate.certificate_chart(odd), certificate.trace_chart(odd)):
        ElementTree.fromstring(svg(chart))
    assert certificate.certificate_chart(replace(reduction, certificate=replace(reduction.certificate, held_out=()))) is None
    assert certificate.trace_chart(replace(reduction, trace=())) is None


def test_channels_show_what_the_result_says(finished):
    job = read_job(finished, "bolts-04")
    (panel,) = figures.channel_chart(job).panels
    bars = {item.role: item.edges for item in panel.items if isinstance(item, Tiles)}
    for role, name, place in (("channel", "mic01", 0), ("channel-unseen", "mic02", 1)):
        ((left, right, low, high),) = bars[role]
        assert left < place < right
        assert (low, high) == (0.0, job.misfit_db.responses[name].final)
    (before,) = [item for item in panel.items if isinstance(item, Curve)]
    np.testing.assert_array_equal(before.y[::3], [entry.initial for entry in job.misfit_db.responses.values()])
    assert figures.channel_chart(replace(job, misfit_db=replace(job.misfit_db, responses={}))) is None


def test_a_state_stands_over_the_measured_reference(finished):
    """On its own lines, which may be others; coherence is a curve where it was measured."""
    campaign, job, own = campaign_of(finished), read_job(finished, "bolts-04"), read_frf(finished / "bolts-04" / "frf.csv")
    other = read_frf(finished / "bolts-00" / "frf.csv")
    few = Frf(other.frequency_hz[::2], {name: {key: v[::2] for key, v in found.items()} for name, found in other.responses.items()})
    chart = figures.frf_chart(job, campaign.response("mic01"), own, ("bolts-00", few))
    curves = {item.label: item for item in chart.panels[0].items if isinstance(item, Curve)}
    np.testing.assert_array_equal(curves["measured, bolts-00"].x, few.frequency_hz)
    np.testing.assert_array_equal(curves["measured, bolts-00"].y, few.responses["mic01"]["measured_db"])
    assert "measured, bolts-00" in chart.alt
    (coherence,) = [item for item in chart.panels[2].items if isinstance(item, Curve)]
    np.testing.assert_array_equal(coherence.y, own.responses["mic01"]["coherence"])
    bare = Frf(own.frequency_hz, {"mic01": {**own.responses["mic01"], "coherence": np.full(len(own.frequency_hz), np.nan)}})
    assert len(figures.frf_chart(job, campaign.response("mic01"), bare).panels) == 2


def test_damping_stands_over_the_number_of_removed_bolts(finished):
    """With its interval inside the bounds; the paper's values only where the campaign asks for them."""
    jobs = [read_job(finished, name) for name in ("bolts-00", "bolts-04", "bolts-15")]
    found = {paper: damping_chart(jobs, paper=paper).panels[0].items for paper in (True, False)}
    marks = {item.role: item for item in found[True] if isinstance(item, Marks)}
    np.testing.assert_array_equal(marks["series0"].x, [0, 4, 15])
    np.testing.assert_allclose(marks["series0"].y, [-0.3, 0.46, 2.55])
    np.testing.assert_allclose(marks["stated"].y[marks["stated"].x == 15], 3.269)
    assert "stated" not in {item.role for item in found[False]}
    (whiskers,) = [item for item in found[True] if isinstance(item, Curve)]
    np.testing.assert_allclose(whiskers.y[:2], [-0.4, -0.3 + 0.196])
    assert damping_chart(jobs[:1], paper=True) is None
    assert damping_chart([replace(job, removed=None) for job in jobs], paper=True) is None


def test_values_are_read_back_at_the_lines(finished):
    """Pictures are drawn to tenths of points, which is 41.99 Hz for the line at 42 Hz."""
    assert figures.steps_of(np.array([20.0, 20.5, 21.0])) == (20.0, 0.5)
    assert figures.steps_of(np.array([20.0, 20.5, 22.0])) is None
    assert figures.steps_of(np.array([20.0])) is None
    assert 'data-x="20 400"' in (page := (finished / "report.html").read_text(encoding="utf-8"))
    assert re.search(r'<g class="panel" data-x="20 400"[^>]* data-steps="20 [0-9.]+"', page)


def tiny(title: str = "a", last: float = 3.0) -> Chart:
    axis = linear_axis("x", 0.0, 4.0)
    curve = Curve("updated", np.array([0.0, 1.0, 2.0]), np.array([1.0, 2.0, last]), "c")
    return Chart(title=title, subtitle="", alt="alt", panels=(Panel(x=axis, y=axis, items=(curve,)),), width=200.0, height=120.0)


def test_a_figure_is_drawn_only_when_it_changes(tmp_path):
    file = tmp_path / "a.png"
    assert draw(tiny(), file)
    assert not draw(tiny(), file)
    assert not is_current(tiny(last=3.0001), file)
    assert draw(tiny(title="b"), file)
    whole = file.read_bytes()
    file.write_bytes(whole[:-20])
    assert draw(tiny(title="b"), file)
    assert file.read_bytes() == whole
    file.write_bytes(b"\x89PNG\r\n\x1a\n\xff\xff\xff\xfftEXt" + b"IEND\xaeB`\x82")
    assert draw(tiny(title="b"), file)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.png"]


def test_texts_are_never_read_as_mathematics(tmp_path):
    assert draw(tiny(title=r"$\frac{1}{$ 中文 &<b>"), tmp_path / "a.png")


def test_shapes_stay_inside_the_picture(finished):
    job = read_job(finished, "bolts-15")
    drawing = lay_out(figures.profile_chart(job, figures.profile_scales([job])), header=True)
    for shape in [*drawing.around, *(shape for frame in drawing.frames for shape in frame.shapes)]:
        points = getattr(shape, "points", None)
        points = np.array([[shape.x, shape.y]]) if points is None else points[np.isfinite(points).all(axis=1)]
        assert (points >= 0).all()
        assert (points <= [drawing.width, drawing.height]).all()


def test_every_role_has_its_colour_in_the_style_sheet():
    sheet = css()
    for role in STYLES:
        assert sheet.count(f"--{role}:") == 2
        assert f".r-{role}{{" in sheet


class TestLCurve:
    ETA = np.logspace(-2.0, 4.0, 9)

    def job(self, finished, corner, data=None, penalty=None):
        data = 10.0 ** np.array([3.0, 3.0, 3.01, 3.02, 3.1, 3.6, 3.9, 4.2, 4.5]) if data is None else data
        penalty = 10.0 ** np.array([3.0, 2.5, 2.0, 1.5, 1.1, 1.0, 0.9, 0.2, -1.0]) if penalty is None else penalty
        at = None if corner is None else CornerRecord(data=corner[0], penalty=corner[1])
        curve = LCurveRecord.model_construct(eta=self.ETA, data=data, penalty=penalty, at=at, chosen=12.5)
        return replace(read_job(finished, "bolts-04"), l_curve=curve)

    def test_the_corner_is_marked(self, finished, tmp_path):
        chart = l_curve_chart(self.job(finished, (1250.0, 12.0)))
        (corner,) = [item for item in chart.panels[0].items if isinstance(item, Marks) and item.role == "corner"]
        np.testing.assert_allclose([corner.x[0], corner.y[0]], np.log10([1250.0, 12.0]))
        assert "corner at η = 12.5" in chart.subtitle
        ElementTree.fromstring(svg(chart))
        assert draw(chart, tmp_path / "l-curve.png")

    def test_without_a_corner_it_says_so(self, finished):
        chart = l_curve_chart(self.job(finished, None))
        assert chart.subtitle == "no corner: η = 12.5 was used"
        assert not [item for item in chart.panels[0].items if isinstance(item, Marks) and item.role == "corner"]

    @pytest.mark.parametrize("values", [np.zeros(9), np.ones(9), 10.0 ** np.linspace(3.0, 3.01, 9)])
    def test_odd_values_stand(self, finished, values):
        ElementTree.fromstring(svg(l_curve_chart(self.job(finished, None, values, values))))

    def test_no_curve(self, finished):
        assert l_curve_chart(read_job(finished, "bolts-04")) is None


# -- readable -----------------------------------------------------------------------------------------------------------


def contrast(a: str, b: str) -> float:
    """WCAG 2."""
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def variables(sheet: str) -> dict[str, tuple[str, str]]:
    """Colours of the page's own style sheet, light and dark."""
    light, dark = sheet.split("@media screen and (prefers-color-scheme: dark)")[:2]
    found = [dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", part)) for part in (light, dark)]
    assert set(found[0]) == set(found[1])
    return {name: (colour, found[1][name]) for name, colour in found[0].items()}


def test_words_stand_out_from_what_is_behind_them():
    """AA: 4.5 to 1, light and dark, on the page, on cards, on badges and on the cells of the strip."""
    sheet = files("lrbc_cli.report").joinpath("page.css").read_text(encoding="utf-8")
    page = variables(sheet) | {role: (style.light, style.dark) for role, style in STYLES.items()}
    words = {name: ("page", "card") for name in ("text", "strong", "soft", "link")} | {
        name: ("page",) for name in ("bad", "warn", "loose-name")
    }
    words |= {"good": ("good-back",), "outside-on": ("outside",), "on0": ("p0", "unknown")}
    pairs = [(word, back) for word, backs in words.items() for back in backs]
    pairs += [(name, f"{name}-back") for name in ("bad", "warn")] + [(f"on{step}", f"p{step}") for step in range(PROBABILITIES)]
    weak = {(word, back): worst for word, back in pairs if (worst := min(map(contrast, page[word], page[back]))) < 4.5}
    assert not weak
    # Words use no other colours.
    used = {name for rule in re.findall(r"\bcolor: var\(--([\w-]+)\)", sheet) for name in [rule]}
    assert used <= {word for word, _ in pairs}


def test_letters_are_large_enough_on_a_phone(finished):
    """A drawing is never narrower than its letters need: narrower screens scroll it."""
    page = (finished / "report.html").read_text(encoding="utf-8")
    drawings = re.findall(r'<svg viewBox="0 0 (\d+) \d+" role="img".*?</svg>', page, re.S)
    # The strip of verdicts is two drawings, which share their width.
    least, left, right = re.search(
        r'class="rows" style="min-width:(\d+)px"><svg viewBox="0 0 (\d+) [^>]*>.*?</svg><svg viewBox="\2 0 (\d+) ', page, re.S
    ).groups()
    strip = page.split('class="rows"')[1].split("</div>")[0]
    sizes = [float(size) * float(least) / (float(left) + float(right)) for size in re.findall(r'font-size="([\d.]+)"', strip)]
    assert len(sizes) > 20
    for drawing in re.finditer(r'<svg viewBox="0 0 (\d+) \d+" role="img" [^>]*?style="min-width:(\d+)px".*?</svg>', page, re.S):
        width, least = float(drawing.group(1)), float(drawing.group(2))
        sizes += [float(size) * least / width for size in re.findall(r'font-size="([\d.]+)"', drawing.group(0))]
    assert len(drawings) >= 18
    assert min(sizes) >= 9.0


def test_words_in_figures_have_colours_for_words(finished):
    page = (finished / "report.html").read_text(encoding="utf-8")
    roles = set(re.findall(r'<text class="t r-([\w-]+)"', page))
    assert roles <= {"text", "strong", "loose-name", "outside-on", *(f"on{step}" for step in range(PROBABILITIES))}


# -- for print ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "expected"), [(200.0, 90.0), (430.0, 140.0), (620.0, 190.0), (980.0, 190.0)])
def test_figures_for_print_have_widths_of_journals(tmp_path, width, expected):
    chart = replace_chart(tiny(), width=width)
    publish(chart, tmp_path / "a.svg")
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    assert float(root.get("width").removesuffix("pt")) / 72 * 25.4 == pytest.approx(expected, abs=0.01)
    assert not root.findall(".//{*}text")
    publish(chart, tmp_path / "a.pdf")
    content = (tmp_path / "a.pdf").read_bytes()
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+)", content).group(1)
    assert float(box) / 72 * 25.4 == pytest.approx(expected, abs=0.01)
    assert b"/FontFile2" in content
    assert b"/CreationDate" not in content


@pytest.mark.parametrize("count", [6, 12, 20, 100])
def test_names_under_bars_do_not_run_together(count: int) -> None:
    """Those looked for first are there, and a character lies between any two."""
    names = [f"R{k:02d}" for k in range(count)]
    ticks = figures._some(names, first=[count - 1])
    assert (count - 1, names[-1]) in ticks
    slot = (430.0 - 60.0) / (count + 0.2)
    places = [place for place, _ in ticks]
    assert min(np.diff(places)) * slot >= 4 * 0.6 * 9.0
    assert len(ticks) == count or count > 12


@pytest.mark.parametrize(("unit", "written"), [("m/s²/N", "(m/s²)/N"), ("Pa/N", "Pa/N"), ("(m/s²)/N", "(m/s²)/N"), ("1/N", "1/N")])
def test_units_of_frfs_can_be_read_in_one_way(unit: str, written: str) -> None:
    assert over_force(unit) == written
