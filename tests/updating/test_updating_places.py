"""From stiffness profiles to verdicts on bolts."""

from __future__ import annotations

import numpy as np
import pytest

from lrbc_cli.updating.judging.bolt import JOB, REFERENCE
from lrbc_cli.updating.judging.decide import judge as decide
from lrbc_cli.updating.judging.evidence import Evidence, at_bolts
from lrbc_cli.updating.judging.rule import DecisionRule
from lrbc_cli.updating.unknowns.places import Edge, Joints, foot, misplaced, pitch_of, places

Y = np.linspace(0.0, 0.5, 51)
XYZ = np.column_stack([0 * Y, Y, 0 * Y])
BOLTS = np.column_stack([np.full(9, -0.02), np.linspace(0.05, 0.45, 9), np.zeros(9)])


def edge(log10, reference=None, cap=5.0):
    return Edge(
        xyz=XYZ,
        arc_length=Y,
        log10=np.asarray(log10, dtype=float),
        cap=cap,
        reference=None if reference is None else np.asarray(reference, dtype=float),
    )


def profile(tight, loose=None, at=()):
    """Log10 stiffness with a dip at some bolts."""
    p = np.full(Y.size, tight)
    for bolt in at:
        p[np.abs(Y - BOLTS[bolt, 1]) <= 0.025] = loose
    return p


def judge(edges, bolts, loose_change, is_reference):
    """By the values along the edges alone."""
    evidence = Evidence(
        job="x",
        status="converged",
        reason="",
        along_edges=True,
        bolts=at_bolts(edges, [str(i) for i in range(len(bolts))], np.asarray(bolts)),
        missing_reference=None,
        compared="validation channels",
        misfit_db=0.1,
        setting="",
    )
    return list(decide(evidence, DecisionRule(loose_change=loose_change), REFERENCE if is_reference else JOB).bolts)


def verdicts(edges, bolts=BOLTS, loose_change=-1.0, is_reference=False):
    return [v.verdict for v in judge(edges, bolts, loose_change, is_reference)]


class TestAgainstTheTightState:
    def test_loose_and_tight(self):
        found = judge([edge(profile(4.5, 2.0, (3, 4)), profile(4.5))], BOLTS, -1.0, False)
        assert [v.verdict for v in found] == ["tight"] * 3 + ["loose"] * 2 + ["tight"] * 4
        assert found[3].change == pytest.approx(-2.5, abs=0.6)
        assert found[0].change == pytest.approx(0.0)
        assert found[0].log10_stiffness == pytest.approx(4.5)
        assert found[0].note is None

    def test_all_loose(self):
        assert verdicts([edge(profile(2.0), profile(4.5))]) == ["loose"] * 9

    def test_saturated_values_count_as_equal(self):
        """A fall from 10^12 to 10^5.2 is none where nothing above 10^5 is felt."""
        found = judge([edge(profile(5.2), profile(12.0))], BOLTS, -1.0, False)
        assert {v.verdict for v in found} == {"tight"}
        assert found[0].change == pytest.approx(0.0)
        # The stiffness itself is reported as it was found.
        assert found[0].log10_stiffness == pytest.approx(5.2)

    def test_the_threshold_counts(self):
        edges = [edge(profile(3.8), profile(4.5))]
        assert verdicts(edges, loose_change=-1.0) == ["tight"] * 9
        assert verdicts(edges, loose_change=-0.5) == ["loose"] * 9

    def test_a_stiffer_state_is_tight(self):
        assert verdicts([edge(profile(4.9), profile(3.0))]) == ["tight"] * 9


def test_the_reference_itself_is_tight():
    found = judge([edge(profile(4.5, 2.0, (3,)))], BOLTS, -1.0, True)
    assert {v.verdict for v in found} == {"tight"}
    assert {v.change for v in found} == {0.0}
    assert "reference" in found[0].note


class TestContrast:
    """Without a tight state a bolt can be looser than the others, but nothing says that one is tight."""

    def test_the_looser_ones_are_loose(self):
        found = judge([edge(profile(4.5, 2.0, (3, 4)))], BOLTS, -1.0, False)
        assert [v.verdict for v in found] == ["undecided"] * 3 + ["loose"] * 2 + ["undecided"] * 4
        assert found[3].change is None
        assert "contrast" in found[3].note

    def test_an_even_profile_says_nothing(self):
        assert verdicts([edge(profile(1.0))]) == ["undecided"] * 9


class TestPlaces:
    def test_one_bolt_alone_takes_the_terms_beside_it(self):
        found = judge([edge(profile(2.0), profile(4.5))], BOLTS[4:5], -1.0, False)
        assert found[0].verdict == "loose"
        assert found[0].note is None

    def test_half_a_pitch_on_either_side(self):
        """Means over the terms nearest to each bolt and no others."""
        ramp = 10.0 * Y
        found = judge([edge(ramp, cap=99.0)], BOLTS, -1.0, False)
        np.testing.assert_allclose([v.log10_stiffness for v in found], 10.0 * BOLTS[:, 1], atol=0.06)

    @pytest.mark.parametrize("state", ["tight", "reference", "alone"])
    def test_beyond_the_ends_is_outside(self, state):
        """Whatever the job is compared with; no number at all, for nothing was measured there."""
        bolts = np.vstack([BOLTS, [[-0.02, 0.60, 0.0]], [[-0.02, -0.08, 0.0]]])
        tight = None if state == "alone" else profile(4.5)
        found = judge([edge(profile(4.5, 2.0, (3, 4)), tight)], bolts, -1.0, state == "reference")
        for bolt, away in zip(found[-2:], ("100 mm", "80 mm"), strict=True):
            assert bolt.verdict == "outside"
            assert away in bolt.note
            assert (bolt.log10_stiffness, bolt.change, bolt.change_std, bolt.probability_loose, bolt.threshold) == (None,) * 5
        # They do not touch what is said of the others.
        others = judge([edge(profile(4.5, 2.0, (3, 4)), tight)], BOLTS, -1.0, state == "reference")
        assert [(v.verdict, v.change, v.note) for v in found[:-2]] == [(v.verdict, v.change, v.note) for v in others]
        assert "outside" not in {v.verdict for v in others}

    def test_only_bolts_outside(self):
        assert verdicts([edge(profile(4.5))], np.array([[0.0, 2.0, 0.0], [0.0, 2.1, 0.0]])) == ["outside", "outside"]

    def test_an_edge_in_two_groups(self):
        """The first goes on straight along the second, whose terms reach the bolts there."""
        low, high = slice(0, 26), slice(26, 51)
        loose, tight = profile(4.5, 2.0, (7,)), profile(4.5)
        parts = [Edge(xyz=XYZ[k], arc_length=Y[k], log10=loose[k], cap=5.0, reference=tight[k]) for k in (low, high)]
        for edges in (parts, parts[::-1]):
            found = judge(edges, BOLTS, -1.0, False)
            assert [v.verdict for v in found] == ["tight"] * 7 + ["loose"] + ["tight"]
            # The fifth stands at the joint.
            where = places(edges, BOLTS)
            assert [edges[place.edge] is parts[1] for place in where[:4] + where[5:]] == [False] * 4 + [True] * 4

    def test_the_far_edge_reaches_nothing(self):
        """Beyond the end of its own edge a bolt is not judged by the opposite one, which is longer."""
        half, other = slice(0, 26), XYZ + np.array([0.6, 0, 0])
        edges = [
            Edge(xyz=XYZ[half], arc_length=Y[half], log10=profile(2.0)[half], cap=5.0, reference=profile(4.5)[half]),
            Edge(xyz=other, arc_length=Y, log10=profile(4.5), cap=5.0, reference=profile(4.5)),
        ]
        assert verdicts(edges) == ["loose"] * 5 + ["outside"] * 4

    def test_bolts_of_another_edge_are_outside(self):
        """All bolts of a plate are listed, but only its left edge is identified."""
        right = BOLTS + np.array([0.64, 0, 0])
        top = np.column_stack([np.linspace(0.1, 0.5, 9), np.full(9, 0.52), np.zeros(9)])
        found = judge([edge(profile(4.5, 2.0, (3,)), profile(4.5))], np.vstack([BOLTS, right, top]), -1.0, False)
        assert [v.verdict for v in found] == ["tight"] * 3 + ["loose"] + ["tight"] * 5 + ["outside"] * 18
        assert "620 mm from the edge" in found[9].note

    def test_uneven_and_paired_bolts_between_terms(self):
        """Half of a close pair's pitch reaches no term, but the terms on both sides of a bolt feel it: a loose one must not be outside."""
        coarse = Edge(xyz=XYZ[::5], arc_length=Y[::5], log10=profile(2.0)[::5], cap=5.0, reference=profile(4.5)[::5])
        step = float(Y[5] - Y[0])
        at = np.array([1.5, 1.6, 4.5, 4.6, 7.5, 7.6, 3.5]) * step + Y[0]
        bolts = np.column_stack([np.full(at.size, XYZ[0, 0] - 0.01), XYZ[0, 1] - Y[0] + at, np.zeros(at.size)])
        assert verdicts([coarse], bolts) == ["loose"] * 7
        # In a gap of the edge no term feels it.
        kept = np.array([0, 1, 2, 3, 7, 8, 9, 10])
        gapped = Edge(
            xyz=coarse.xyz[kept], arc_length=coarse.arc_length[kept], log10=coarse.log10[kept], cap=5.0, reference=coarse.reference[kept]
        )
        assert verdicts([gapped], np.vstack([bolts[:2], bolts[:1] * [1, 0, 1] + [0, XYZ[0, 1] + 5 * step, 0]]))[2] == "outside"

    def test_two_rows_of_bolts_and_a_wide_flange(self):
        aside = 0.7 * float(np.diff(BOLTS[:2, 1])[0])
        rows = np.vstack([BOLTS, BOLTS - np.array([0.04, 0, 0])]) - np.array([aside, 0, 0])
        assert verdicts([edge(profile(2.0), profile(4.5))], rows) == ["loose"] * 18

    def test_a_whole_table_of_bolts_far_aside_is_outside(self):
        """Bolts of another edge alone, or in other coordinates: terms that none of them holds say nothing of them."""
        for bolts in (BOLTS + np.array([0.45, 0, 0]), BOLTS[4:5] + np.array([0, 0, 0.7])):
            assert set(verdicts([edge(profile(4.5), profile(4.5))], bolts)) == {"outside"}

    def test_just_beyond_the_end_still_feels_its_last_terms(self):
        bolts = np.vstack([BOLTS, [[-0.02, 0.52, 0.0]]])
        assert verdicts([edge(profile(2.0), profile(4.5))], bolts)[-1] == "loose"

    def test_the_nearest_of_several_edges(self):
        far = Edge(xyz=XYZ + np.array([0.6, 0, 0]), arc_length=Y, log10=profile(2.0), cap=5.0, reference=profile(4.5))
        bolts = np.vstack([BOLTS, BOLTS + np.array([0.64, 0, 0])])
        found = verdicts([edge(profile(4.5), profile(4.5)), far], bolts)
        assert found == ["tight"] * 9 + ["loose"] * 9

    def test_a_single_term(self):
        one = Edge(xyz=np.zeros((1, 3)), arc_length=np.zeros(1), log10=np.array([2.0]), cap=5.0, reference=np.array([4.5]))
        found = judge([one], np.array([[0.0, 0.01, 0.0]]), -1.0, False)
        assert found[0].verdict == "loose"
        assert found[0].change == pytest.approx(-2.5)

    def test_a_single_bolt_takes_the_terms_on_both_sides(self):
        ramp = 10.0 * Y
        found = judge([edge(ramp, cap=99.0)], np.array([[-0.02, 0.305, 0.0]]), -1.0, False)
        assert found[0].log10_stiffness == pytest.approx(3.05)

    def test_no_bolts(self):
        assert judge([edge(profile(4.5))], np.zeros((0, 3)), -1.0, False) == []

    def test_foot_on_a_corner(self):
        corner = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 1.0, 0]])
        bent = Edge(xyz=corner, arc_length=np.array([0.0, 1.0, 2.0]), log10=np.zeros(3), cap=5.0, reference=None)
        assert foot(bent.xyz, bent.arc_length, np.array([0.4, -0.1, 0.0])) == pytest.approx((0.4, 0.1))
        assert foot(bent.xyz, bent.arc_length, np.array([1.2, 0.7, 0.0])) == pytest.approx((1.7, 0.2))
        # Beyond the ends the edge goes on straight.
        assert foot(bent.xyz, bent.arc_length, np.array([-0.5, 0.0, 0.1])) == pytest.approx((-0.5, 0.1))
        assert foot(bent.xyz, bent.arc_length, np.array([1.0, 1.5, 0.0])) == pytest.approx((2.5, 0.0))

    def test_nodes_that_coincide(self):
        doubled = Edge(xyz=XYZ[[0, 10, 10, 50]], arc_length=Y[[0, 10, 10, 50]], log10=np.zeros(4), cap=5.0, reference=None)
        assert foot(doubled.xyz, doubled.arc_length, np.array([0.0, 0.3, 0.0]))[0] == pytest.approx(0.3)

    def test_pitch(self):
        assert pitch_of(BOLTS) == pytest.approx(0.05)
        assert pitch_of(BOLTS[:1]) == 0.0
        # One gap does not change the pitch.
        assert pitch_of(np.delete(BOLTS, 4, axis=0)) == pytest.approx(0.05)


class TestJoints:
    def test_a_bolt_is_judged_by_its_own_values_in_all_groups(self):
        """Wherever it lies; values above saturation count as saturated."""
        axial = Joints(np.array([0.0, -1.5, 6.0]), 5.0, np.zeros(3), np.array([2, 0, 1]))
        rocking = Joints(np.array([-0.5, 0.0]), 5.0, np.zeros(2), np.array([0, -1]))
        found = at_bolts([axial, rocking], ["A", "B", "C", "D"], np.arange(12.0).reshape(4, 3))
        assert [bolt.outside for bolt in found] == [None, None, None, "no term belongs to it"]
        assert [bolt.difference for bolt in found] == [-1.0, 5.0, 0.0, None]
        assert [bolt.log10_stiffness for bolt in found] == [-1.0, 6.0, 0.0, None]

    def test_without_a_tight_state_there_is_no_difference(self):
        groups = [Joints(np.zeros(1), 5.0, np.zeros(1), np.array([0])), Joints(np.zeros(1), 5.0, None, np.array([0]))]
        assert at_bolts(groups, ["A"], np.zeros((1, 3)))[0].difference is None

    def test_the_tight_state_is_as_well_known_as_its_values(self):
        known = Joints(np.zeros(2), 5.0, np.zeros(2), np.array([0, 1]), np.array([0.3, np.inf]))
        other = Joints(np.zeros(1), 5.0, np.zeros(1), np.array([0]), np.array([0.1]))
        found = at_bolts([known, other], ["A", "B"], np.zeros((2, 3)))
        assert [bolt.tight_std for bolt in found] == [pytest.approx(np.sqrt(0.05)), None]
        assert [bolt.groups for bolt in found] == [(0, 1), (0,)]

    def test_edges_serve_the_bolts_that_own_nothing(self):
        joint = Joints(np.array([-2.0]), 5.0, np.zeros(1), np.array([3]))
        bolts = np.vstack([BOLTS[:3], [[9.0, 9.0, 9.0]], BOLTS[3:]])
        names = [str(i) for i in range(len(bolts))]
        found = at_bolts([joint, edge(profile(4.5, 2.0, (4,)), profile(4.5))], names, bolts)
        alone = at_bolts([edge(profile(4.5, 2.0, (4,)), profile(4.5))], names[:-1], BOLTS)
        assert found[3].difference == -2.0
        assert [bolt.difference for bolt in (*found[:3], *found[4:])] == [bolt.difference for bolt in alone]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda xyz: xyz, None),
        (lambda xyz: xyz + np.array([0.0, 0.02, 0.0]), None),
        (lambda xyz: xyz - np.array([0.0, 0.2, 0.0]), "+0.2 m in Y added"),
        (lambda xyz: xyz + np.array([0.3, 0.2, 0.0]), "-0.28 m in X and -0.2 m in Y added"),
        (lambda xyz: xyz[:, [1, 0, 2]], "X and Y exchanged"),
        # Twice as many along twice the length: no other origin brings all of them to the terms.
        (lambda xyz: np.vstack([xyz, xyz + np.array([0.0, 0.45, 0.0])]), None),
        # All round a plate, of which one edge is identified.
        (lambda xyz: np.vstack([xyz, xyz[:, [1, 0, 2]], xyz + np.array([0.5, 0.0, 0.0])]), None),
    ],
)
def test_bolts_in_other_axes_or_from_another_origin(change, said):
    found = misplaced([edge(np.zeros(Y.size))], change(BOLTS))
    assert found == (None if said is None else (said, len(BOLTS)))


def test_bolts_beyond_one_end_that_leave_the_other_one_free():
    """A row that is longer than the edge is never reached as a whole; one that is shifted is reached less than it could be."""
    beyond = np.array([0.0, 0.12, 0.0])
    row = np.vstack([BOLTS - beyond, BOLTS[-3:] + beyond])
    terms = [edge(np.zeros(Y.size))]
    assert misplaced(terms, row) is None
    found = misplaced(terms, row - [0.0, 0.2, 0.0])
    assert found is not None
    assert found[0] == "+0.2 m in Y added"
    assert 0 < found[1] < len(row)


def test_joints_lie_where_they_own_terms():
    assert misplaced([Joints(np.zeros(2), np.inf, None, np.array([0, 1]))], BOLTS) is None
