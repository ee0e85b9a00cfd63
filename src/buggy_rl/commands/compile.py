"""Compiles inner loops of engines and effects for the CPU; needs a C++ compiler, a few minutes.

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
OF_MOTION = ("centred", "mean_acceleration", "moved")
OF_EFFECTS = (*OF_MOTION, "friction_change_12", "slip_change_12")
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


def at_first_use(simulator: Any, **options: Any) -> None:
    """Compiles what a diagnosis steps most and nobody has compiled yet, behind a bar.

    Only for the user's cache: where BUGGY_RL_KERNELS names a folder, or none, that is kept to.

    Args:
        simulator: As the diagnosis names it; the engine that a file names is found there.
        options: Of the simulator.
    """
    from buggy_rl.core.kernels import CACHE, FOLDER, kernels
    from buggy_rl.jobs import cores
    from buggy_rl.jobs.bar import tqdm

    if FOLDER in os.environ or not shutil.which(os.environ.get("CXX", "g++")):
        return
    wanted = kernels(kernels_of(simulator, **options))
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


def kernels_of(simulator: Any, **options: Any) -> list[str]:
    """Names of the kernels of a simulator, and of effects on a car that is driven as its own is."""
    from buggy_rl.core.longitudinal import declared_by
    from buggy_rl.diagnosis.run.maker import engine_of, in_closed_form
    from buggy_rl.effects.measuring import front_drive_share
    from buggy_rl.effects.tyre.change import FrictionChange, changed_by, driven_axles
    from buggy_rl.effects.tyre.stiffness import SlipChange
    from buggy_rl.simulators import ENGINES
    from buggy_rl.simulators.mujoco.closed_cars import COMPILED, substep_kernel
    from buggy_rl.task.env import make_simulator

    try:
        engine = engine_of(simulator)
        if engine not in ENGINES and not engine.endswith(".pt"):
            return [*OF_EFFECTS]  # a user's own, which may take long to build
        made = make_simulator(simulator, 1, **options)
    except (ValueError, OSError):  # the diagnosis says what is wrong with the file
        return [*OF_EFFECTS]
    command, axles = declared_by(made), driven_axles(front_drive_share(made))
    own = [OF_ENGINES[engine]] if engine in OF_ENGINES else []
    if own == ["reference_substep"] and command.kind == "throttle_brake_reverse":
        own = ["reference_substep_braked"]
    if in_closed_form(simulator):
        car: Any = made
        used = substep_kernel(car.car.drive, command.kind)
        own = [kernel.name for kernel in COMPILED if kernel is used]
    tyres = [changed_by(axles, command.two_way, kind).name for kind in (FrictionChange, SlipChange)]
    return [*own, *OF_MOTION, *tyres]


def compile_kernel(name: str, folder: Path) -> str:
    """Compiles one kernel; its name."""
    from buggy_rl.core.kernels import kernels

    (kernel,) = kernels([name])
    kernel.compile(folder)
    return name


if __name__ == "__main__":
    run(main)
