"""Learned dynamics: a history of (velocity, action) -> the change of velocity in a step."""

MODELS = {  # kind -> module:class
    "mlp": "buggy_rl.models.mlp:MLP",
    "temporal_cnn": "buggy_rl.models.temporal_cnn:TemporalCNN",
    "gru": "buggy_rl.models.gru:GRU",
    "transformer": "buggy_rl.models.transformer:CausalTransformer",
}
