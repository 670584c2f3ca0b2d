"""The unknowns of a job: where the bolts are, and which stiffness values each of them changes."""
