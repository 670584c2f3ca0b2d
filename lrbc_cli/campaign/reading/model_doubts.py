"""Warnings about doubtful or contradictory, but usable models, and refusals of clearly wrong matrices; given by every command."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.campaign.reading.dof_source import MANY
from lrbc_cli.campaign.reading.doubts.chosen import part_of_stiffness
from lrbc_cli.campaign.reading.doubts.coupled import one_way_text, opposed_text
from lrbc_cli.campaign.reading.doubts.idle import clamped_beside, cut_edges
from lrbc_cli.campaign.reading.doubts.materials import massless_part, too_heavy
from lrbc_cli.campaign.reading.doubts.names import sorted_names
from lrbc_cli.campaign.reading.doubts.numbering import numbering_doubts
from lrbc_cli.campaign.reading.doubts.rigid import require_single_diagonal
from lrbc_cli.campaign.reading.doubts.settings import setting_slips, start_slips
from lrbc_cli.campaign.reading.doubts.springs import doubled_springs, exceeding_springs, half_grounded, held_springs
from lrbc_cli.campaign.reading.groups import TermGroup
from lrbc_cli.campaign.reading.places import AT_NODE
from lrbc_cli.config import Campaign, ModelConfig
from lrbc_cli.config.explain import suggestion
from lrbc_cli.config.structure import ProportionalDamping
from lrbc_cli.errors import DataError, listing
from lrbc_cli.model.dofs import COMPONENTS, DofLabels, DofTable, PointTable
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.selection import pitch
from lrbc_cli.reduction.problem.vectors import highest_omega
from lrbc_cli.updating.unknowns.places import Edge, Joints, misplaced, spots

#: Stiffness from which a diagonal entry is a penalty [N/m, or N/mm].
PENALTY = 1e30

#: Loss factor that no bolted structure reaches; larger values are probably in per cent.
LARGE_LOSS = 0.5

#: Number of digits in which equal entries agree.
_DIGITS = 9


def doubts(model: FeModel) -> list[str]:
    """Warnings about the matrices, in words."""
    m = model
    found = [text for text in (one_way_text(model), opposed_text(model)) if text]
    if np.iscomplexobj(m.K.data) and loss_factor(m) < 0:
        found.append(
            "the imaginary part of the stiffness is negative: with exp(+i omega t) it adds energy. Write `conjugate: true` beside its file"
        )
    structure = np.abs(m.K.diagonal())[~m.is_acoustic]
    huge = np.flatnonzero(~m.is_acoustic)[structure > 1e8 * max(float(np.median(structure)), 1e-300)] if structure.size else structure
    if huge.size:
        few = f"{huge.size} structural DOF{'s have' if huge.size > 1 else ' has'} a huge diagonal, possibly penalties of fixed DOFs"
        held = np.isin(huge, m.terms.left.indices)
        if held.any():
            found.append(
                f"{few}. Terms act on {'them' if held.all() else f'{held.sum()} of them'}, without effect: remove these constraints in the "
                "FE model, where the terms hold the structure instead, and export it again"
            )
        else:
            found.append(f"{few}. Fixed DOFs cannot be loosened: export the edge pinned")
    return found


def require_roles(
    K: sp.csc_array, M: sp.csc_array, source: ModelConfig, band_hz: tuple[float, float], labels: DofLabels | None = None
) -> None:
    """Refuse exchanged stiffness and mass matrices, and a stiffness matrix whose diagonal counts twice.

    Raises
    ------
    DataError
        If no local frequency is near the band, but with exchanged matrices frequencies reach it; or if the diagonal counts twice.
    """
    if labels is not None:
        require_single_diagonal(K, labels.component, source.stiffness.path, source.stiffness.group)
    highest, exchanged = highest_omega(K, M) / (2.0 * np.pi), highest_omega(M, K) / (2.0 * np.pi)
    if not highest * 10.0 < band_hz[1] < exchanged < np.inf:
        return
    largest = [float(np.abs(matrix.data).max(initial=0.0)) for matrix in (K, M)]
    negative = int((np.real(M.diagonal()) < 0).sum())
    raise DataError(
        "the stiffness and the mass matrix are exchanged",
        file=source.mass.path,
        place=source.mass.group or "model.mass",
        expected=f"masses far below stiffnesses: frequencies in the band up to {band_hz[1]:g} Hz",
        found=f"masses up to {largest[1]:.1e}, stiffnesses up to {largest[0]:.1e}: all frequencies below {highest:.1g} Hz; with the "
        f"matrices exchanged up to {exchanged:.1g} Hz" + (f"; {negative} negative masses" if negative else ""),
        hint="exchange model.stiffness and model.mass in the campaign file",
    )


def require_mass(M: sp.csc_array, C: sp.csc_array, dofs: DofTable, source: ModelConfig) -> None:
    """Refuse exchanged mass and damping matrices.

    Raises
    ------
    DataError
        If under a translation the entries of the damping matrix add up like those of a mass matrix, and those of the mass matrix cancel.
    """
    for label in COMPONENTS[:3]:
        at = np.flatnonzero(dofs.component == label)
        sums = [(float(np.real(A[at][:, at]).sum()), float(np.abs(np.real(A[at][:, at])).sum())) for A in (M, C)]
        if not at.size or any(size == 0.0 for _, size in sums):
            continue
        mass, damping = (total / size for total, size in sums)
        if mass < min(MANY, 0.5 * damping) and damping > MANY:
            raise DataError(
                "the mass and the damping matrix are exchanged",
                file=source.mass.path,
                place=source.mass.group or "model.mass",
                expected="mass entries mostly of one sign: their sum over a translation is the mass of the structure",
                found=f"{label}: the sum is {mass:.1%} of the sizes of the entries in the mass matrix, {damping:.0%} in the damping matrix",
                hint="exchange model.mass and model.damping in the campaign file",
            )


def fixed_dofs(K: sp.csc_array, M: sp.csc_array) -> tuple[NDArray[np.bool_], str]:
    """(n,) mask of fixed DOFs, exported as rows of zeros or with a penalty (Abaqus: 1e36), and a note on them."""
    empty = (np.abs(K).sum(axis=0) == 0) & (np.abs(M).sum(axis=0) == 0) & (np.abs(K).sum(axis=1) == 0) & (np.abs(M).sum(axis=1) == 0)
    held = np.abs(K.diagonal()) >= PENALTY
    counts = ((int(empty.sum()), "empty rows in both matrices"), (int(held.sum()), "a penalty on the diagonal"))
    told = ", ".join(f"{count} with {text}" for count, text in counts if count)
    return empty | held, f"fixed DOFs left out: {told}" if told else ""


def loss_factor(model: FeModel) -> float:
    """Loss factor of a complex stiffness matrix, from its diagonal."""
    return float(model.K.imag.diagonal().sum() / model.K.real.diagonal().sum())


def require_known_bolts(campaign: Campaign, bolts: PointTable | None) -> None:
    """Refuse a stated removed bolt that does not exist.

    Raises
    ------
    ConfigError
    """
    for job, settings in campaign.jobs.items() if bolts is not None else ():
        for index, name in enumerate(settings.removed):
            if name not in bolts.name:  # type: ignore[union-attr]
                raise campaign.error(
                    f"no bolt has the name '{name}'",
                    *("jobs", job, "removed", index),
                    expected=f"one of {', '.join(bolts.name)}",  # type: ignore[union-attr]
                    hint=suggestion(name, bolts.name) or "write it as the bolts file has it",  # type: ignore[union-attr]
                )


def slips(
    campaign: Campaign,
    model: FeModel,
    responses: Sequence[tuple[str, int]],
    groups: Sequence[TermGroup],
    bolts: PointTable | None,
    dofs: DofTable | None,
    *,
    astray: Collection[str] = (),
    misnamed: Collection[str] = (),
) -> Iterator[str]:
    """Warnings about contradictions in settings, damping, responses, terms, springs and bolts, each with its remedy.

    Parameters
    ----------
    campaign : Campaign
    model : FeModel
    responses : sequence of (str, int)
        Names, and indices of the excitations.
    groups : sequence of TermGroup
    bolts : PointTable or None
    dofs : DofTable or None
    astray : collection of str
        Responses whose places are in doubt.
    misnamed : collection of str
        Bolts whose springs were found under the name of another bolt.
    """
    yield from setting_slips(campaign)
    yield from part_of_stiffness(campaign, model, dofs)
    yield from _numbering(campaign, model, dofs)
    yield from _damping(campaign, model)
    yield from _one_place(model, responses, astray)
    yield from _terms_twice(model, groups, dofs, bolts)
    yield from held_springs(campaign, model, groups, dofs)
    yield from exceeding_springs(model, groups, dofs, bolts)
    yield from half_grounded(model, groups, dofs)
    yield from clamped_beside(model, groups, bolts, dofs, campaign.unit_system)
    yield from massless_part(model, dofs)
    yield from too_heavy(model, dofs, campaign.unit_system)
    yield from _out_of_reach(campaign, groups, bolts, dofs, misnamed)
    yield from sorted_names(bolts)


def misread(campaign: Campaign, model: FeModel, groups: Sequence[TermGroup], dofs: DofTable | None) -> bool:
    """Whether matrices, damping or start values are warned of, so that measurements cannot be compared with the model yet."""
    told = (
        *_numbering(campaign, model, dofs),
        *_damping(campaign, model),
        *_terms_twice(model, groups, dofs, None),
        *start_slips(campaign).values(),
        *too_heavy(model, dofs, campaign.unit_system, flat=False),
    )
    return bool(told or opposed_text(model))


def _numbering(campaign: Campaign, model: FeModel, dofs: DofTable | None) -> Iterator[str]:
    """Warnings about the numbering of mass and damping; proportional damping has that of the others."""
    return numbering_doubts(model, dofs, own_damping=not isinstance(campaign.model.damping, ProportionalDamping))


def _damping(campaign: Campaign, model: FeModel) -> Iterator[str]:
    damping = campaign.model.damping
    for name, group in campaign.parameters.items():
        loss = getattr(group.damping, "loss_factor", None)
        if loss is not None and loss >= LARGE_LOSS:
            yield f"parameters.{name}.damping.loss_factor: {loss:g} is {loss:.0%}. If per cent was meant, write {loss / 100:g}"
    if not isinstance(damping, ProportionalDamping):
        share = structural_share(model, campaign.reduction.band)
        if share is not None:
            yield (
                f"model.damping: the matrix is {share:.4g} times the stiffness, probably structural damping; as viscous damping it lets "
                "hardly anything in the band oscillate. Write model.damping: {structure: {loss_factor: "
                f"{share:.4g}}}}}, or give the stiffness as a complex matrix, without this damping matrix"
            )
        return
    for field, there in (("structure", not model.is_acoustic.all()), ("acoustic", bool(model.is_acoustic.any()))):
        own = getattr(damping, field)
        if any((own.alpha, own.beta, own.loss_factor)) and not there:
            kind = "pressures" if field == "acoustic" else "displacements"
            yield (
                f"model.damping.{field} has no effect: the model has no {kind}. Remove it, or correct in model.dofs which DOFs are "
                "pressures (component PRES)"
            )
        elif own.loss_factor >= LARGE_LOSS:
            yield (
                f"model.damping.{field}.loss_factor: {own.loss_factor:g} is {own.loss_factor:.0%}. If per cent was meant, write "
                f"{own.loss_factor / 100:g}"
            )
        elif _least_ratio(own.alpha, own.beta, campaign.reduction.band) > 1.0:
            fix = "correct them, or remove damping that the model has from elsewhere"
            if not own.alpha and own.beta < 0.5:
                fix = f"beta is in seconds: if the damping ratio of the modes was meant, write loss_factor: {2.0 * own.beta:g} for both"
            elif _largest_ratio(own.beta, own.alpha, campaign.reduction.band) < 1.0:
                fix = f"they are probably exchanged: write alpha: {own.beta:g}, beta: {own.alpha:g}"
            yield (
                f"model.damping.{field}: with alpha: {own.alpha:g} and beta: {own.beta:g} nothing in the band oscillates (damping ratio "
                f"{_least_ratio(own.alpha, own.beta, campaign.reduction.band):.3g} and more); {fix}"
            )


def undamped_text(model: FeModel, groups: Sequence[TermGroup]) -> str | None:
    """Warning if the model has no damping; else None."""
    own = any(group.beta or group.loss_factor or group.config.kind == "damping" for group in groups)
    if own or np.iscomplexobj(model.K.data) or model.C.count_nonzero():
        return None
    only_air = bool(model.is_acoustic.all())
    field, factor = ("acoustic", 0.001) if only_air else ("structure", 0.01)
    return (
        "the model has no damping: its resonances are infinite and those of the measurement are not, so no fit can match them. Write "
        f"model.damping: {{{field}: {{loss_factor: {factor:g}}}}} (a usual value), or the half-power width of a measured resonance divided "
        "by its frequency"
    )


def _least_ratio(alpha: float, beta: float, band_hz: tuple[float, float]) -> float:
    """Least damping ratio alpha / (2 omega) + beta omega / 2 of modes in the band."""
    low, high = (2.0 * np.pi * hz for hz in band_hz)
    best = float(np.clip(np.sqrt(alpha / beta), low, high)) if beta > 0.0 else high
    return 0.5 * (alpha / best + beta * best)


def _largest_ratio(alpha: float, beta: float, band_hz: tuple[float, float]) -> float:
    """Largest damping ratio of modes in the band, at one of its ends."""
    return max(0.5 * (alpha / (2.0 * np.pi * hz) + beta * 2.0 * np.pi * hz) for hz in band_hz)


def structural_share(model: FeModel, band_hz: tuple[float, float], *, same: float = 1e-3, most: float = 0.9) -> float | None:
    """Loss factor, if the damping matrix is that share of the stiffness and would be overcritical as viscous damping; else None.

    Parameters
    ----------
    model : FeModel
    band_hz : (float, float)
    same : float
        Largest relative difference of the share from row to row.
    most : float
        Least share of the rows that agree; not all do, as baselines are subtracted from the stiffness only.
    """
    stiffness, damping = (np.real(matrix.diagonal())[~model.is_acoustic] for matrix in (model.K, model.C))
    known = stiffness > 0.0
    if not known.any() or not damping.any():
        return None
    shares = damping[known] / stiffness[known]
    share = float(np.median(shares))
    if np.mean(np.abs(shares - share) <= same * share) < most or not 0.0 < share < LARGE_LOSS:
        return None
    # The damping ratio of a mode at omega would be share * omega / 2.
    return share if share * np.pi * float(np.sqrt(band_hz[0] * band_hz[1])) > 1.0 else None


def _one_place(model: FeModel, responses: Sequence[tuple[str, int]], astray: Collection[str]) -> Iterator[str]:
    """Warnings about responses with the same output row and excitation, so that two sensors are compared with one FRF.

    Responses whose place is in doubt (``astray``) are left out, because their nearest node is meaningless.
    """
    seen: dict[tuple[object, ...], str] = {}
    pairs = []
    for i, ((name, own), row) in enumerate(zip(responses, _columns(model.L.T.tocsc(), scaled=False), strict=True)):
        first = seen.setdefault((row, int(model.output_power[i]), own), name)
        if first != name and not {first, name} & set(astray):
            pairs.append(f"{first} and {name}")
    if pairs:
        what = "place or the excitation" if model.B.shape[1] > 1 else "place"
        yield (
            f"responses {listing(pairs, 8)} are the same DOF of the model, for the same hammer point: correct the {what} of the wrong one "
            f"{'' if len(pairs) == 1 else 'of each pair '}under responses, or remove it"
        )


def _terms_twice(model: FeModel, groups: Sequence[TermGroup], dofs: DofTable | None, bolts: PointTable | None) -> Iterator[str]:
    """Warnings about groups that share terms, whose values cannot be distinguished."""
    left, right = _columns(model.terms.left), _columns(model.terms.right)
    owner: dict[tuple[object, ...], TermGroup] = {}
    shared: dict[tuple[str, str], tuple[TermGroup, TermGroup, list[int]]] = {}
    for group in groups:
        for term in group.terms.tolist():
            first = owner.setdefault((left[term], right[term], int(model.terms.power[term])), group)
            if first is not group:
                shared.setdefault((first.name, group.name), (first, group, []))[2].append(term)
    for first, second, terms in shared.values():
        if dofs is not None and first.config.select.bushings is not None and second.config.select.bushings is not None:
            yield doubled_springs(model, groups, (first, second), terms, dofs, bolts)
        else:
            yield (
                f"parameters {first.name} and {second.name} contain the same {len(terms)} term{'s' if len(terms) > 1 else ''}, so their "
                "values cannot be distinguished: remove these terms from one of the two selections"
            )


def misplaced_bolts(groups: Sequence[TermGroup], bolts: PointTable | None) -> str | None:
    """Warning if terms would reach all or more bolts with other axes or another origin of the bolts file; else None."""
    otherwise = None if bolts is None else misplaced(_reaching(groups), bolts.xyz)
    if bolts is None or otherwise is None:
        return None
    lost = [name for name, spot in zip(bolts.name, spots(_reaching(groups), bolts.xyz), strict=True) if isinstance(spot, str)]
    named, (how, reached) = listing(lost, 6), otherwise
    count = len(bolts.name)
    then = "every bolt lies" if reached == count else f"{reached} of {count} bolts, not {count - len(lost)}, lie"
    picked = [group.name for group in groups if group.config.select.box is not None or group.config.select.along is not None]
    other = f", or whether {' and '.join(f'parameters.{name}.select' for name in picked)} picks another edge" if picked else ""
    return (
        f"{named} of the bolts file lie{'s' if len(lost) == 1 else ''} beside all identified terms; with {how} {then} at terms: check "
        f"whether the file was written in other axes or from another origin{other}"
    )


def _reaching(groups: Sequence[TermGroup]) -> list[Edge | Joints]:
    """Stiffness groups that can reach a bolt, as edges or joints with placeholder values."""
    values: list[Edge | Joints] = []
    for group in groups:
        zero = np.zeros(group.count)
        if group.config.kind == "stiffness" and group.bolt is not None:
            values.append(Joints(zero, np.inf, None, group.bolt))
        elif group.config.kind == "stiffness" and group.xyz is not None and group.arc_length is not None:
            values.append(Edge(xyz=group.xyz, arc_length=group.arc_length, log10=zero, cap=np.inf, reference=None))
    return values


def _out_of_reach(
    campaign: Campaign, groups: Sequence[TermGroup], bolts: PointTable | None, dofs: DofTable | None, misnamed: Collection[str]
) -> Iterator[str]:
    """Warnings if terms do not reach bolts, with the likely cause: other axes, origin or structure, missing springs, or a box too short.

    A row may be longer than its edge, so up to half of the bolts of edges are tolerated, unless all lie off the plane of the structure.
    """
    elsewhere = misplaced_bolts(groups, bolts)
    if elsewhere is not None:
        yield (
            f"{elsewhere}. Correct what is wrong, or remove the bolts that no term reaches; until then there is no all-clear "
            "(lrbc check --picture shows the places)"
        )
        return
    values = _reaching(groups)
    found = spots(values, bolts.xyz) if bolts is not None and values else []
    lost = [k for k, spot in enumerate(found) if isinstance(spot, str) and bolts is not None and bolts.name[k] not in misnamed]
    if bolts is not None and dofs is not None:
        cut = cut_edges(groups, bolts, lost, dofs, campaign.unit_system.length)
        yield from dict.fromkeys(cut.values())
        lost = [k for k in lost if k not in cut]
    if bolts is None or not lost:
        return
    if not any(isinstance(group, Edge) for group in values):
        fix = "Add springs there to the tables of parameters.NAME.select, or take such bolts out of the bolts file"
    elif (aside := _off_plane(bolts, dofs)) > 0.0:
        fix = (
            f"All bolts of the file lie {1e3 * aside:.3g} mm or more off the plane of the structure, too: it is probably that of another "
            "structure. Give the bolts file of this one"
        )
    elif 2 * len(lost) > len(found):
        fix = "Look at them with `lrbc check --picture`, and correct the bolts file (order of its axes, origin) or parameters.NAME.select"
    else:
        return
    first = f" ({bolts.name[lost[0]]})" if len(lost) > 1 else ""
    yield (
        f"{len(lost)} of {len(found)} bolts cannot be judged ({listing([bolts.name[k] for k in lost], 6)}): {found[lost[0]]}{first}. {fix}"
    )


def _off_plane(bolts: PointTable, dofs: DofTable | None, *, flat: float = 1e-6) -> float:
    """Least distance of the bolts from the plane of the structural nodes [m]; 0 if one lies in it, or the nodes are in no plane."""
    xyz = np.zeros((0, 3)) if dofs is None else np.unique(dofs.xyz[~dofs.is_acoustic], axis=0)
    if len(xyz) < 3:
        return 0.0
    _, sizes, axes = np.linalg.svd(xyz - xyz.mean(axis=0), full_matrices=False)
    away = float(np.abs((bolts.xyz - xyz.mean(axis=0)) @ axes[2]).min())
    return away if sizes[2] <= flat * sizes[0] and sizes[1] > flat * sizes[0] and away > AT_NODE * pitch(xyz) else 0.0


def _columns(vectors: sp.csc_array, *, scaled: bool = True) -> list[tuple[bytes, bytes]]:
    """Columns as bytes for comparison; up to a factor if ``scaled``."""
    vectors = vectors.sorted_indices()
    found = []
    for start, end in zip(vectors.indptr[:-1], vectors.indptr[1:], strict=True):
        values = vectors.data[start:end]
        largest = values[np.argmax(np.abs(values))] if scaled and values.size else 1.0
        found.append((vectors.indices[start:end].tobytes(), (np.round(values / largest, _DIGITS) + 0.0).tobytes()))
    return found
