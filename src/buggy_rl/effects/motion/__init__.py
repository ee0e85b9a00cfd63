"""Forces on the car that a simulator leaves out."""
