"""Makes two fitted simulators of the sample drives, a policy trained in each, and a blind test.

    python scripts/demo.py [OUTPUT]

Runs what one would run by hand, on smaller settings: check the drives, train models, fit MuJoCo,
compare; train a policy in each simulator, by the same code and settings, draw and film how they
drive on the reference car. Beside it kernels are compiled, an effect drawn at random is concealed
in a car, the diagnosis names it, and the sealed answer is shown. As many stages run at a time as
there are cores; what each has printed lies in OUTPUT/log. Started again, it goes on with the
trainings and the blind case that are there.
"""

import json
import multiprocessing
import os
import re
import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from buggy_rl.commands import MODULES, PROGRAM, as_typed
from buggy_rl.commands.compile import OF_EFFECTS, OF_ENGINES
from buggy_rl.core.config import run
from buggy_rl.jobs import cores
from buggy_rl.jobs.bar import PERIOD, tqdm

STUDY = "configs/demo.yaml"
SIMULATORS = {"learned": "models/history_mlp.pt", "mujoco": "mujoco_fitted.yaml"}
# Of both policies: the engine alone differs.
SETTINGS = ("configs/ppo.yaml", "configs/demo_policy.yaml", "ppo.steps=700_000")
BLIND = "configs/demo_blind.yaml"
KERNELS = (OF_ENGINES["reference"], *OF_EFFECTS)
PRELOADED = (  # by all stages together, once: PyTorch and TorchRL take seconds
    *("buggy_rl.visual.study.stages", "buggy_rl.policies.evaluation.drives"),
    *("buggy_rl.proof.blind_demo", "buggy_rl.figures.models"),
)
RESULTS = (
    *("table.png", "rollouts.png", "drives.png", "policies.png", "policy.gif"),
    *("blind_demo/blind_demo.png", "blind_demo/report.html"),
)
IN_FULL = (
    ("all models, half an hour", "train_models.py configs/sample.yaml"),
    ("the fit of MuJoCo", "fit_mujoco.py configs/sample.yaml"),
    ("the table", "evaluate_models.py configs/sample.yaml"),
    (
        "a policy of 3 million steps",
        "train_policy.py configs/ppo.yaml engine.simulator={output}/mujoco_fitted.yaml"
        " output=runs/policy",
    ),
    ("a film in full size", "render.py what=runs/policy/best.pt output=runs/policy.mp4"),
    ("a blind test, longer drives", "blind_demo.py output=runs/blind_demo"),
    ("all kernels", "compile.py"),
    ("your own drives, one page", 'study.py configs/study.yaml "data.recordings=[FOLDER]"'),
)
BAR = "{desc:24}{percentage:3.0f}%|{bar:20}| {elapsed} {postfix}"
ENDINGS = (".out", ".err", ".json")  # of what a stage printed, its bars and errors, its CPU time
POLL = 0.2  # [s] between two looks at the stages that run
TAIL = 15  # last lines shown of what failed
GRACE = 10.0  # [s] that a stage has to end by itself


@dataclass(frozen=True)
class DemoStage:
    """One command of the demo."""

    name: str
    """Name of its bar and of its log."""
    title: str
    verb: str
    arguments: tuple[str, ...]
    needs: tuple[str, ...] = ()
    """Names of stages that must have ended."""
    without: str = ""
    """What is said where it fails and the demo goes on without; empty where it cannot."""

    @property
    def command(self) -> str:
        """The command as one would type it."""
        script = f"python scripts/{MODULES[self.verb]}.py"
        return as_typed(" ".join([script, *self.arguments]))


def main() -> None:
    """Runs all stages, each as soon as a core is free and what it needs is there."""
    arguments = [argument.removeprefix("output=") for argument in sys.argv[1:]]
    if {"-h", "--help"} & set(arguments):
        print((__doc__ or "").strip())
        return
    if len(arguments) > 1 or any("=" in a or a.startswith("-") for a in arguments):
        raise ValueError(f"{' '.join(sys.argv[1:])}: the demo takes one folder (--help)")
    if not Path("data/sample").is_dir():
        raise ValueError("no folder data/sample here: the demo runs in a clone of the repository")
    output = arguments[0] if arguments else "demo"
    began, spent = time.monotonic(), run_stages(stages(output), Path(output), cores())
    print(
        f"\nDone in {time.monotonic() - began:.0f} s, {sum(spent.values()):.0f} s of CPU: ", end=""
    )
    print(", ".join(f"{name} {seconds:.0f}" for name, seconds in spent.items()))
    print("Look at:\n" + "\n".join(f"  {output}/{name}" for name in RESULTS))
    print("All of this was small. In full:")
    for what, command in IN_FULL:
        print(as_typed(f"  {what:28} python scripts/{command.format(output=output)}"))


def stages(output: str) -> list[DemoStage]:
    """All stages; of those that could run, the first one does."""
    own, study = f"output={output}", (STUDY, f"output={output}")
    policies = [policy_stage(name, output) for name in SIMULATORS]
    best = {name: f"{output}/policy_{name}/best.pt" for name in SIMULATORS}
    drawn = [f"policies.{name}={file}" for name, file in best.items()]
    film = [f"what={best['mujoco']}", "ghost=pure_pursuit", "simulator=reference", "seconds=4"]
    film += ["size=320,240", "fps=10", "samples=0"]
    slower = "nothing compiled: simulators run by PyTorch, slower"
    kernels = (f"only={','.join(KERNELS)}", "workers=1")
    return [
        DemoStage("check", "Are the drives fit for use?", "check", ("data/sample",)),
        DemoStage("compile", "Compile what is stepped most", "compile", kernels, (), slower),
        DemoStage("drives", "What was driven?", "drives", study),
        DemoStage("learn", "Learn the car from its drives", "train", study),
        DemoStage("fit", "Fit MuJoCo to the same drives", "fit", study),
        policies[0],
        DemoStage(
            "blind test",
            "What was left out of a simulator?",
            "blind-demo",
            (BLIND, f"{own}/blind_demo"),
            ("compile",),
        ),
        policies[1],
        DemoStage("compare", "Which simulator to trust?", "evaluate", study, ("learn", "fit")),
        DemoStage(
            "policies",
            "How do the policies drive?",
            "policies",
            (*drawn, "courses=lap,infinity", f"{own}/policies.png"),
            tuple(policy.name for policy in policies),
        ),
        DemoStage(
            "film",
            "Film one on the reference car",
            "render",
            (*film, f"{own}/policy.gif"),
            (policies[1].name,),
        ),
    ]


def policy_stage(name: str, output: str) -> DemoStage:
    """Trains a policy in one of the simulators; goes on where it was stopped."""
    folder, made_by = f"{output}/policy_{name}", {"learned": "learn", "mujoco": "fit"}[name]
    own = [f"engine.simulator={output}/{SIMULATORS[name]}", f"output={folder}"]
    own += ["resume=true"] if Path(folder, "checkpoint.pt").is_file() else []
    title = f"Train a policy: {name}"
    return DemoStage(f"policy {name}", title, "policy", (*SETTINGS, *own), (made_by,))


def run_stages(todo: Sequence[DemoStage], output: Path, lanes: int) -> dict[str, float]:
    """Runs stages, `lanes` at a time, each in a process of its own.

    Returns:
        CPU time [s] of each stage, by its name.

    Raises:
        SystemExit: A stage has failed that the others need.
    """
    log = output / "log"
    log.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(PRELOADED))
    waiting, free = list(todo), list(range(lanes))
    running: list[RunningStage] = []
    spent: dict[str, float] = {}
    try:
        while waiting or running:
            for stage in [s for s in waiting if set(s.needs) <= set(spent)][: len(free)]:
                waiting.remove(stage)
                running.append(RunningStage(stage, context, log, free.pop(0)))
            time.sleep(POLL)
            for one in list(running):
                if one.show():
                    running.remove(one)
                    free.append(one.lane)
                    spent[one.stage.name] = one.finish()
    finally:
        for one in running:
            one.end()
    return spent


class RunningStage:
    """A stage that runs, behind a bar.

    Args:
        stage: Which.
        context: That its process is made in.
        log: Folder of what it prints.
        lane: Number of its bar, from the top.
    """

    def __init__(self, stage: DemoStage, context, log: Path, lane: int) -> None:
        self.stage, self.lane, self._log = stage, lane, log / stage.name.replace(" ", "_")
        for ending in ENDINGS:
            self._log.with_suffix(ending).unlink(missing_ok=True)  # of an earlier demo
        given = (stage.verb, list(stage.arguments), str(self._log), sys.argv[0])
        self._process = context.Process(target=run_verb, args=given)
        self._process.start()
        self._bar = tqdm(total=100, desc=stage.name, position=lane, bar_format=BAR, leave=False)

    def show(self) -> bool:
        """Shows how far it is; whether it has ended."""
        said = _end(self._log.with_suffix(".err"))
        if done := re.findall(r"(\d+)%\|", said):
            told = re.findall(r"[\d.]+ closed", said)
            self._bar.n = int(done[-1])
            self._bar.set_postfix_str(told[-1] if told else "", refresh=False)
        self._bar.refresh()
        return not self._process.is_alive()

    def finish(self) -> float:
        """Prints what it has printed; its CPU time [s].

        Raises:
            SystemExit: It has failed, and the demo cannot go on without it.
        """
        seconds = self._bar.format_dict["elapsed"]
        self._bar.close()
        printed = self._log.with_suffix(".out")
        said = printed.read_text().strip() if printed.is_file() else ""
        head = f"\n== {self.stage.title}\n   {self.stage.command}\n"
        if self._process.exitcode and not self.stage.without:
            last = _end(self._log.with_suffix(".err")).splitlines()[-TAIL:]
            tqdm.write("\n".join([head, said, *last]), file=sys.stdout)
            raise SystemExit(f"error: {self.stage.title!r} did not finish; see above")
        said = self.stage.without if self._process.exitcode else said
        tqdm.write("\n".join(filter(None, [head, said, f"({seconds:.0f} s)"])), file=sys.stdout)
        sys.stdout.flush()
        file = self._log.with_suffix(".json")
        return json.loads(file.read_text())["cpu"] if file.is_file() else 0.0

    def end(self) -> None:
        """Ends it where it still runs."""
        self._bar.close()
        self._process.terminate()
        self._process.join(GRACE)
        self._process.kill()


def _end(file: Path, length: int = 4000) -> str:
    """The last characters of a text file; empty where there is none."""
    if not file.is_file():
        return ""
    with open(file, "rb") as read:
        read.seek(max(0, file.stat().st_size - length))
        return read.read().decode(errors="replace").replace("\r", "\n")


def run_verb(verb: str, arguments: Sequence[str], log: str, program: str) -> None:
    """Runs a verb in this process, with what it prints in LOG.out and LOG.err.

    Args:
        verb: Which.
        arguments: Its own.
        log: Beginning of the names; LOG.json is its CPU time.
        program: That the demo was started by, since commands are named as one has typed them.
    """
    for stream, ending in ((1, "out"), (2, "err")):
        os.dup2(os.open(f"{log}.{ending}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644), stream)
    os.environ[PERIOD] = "1"  # its lines are the bar of the demo
    name = MODULES[verb]
    typed = f"{PROGRAM} {verb}" if program.startswith(PROGRAM) else f"scripts/{name}.py"
    sys.argv = [typed, *arguments]
    try:
        run(lambda: sys.exit(import_module(f"buggy_rl.commands.{name}").main()))
    finally:
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        cpu = sum(each.ru_utime + each.ru_stime for each in used)
        Path(f"{log}.json").write_text(json.dumps({"cpu": cpu}))


if __name__ == "__main__":
    run(main)
