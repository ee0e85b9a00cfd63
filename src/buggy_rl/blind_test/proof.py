"""A run of the proof: what it consists of, and its stages one after the other."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.draw import PAIRINGS, Settings, draw_all
from buggy_rl.blind_test.exam import finished
from buggy_rl.blind_test.sealing import Vault, groups
from buggy_rl.plants import abilities

STAGES = (
    "prepare",
    "seal",
    "ask",
    "again",
    "weigh",
    "compare",
    "settle",
    "score",
    "page",
)


@dataclass(frozen=True)
class ProofConfig:
    """Sealed cases, asked and counted."""

    output: str = MISSING
    """Folder of what may be seen, the answers and the score."""
    sealed: str = ""
    """Folder of what is sealed; empty for OUTPUT_sealed."""
    stages: list[str] = field(default_factory=lambda: list(STAGES))
    """Any of prepare, seal, ask, again, weigh, compare, settle, score, page; done is done."""
    draw: Settings = field(default_factory=Settings)
    effects: list[str] = field(default_factory=list)
    """Effects that the tool chooses from; empty for the whole library."""
    stretches: int = 0
    """Stretches of a second that the tool looks at; 0 for its own choice."""
    rivals: int = 6
    """Other effects that are fitted to a case to see whether it can be decided."""
    limit: float = 3600.0
    """Most seconds for a case."""
    workers: int = 2
    """Cases at a time."""
    secret: str = "buggy"
    """What the salts of the sealed answers are made from."""
    page: str = ""
    """Markdown file to write; empty for OUTPUT/proof.md."""
    images: str = ""
    """Folder for its pictures; empty for the page's own."""
    opened: str = ""
    """File that counts how often sealed seeds were scored; empty for OUTPUT/opened.json."""
    hashes: str = ""
    """File of the hashes of sealed answers; empty for OUTPUT/hashes.txt."""
    ledger: str = ""
    """File of settled cases, which are not done again; empty for OUTPUT/ledger.jsonl."""

    def __post_init__(self) -> None:
        unknown = sorted(set(self.stages) - set(STAGES))
        if unknown:
            raise ValueError(f"no stages {unknown}; available: {', '.join(STAGES)}")

    @property
    def vault(self) -> Vault:
        """Where its cases lie."""
        output = Path(self.output)
        sealed = Path(self.sealed) if self.sealed else Path(f"{output}_sealed")
        return Vault(output, sealed, Path(self.hashes) if self.hashes else None)


def cases_of(config: ProofConfig) -> list[Case]:
    """What is drawn by a config."""
    plants = {PAIRINGS[name].plant for name in config.draw.pairings}
    return draw_all(config.draw, {plant: abilities(plant) for plant in plants})


def unsealed(vault: Vault, cases: Sequence[Case]) -> list[list[Case]]:
    """Groups of cases that are still to be sealed, whole ones: what is beside a case stays."""
    return [
        group
        for group in groups(cases)
        if not all(vault.answer(case.id).exists() for case in group)
    ]


def unanswered(vault: Vault, ids: Sequence[str]) -> list[tuple[Path, Path]]:
    """Folders of what the tool is still to be asked."""
    return [(vault.seen(id_), vault.said(id_)) for id_ in ids if not finished(vault.said(id_))]


def unweighed(vault: Vault, cases: Sequence[Case]) -> list[Case]:
    """Answered cases to which the true structure is still to be fitted."""
    return [
        case for case in cases if finished(vault.said(case.id)) and not vault.is_weighed(case.id)
    ]


def side_by_side(
    work: Callable[..., Any], arguments: Sequence[tuple], workers: int
) -> Iterator[Any]:
    """Results of a function in processes of their own, as they come."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _alone) as pool:
        futures = [pool.submit(work, *each) for each in arguments]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()  # a killed parent's workers hear nothing of it
            raise


def _alone() -> None:
    import torch

    torch.set_num_threads(1)
