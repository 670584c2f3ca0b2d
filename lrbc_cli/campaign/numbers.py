"""Digests of all numbers, and of the operators on them, in the code that results rest on: part of what they rest on, by stage.

A number that is not among the settings, the statistical model or the decision rule changes results all the same. They are stored, because
parsing the sources takes longer than judging a campaign anew; a test computes them and says what to write here. So no number can change
without that what rested on the other one counts as out of date.
"""

#: Of reduced models; of identifications and calibrations, which rest on reduced models, too; of judgements.
NUMBERS = {
    "reduction": "3feba67c13b6ab39",
    "identification": "9c4431b4847753cc",
    "judgement": "63ff30b798d35e2c",
}
