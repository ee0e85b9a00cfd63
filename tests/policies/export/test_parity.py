"""The car's runtime does what the task of training does, and a runtime that does not is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from buggy_rl.car.policy import Policy as Runtime
from buggy_rl.car.policy_file import PolicyFile, read_policy
from buggy_rl.export.export import Export, ExportConfig
from buggy_rl.export.parity import ParityError
from tests.policies.export.made import policy_file, stack

EVERYTHING = {
    "filter": ("past_mean", {"width": 3}),
    "command": ("action_smoothing", {"time_constant": 0.04}),
    "target_speed": ("target_speed", {"low": 1.0, "high": 2.0}),
    "observation": (
        "observation",
        {"inputs": ["target_speed", "velocity", "last_action", "waypoints", "smoothed_action",
                    "lateral_error", "heading_error"]},
    ),
    "history": ("history", {"rows": 3}),
    "noise": ("observation_noise", {}),
    "waypoints": ("waypoints", {"visible": 6, "at_once": 2, "lateral_bound": 0.4}),
}  # fmt: skip
STACKS = {
    "the original's": {},
    "past mean": {"filter": ("past_mean", {"width": 5})},
    "past mean of clipped": {
        "filter": ("clip_velocity", {}),
        "clip": ("past_mean", {"width": 4}),
    },
    "history": {"history": ("history", {"rows": 4})},
    "last action": {
        "observation": ("observation", {"inputs": ["velocity", "last_action", "waypoints"]})
    },
    "smoothing": {"command": ("action_smoothing", {"time_constant": 0.1})},
    "rate limit": {
        "command": ("rate_limit", {"throttle": 5.0, "steering": 3.0}),
        "observation": ("observation", {"inputs": ["waypoints", "velocity", "limited_action"]}),
    },
    "everything": EVERYTHING,
}
PARTS = ("past mean", "history", "last action", "smoothing")  # each is in `EVERYTHING`


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """An export of a task, with the pair of files in a folder."""

    def make(stack_name, steps=80, random_steps=80, **config):
        folder = tmp_path_factory.mktemp("policy")
        file = policy_file(folder, stack(**STACKS[stack_name]), hidden=[32, 32], **config)
        export = Export(ExportConfig(str(file), str(folder / "car"), random_steps=random_steps))
        export.compared = {
            name: replace(course, steps=min(course.steps, steps))
            for name, course in export.compared.items()
        }
        return export, read_policy(str(export.write(folder)))

    return make


@pytest.fixture(scope="module")
def full(exported):
    """The export with every transform, made once."""
    return exported("everything")


@pytest.mark.parametrize(
    "stack_name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in PARTS)) for name in STACKS],
)
def test_runtime_and_training_agree_over_drives_and_on_random_inputs(exported, stack_name):
    export, content = exported(stack_name, 40, 40)
    results = dict(export.comparisons(Runtime(content)))
    assert set(results) == {"lap", "infinity", "random inputs"}
    assert results["random inputs"]["steps"] == results["lap"]["steps"] == 40
    for result in results.values():
        assert result["observation"] < 1e-5
        assert result["command"] < 1e-5


@pytest.mark.slow
def test_they_agree_to_the_end_of_a_drive(exported):
    export, content = exported("everything", steps=600)
    (where, result), *_ = export.comparisons(Runtime(content))
    assert (where, result["command"] < 1e-5) == ("lap", True)
    assert result["steps"] > 500


@pytest.mark.parametrize("activation", ["tanh", pytest.param("elu", marks=pytest.mark.slow)])
def test_so_they_do_with_other_layers_and_without_scaling(exported, activation):
    export, content = exported("the original's", activation=activation, scaling="none")
    assert "mean" not in content.arrays
    assert len(dict(export.comparisons(Runtime(content)))) == 3


def changed(content, edit):
    """The same policy with other settings."""
    settings = json.loads(json.dumps(content.settings))
    edit(settings)
    return PolicyFile(settings, content.arrays)


WRONG = {  # what a runtime does wrong, and the first field that shows it
    "past mean one row short": (lambda s: s["sensing"][0].update(width=2), "observation vx"),
    "no clipping": (lambda s: s["sensing"].pop(1), "observation vx"),
    "slower smoothing": (lambda s: s["commands"][0].update(share=0.1), "throttle"),
    "no last action": (
        lambda s: s["commands"].insert(0, s["commands"].pop(1)),
        "observation last_throttle",
    ),
    "one waypoint at once": (lambda s: s["waypoints"].update(at_once=1), "next_waypoint"),
    "wide waypoints": (lambda s: s["waypoints"].update(lateral_bound=5.0), "next_waypoint"),
    "inputs exchanged": (lambda s: s["observation"]["inputs"].reverse(), "observation"),
    "leaves too early": (lambda s: s.update(leave_path=0.05), "left the path in the runtime"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_runtime_with_wrong_settings_is_refused_by_the_field_that_differs(full, fault):
    export, content = full
    edit, field = WRONG[fault]
    with pytest.raises((ParityError, ValueError), match=field):
        list(export.comparisons(_runtime(changed(content, edit))))


def _runtime(content):
    return Runtime(content)


class OffByOne(Runtime):
    """Shows the waypoints one too far on."""

    def _follow(self, x, y, yaw):
        super()._follow(x, y, yaw)
        self.waypoints._row += 1


def test_waypoints_that_are_off_by_one_are_refused_in_the_first_step(full):
    export, content = full
    with pytest.raises(ParityError, match=r"lap, step 0: observation x_1 of 2 steps ago is 0\.\d+"):
        list(export.comparisons(OffByOne(content)))


def test_a_weight_that_was_changed_is_refused(full):
    export, content = full
    arrays = {**content.arrays, "bias_2": content.arrays["bias_2"] + np.float32(1e-3)}
    with pytest.raises(ParityError, match=r"lap, step 0: throttle is .* in training"):
        list(export.comparisons(Runtime(PolicyFile(content.settings, arrays))))
