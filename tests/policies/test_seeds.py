"""Trainings over seeds: one job each, of one config."""

from dataclasses import replace
from pathlib import Path

import pytest

from buggy_rl.core.config import build
from buggy_rl.policies.training.run import PolicyRunConfig
from buggy_rl.policies.training.seeds import PolicyTrainingConfig, seed_jobs, share_trained


def config(folder: Path, *more: str) -> PolicyTrainingConfig:
    return build(PolicyTrainingConfig, [f"output={folder}", "seeds=[3,4]", "ppo.steps=1000", *more])


def test_each_seed_is_a_job_of_the_same_config(tmp_path):
    jobs = seed_jobs(config(tmp_path, "ppo.clip=0.3", "resume=true"), Path("train_policy.py"))
    assert [job.folder for job in jobs] == [tmp_path / "seed_3", tmp_path / "seed_4"]
    assert jobs[1].command[2:] == ("seed=4", "ppo.seed=4", f"output={tmp_path / 'seed_4'}")
    jobs[0].prepared(1)
    shared = build(PolicyRunConfig, [jobs[0].command[1]])
    assert shared.ppo.clip == 0.3
    assert not shared.resume  # a job resumes by itself where there is a checkpoint
    assert jobs[0].checkpoint == "checkpoint.pt"


def test_where_it_runs_is_no_part_of_a_training(tmp_path):
    one, other = config(tmp_path), config(tmp_path, "launcher=ray", "workers=7", "retries=1")
    assert one.single == other.single
    assert vars(one.single).keys() == vars(replace(PolicyRunConfig(output="x"))).keys()


def test_another_config_in_the_same_folder_is_refused(tmp_path):
    (first, _) = seed_jobs(config(tmp_path), Path("train_policy.py"))
    first.prepared(1)
    begun = (tmp_path / "seeds.yaml").read_text()
    (again, _) = seed_jobs(config(tmp_path, "ppo.clip=0.3"), Path("train_policy.py"))
    with pytest.raises(ValueError, match=r"seed_3 answers .*: ppo.clip was 0.2, now 0.3; use"):
        _ = again.done
    assert (tmp_path / "seeds.yaml").read_text() == begun
    (same, _) = seed_jobs(config(tmp_path, "threads=2"), Path("train_policy.py"))
    assert not same.done


def test_a_seed_that_stands_there_twice_is_refused():
    with pytest.raises(ValueError, match="twice"):
        PolicyTrainingConfig(output="out", seeds=[1, 1])


def test_progress_is_read_off_the_log(tmp_path):
    assert share_trained(tmp_path, 1000) == 0.0
    log = tmp_path / "csv" / "scalars" / "reward.csv"
    log.parent.mkdir(parents=True)
    log.write_text("100,0.1\n250,0.2\n")
    assert share_trained(tmp_path, 1000) == 0.25
