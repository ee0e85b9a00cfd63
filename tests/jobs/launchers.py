"""The launchers as the tests use them."""

from buggy_rl.jobs import Launching

OPTIONS = {"local": {}, "ray": {}, "submitit": {"cluster": "local"}}


def launching(name: str, retries: int = 0) -> Launching:
    """A launcher on this machine alone; a job takes one core of it."""
    return Launching(launcher=name, cluster=OPTIONS[name], cores=1, retries=retries)
