import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from buggy_rl.core import keys
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.learned.factory import ModelConfig, make_model, save_model
from buggy_rl.simulators.learned.training import Training, TrainingConfig
from tests.drives import toy_drive


@pytest.fixture(scope="module", autouse=True)
def gradients():
    """As usual: a model is trained."""


@pytest.fixture(scope="module")
def model():
    """A model that has learned the toy car, in a second."""
    torch.manual_seed(0)
    untrained = make_model(ModelConfig("mlp", options={"rows": 3, "hidden": [32]}))
    config = TrainingConfig(epochs=32, horizon=20, stride=10, batch_size=32)
    drives = [toy_drive(str(i), 800, i) for i in range(7)]
    list(Training(untrained, drives[:6], drives[6:], config).run())
    return untrained


def test_memory_holds_the_last_velocities_and_actions_oldest_first(model):
    engine = make_engine("learned", model=model)
    state = engine.reset(
        TensorDict({keys.POSE: torch.zeros(3), keys.VELOCITY: torch.ones(3)}), set_state=True
    )
    rows = []
    for step in range(3):
        state[keys.ACTION] = torch.tensor([0.1 * step, -0.1 * step])
        rows.append(torch.cat([state[keys.VELOCITY], state[keys.ACTION]]))
        state = engine.step(state)["next"]
    assert_close(state[keys.HISTORY], torch.stack(rows[1:]))


def test_a_trained_model_driven_by_hand_at_full_throttle_and_full_lock_stays_in_its_world(model):
    engine = make_engine("learned", 2, model=model)
    state = engine.reset()
    flagged = []
    for _ in range(500):
        state[keys.ACTION] = torch.tensor([[1.0, 1.0], [1.0, -1.0]])
        state = engine.step(state)["next"]
        flagged.append(state[keys.OUT_OF_RANGE])
    envelope = model.envelope
    width = (envelope.high - envelope.low)[:3]
    assert (state[keys.VELOCITY] <= envelope.high[:3] + 0.1001 * width).all()
    assert (state[keys.VELOCITY] >= envelope.low[:3] - 0.1001 * width).all()
    assert torch.stack(flagged).any(), "nobody drove like that in the data: it must be flagged"


def test_ordinary_driving_is_not_flagged(model):
    drive = toy_drive("new", 600, 9)
    engine = make_engine("learned", model=model)
    state, flagged = engine.reset(), 0
    for action in drive.data[keys.ACTION]:
        state[keys.ACTION] = action
        state = engine.step(state)["next"]
        flagged += state[keys.OUT_OF_RANGE].item()
    print(flagged)
    assert flagged < 0.1 * 600


def test_after_coasting_to_a_stop_the_car_stays_where_it_is(model):
    engine = make_engine("learned", model=model)
    start = TensorDict({keys.POSE: torch.zeros(3), keys.VELOCITY: torch.tensor([1.0, 0.0, 0.0])})
    state = engine.reset(start, set_state=True)
    poses = []
    for _ in range(800):
        state[keys.ACTION] = torch.tensor([-1.0, 0.7])
        state = engine.step(state)["next"]
        poses.append(state[keys.POSE])
    assert torch.equal(poses[-1], poses[-100])


def test_a_model_trained_at_another_rate_is_refused(model, tmp_path):
    config = ModelConfig("mlp", options={"rows": 3, "hidden": [32]})
    save_model(model, config, tmp_path / "m.pt", {"dt": 0.02})
    with pytest.raises(ValueError, match=r"trained at a step of 0\.02 s"):
        make_engine(str(tmp_path / "m.pt"))


def test_a_simulator_file_finds_its_model_beside_itself(model, tmp_path):
    config = ModelConfig("mlp", options={"rows": 3, "hidden": [32]})
    save_model(model, config, tmp_path / "m.pt", {"dt": 0.01})
    (tmp_path / "car.yaml").write_text("engine: learned\noptions: {model: m.pt}\n")
    engine = make_engine(tmp_path / "car.yaml", 3)
    assert engine.batch_size == (3,)
