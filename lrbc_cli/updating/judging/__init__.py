"""From the evidence of an identification to verdicts on bolts, and from the verdicts to an outcome (all-clear or not).

In the order of a judgement: ``decide.judge`` asks ``decide.validity`` whether the state is explained; ``bolt.Threshold`` sets the change
below which a bolt is loose; ``evidence.Change.below`` gives the probability of it, which ``groups.of_its_groups`` raises if a group of its
springs alone is looser; ``rule.DecisionRule.word`` makes a verdict of it; ``bolt._doubt_of_tight`` lists all that forbids to call a bolt
tight. ``campaign.jobs.judging`` adds the doubts of the measurement, and ``clearance`` makes the outcome of a job.
"""
