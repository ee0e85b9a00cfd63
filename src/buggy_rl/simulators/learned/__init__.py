"""Learned dynamics: a history of (velocity, action) -> the change of velocity in a step."""

MODELS = {  # kind -> module:class
    "mlp": "buggy_rl.simulators.learned.networks:MLP",
    "temporal_cnn": "buggy_rl.simulators.learned.networks:TemporalCNN",
    "gru": "buggy_rl.simulators.learned.networks:GRU",
    "transformer": "buggy_rl.simulators.learned.networks:CausalTransformer",
}
