"""What measurements show when compared with each other: copies, exchanges, other units, other measuring chains."""
