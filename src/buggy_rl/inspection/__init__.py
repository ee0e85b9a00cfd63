"""What a folder of foreign recordings holds: rates, columns, delays, coverage, a proposed map."""
