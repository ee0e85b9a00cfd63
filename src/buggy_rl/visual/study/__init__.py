"""A whole study: from a folder of recordings to one page, stage by stage."""
