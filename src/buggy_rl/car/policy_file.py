"""The file pair of an exported policy, NAME.npz and NAME.json, and its network in numpy."""

import json
import os
from typing import Any, Callable, Dict, List, NamedTuple, Sequence, Tuple

import numpy as np

from buggy_rl.car.commands import COMMANDS
from buggy_rl.car.observation import SENSING, quantities


def _relu(values: np.ndarray) -> None:
    np.maximum(values, 0.0, out=values)


def _tanh(values: np.ndarray) -> None:
    np.tanh(values, out=values)


def _elu(values: np.ndarray) -> None:
    below = np.expm1(np.minimum(values, 0.0))
    np.copyto(values, below, where=values < 0)


ACTIVATIONS: Dict[str, Callable] = {"relu": _relu, "tanh": _tanh, "elu": _elu}


class Network:
    """u = W_n a(... a(W_1 s(o) + b_1) ...) + b_n,  s(o) = clip((o - mean) / sd, -limit, limit).

    Args:
        layers: Weights [out, in] and biases [out], from the observation on.
        activation: A name in `ACTIVATIONS`, between the layers.
        scaling: mean [in] and sd [in] of the observation; empty for none.
        limit: Standard deviations beyond which an observation is cut off.
    """

    def __init__(
        self,
        layers: Sequence[Tuple[np.ndarray, np.ndarray]],
        activation: str,
        scaling: Sequence[np.ndarray] = (),
        limit: float = 0.0,
    ) -> None:
        single = [(np.array(w, np.float32, order="C"), np.array(b, np.float32)) for w, b in layers]
        self._layers = [(weight, bias, np.empty_like(bias)) for weight, bias in single]
        self._activate = ACTIVATIONS[activation]
        self._scaling = tuple(np.array(row, np.float32) for row in scaling)
        self._limit = np.float32(limit)
        self._scaled = np.empty(self.inputs, np.float32)

    @property
    def inputs(self) -> int:
        """Numbers of an observation."""
        return self._layers[0][0].shape[1]

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """The mean command [2], unbounded, of an observation [inputs]; kept until the next call."""
        values, last = self._standardised(observation), self._layers[-1]
        for layer in self._layers:
            weight, bias, out = layer
            np.dot(weight, values, out=out)
            out += bias
            if layer is not last:
                self._activate(out)
            values = out
        return values

    def _standardised(self, observation: np.ndarray) -> np.ndarray:
        if not self._scaling:
            return observation
        mean, sd = self._scaling
        scaled = self._scaled
        np.subtract(observation, mean, out=scaled)
        np.divide(scaled, sd, out=scaled)
        np.minimum(scaled, self._limit, out=scaled)
        np.maximum(scaled, -self._limit, out=scaled)
        return scaled


SCHEMA = 1  # of the JSON file
SUFFIXES = (".json", ".npz")

OUTPUTS = 2  # throttle, steering


class PolicyFile(NamedTuple):
    """What a file pair holds."""

    settings: Dict[str, Any]
    """The JSON."""
    arrays: Dict[str, np.ndarray]
    """weight_0, bias_0, ...; mean and sd of the observation where it is scaled."""

    @property
    def layers(self) -> List[Tuple[np.ndarray, np.ndarray]]:
        """Weights [out, in] and biases [out], from the observation on."""
        count = sum(name.startswith("weight_") for name in self.arrays)
        return [(self.arrays[f"weight_{i}"], self.arrays[f"bias_{i}"]) for i in range(count)]


def stem(file: str) -> str:
    """The common part of the pair's names."""
    root, suffix = os.path.splitext(file)
    return root if suffix in SUFFIXES else file


def read_policy(file: str) -> PolicyFile:
    """Reads a file pair and checks that its parts belong together.

    Args:
        file: Of either file, or their common part.

    Raises:
        ValueError: A file is missing, of another schema, or the two do not fit each other.
    """
    root = stem(file)
    for suffix in SUFFIXES:
        if not os.path.isfile(root + suffix):
            raise ValueError(
                f"there is no policy file {root + suffix}: write it with scripts/export_policy.py "
                "and copy both, .json and .npz"
            )
    with open(root + ".json") as stream:
        settings = json.load(stream)
    with np.load(root + ".npz", allow_pickle=False) as content:
        arrays = {name: content[name] for name in content.files}
    read = PolicyFile(settings, arrays)
    _check(read, root)
    return read


def _check(read: PolicyFile, root: str) -> None:
    settings = read.settings
    if settings.get("schema") != SCHEMA:
        raise ValueError(
            "{}.json: schema is {!r}, this runtime reads {}: export the policy again with the "
            "version that runs on the car".format(root, settings.get("schema"), SCHEMA)
        )
    known: Tuple[Tuple[str, Any], ...] = (("sensing", SENSING), ("commands", COMMANDS))
    for place, kinds in known:
        for entry in settings[place]:
            if entry["name"] not in kinds:
                names = ", ".join(sorted(kinds))
                raise ValueError(f"{root}.json: {place} {entry['name']!r}; known are {names}")
    if settings["network"]["activation"] not in ACTIVATIONS:
        raise ValueError(f"{root}.json: activation {settings['network']['activation']!r}")
    _check_sizes(read, root)


def _check_sizes(read: PolicyFile, root: str) -> None:
    """Raises ValueError where layers and observation do not fit each other."""
    settings = read.settings
    row = quantities(settings["observation"]["inputs"], settings["waypoints"]["visible"])
    size = len(row) * settings["observation"]["rows"]
    for index, (weight, bias) in enumerate(read.layers):
        if weight.shape != (len(bias), size):
            raise ValueError(
                f"{root}.npz: weight_{index} is {list(weight.shape)}, expected "
                f"[{len(bias)}, {size}]: the two files are of different exports"
            )
        size = len(bias)
    if size != OUTPUTS or not read.layers:
        raise ValueError(f"{root}.npz: the network has {size} outputs, expected throttle, steering")
