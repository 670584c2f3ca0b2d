"""What contradicts itself in a campaign, by kind: its springs and the matrix, its settings."""
