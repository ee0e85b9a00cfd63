"""Compiles inner loops of engines and effects for the CPU; needs a C++ compiler, a minute or two.

    python scripts/compile.py

`make install` does it. From then on every script uses them; results are the same to rounding.
BUGGY_RL_KERNELS= (empty) runs without. Compile again after a change of the source or of PyTorch: a
package of other source is not used, and not made twice.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Compiles what is not there."""
    config = from_command_line(__doc__, "buggy_rl.core.kernels:CompileConfig")

    from buggy_rl.core.kernels import CACHE, FOLDER, kernels
    from buggy_rl.jobs.bar import tqdm

    folder = Path(config.output or CACHE)
    for kernel in (bar := tqdm(kernels())):
        bar.set_description_str(kernel.name)
        if not kernel.file(folder).is_file():
            kernel.compile(folder)
    use = "" if folder == CACHE else f"; to use them: export {FOLDER}={folder}"
    print(f"written: {folder}{use}")


if __name__ == "__main__":
    run(main)
