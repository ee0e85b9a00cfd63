"""Compiles inner loops of engines and effects for the CPU; needs a C++ compiler, a minute or two.

    python scripts/compile.py
    python scripts/compile.py only=engines,moved workers=1

`only` names kernels, `engines` or `effects`; `make install` compiles these two groups. From then on
every script uses them; results are the same to rounding.
BUGGY_RL_KERNELS= (empty) runs without. Compile again after a change of the source or of PyTorch: a
package of other source is not used, and not made twice. A script that is started meanwhile waits
for the kernel that is being compiled, and for no other.
"""

import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from buggy_rl.core.config import from_command_line, run

OF_ENGINES = {"reference": "reference_substep", "single_track": "single_track_substep"}
OF_EFFECTS = ("centred", "mean_acceleration", "moved", "friction_change_12", "slip_change_12")
GROUPS = {"engines": (*OF_ENGINES.values(), "reference_substep_braked"), "effects": OF_EFFECTS}
"""What `only` may name besides kernels: those of engines, and of effects on a rear-driven car."""


def main() -> None:
    """Compiles what is not there."""
    config = from_command_line(__doc__, "buggy_rl.core.kernels:CompileConfig")

    from buggy_rl.core.kernels import CACHE, FOLDER, kernels
    from buggy_rl.jobs import cores
    from buggy_rl.jobs.bar import tqdm

    folder = Path(config.output or CACHE)
    only = [kernel for name in config.only for kernel in GROUPS.get(name, (name,))]
    missing = [k.name for k in kernels(only) if not k.file(folder).is_file()]
    with tqdm(total=len(missing), desc="compiling", unit="kernel", disable=not missing) as bar:
        for name in compiled(missing, folder, config.workers or cores()):
            bar.set_postfix_str(name)
            bar.update()
    use = "" if folder == CACHE else f"; to use them: export {FOLDER}={folder}"
    print(f"written: {folder}{use}")


def compiled(names: Sequence[str], folder: Path, workers: int) -> Iterator[str]:
    """Compiles kernels in their order, `workers` at a time; the name of each that is done.

    Raises:
        RuntimeError: There is no C++ compiler, or it refuses.
    """
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    if workers < 2 or len(names) < 2:
        yield from (compile_kernel(name, folder) for name in names)
        return
    # "spawn": PyTorch's compiler has threads, which a forked process would not have.
    with ProcessPoolExecutor(min(workers, len(names)), get_context("spawn")) as pool:
        for done in as_completed([pool.submit(compile_kernel, name, folder) for name in names]):
            yield done.result()


def at_first_use(simulator: Any) -> None:
    """Compiles what a diagnosis steps most and nobody has compiled yet, behind a bar.

    Only for the user's cache: where BUGGY_RL_KERNELS names a folder, or none, that is kept to.

    Args:
        simulator: As the diagnosis names it; the engine that a file names is found there.
    """
    from buggy_rl.core.kernels import CACHE, FOLDER, kernels
    from buggy_rl.jobs import cores
    from buggy_rl.jobs.bar import tqdm

    if FOLDER in os.environ or not shutil.which(os.environ.get("CXX", "g++")):
        return
    wanted = kernels([*kernels_of_engine(simulator), *OF_EFFECTS])
    missing = [kernel.name for kernel in wanted if not kernel.file(CACHE).is_file()]
    if not missing:
        return
    said = f"compiling {len(missing)} kernels, this once, some 15 s of a core each"
    try:
        with tqdm(total=len(missing), desc=said, unit="kernel") as bar:
            for _ in compiled(missing, CACHE, cores()):
                bar.update()
    except RuntimeError as error:
        tqdm.write(f"not compiled, PyTorch runs, slower: {str(error).splitlines()[0]}")


def kernels_of_engine(simulator: Any) -> list[str]:
    """Names of the kernels of the engine that a simulator is, or that its file names."""
    from buggy_rl.diagnosis.run.maker import engine_of

    try:
        engine = engine_of(simulator)
    except ValueError:  # the diagnosis says what is wrong with the file
        return []
    return [OF_ENGINES[engine]] if engine in OF_ENGINES else []


def compile_kernel(name: str, folder: Path) -> str:
    """Compiles one kernel; its name."""
    from buggy_rl.core.kernels import kernels

    (kernel,) = kernels([name])
    kernel.compile(folder)
    return name


if __name__ == "__main__":
    run(main)
