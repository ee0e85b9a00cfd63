"""Policies and controllers driven and compared."""
