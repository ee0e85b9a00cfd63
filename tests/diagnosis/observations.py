"""Observed cases as a search writes them down, made by hand: few numbers, each with a meaning."""


def hypothesis(effects, held_out, excess, **other):
    """One that leaves `excess`, with a held-out loss of each block."""
    evident = -sum(held_out) / 4
    return {
        "effects": sorted(effects),
        "asked": False,
        "z": [1.0] * len(effects) + [0.0],
        "held_out": list(held_out),
        "penalty": 0.0,
        "excess": excess,
        "typical": 1.0 + excess,
        "channel": [1 / 6] * 6,  # shares
        "unclosed": excess,
        "at_bound": [],
        "varies": {effect: ["vx", 0.0, 0.0] for effect in effects},
        "on_baseline": 0.0,
        "evidence": {
            "log_evidence": evident, "plain": evident, "spread": 0.0, "variation": 0.0,
            "by_spread": 0.0, "by_variation": 0.0, "dispersion": 1.0, "numbers": 500.0,
        },
    } | other  # fmt: skip


def case(hypotheses, first=1.0, usual=(0.0, 0.0)):
    """Of the first hypothesis, which is that nothing is missing, and others."""
    return {
        "first": first,
        "usual": list(usual),
        "segments": 40,
        "dispersion": 1.0,
        "hypotheses": list(hypotheses),
    }
