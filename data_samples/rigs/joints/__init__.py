"""Virtual rigs whose bolts are joints: springs of several components at discrete places, to ground or between two parts."""
