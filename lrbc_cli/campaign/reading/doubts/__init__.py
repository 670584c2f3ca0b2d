"""Contradictions within a campaign, by kind: between its springs and the matrix, and in its settings."""
