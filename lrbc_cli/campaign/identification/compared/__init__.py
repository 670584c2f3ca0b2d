"""Faults of measurements that show in comparison with others or with the model: copies, exchanged sensors, units, measuring chains."""
