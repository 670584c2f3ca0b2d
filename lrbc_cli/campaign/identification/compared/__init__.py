"""What measurements say of each other: copies, exchanges, other units, other chains."""
