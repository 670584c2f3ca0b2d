"""The unknowns of a job: where bolts lie, and which values they move."""
