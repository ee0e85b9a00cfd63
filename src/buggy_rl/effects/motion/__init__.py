"""Forces and moments on the car that a simulator lacks."""
