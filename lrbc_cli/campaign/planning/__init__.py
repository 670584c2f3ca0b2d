"""What planned microphones and hammer points can see of the bolts."""
