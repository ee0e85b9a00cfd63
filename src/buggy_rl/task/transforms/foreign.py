"""Transforms of TorchRL in a task: which are refused, and what does their work here.

Those of `RIGHT` equal a computation of their definition through partial resets
(`tests/task/transforms/test_swaps.py`). Those of `REFUSED` could be built, and would be wrong
without a word. Names that are in neither list are of later versions of TorchRL.
"""

from collections.abc import Mapping
from typing import Any

RIGHT = {  # and what it is good for in a task
    "ActionScaling": "commands of another range",
    "CatFrames": "the last observations; `history` keeps them in the TensorDict",
    "CatTensors": "numbers in one row",
    "ClipTransform": "bounds of any key",
    "DTypeCastTransform": "another type",
    "DoubleToFloat": "float32 of a simulator's float64",
    "ExcludeTransform": "leaves out what no step needs",
    "FiniteTensorDictCheck": "an error where a number is not finite",
    "FlattenObservation": "waypoints in one row",
    "InitTracker": "marks first states, for recurrent policies",
    "ObservationNorm": "a shift and a scale that are given",
    "PermuteTransform": "another order of dimensions",
    "RenameTransform": "another name beside a key (`create_copy`)",
    "RewardClipping": "bounds of the reward",
    "RewardScaling": "scale and shift of the reward",
    "RewardSum": "the reward of the episode so far",
    "SignTransform": "the sign of the reward",
    "SqueezeTransform": "without a dimension of size 1",
    "StepCounter": "length of an episode and its limit",
    "TensorDictPrimer": "the first memory of a recurrent policy",
    "UnsqueezeTransform": "with a dimension of size 1",
}

_SEVERAL = (
    "takes several steps of what is beneath it in one, of which commands, rewards, sensors and "
    "counts of the task see one: give the engine a longer control period (dt)"
)
_OUTSIDE = (
    "keeps what it has seen outside the TensorDict, so that neither a checkpoint nor a validation "
    "nor the policy's file has it: "
)
_BUFFER = "works on a replay buffer's samples, not on steps: append it to the buffer"
_ACTIONS = "changes what an action is, and engines take throttle and steering in [-1, 1]: "
_PICTURES = "works on pictures, and a task has none: films are made by buggy_rl.visual"
_ENDS = "is for environments that reset themselves, and these do not: leave it out"
_DEVICE = "moves data between devices: build the environment on one, make_env(device=...)"
_BACKEND = "adapts another kind of environment, and this one needs no adapting: leave it out"

REFUSED = {
    "Compose": "hides its parts from the checks of the order: name each in a place of its own",
    "ActionChunkTransform": _SEVERAL,
    "ActionDiscretizer": _ACTIONS + "let the policy's output stay continuous",
    "ActionMask": _ACTIONS + "a mask is of discrete ones; limit commands by rate_limit",
    "ActionTokenizerTransform": _ACTIONS + "let the policy's output stay continuous",
    "AutoResetTransform": _ENDS,
    "BatchSizeTransform": "changes the batch that an engine was made for: make_env(batch_size=...)",
    "BinarizeReward": "makes integers of rewards, which losses cannot use: use SignTransform",
    "BurnInTransform": _BUFFER,
    "CenterCrop": _PICTURES,
    "ConditionalPolicySwitch": "drives with a policy of its own: use policies.closed_loop.drive",
    "ConditionalSkip": "leaves steps out of an episode, whose counts go on: write `_step` masks",
    "Crop": _PICTURES,
    "DecodeVideoTransform": _PICTURES,
    "DeviceCastTransform": _DEVICE,
    "DiscreteActionProjection": _ACTIONS + "let the policy's output stay continuous",
    "EndOfLifeTransform": _BACKEND,
    "ExpandAs": "changes the shape of rewards, which losses read as [1]: leave it out",
    "FlattenAction": _ACTIONS + "flatten in the policy",
    "FrameSkipTransform": _SEVERAL,
    "GrayScale": _PICTURES,
    "Hash": "numbers states for looking them up, which no state of a car is: leave it out",
    "LineariseRewards": "sums rewards, as the weights of rewards do: set rewards.weights",
    "MacroPrimitiveTransform": _SEVERAL,
    "MeanActionSelector": _ACTIONS + "take the mean in the policy",
    "ModuleTransform": _OUTSIDE + "make the module a part of the policy",
    "MultiAction": _SEVERAL,
    "MultiStepTransform": _BUFFER,
    "NextObservationDelta": "lets a step be kept as differences: append it to a replay buffer",
    "NextStateReconstructor": _BUFFER,
    "NoopResetEnv": (
        "steps all environments where some are reset: begin at a drawn start by the options "
        "start_lateral and start_heading of waypoints"
    ),
    "PinMemoryTransform": _DEVICE,
    "PolicyAgeFilter": _BUFFER,
    "R3MTransform": _PICTURES,
    "RNDTransform": _OUTSIDE + "write a term of the reward",
    "RandomCropTensorDict": _BUFFER,
    "RandomTruncationTransform": (
        "draws in a step, which must be a function of its input: use step_limit"
    ),
    "RayTransform": "computes in a Ray actor, whose memory no checkpoint has: put it in the policy",
    "RemoveEmptySpecs": _BACKEND,
    "Resize": _PICTURES,
    "Reward2GoTransform": _BUFFER,
    "SelectTransform": "takes away what steps need: name what is to go by ExcludeTransform",
    "Stack": "joins keys of several agents, and here drives one: use CatTensors",
    "SuccessReward": "writes the reward, as rewards do: give rewards another weight",
    "TargetReturn": "conditions a policy on a return to come, which no policy here reads: leave it "
    "out, or put it over the environment by TorchRL's TransformedEnv",
    "TerminateTransform": "ends an episode by what is in no reward's order: use leave_path, or a "
    "TaskTransform that sets terminated and done",
    "TimeMaxPool": _OUTSIDE + "use history, or past_mean",
    "Timer": "writes the time of the clock, which is no function of a state: time a run outside",
    "ToTensorImage": _PICTURES,
    "Tokenizer": "works on text, and a task has none: leave it out",
    "TrajCounter": _OUTSIDE + "count ends in the batches",
    "UnaryTransform": "applies a function that no file can name: write a TaskTransform",
    "VC1Transform": _PICTURES,
    "VIPRewardTransform": _PICTURES,
    "VIPTransform": _PICTURES,
    "VecGymEnvTransform": _ENDS,
    "VecNorm": _OUTSIDE + "use ObservationNorm with loc and scale",
    "VecNormV2": _OUTSIDE + "use ObservationNorm with loc and scale",
    "gSDENoise": "draws for a policy with state-dependent noise, and this one has none: leave it "
    "out, exploration is the policy's",
}
"""Names of classes and why, with what to do instead."""


def refuse_wrong(transform: type, options: Mapping[str, Any]) -> None:
    """Refuses a class of TorchRL, or a subclass of one, that would be wrong in a task.

    Raises:
        ValueError: It is one; the message says why and what to use instead.
    """
    torchrls = [kind for kind in transform.__mro__ if kind.__module__.startswith("torchrl.")]
    for kind in torchrls:
        if kind.__name__ in REFUSED:
            raise ValueError(f"{kind.__name__} {REFUSED[kind.__name__]}")
    if "StepCounter" in {kind.__name__ for kind in torchrls} and not options.get(
        "update_done", True
    ):
        raise ValueError(
            "StepCounter with update_done=false truncates episodes that are not done: leave it true"
        )
