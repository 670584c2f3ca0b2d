"""``check``: what it says of the model, the measurements and the plan; it changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from campaigns import Folder, box, chain_folder, frame

Matrices = dict[str, np.ndarray]


def spoil(folder: Folder, change: Callable[[Matrices], object]) -> None:
    """Change K and M as dense arrays."""
    matrices = {name: scipy.io.mmread(folder.data / f"{name}.mtx", spmatrix=False).toarray() for name in "KM"}
    change(matrices)
    for name, matrix in matrices.items():
        scipy.io.mmwrite(folder.data / f"{name}.mtx", sp.coo_array(matrix), symmetry="general", precision=17)


def section(text: str, title: str) -> list[str]:
    """Lines below a title."""
    lines = text.splitlines()
    start = lines.index(title) + 1
    stop = next((i for i in range(start, len(lines)) if not lines[i].startswith(" ")), len(lines))
    return [line.strip() for line in lines[start:stop]]


def warnings(folder: Folder) -> list[str]:
    result = folder.run("check")
    assert result.code == 0, result.stderr
    return section(result.stdout, "warnings") if "warnings" in result.stdout.splitlines() else []


def test_the_plan_of_the_frame(tmp_path: Path) -> None:
    folder = frame(tmp_path / "new")
    before = folder.listing()
    result = folder.run("check")
    assert (result.code, result.stderr) == (0, "")
    assert folder.listing() == before
    files = section(result.stdout, "files")
    assert "stiffness: symmetric banner: the other triangle was filled in" in files
    assert "stiffness: 414 x 414, 9070 non-zeros, matrix-market, float64" in files
    assert "response acc3: row 0 of sensors.mtx, acceleration" in files
    assert "excitation hammer: node 48 UZ, 0.00 mm from the given point" in files
    assert "parameters left_edge: stiffness, 10 terms, 10 parameters, 0.360 m along the edge" in files
    model = section(result.stdout, "model")
    assert model[0] == "414 DOFs: 414 structural, 0 acoustic"
    assert "symmetry: symmetric" in model
    assert any(line.startswith("mass sum over translations: UZ 0.8") for line in model)
    assert "10 rank-one terms (same left and right vectors), 1 excitation(s), 4 response(s), 3 used" in model
    reduced = section(result.stdout, "reduced model")
    assert reduced[0].startswith("band 30 to 500 Hz, tolerance 0.001, back end ")
    assert "cache: miss (the cache is empty)" in reduced
    estimate = next(line for line in reduced if line.startswith("estimate:"))
    for part in (" s, a peak of ", " GB", "entries of the factors", "available on this machine"):
        assert part in estimate
    predicted = folder.run("check", "--json").json["reduction"]
    assert predicted["peak_bytes"] > sum(predicted["parts_bytes"].values()) > 0
    assert predicted["seconds"] > 0
    # Non-zeros of this small model: more than its matrix has, less than a full one would.
    assert 9070 / 2 < predicted["factor_nonzeros"] < 414**2
    jobs = section(result.stdout, "jobs")
    assert any(line.startswith("tight: 471 lines from 30 to 500 Hz") and "4 of 4 responses matched" in line for line in jobs)
    stated = "quantities not stated in the file, taken as in the campaign: acc1, acc2, acc3, acc4"
    assert jobs.count(stated) == 3
    assert len(jobs) == 12
    mapping = "acc1: column acc1_real: acc1, quantity unknown"
    assert mapping not in jobs
    assert section(folder.run("check", "-v").stdout, "jobs").count(mapping) == 3
    assert "loose-all: runs (no result yet)" in jobs
    assert "warnings" not in result.stdout.splitlines()


def test_the_plan_for_programs(frame: Folder) -> None:
    before = frame.listing()
    tree = frame.run("check", "--json").json
    assert frame.listing() == before
    assert (tree["dofs"], tree["acoustic_dofs"], tree["terms"]) == (414, 0, 10)
    assert tree["parameters"] == {"left_edge": 10}
    assert tree["responses"] == ["acc1", "acc2", "acc3", "acc4"]
    assert tree["cache"]["hit"] is True
    # Nothing is to be built.
    assert tree["reduction"] is None
    assert tree["jobs"] == {job: {"run": False, "reason": "nothing changed"} for job in ("tight", "loose-2", "loose-all")}
    assert tree["errors"] == {}
    assert tree["warnings"] == []
    assert "model" in tree["text"]


def test_coupling_of_the_box(box: Folder) -> None:
    model = section(box.run("check").stdout, "model")
    assert model[0] == "32 DOFs: 8 structural, 24 acoustic"
    assert any("u-p coupled, M_as = -kappa K_saᵀ with kappa = 1" in line and "symmetrised" in line for line in model)

    def mismatch(matrices: Matrices) -> None:
        A = matrices["K"][:8, 8:]
        A[np.nonzero(A)] *= np.linspace(0.9, 1.1, np.count_nonzero(A))

    spoil(box, mismatch)
    model = section(box.run("check").stdout, "model")
    found = next(line for line in model if line.startswith("symmetry:"))
    assert "not transposes of each other" in found
    assert "LU" in found
    defect = float(found.split("defect ")[1].split(")")[0])
    assert 0.02 < defect < 0.1
    # It still serves: LU takes over.
    assert box.run("reduce").code == 0


def test_half_a_symmetric_matrix(tmp_path: Path) -> None:
    folder = chain_folder(tmp_path / "new")
    (folder.data / "one.csv").write_text(
        "frequency_hz,a_real,a_imag,b_real,b_imag\n" + "".join(f"{f},1,0,1,0\n" for f in range(20, 501, 10))
    )
    assert warnings(folder) == []
    spoil(folder, lambda matrices: matrices.update(K=np.tril(matrices["K"])))
    found = warnings(folder)
    assert len(found) >= 1
    assert "stiffness: only one triangle is stored" in found[0]
    assert "relative asymmetry" in folder.run("check").stdout


def test_singular_mass_and_orphans(tmp_path: Path) -> None:
    folder = chain_folder(tmp_path / "new")
    (folder.data / "one.csv").write_text(
        "frequency_hz,a_real,a_imag,b_real,b_imag\n" + "".join(f"{f},1,0,1,0\n" for f in range(20, 501, 10))
    )

    def massless(matrices: Matrices) -> None:
        matrices["M"][4:6] = 0.0

    spoil(folder, massless)
    assert "2 massless DOFs (singular mass matrix): allowed" in folder.run("check").stdout
    assert warnings(folder) == []

    def orphan(matrices: Matrices) -> None:
        matrices["K"] = np.pad(matrices["K"], (0, 1))
        matrices["M"] = np.pad(matrices["M"], (0, 1))

    spoil(folder, orphan)
    assert any("1 DOFs have neither stiffness nor mass" in line for line in warnings(folder))


@pytest.mark.parametrize("loss", [0.02, -0.02])
def test_hysteretic_damping(box: Folder, loss: float) -> None:
    def complex_stiffness(matrices: Matrices) -> None:
        matrices["K"] = matrices["K"].astype(complex)
        matrices["K"][:8, :8] *= 1 + 1j * loss

    spoil(box, complex_stiffness)
    result = box.run("check")
    assert result.code == 0
    model = section(result.stdout, "model")
    assert any("stiffness is complex (hysteretic damping), loss factor about" in line for line in model)
    assert any("imaginary part of the stiffness is negative" in line for line in warnings(box)) == (loss < 0)


def test_penalties_are_told(box: Folder) -> None:
    def penalty(matrices: Matrices) -> None:
        matrices["K"][7, 7] *= 1e12

    spoil(box, penalty)
    assert any("1 structural DOFs have a huge diagonal" in line for line in warnings(box))


def test_a_distant_node_is_told(box: Folder) -> None:
    box.replace("- 2.0\n    - 0.0\n    - 0.1", "- 1.98\n    - 0.0\n    - 0.1")
    found = warnings(box)
    assert len(found) == 1
    assert "responses.mic3: the nearest node 124 is 20.0 mm away (mesh size 87 mm)" in found[0]
    assert "warning: responses.mic3" in box.run("check").stderr
    assert "response mic3: node 124 PRES, 20.00 mm from the given point, pressure" in box.run("check").stdout


def test_a_response_that_is_only_reported_may_be_missing(box: Folder) -> None:
    words = ("update.responses=[mic1, mic2, acc1]", "responses.mic3.record=nothing", "update.comparison=direct")
    overrides = tuple(part for word in words for part in ("--override", word))
    result = box.run("check", *overrides)
    assert result.code == 0
    assert "3 of 4 responses matched" in result.stdout
    assert "tight.uff: no record of response mic3, which is only reported" in section(result.stdout, "warnings")
    assert box.run("update", *overrides).code == 0
    tree = box.result("loose")
    assert tree["misfit_db"]["responses"]["mic3"]["final"] is None
    assert tree["misfit_db"]["held_out_final"] is None
    assert tree["notes"] == ["loose.uff: no record of response mic3, which is only reported"]
    assert box.run("report").code == 0


def test_lines_beyond_the_band_are_left_out_and_noted(box: Folder) -> None:
    band = ("--override", "reduction.band=[101.0, 301.0]")
    result = box.run("check", *band)
    assert result.code == 0
    assert "tight: 100 lines from 102 to 300 Hz (41 below and 50 above the band left out)" in result.stdout
    assert box.run("update", *band).code == 0
    assert len(box.result("tight")["lines"]["frequency_hz"]) == 100


def test_unusable_measurements_leave_the_rest_of_the_plan(frame: Folder) -> None:
    (frame.data / "frf" / "loose-2.csv").write_bytes(b"")
    before = frame.listing()
    result = frame.run("check")
    assert result.code == 3
    assert frame.listing() == before
    jobs = section(result.stdout, "jobs")
    assert f"loose-2: unusable ({frame.data / 'frf' / 'loose-2.csv'}: the file is empty)" in jobs
    assert "tight: kept (nothing changed)" in jobs
    assert "loose-all: kept (nothing changed)" in jobs
    assert "loose-2.csv: the file is empty" in result.stderr


def test_no_jobs_yet(tmp_path: Path) -> None:
    folder = box(tmp_path / "new")
    result = folder.run("check", "--override", "jobs={}", "--override", "update.reference=")
    assert result.code == 0
    assert section(result.stdout, "jobs") == ["none"]
    assert folder.run("reduce", "--override", "jobs={}", "--override", "update.reference=").code == 0


def test_check_of_a_fresh_clone_writes_nothing(tmp_path: Path) -> None:
    folder = box(tmp_path / "new")
    before = folder.listing()
    for args in ([], ["--json"], ["-v"], ["-q"]):
        assert folder.run("check", *args).code == 0
    assert folder.listing() == before
