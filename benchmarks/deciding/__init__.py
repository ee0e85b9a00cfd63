"""Parts of manoeuvres.py."""
