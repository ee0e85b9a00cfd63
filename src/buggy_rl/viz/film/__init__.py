"""Films of cars: recordings, simulators and policies, by MuJoCo's renderer or drawn from above."""
