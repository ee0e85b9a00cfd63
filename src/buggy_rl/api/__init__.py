"""What the names of `buggy_rl` do that take several parts of the package; docs/api.md lists them.

Commands call the same functions, so that Python and the command line give the same results.
"""
