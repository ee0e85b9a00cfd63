"""Missing physics between the command given and the command that acts."""
