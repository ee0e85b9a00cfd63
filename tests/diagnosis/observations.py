"""What was seen of searches, made by hand: few numbers, each with a meaning."""

from buggy_rl.diagnosis.search.candidate import Variation
from buggy_rl.diagnosis.search.case_evidence import CaseEvidence, HypothesisEvidence
from buggy_rl.estimation.evidence import BaselineMisfit, Evidence


def hypothesis(effects, held_out, excess, **other):
    """One that leaves `excess`, with a held-out loss of each block."""
    evident = -sum(held_out) / 4
    numbers = {
        "effects": tuple(sorted(effects)),
        "asked": False,
        "values": {effect: {} for effect in (*effects, "")},
        "z": (1.0,) * len(effects) + (0.0,),
        "sd": (0.1,) * (len(effects) + 1),
        "correlation": (),
        "held_out": tuple(held_out),
        "penalty": 0.0,
        "excess": excess,
        "typical": 1.0 + excess,
        "channel": (1 / 6,) * 6,  # shares
        "by_condition": (),
        "unclosed": excess,
        "at_bound": (),
        "varies": {effect: Variation("vx", 0.0, 0.0) for effect in effects},
        "on_baseline": 0.0,
        "evidence": Evidence(evident, 0.0, 0.0, 1.0, evident, 0.0, 0.0, 500.0),
    }
    return HypothesisEvidence(**(numbers | other))


def case(hypotheses, first=1.0, usual=(0.0, 0.0)):
    """Of the first hypothesis, which is that nothing is missing, and others."""
    return CaseEvidence(first, BaselineMisfit(*usual), 40, 1.0, tuple(hypotheses))
