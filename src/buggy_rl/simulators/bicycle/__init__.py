"""The bicycle: two axles behind a motor and delayed actuators, with tyres or without slip."""
