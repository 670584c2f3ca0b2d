"""One part of an assembly with the material of another."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from looking import seen
from rows import COUNT, HZ, InputsAlone, assembly, told
from systems import whole

from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.looking import unexplained
from lrbc_cli.campaign.looking.causes import added, parts, rescaled
from lrbc_cli.campaign.looking.causes.added import added_text, loaded_text
from lrbc_cli.campaign.looking.causes.held import held_text, supports_of, supports_text, tied_text
from lrbc_cli.campaign.looking.causes.parts import lump_text
from lrbc_cli.campaign.looking.odd.left_on import left_on_text
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.looking.trials import Cause
from lrbc_cli.campaign.looking.unexplained import gains_by_chance
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.mesh_parts import MeshPart
from lrbc_cli.updating.comparison.scale import Known, Offset


@pytest.mark.parametrize(
    ("factors", "what"),
    [
        ((2.9, 1.0), "the mass of the part of 40 nodes at x 0 to 0.8, y 0.1, z 0 m is probably about 2.9 times too small"),
        ((1.0, 1.0 / 3.0), "the stiffness of the part of 40 nodes at x 0 to 0.8, y 0.1, z 0 m is probably about 2.9 times too large"),
        (
            (1.0 / 2.9, 1.0 / 3.0),
            "the stiffness and mass of the part of 40 nodes at x 0 to 0.8, y 0.1, z 0 m are probably about 2.9 times",
        ),
    ],
)
def test_a_part_of_another_material(factors: tuple[float, float], what: str) -> None:
    assert told(assembly(), assembly(*factors)).startswith(what)


def test_feet_and_what_a_baseline_leaves_are_no_share_of_a_part() -> None:
    """A frame of steel, modelled as of aluminium, stands on the same feet; springs that were subtracted leave rounding errors."""
    feet = sp.diags_array(np.where(np.isin(np.arange(2 * COUNT), (COUNT + 2, COUNT + 37)), 2e6, 0.0))
    rounding = sp.lil_array((2 * COUNT, 2 * COUNT))
    rounding[0, COUNT + 30] = rounding[COUNT + 30, 0] = 1e-7
    given, true = (replace(model, K=sp.csc_array(model.K + feet + rounding)) for model in (assembly(1.0 / 2.9, 1.0 / 3.0), assembly()))
    text = told(given, true)
    assert text.startswith(
        "the stiffness and mass of the part of 40 nodes at x 0 to 0.8, y 0.1, z 0 m are probably about 2.9 times too small"
    ), text
    left = re.search(r"to ([\d.]+) dB", text)
    assert left is not None
    assert float(left[1]) < 1.0  # of proportional damping


def test_parts_of_one_section_are_wrong_together() -> None:
    """Two stringers, and a third that is heavier."""

    def part(at: int, mass: float) -> MeshPart:
        own = np.arange(12) // 3 == at
        return MeshPart(own, sp.csc_array(np.diag(5.0 * own)), sp.csc_array(np.diag(mass * own)))

    first, second = parts._grouped([part(0, 1.0), part(1, 1.2), part(2, 1.0)])
    assert [np.flatnonzero(each.own)[0] for each in first.parts] == [0, 6]
    np.testing.assert_array_equal(first.M.diagonal(), [1.0] * 3 + [0.0] * 3 + [1.0] * 3 + [0.0] * 3)
    np.testing.assert_array_equal(first.times(2.0, 3.0).K.diagonal(), 2.0 * first.K.diagonal())
    assert len(second.parts) == 1


@pytest.mark.parametrize(
    ("own", "db", "error_db", "chance"),
    [((1,), -9.9, 8.0, True), ((1,), -20.0, 8.0, False), ((1,), -9.9, 1.0, False), ((0, 1, 2, 3), -9.9, 8.0, False)],
)
def test_a_gain_of_one_response_beside_a_far_model(own: tuple[int, ...], db: float, error_db: float, chance: bool) -> None:
    """A factor that no unit has, by chance; not a digit of a sensitivity, nor beside a model that is near, nor of most responses."""
    rng = np.random.default_rng(2)
    model = 10.0 ** (rng.normal(0.0, 10.0, (150, 6)) / 20.0) + 0j
    responses = [SimpleNamespace(name=f"a{i}", quantity="acceleration", input=0, node=i, direction="UZ") for i in range(6)]
    update = SimpleNamespace(reference="tight")
    inputs: Any = SimpleNamespace(responses=responses, campaign=SimpleNamespace(update=update))
    job = seen(model * 10.0 ** (rng.normal(0.0, error_db, model.shape) / 20.0), model[None], hz=HZ, inputs=inputs)
    offsets = [Offset(response=i, db=db, half=0.5, power=0, known=(), before=11.2, after=5.5, named=i in own) for i in range(6)]
    found = [Finding(text="a factor", kind=Kind.UNITS, responses=own)]
    assert gains_by_chance(job, found, offsets) == chance
    assert not gains_by_chance(replace(job, job="state"), found, offsets)


def test_moduli_differ_by_more_than_densities(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of steel and aluminium: 210 and 70 GPa, 7850 and 2700 kg/m3."""
    tried = list[FeModel]()

    def misfit(_: Seen, model: FeModel) -> tuple[float, float]:
        tried.append(model)
        return 9.0, 9.0

    monkeypatch.setattr(parts, "_misfit", misfit)
    assert told(assembly(), assembly(2.9, 3.0)) == ""
    largest = [max((getattr(model, name).diagonal() / getattr(assembly(), name).diagonal()).max() for model in tried) for name in "KM"]
    assert largest == pytest.approx([3.0, 2.9])


def test_nothing_is_said_of_right_parts_or_of_one() -> None:
    """Errors of some per cent are left to the calibration; a single part is examined elsewhere."""
    assert told(assembly(), assembly(1.05, 0.93)) == ""
    assert told(assembly(joined=True), assembly(2.9, joined=True)) == ""


@pytest.mark.parametrize("mass", [2.9, 1.0 / 2.9])
@pytest.mark.slow
def test_a_density_that_is_wrong_as_a_whole(monkeypatch: pytest.MonkeyPatch, mass: float) -> None:
    """The level of the FRFs tells a wrong mass from a wrong stiffness; at few lines narrow peaks are missed."""
    monkeypatch.setattr(rescaled, "mistake_text", lambda _, matrix, size: f"{matrix} {size:.2g}")

    def lightly_damped(model: FeModel) -> FeModel:
        return replace(model, C=sp.csc_array(0.1 * model.C))

    given, true = lightly_damped(assembly()), lightly_damped(assembly(1.03 * mass, first=mass))
    wrong = told(given, true, lambda job, _: rescaled.scaled_text(job, mass**-0.5, "too heavy") or "")
    assert wrong == f"too heavy; mass {1.0 / mass:.2g}"


@pytest.mark.parametrize(
    ("stiff", "heavy", "said"),
    [
        (1.5**3, 1.5, "The thickness of plates, or the height of beams, is probably 1.5 times too large in the model: with the third"),
        (
            1.8**-3,
            1.0 / 1.8,
            "The thickness of plates, or the height of beams, is probably 1.8 times too small in the model: with the third",
        ),
        (2.25, 1.0, "too stiff; stiffness 2."),
    ],
)
def test_a_thickness_is_told_apart_from_one_matrix_by_the_level(
    monkeypatch: pytest.MonkeyPatch, stiff: float, heavy: float, said: str
) -> None:
    """Of a sheet of 3 mm instead of 2 mm, the frequencies alone said a stiffness 2.3 times too large; the level was 3.5 dB off then."""
    monkeypatch.setattr(rescaled, "mistake_text", lambda _, matrix, size: f"{matrix} {size:.2g}")

    def built(k: float, m: float) -> FeModel:
        plain = assembly()
        return replace(plain, K=sp.csc_array(k * plain.K), M=sp.csc_array(m * plain.M))

    def cause(job: Seen, _: float) -> str:
        # So that forty lines are compared, which is faster.
        job.source.known[b"work"] = 0.1 * rescaled.MOST_WORK / (12 * 40)
        return rescaled.scaled_text(job, (heavy / stiff) ** 0.5, "too stiff") or ""

    text = told(built(stiff, heavy), built(1.0, 1.0), cause)
    assert text.startswith(said)


def test_proportional_damping_follows_the_mass_that_is_corrected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Alpha times a mass in grams damped the corrected model away, so that its level was 17 dB off and nothing was named."""
    monkeypatch.setattr(rescaled, "mistake_text", lambda _, matrix, size: f"{matrix} {size:.2g}")
    alpha, beta = 8.0, 2e-6

    def damped(mass: float) -> FeModel:
        plain = assembly()
        M = sp.csc_array(mass * plain.M)
        return replace(plain, M=M, C=sp.csc_array(alpha * M + beta * plain.K))

    settings = ((alpha, beta), (0.0, 0.0))
    text = told(damped(1e2), damped(1.0), lambda job, before: rescaled.rescaled_text(job, before) or "", damping=settings)
    assert text.startswith("mass 1e+02")


def calibrated_to(monkeypatch: pytest.MonkeyPatch, true: dict[str, float], *, left: float = 0.7) -> tuple[Any, list[dict[str, float]]]:
    """A job that rough calibrations, each within its bounds, fit with the true factors, and what they start from."""
    starts = list[dict[str, float]]()

    def calibrated(_: Any, __: Any, *, beside: dict[str, float]) -> Any:
        starts.append(beside)
        return SimpleNamespace(factors={name: np.clip(true[name] / value, 0.74, 1.35) for name, value in beside.items()})

    monkeypatch.setattr(rescaled, "roughly_calibrated", calibrated)
    monkeypatch.setattr(Seen, "of_model", lambda *_: SimpleNamespace(misfit=left))
    settings = SimpleNamespace(job="tight", names=list(true))
    inputs = SimpleNamespace(campaign=SimpleNamespace(calibration=settings))
    return SimpleNamespace(inputs=inputs, job="tight", source=None, misfit=11.0), starts


@pytest.mark.parametrize(
    ("true", "says", "not_said"),
    [
        ((2.9, 0.95), "3.1 times too small relative to its mass (modulus (70 GPa", "thickness"),
        ((0.95, 2.2), "2.3 times too large relative to its mass (density", "modulus"),
        ((2.2, 1.29), "The thickness of plates, or the height of beams, is probably 1.3 times too small", "density"),
        ((0.65,), "1.5 times too large, or density 1.5 times too small, or thickness of plates 1.24 times too large", ""),
    ],
)
def test_a_stiffness_that_no_calibration_reaches(
    monkeypatch: pytest.MonkeyPatch, true: tuple[float, ...], says: str, not_said: str
) -> None:
    """Resonances are not all shifted by one factor beside springs of bolts or air, so the ratio is but where to begin."""
    names = ["stiffness.structure", "mass.structure"]
    ratio = 1.1 * (true[0] / (true[1] if len(true) > 1 else 1.0)) ** 0.5
    job, starts = calibrated_to(monkeypatch, dict(zip(names, true, strict=False)))
    text = rescaled.far_text(job, Any, ratio)
    assert says in text
    assert not not_said or not_said not in text
    assert starts[0]["stiffness.structure"] == pytest.approx(ratio**2)
    # What a calibration from the model as exported reaches, or what does not fit then, is something else.
    job, _ = calibrated_to(monkeypatch, dict.fromkeys(names, 1.1))
    assert rescaled.far_text(job, Any, 1.2) == ""
    job, _ = calibrated_to(monkeypatch, dict(zip(names, true, strict=False)), left=4.0)
    assert rescaled.far_text(job, Any, ratio) == ""


@pytest.mark.parametrize(
    ("stiffness", "mass", "says"),
    [
        (0.30, 0.66, "The thickness of plates, or the height of beams, is probably 1.5 times too large in the model"),
        (2.2, 1.29, "The thickness of plates, or the height of beams, is probably 1.3 times too small in the model"),
        (0.35, 0.33, "Stiffness and mass of the model are probably both about 2.9 times too large"),
        (0.53, 1.02, ""),
        (0.98, 2.2, ""),
        # Another clock, and a gain.
        (1.14, 1.04, ""),
    ],
)
def test_what_the_factors_of_a_rough_calibration_mean(monkeypatch: pytest.MonkeyPatch, stiffness: float, mass: float, says: str) -> None:
    """Found in rounds, each of which reaches no farther than its bounds."""
    names = ["stiffness.structure", "mass.structure"]
    job, starts = calibrated_to(monkeypatch, dict(zip(names, (stiffness, mass), strict=True)))
    ratio, level = (stiffness / mass) ** 0.5 * 1.1, -20.0 * np.log10(mass) + 4.0
    text = rescaled.both_text(job, Any, ratio, level)
    assert text.startswith(says)
    assert bool(text) == bool(says)
    assert len(starts) == 3
    # Where one of the two is not calibrated, nothing is known.
    job.inputs.campaign.calibration.names = names[:1]
    assert rescaled.both_text(job, Any, ratio, level) == ""


def test_a_material_that_looks_like_a_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A factor of all FRFs that no unit has, beside shapes that differ: rough calibrations find both factors of the model."""
    names = ["stiffness.structure", "mass.structure"]
    job, starts = calibrated_to(monkeypatch, dict(zip(names, (0.32, 0.335), strict=True)))
    foot = Known(20.0 * np.log10(1.0 / 0.3048), "FRFs in ft/s2/N", "ft/s2/N")

    def said(db: float, power: int = 0) -> str:
        far = Offset(response=0, db=db, half=1.3, power=power, known=(foot,), before=11.8, after=5.6, named=True)
        return rescaled.material_text(job, Any, [far])

    assert "Stiffness and mass of the model are probably both about 3.1 times too large" in said(11.5)
    assert "Compare the mass sum with the weight of the structure first" in said(11.5)
    assert starts[0]["mass.structure"] == pytest.approx(10.0 ** (-11.5 / 20.0))
    # A unit, a derivative, or shapes as in the model.
    assert said(10.5) == said(11.5, 1) == ""
    job.misfit = 2.5
    assert said(11.5) == ""
    job, _ = calibrated_to(monkeypatch, dict(zip(names, (0.32, 0.335), strict=True)), left=6.0)
    assert said(11.5) == ""


def test_a_structure_beside_air_of_another_material() -> None:
    text = told(assembly(0.34, joined=True, first=0.34), assembly(joined=True), air=True)
    assert text.startswith("the mass of the structure is probably about 2.9 times too small")


def test_a_mass_that_the_structure_does_not_have() -> None:
    heavy = assembly()
    heavy = replace(heavy, M=sp.csc_array(heavy.M + sp.diags_array(np.where(np.arange(2 * COUNT) == COUNT + 20, 25.0, 0.0))))
    assert told(heavy, assembly(), lump_text).startswith(f"the mass matrix holds 25 kg at node {COUNT + 20} in addition to the mass")
    # It is on the test bench, too; or there is none.
    assert told(heavy, heavy, lump_text) == ""
    assert told(assembly(), assembly(2.9), lump_text) == ""


@dataclass(frozen=True)
class StageAlone:
    reduction: Any


def loaded(*nodes: int, mass: float = 8.0, damping: float = 0.1) -> FeModel:
    """With a mass at each of some nodes, and light damping."""
    plain = assembly()
    return replace(
        plain,
        C=sp.csc_array(damping * plain.C),
        M=sp.csc_array(plain.M + sp.diags_array(np.where(np.isin(np.arange(2 * COUNT), nodes), mass, 0.0))),
    )


def test_a_mass_that_the_model_lacks() -> None:
    """At one of the nodes that are tried, or beside it."""
    text = told(loaded(), loaded(10), added_text)
    found = re.match(r"with about ([\d.]+) kg more near node (\d+) at \(0.2051, 0, 0\) m the level misfit falls", text)
    assert found is not None
    assert float(found[1]) == pytest.approx(8.0, rel=0.15)
    assert int(found[2]) == 10
    # In another job it was left on the structure.
    left = told(loaded(), loaded(10), left_on_text)
    assert re.match(
        r"With about [78]\.?\d* kg more near node 10 at \(0.2051, 0, 0\) m the level misfit is 0\.\d dB, with all bolts tight", left
    )
    assert told(loaded(10), loaded(10), left_on_text) == ""
    # A pump on two feet.
    pump = re.match(r"with about ([\d.]+) kg more near nodes 8, 12 at", told(loaded(), loaded(8, 12, mass=4.0), added_text))
    assert pump is not None
    assert float(pump[1]) == pytest.approx(8.0, rel=0.1)
    # A model that holds it, masses at three places, or another material are something else.
    assert told(loaded(10), loaded(10), added_text) == ""
    assert told(loaded(), loaded(3, 37, COUNT + 15, mass=12.0), added_text) == ""
    assert told(assembly(), assembly(2.9), added_text) == ""


def test_a_foot_that_the_model_lacks() -> None:
    """One of five feet, on a node that is tried, or beside it; not a mass, which a support resembles below a resonance."""

    def on(*nodes: int) -> FeModel:
        plain = loaded()
        return replace(plain, K=sp.csc_array(plain.K + sp.diags_array(np.where(np.isin(np.arange(2 * COUNT), nodes), 5e6, 0.0))))

    def nearest(job: Seen, before: float) -> str:
        found = added.nearest_added(job, before, supports=True)
        return "" if found is None else f"{found.matrix} {found.size:.3g} {found.nodes[0]}"

    feet = (2, 37, COUNT + 2, COUNT + 12)
    matrix, size, node = told(on(*feet), on(*feet, COUNT + 37), nearest).split()
    assert matrix == "stiffness"
    assert float(size) == pytest.approx(5e6, rel=0.3)
    assert abs(int(node) - (COUNT + 37)) <= 1
    assert told(loaded(), loaded(10), nearest).startswith("mass 8")


@pytest.mark.parametrize(("left", "told"), [(0.9, True), (1.3, False)])
def test_a_mass_that_a_calibration_has_half_made_up_for(monkeypatch: pytest.MonkeyPatch, left: float, told: bool) -> None:
    """2.5 dB were left after a rough calibration, and nothing was said. The mass is calibrated together with the factors."""
    plain, names, begun = assembly(), ("stiffness.structure",), list[float]()
    settings = SimpleNamespace(job="tight", names=names)
    inputs = InputsAlone(model=plain, campaign=SimpleNamespace(calibration=settings), recipe=None)
    source = SimpleNamespace(stage=StageAlone(None))
    seen: Any = SimpleNamespace(source=source, job="tight", misfit=7.5, inputs=inputs, few=lambda _: None)
    at = np.array([10])
    monkeypatch.setattr(
        added, "nearest_added", lambda *_, **__: added.Added(matrix="mass", size=8.0, nodes=(10,), at=at, place="(0.2, 0, 0) m", left=4.0)
    )
    monkeypatch.setattr(added, "recipe_of", lambda *_: None)
    monkeypatch.setattr(added, "coarsely_reduced", lambda inputs: begun.append((inputs.model.M - plain.M).sum()))
    monkeypatch.setattr(added, "Looking", lambda **fields: fields)
    monkeypatch.setattr(added, "calibrated_by_rounds", lambda *_: (None, {"stiffness.structure": 1.0, "added there": 0.7}))
    monkeypatch.setattr(added.Seen, "of_model", lambda *_: SimpleNamespace(misfit=left))
    text = added.missing_cause(seen, Any, 2.5, least=2.0).text
    # Each reduced model holds the mass found with the one before.
    assert begun == pytest.approx([8.0, 5.6])
    start = f"with about 3.9 kg more near node 10 at (0.2, 0, 0) m a rough calibration leaves {left:.1f} dB, without it 2.5 dB"
    assert text.startswith(start) is told
    assert bool(text) is told
    # Near enough after the calibration, or calibrated from another job: nothing is looked for.
    assert added.missing_cause(seen, Any, 1.9, least=2.0).text == ""
    settings.job = "another"
    assert added.missing_cause(seen, Any, 2.5, least=2.0).text == ""


@pytest.mark.parametrize(
    ("quantity", "row", "told"), [("acceleration", 3, True), ("velocity", 4, True), ("pressure", 3, False), ("velocity", 6, False)]
)
def test_a_mass_where_a_sensor_is(quantity: str, row: int, told: bool) -> None:
    """A sensor of 50 g, at the node found or beside it, was told as a motor or a fixture."""
    dofs = DofTable(node=np.arange(9), component=np.full(9, "UZ"), xyz=np.array([[0.1 * k, 0.0, 0.0] for k in range(9)]))
    response = SimpleNamespace(name="a2", node=row, direction=3, quantity=quantity, text="")
    inputs: Any = SimpleNamespace(responses=[response], dofs=dofs)
    found = added.Added(matrix="mass", size=0.05, nodes=(3,), at=np.array([3]), place="(0.3, 0, 0) m", left=1.0)
    text = added._text(inputs, found, 2.6, with_calibration=True)
    assert ("a2 was measured there, so this is probably the mass of the sensor" in text) is told
    assert ("such as a motor or a fixture" in text) is not told


@pytest.mark.parametrize(
    ("lump", "part", "told"),
    [(3.0, 1.8, "part"), (3.0, 3.4, "lump"), (1.9, 1.8, "lump"), (np.inf, 1.8, "part"), (3.0, np.inf, "lump")],
)
@pytest.mark.parametrize("joint", [np.inf, 1.2])
def test_a_wrong_part_that_looks_like_a_missing_foot(
    monkeypatch: pytest.MonkeyPatch, lump: float, part: float, told: str, joint: float
) -> None:
    """The mass matrix of another revision: a support left 3.0 dB, the right mass of that part 1.8 dB. Below 2 dB nothing else is asked.

    A screw at another place: a support left 1.9 dB, the right place 1.2 dB.
    """
    told = told if np.isinf(joint) else "joint"
    for name, text, left in (("missing_cause", "lump", lump), ("part_cause", "part", part), ("displaced_cause", "joint", joint)):
        cause = Cause(text, left) if np.isfinite(left) else Cause()
        monkeypatch.setattr(unexplained, name, lambda *_, cause=cause, **__: cause)
    monkeypatch.setattr(unexplained, "tied_text", lambda _: "")
    job: Any = SimpleNamespace(inputs=SimpleNamespace(springs_doubt=""))
    assert [each.text for each in unexplained.of_a_part(job, Any, 2.5)] == [told]


def grounded(*nodes: int, stiffness: float = 1e9) -> FeModel:
    """With a spring to the ground at each of some nodes."""
    plain = assembly()
    return replace(plain, K=sp.csc_array(plain.K + sp.diags_array(np.where(np.isin(np.arange(2 * COUNT), nodes), stiffness, 0.0))))


@pytest.mark.parametrize(("stated", "words"), [(4e7, "10 times too stiff"), (4e5, "10 times too soft"), (4e6, "")])
def test_feet_of_a_wrong_stiffness(stated: float, words: str) -> None:
    feet = (2, 37, COUNT + 2, COUNT + 37)
    given, true = (grounded(*feet, stiffness=size) for size in (stated, 4e6))
    text = told(given, true, lambda job, before: held_text(job, before) or "")
    assert bool(text) is bool(words)
    assert words in text
    assert not words or text.startswith(f"the supports of the model (2, 37, {COUNT + 2}, {COUNT + 37}) are probably {words}")


def test_supports_at_nodes_of_bolts() -> None:
    """Springs of bolts between two nodes put no force to the ground, so even soft supports there are seen; each alone explains little."""
    feet = (0, 15, COUNT + 5, COUNT + 38)
    soft = grounded(*feet, stiffness=2e4)
    text = told(grounded(*feet), soft, lambda job, before: held_text(job, before) or "")
    assert text.startswith(
        f"the stiffness matrix holds nodes 0, 15, {COUNT + 5}, {COUNT + 38} of bolts to the ground (UX) in addition to the "
    )
    assert "or a support is far too stiff" in text
    assert told(soft, soft, lambda job, before: held_text(job, before) or "") == ""

    def found(job: Seen, _: float) -> str:
        at, stiffness = supports_of(job)
        return " ".join(f"{row}: {size:.6g}" for row, size in zip(at, stiffness, strict=True))

    assert told(soft, soft, found) == f"0: 20000 15: 20000 {COUNT + 5}: 20000 {COUNT + 38}: 20000"
    assert told(assembly(), assembly(), found) == ""


def test_a_tie_that_was_left_beside_the_bolts() -> None:
    """Two rows of masses at one place that springs join beside the terms; named only if the structure does not have them."""

    def tied(*nodes: int) -> FeModel:
        plain = assembly()
        apart = sp.lil_array((2 * COUNT, len(nodes)))
        for k, node in enumerate(nodes):
            apart[node, k], apart[COUNT + node, k] = 1.0, -1.0
        return replace(plain, K=sp.csc_array(plain.K + 1e8 * (apart @ apart.T)))

    def cause(job: Seen, _: float) -> str:
        inputs: Any = job.inputs
        inputs.dofs = replace(inputs.dofs, xyz=inputs.dofs.xyz * [1.0, 0.0, 1.0])
        return tied_text(job)

    text = told(tied(2, 20, 30), assembly(), cause)
    assert text.startswith("beside the bolts the stiffness matrix joins 3 pairs of nodes at one place (2 and 42, 20 and 60, 30 and 70; x ")
    before, after = map(float, re.findall(r"from ([\d.]+) to ([\d.]+) dB", text)[0])
    assert after < 0.1 < before
    assert told(tied(2, 20, 30), tied(2, 20, 30), cause) == ""
    assert told(assembly(), tied(2, 20, 30), cause) == ""
    # At other places nothing is a tie.
    assert told(tied(2, 20, 30), assembly(), lambda job, _: tied_text(job)) == ""


def test_a_foot_in_the_air() -> None:
    feet = (2, 37, COUNT + 2, COUNT + 12, COUNT + 37)
    text = told(grounded(*feet), grounded(2, 37, COUNT + 2, COUNT + 37), lambda job, before: held_text(job, before) or "")
    assert f"Without the support of node {COUNT + 12} alone (UX) the level misfit falls" in text
    assert "as by a foot in the air. Support it on the test bench and measure again" in text
    assert told(grounded(*feet), grounded(*feet), lambda job, before: held_text(job, before) or "") == ""
    # None of them was on the test bench.
    every = told(grounded(*feet), assembly(), lambda job, before: held_text(job, before) or "")
    assert "probably by a boundary condition that was left in: without it" in every


@pytest.mark.parametrize(("nodes", "mass", "is_told"), [((COUNT + 9,), 0.25, True), ((10,), 8.0, False), ((), 0.0, False)])
def test_a_heavy_sensor(monkeypatch: pytest.MonkeyPatch, nodes: tuple[int, ...], mass: float, is_told: bool) -> None:
    """Not a mass elsewhere, nor one that leaves much: ribs of steel on a lid had been told as 34 g that left 2.3 of 3.0 dB."""
    reduced = whole(assembly(), structure=2 * COUNT)

    def cause(job: Seen, _: float) -> str:
        source: Any = SimpleNamespace(**vars(job.source), stage=SimpleNamespace(reduction=SimpleNamespace(model=reduced)))
        source.inputs.responses = [SimpleNamespace(name=f"a{k}", quantity="acceleration") for k in range(4)]
        return loaded_text(replace(job, source=source))

    text = told(assembly(), loaded(*nodes, mass=mass, damping=1.0), cause)
    assert bool(text) is is_told
    found = re.match(r"with about (\d+) g more at the sensor of a2 the level misfit falls from", text)
    assert not is_told or (found is not None and float(found[1]) == pytest.approx(1e3 * mass, rel=0.25))
    left = re.search(r"to ([\d.]+) dB", text)
    if left is not None:
        monkeypatch.setattr(added, "NEAR", float(left[1]) - 0.1)
        assert told(assembly(), loaded(*nodes, mass=mass, damping=1.0), cause) == ""


def frame_of(*held: tuple[int, str], missing: tuple[int, str] | None = None, plane: int = 0) -> Any:
    """A chain of nodes with UX and UY, free but for stiff springs to the ground; the first ``plane`` lie at x = 0 and have UX alone."""
    nodes, components = np.repeat(np.arange(COUNT), 2), np.array(["UX", "UY"] * COUNT)
    row = 2.0 * np.eye(COUNT) - np.eye(COUNT, k=1) - np.eye(COUNT, k=-1)
    row[0, 0] = row[-1, -1] = 1.0
    K = 1e6 * np.kron(row, np.eye(2))
    for node, component in held:
        at = 2 * node + (component == "UY")
        K[at, at] += 1e9
    kept = np.array([(node, component) != missing for node, component in zip(nodes.tolist(), components.tolist(), strict=True)])
    kept &= (nodes >= plane) | (components == "UX")
    model = SimpleNamespace(K=sp.csc_array(K[np.ix_(kept, kept)]), is_acoustic=np.zeros(int(kept.sum()), dtype=bool))
    model.terms = SimpleNamespace(left=sp.csc_array((int(kept.sum()), 0)))
    xyz = np.stack([np.repeat(np.linspace(0.0, 0.8, COUNT), 2), np.tile([0.0, 0.0], COUNT), np.zeros(2 * COUNT)], axis=1)
    xyz[nodes < plane] = 0.0
    dofs = DofTable(node=nodes[kept], component=components[kept], xyz=xyz[kept])
    inputs = SimpleNamespace(model=model, dofs=dofs, campaign=SimpleNamespace(unit_system=SimpleNamespace(length=1.0)))
    return SimpleNamespace(inputs=inputs)


def test_a_support_unlike_the_others_is_named_first_of_all() -> None:
    feet = [(node, component) for node in (0, 13, 39) for component in ("UX", "UY")]
    assert supports_text(frame_of()) == ""
    assert supports_text(frame_of(*feet)).startswith(
        ". The model is held to the ground in addition to the bolts (at or next to 3 nodes: 0, 13, 39)"
    )
    assert "4 nodes: 0, 13, 25, 39; unlike the others, node 25 in UY alone)" in supports_text(frame_of(*feet, (25, "UY")))


def test_a_tie_that_bridges_the_bolts() -> None:
    """Two chains one on the other, with coincident nodes: one pair is a bolt, five are coupled as if glued."""
    job = frame_of()
    inputs, half = job.inputs, COUNT // 2
    assert 2 * half == COUNT
    xyz = inputs.dofs.xyz.copy()
    xyz[COUNT:] = xyz[:COUNT]
    inputs.dofs = replace(inputs.dofs, xyz=xyz)
    K = inputs.model.K.toarray()
    # Neighbours at the cut lie apart.
    assert supports_text(job) == ""

    def coupled(at: int, stiffness: float) -> None:
        for one, other in ((2 * at, 2 * (at + half)), (2 * at + 1, 2 * (at + half) + 1)):
            K[np.ix_([one, other], [one, other])] += stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])

    left = np.zeros((2 * COUNT, 1))
    left[[2 * 3, 2 * (3 + half)], 0] = 1.0, -1.0
    inputs.model.terms = SimpleNamespace(left=sp.csc_array(left))
    coupled(3, 1e6)
    inputs.model.K = sp.csc_array(K)
    assert supports_text(job) == ""
    for at in (5, 7, 9, 11, 13):
        coupled(at, 1e9)
    inputs.model.K = sp.csc_array(K)
    text = supports_text(job)
    assert text.startswith(". Besides the bolts, nodes at the same place are coupled in the model by up to 1e+09 N/m (pairs: 5, nodes ")
    assert text.endswith("check whether a tie or a contact was left in there")
    assert f"5 and {5 + half}" in text
    assert f"3 and {3 + half}" not in text


def test_a_direction_that_one_node_alone_has_lost() -> None:
    """Fixed when the matrices were exported: its row is not there."""
    text = supports_text(frame_of(missing=(25, "UY")))
    assert text.startswith(". Alone of all nodes, node 25 has no UY: check whether a boundary condition was left in there")
    text = supports_text(frame_of(plane=6))
    assert text.startswith(
        ". Alone of all nodes, 6 at x = 0 have no UY: check whether a boundary condition was left in there, or a condition"
    )
    # Most of the nodes: another kind of element.
    assert "Alone of all" not in supports_text(frame_of(plane=COUNT // 2))
