"""Steps a second of a whole training loop."""

import time

from training.cases import Training

WARM_UP = 2  # batches that do not count


def rates(training: Training, seconds: float, repeats: int) -> tuple[list[float], float]:
    """Steps a second of each repeat, and the steps a CPU second over all of them.

    A repeat is as many whole batches as take at least `seconds`. On a quiet machine and one
    thread both figures are the same; the second one does not see what else the machine does.
    """
    found: list[float] = []
    batches = 0
    first = begin = (0, 0.0, 0.0)  # steps, wall time, CPU time
    last = begin

    def watch(steps: int) -> bool:
        nonlocal batches, first, begin, last
        now = (steps, time.perf_counter(), time.process_time())
        if batches <= WARM_UP:
            first = begin = now
        elif now[1] - begin[1] >= seconds:
            found.append((steps - begin[0]) / (now[1] - begin[1]))
            begin = last = now
        batches += 1
        return len(found) < repeats

    training.train(watch)
    return found, (last[0] - first[0]) / (last[2] - first[2])
