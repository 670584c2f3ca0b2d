"""The picture of the structure: bolts by verdict, one figure a job, turnable on the page."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from fake_campaign import campaign_of, reseal

from lrbc_cli.errors import DataError
from lrbc_cli.report.drawing.structure import Camera, scene_of
from lrbc_cli.report.html import resource
from lrbc_cli.report.parts.structure import structure_chart, structure_page, structure_parts
from lrbc_cli.report.write import write_report, write_structure
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.shapes import ShapesRecord
from lrbc_cli.results.store import read_job, write, write_sealed
from lrbc_cli.results.structure import StructureRecord


def plate(output: Path, lift: float = 0.0) -> StructureRecord:
    """A grid of 6 by 5 nodes beside the bolts of the campaign, curved where it is lifted."""
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(0.1, 0.9, 6), np.linspace(0.2, 0.7, 5)))
    number = np.arange(30).reshape(5, 6)
    pairs = [*zip(number[:, :-1].ravel(), number[:, 1:].ravel(), strict=True), *zip(number[:-1].ravel(), number[1:].ravel(), strict=True)]
    point = {"direction": [0.0, 0.0, 1.0], "quantity": "acceleration", "used": True}
    return StructureRecord.checked(
        {
            "campaign": "soundbox-left-edge",
            "fields": [
                {"field": "structure", "count": 30, "xyz": np.column_stack([x, y, lift * x**2]), "lines": np.array(pairs).ravel()},
                {"field": "acoustic", "count": 900, "xyz": [[0.0, 0.0, 0.5], [1.0, 1.0, 1.0]]},
            ],
            "bolts": [bolt.tree() for bolt in campaign_of(output).bolts],
            "excitations": [{"name": "hammer", "position": [0.4, 0.4, 0.0], **point, "quantity": "force"}],
            "responses": [
                {"name": "acc</script>", "position": [0.7, 0.5, 0.0], **point},
                {"name": "mic01", "position": [0.5, 0.3, 0.4], "direction": None, "quantity": "pressure", "used": False},
            ],
            "terms": [
                {"name": "edge", "kind": "stiffness", "along_edge": True, "positions": [[0.1, 0.2, 0], [0.1, 0.7, 0]], "springs": []}
            ],
            "notes": ["2 of 900 acoustic nodes are drawn"],
        }
    )


def job_of(output: Path, name: str = "bolts-04") -> JobRecord:
    job = read_job(output, name)
    assert isinstance(job, JobRecord)
    return job


class Elements(HTMLParser):
    """Start tags, and the text of each kind of script."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: dict[str, str] = {}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        if self.found and self.found[-1][0] == "script":
            kind = str(self.found[-1][1].get("type", "code"))
            self.scripts[kind] = self.scripts.get(kind, "") + data


def test_every_job_has_its_picture_and_the_page_a_chooser(output: Path) -> None:
    record = plate(output)
    write_sealed(output / "structure.json", record)
    write_report(output, workers=1)
    for name in ("bolts-00", "bolts-04"):
        assert (output / name / "structure.png").read_bytes().startswith(b"\x89PNG")
    page = Elements((output / "report.html").read_text(encoding="utf-8"))
    assert [entry["value"] for name, entry in page.found if name == "option"][:2] == ["0", "1"]
    scene = json.loads(page.scripts["application/json"])
    job = job_of(output)
    # The first job with loose bolts is shown first; colours and signs are those of the strip.
    assert scene["first"] == 1
    assert scene["bolts"] == len(record.bolts) == len(scene["jobs"][1]["bolts"])
    for bolt, (glyph, title) in zip(job.bolts, scene["jobs"][1]["bolts"], strict=True):
        assert title.startswith(f"{bolt.name}: {bolt.verdict}")
        assert ("loose-on" in scene["glyphs"][glyph]) == (bolt.verdict == "loose")
    assert job.names("loose")
    assert scene["jobs"][1]["text"].startswith("bolts-04: ")
    assert scene["marks"][1][0] == "acc</script>"
    # Nearer, the structure is in the middle of the picture: not that of all that is placed on it.
    middle = 0.5 * (np.array(scene["nodes"]).reshape(-1, 3).min(axis=0) + np.array(scene["nodes"]).reshape(-1, 3).max(axis=0))
    np.testing.assert_allclose(scene["middle"], middle, atol=1.0)
    assert scene["middle"][2] != 0
    assert 'href="bolts-04/structure.png"' in (output / "report.html").read_text(encoding="utf-8")


def with_shapes(output: Path, name: str, nodes: int = 30) -> ShapesRecord:
    """Two shapes of a job, for which its result vouches."""
    wave = np.sin(np.arange(3 * nodes))
    values = {"real": wave / np.abs(wave).max(), "imag": 0.1 * wave}
    points = {"measured_real": [0.5, None], "measured_imag": [0.0, None], "modelled_real": [0.4, 1.0], "modelled_imag": [0.1, 0.0]}
    shapes = [{"frequency_hz": f, "largest": 1e-6, "cosine": cosine, **values, **points} for f, cosine in ((96.0, 0.97), (312.0, None))]
    tree = {"job": name, "excitation": "hammer", "nodes": nodes, "responses": ["acc</script>", "mic01"], "shapes": shapes}
    record = ShapesRecord.checked(tree)
    digest = write(output / name / "shapes.json", record)
    job = job_of(output, name).tree()
    job["provenance"]["files"] = {**(job["provenance"].get("files") or {}), "shapes.json": digest}
    reseal(output / name / "result.json", job)
    return record


def test_shapes_are_on_the_page_and_a_figure(output: Path) -> None:
    write_sealed(output / "structure.json", plate(output))
    record = with_shapes(output, "bolts-04")
    with_shapes(output, "bolts-00", nodes=29)
    write_report(output, workers=1)
    text = (output / "report.html").read_text(encoding="utf-8")
    page = Elements(text)
    controls = {entry["name"] for name, entry in page.found if name in ("select", "input") and "name" in entry}
    assert {"shape", "size"} <= controls
    assert any(name == "button" and entry.get("data-do") == "play" for name, entry in page.found)
    first, second = json.loads(page.scripts["application/json"])["jobs"][:2]
    # Those of other nodes than are drawn are left out.
    assert first["shapes"] == []
    assert [shape[0] for shape in second["shapes"]] == ["96 Hz, FDAC 0.97", "312 Hz"]
    decoded = np.frombuffer(base64.b64decode(second["shapes"][0][1]), dtype=np.int8) / 127
    np.testing.assert_allclose(decoded, record.shapes[0].real, atol=0.5 / 127 + 1e-9)
    (point,) = second["shapes"][0][3]
    assert point[3:] == [0.0, 0.0, 1.0, 0.5, 0.0, 0.4, 0.1]
    assert "bolts-04/shapes.png" in text
    assert (output / "bolts-04" / "shapes.png").read_bytes().startswith(b"\x89PNG")
    assert not (output / "bolts-00" / "shapes.png").exists()


def test_the_scene_of_what_is_flat_is_a_plan_and_else_a_view_in_space(output: Path) -> None:
    flat, curved = scene_of(plate(output)), scene_of(plate(output, lift=0.3))
    np.testing.assert_allclose(flat.camera.axes, [[1, 0, 0], [0, 1, 0]], atol=1e-12)
    assert (flat.plane, curved.plane) == ("xy", "")
    for camera in (flat.camera, curved.camera, Camera(123.0, -40.0)):
        np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(2), atol=1e-12)
    # Air is left out of a plan.
    assert flat.high[0] < 1.0
    assert curved.high[0] == 1.0
    assert flat.labels["air"] == "air, 2 of 900 nodes"
    assert {"sensor", "microphone-unseen", "hammer", "mesh", "term"} <= set(flat.labels)
    for record in (plate(output), plate(output, lift=0.3)):
        job = job_of(output)
        chart = structure_chart(record, job)
        words = {item.text for panel in chart.panels for item in panel.items if hasattr(item, "text")}
        # Where there is no room, some names are left out.
        assert len({*job.names("loose")} & words) >= (4 if record.fields[0].xyz[:, 2].max() == 0.0 else 2)
        assert {"hammer", "mic01"} <= words
        # Nothing lies outside the frame.
        for item in chart.panels[0].items:
            if getattr(item, "y", None) is not None and np.size(item.y):
                x, y = chart.panels[0].x, chart.panels[0].y
                assert x.low <= np.nanmin(item.x) <= np.nanmax(item.x) <= x.high
                assert y.low <= np.nanmin(item.y) <= np.nanmax(item.y) <= y.high


def test_a_node_without_a_line_beside_a_mesh_is_drawn(output: Path) -> None:
    record = plate(output)
    solid, air = record.fields
    alone = solid.model_copy(update={"xyz": np.vstack([solid.xyz, solid.xyz.mean(axis=0)])})
    structure_chart(record.model_copy(update={"fields": (alone, air)}))


def test_the_page_of_the_picture_needs_nothing_from_outside(output: Path) -> None:
    text = structure_page(plate(output))
    page = Elements(text)
    assert all(not ({"src", "href"} & set(attributes)) for _, attributes in page.found)
    assert not re.search(r"url\(|@import|https?://(?!www\.w3\.org/2000/svg)", text)
    assert json.loads(page.scripts["application/json"])["jobs"] == []
    # Still where scripts do not run.
    assert any(name == "svg" and attributes.get("role") == "img" for name, attributes in page.found)


def test_no_picture_without_coordinates(output: Path) -> None:
    assert write_structure(output, StructureRecord.checked({"campaign": "soundbox-left-edge", "reason": "no coordinates"})) == []
    write_report(output, workers=1)
    assert 'class="turnable"' not in (output / "report.html").read_text(encoding="utf-8")
    assert not list(output.rglob("structure.png"))


def test_a_damaged_structure_is_told(output: Path) -> None:
    tree = plate(output).tree()
    del tree["bolts"][0]["position"]
    reseal(output / "structure.json", tree)
    with pytest.raises(DataError, match=r"structure.json(.|\n)*bolts\[0\].position"):
        write_report(output, workers=1)


BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no browser")
@pytest.mark.parametrize("camera", ["-90.0,90.0", "-60.0,25.0", "-60.0,5.0", "-90.0,0.0"])
def test_names_do_not_stand_on_one_another_on_a_narrow_page(output: Path, camera: str) -> None:
    """Those of loose bolts are there whatever the view; the others, and the ticks, give way."""
    job = job_of(output)
    text = "".join(filter(None, structure_parts(plate(output), [job])))
    data = re.search(r'"camera":\[[-\d.]+,[-\d.]+\]', text)
    assert data is not None
    page = output / "turned.html"
    turned = text.replace(data[0], f'"camera":[{camera}]')
    page.write_text(f"<meta charset=utf-8><body style='width:360px'>{turned}<script>{resource('structure.js')}</script>", encoding="utf-8")
    line = [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--window-size=390,800", "--virtual-time-budget=20000"]
    for _ in range(5):
        done = subprocess.run([*line, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=60, check=True)
        # The document may be had before the first frame is drawn.
        if '<svg aria-hidden="true" viewBox' in done.stdout:
            break
    boxes, shown = list[tuple[str, float, float, float]](), set[str]()
    for attributes, name in re.findall(r'<text ([^>]*class="t [^>]*)>([^<]+)</text>', done.stdout):
        own = dict(re.findall(r'([\w-]+)="([^"]*)"', attributes))
        # Letters of symbols are none of them.
        if "display: none" in own.get("style", "") or "x" not in own or name in ("n/c", "?", "✕"):
            continue
        # No letter is narrower on average.
        long = 0.45 * 11 * len(name)
        left = float(own["x"]) - {"start": 0.0, "middle": 0.5, "end": 1.0}[own["text-anchor"]] * long
        boxes.append((name, left, left + long, float(own["y"])))
        shown.add(name)
    assert {bolt.name for bolt in job.bolts if bolt.verdict == "loose"} <= shown
    for k, (name, left, right, base) in enumerate(boxes):
        for other, low, high, beside in boxes[:k]:
            assert not (left < high and low < right and abs(base - beside) < 8), (name, other)
