"""An engine's step recorded as a CUDA graph, so that its hundreds of launches become one."""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from buggy_rl.simulators.base import Engine

WARM_UP = 3  # steps before a recording: they allocate and choose algorithms, which it cannot


def recorded(engine: Engine) -> Engine:
    """The engine, with its `_advance` recorded at the first call and replayed from then on.

    A replay reads and writes the memory of the recording: inputs are copied there, results from
    there. What the step computes with besides, such as parameters, must stay as it is.

    Args:
        engine: Of PyTorch, on a GPU; changed in place.

    Raises:
        ValueError: It is not on a GPU.
    """
    if engine.device is None or engine.device.type != "cuda":
        raise ValueError(f"a CUDA graph needs an engine on a GPU, not on {engine.device}")
    engine._advance = _Recording(engine)  # type: ignore[method-assign]
    return engine


class _Recording:
    """One period of an engine as a graph; see `recorded`."""

    def __init__(self, engine: Engine) -> None:
        self._names = list(engine.state_spec.keys())
        self._advance = engine._advance
        self._graph: torch.cuda.CUDAGraph | None = None

    def __call__(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        given = [*(state[name] for name in self._names), action]
        if self._graph is None:
            self._record(state, given)
        torch._foreach_copy_(self._inputs, given)
        assert self._graph is not None
        self._graph.replay()
        return {name: result.clone() for name, result in self._results.items()}

    @torch.no_grad()
    def _record(self, state: TensorDictBase, given: list[Tensor]) -> None:
        self._inputs = [tensor.clone() for tensor in given]
        *own, action = self._inputs
        fixed = TensorDict(dict(zip(self._names, own, strict=True)), state.batch_size)
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            for _ in range(WARM_UP):
                self._advance(fixed, action)
        torch.cuda.current_stream().wait_stream(stream)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._results = self._advance(fixed, action)
        self._graph = graph
