"""Missing physics between the command that is given and the one that acts."""
