"""Does a policy do on the car what it did in simulation, and does a repaired simulator help?"""
