"""Compiles inner loops of two engines and of the tyre effects for the CPU; needs g++.

    python scripts/compile.py output=build/kernels
    export BUGGY_RL_KERNELS=build/kernels

With the second line every script uses them; results are the same to rounding. Compile again after
a change of the source or of PyTorch: a package of other source is not used, and not made twice.
"""

from pathlib import Path

from buggy_rl.config import from_command_line, run


def main() -> None:
    """Compiles what is not there."""
    config = from_command_line(__doc__, "buggy_rl.kernels.registry:CompileConfig")

    from tqdm import tqdm

    from buggy_rl.kernels.registry import kernels

    folder = Path(config.output)
    for kernel in (bar := tqdm(kernels())):
        bar.set_description_str(kernel.name)
        if not kernel.file(folder).is_file():
            kernel.compile(folder)
    print(f"written: {folder}; to use them: export BUGGY_RL_KERNELS={folder}")


if __name__ == "__main__":
    run(main)
