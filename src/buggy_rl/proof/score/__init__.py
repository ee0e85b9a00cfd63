"""Outcomes of cases, and how they are counted."""
