"""The suggested manoeuvre as the leading hypotheses would have it driven."""

import torch
from tensordict import TensorDict

from buggy_rl import keys
from buggy_rl.diagnosis.answer import Answer
from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.manoeuvres import MANOEUVRES
from buggy_rl.diagnosis.report import wording
from buggy_rl.diagnosis.search_result import SearchResult
from buggy_rl.estimation.rollout import sensed
from buggy_rl.longitudinal import declared_by
from buggy_rl.viz.manoeuvre import ManoeuvrePlan


def suggested(case: Case, found: SearchResult, answer: Answer) -> ManoeuvrePlan | None:
    """The manoeuvre that is suggested, and its prediction by each hypothesis; None without one."""
    known = {m.name: m for m in MANOEUVRES}
    if not (answer.suggest and answer.manoeuvres) or answer.manoeuvres[0].manoeuvre not in known:
        return None
    rate, problem = answer.manoeuvres[0], case.problem
    simulation, dt = problem.simulation, problem.segments.dt
    between = [effects for effects in rate.between if effects in found.tried]
    fits = [found.tried[effects].fit for effects in between]
    action = known[rate.manoeuvre].actions(dt, declared_by(simulation.make(1)).rest)
    rest = torch.zeros(len(fits), 3)
    start = TensorDict({keys.POSE: rest, keys.VELOCITY: rest.clone()}, [len(fits)])
    settings = problem.library.settings([(fit, fit.vector) for fit in fits])
    states = simulation.drive(action.repeat(len(fits), 1, 1), settings, start)
    read = torch.stack([sensed(state) for state in states], 1).double().numpy()  # (H, T, 6)
    names = [
        " + ".join(map(wording.effect, effects)) or "nothing is missing" for effects in between
    ]
    return ManoeuvrePlan(
        time=(dt * torch.arange(len(action))).double().numpy(),
        action=action.numpy(),
        predicted=dict(zip(names, read, strict=True)),
    )
