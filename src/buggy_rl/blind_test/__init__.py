"""Proof: physics is concealed in cars, the diagnosis is asked, and its answers are counted."""
