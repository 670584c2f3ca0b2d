"""Digests of all numbers and operators in the code, by stage, so that results count as out of date when one of them changes.

This covers numbers outside the settings, the statistical model and the decision rule. The digests are stored here, because parsing the
sources takes longer than judging a campaign anew; ``tests/test_constants.py`` computes them and says what to write here.
"""

#: For reduced models; for identifications and calibrations (which also depend on reduced models); for judgements.
NUMBERS = {
    "reduction": "959027b085577dff",
    "identification": "359e32ede791fd27",
    "judgement": "6f8ddba0f259cd1a",
}
