"""Physics concealed in simulated cars, diagnosed and scored, and the calibration made of it."""
