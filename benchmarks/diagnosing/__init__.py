"""Parts of diagnosis.py: drives with a known fault, what is measured on them, the tables."""
