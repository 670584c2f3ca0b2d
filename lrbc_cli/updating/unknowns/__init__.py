"""What the unknowns of a job are: where bolts lie, and which values they move."""
