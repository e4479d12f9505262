import copy

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import Collector
from torchrl.data import OneHot
from torchrl.envs import Compose, EnvBase, InitTracker, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from tests.objectives.cue_corridor import CueCorridor, make_env, make_network
from toponav.modules import ActorCritic
from toponav.objectives import A3CLoss, RecurrentPPOLoss


def make_decision(network: ActorCritic, *batch: int) -> TensorDict:
    """Decisions with random entries in the middle of an episode."""
    return TensorDict(
        {
            "embedding": torch.randn(*batch, 3),
            "previous_action": torch.randint(network.num_actions + 1, (*batch, 1)),
            "previous_reward": torch.randn(*batch, 1),
            "is_init": torch.zeros(*batch, 1, dtype=torch.bool),
            "recurrent_state": {
                "hidden": torch.randn(*batch, network.hidden_dim),
                "memory_cell": torch.randn(*batch, network.hidden_dim),
            },
        },
        batch,
    )


def collect(network: ActorCritic, env: EnvBase, *, num_batches: int) -> list:
    """Batches of five decisions; episodes of three or four begin inside them."""
    collector = Collector(
        env,
        network,
        frames_per_batch=env.batch_size.numel() * 5,
        total_frames=env.batch_size.numel() * 5 * num_batches,
        auto_register_policy_transforms=False,
    )
    batches = [batch.clone() for batch in collector]
    collector.shutdown()
    return batches


@pytest.fixture(scope="module", params=[1, 2], ids=["one layer", "two layers"])
def collected(
    request: pytest.FixtureRequest,
) -> tuple[ActorCritic, list[TensorDictBase]]:
    network = make_network(layers=request.param)
    torch.nn.init.normal_(network.actor.weight)
    return network, collect(network, make_env(network, 4), num_batches=4)


def test_a_recomputed_slice_is_the_collected_one(
    collected: tuple[ActorCritic, list[TensorDictBase]],
) -> None:
    network, batches = collected
    assert any(batch["is_init"][:, 1:].any() for batch in batches)
    for batch in batches:
        unrolled = network.unroll(batch)
        for key in ("logits", "state_value"):
            torch.testing.assert_close(unrolled[key], batch[key])
        # The output of the last layer.
        state = ("next", "recurrent_state", "hidden")
        torch.testing.assert_close(unrolled[state], batch[state][..., -32:])
        log_probs = unrolled["logits"].log_softmax(-1)
        log_prob = log_probs.gather(-1, batch["action"].unsqueeze(-1)).squeeze(-1)
        torch.testing.assert_close(log_prob, batch["action_log_prob"])


def test_the_state_is_carried_over_batches_and_zero_at_resets(
    collected: tuple[ActorCritic, list[TensorDictBase]],
) -> None:
    _, batches = collected
    joined = torch.cat(batches, 1)
    is_init = joined["is_init"].squeeze(-1)
    for key in ("hidden", "memory_cell"):
        state = joined["recurrent_state", key]
        before = joined["next", "recurrent_state", key][:, :-1]
        carried = before * ~is_init[:, 1:].unsqueeze(-1)
        assert torch.equal(state[:, 1:], carried)
        assert not state[:, 0].any()
        # The state that an episode ended with is kept, to judge its last view from.
        assert (before[is_init[:, 1:]].abs().sum(-1) > 0).all()


def test_batches_of_a_collection_unroll_as_one(
    collected: tuple[ActorCritic, list[TensorDictBase]],
) -> None:
    network, batches = collected
    whole = network.unroll(torch.cat(batches, 1))
    apart = torch.cat([network.unroll(batch)["state_value"] for batch in batches], 1)
    torch.testing.assert_close(whole["state_value"], apart)


def test_next_values_are_those_of_the_following_decision(
    collected: tuple[ActorCritic, list[TensorDictBase]],
) -> None:
    network, batches = collected
    batch = batches[0]
    inside = ~batch["is_init"][:, 1:].squeeze(-1)
    values = network.next_values(batch)
    assert values.shape == (4, 5, 1)
    assert not values.requires_grad
    torch.testing.assert_close(
        values[:, :-1][inside], batch["state_value"][:, 1:][inside]
    )


def test_the_stored_states_inside_a_slice_are_not_read() -> None:
    network = make_network()
    batch = make_decision(network, 2, 4)
    value = network.unroll(batch)["state_value"]
    batch["recurrent_state", "hidden"][:, 1:] = 100
    torch.testing.assert_close(network.unroll(batch)["state_value"], value)
    batch["recurrent_state", "hidden"][:, 0] = 100
    assert (network.unroll(batch)["state_value"] != value).any()


@pytest.mark.parametrize("key", ["embedding", "previous_action", "previous_reward"])
def test_a_decision_depends_on_every_input(key: str) -> None:
    network = make_network()
    torch.nn.init.normal_(network.actor.weight)
    decision = make_decision(network, 1)
    other = decision.clone()
    other[key] = (other[key] + 1) % 3 if key == "previous_action" else other[key] + 1
    assert (network(decision)["logits"] != network(other)["logits"]).any()
    assert (decision["state_value"] != other["state_value"]).any()


def test_none_is_a_previous_action_of_its_own() -> None:
    network = make_network()
    decision = make_decision(network, 1).expand(3).clone()
    decision["previous_action"] = torch.tensor([[0], [1], [2]])
    values = network(decision)["state_value"].flatten()
    assert len(set(values.tolist())) == 3


def test_an_episode_s_start_forgets_the_state() -> None:
    network = make_network()
    decision = make_decision(network, 2)
    decision["is_init"] = torch.tensor([[True], [False]])
    fresh = decision.clone()
    fresh["recurrent_state", "hidden"] *= 0
    fresh["recurrent_state", "memory_cell"] *= 0
    values, fresh_values = (network(d)["state_value"] for d in (decision, fresh))
    assert values[0] == fresh_values[0]
    assert values[1] != fresh_values[1]


def test_actions_are_drawn_with_their_probabilities() -> None:
    torch.manual_seed(0)
    network = make_network()
    torch.nn.init.zeros_(network.actor.weight)
    network.actor.bias.data = torch.tensor([0.8, 0.2]).log()
    decision = make_decision(network, 4000)
    network(decision)
    assert decision["action"].shape == (4000,)
    # Four standard errors of 0.0063.
    assert decision["action"].float().mean().item() == pytest.approx(0.2, abs=0.0253)
    expected = torch.tensor([0.8, 0.2])[decision["action"]].log()
    torch.testing.assert_close(decision["action_log_prob"], expected)


def test_a_deterministic_policy_takes_the_most_probable_action() -> None:
    network = make_network()
    torch.nn.init.normal_(network.actor.weight)
    decision = make_decision(network, 500)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert torch.equal(network(decision)["action"], decision["logits"].argmax(-1))
    with set_exploration_type(ExplorationType.RANDOM):
        assert (network(decision)["action"] != decision["logits"].argmax(-1)).any()


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_any_batch_of_envs(batch: tuple[int, ...]) -> None:
    network = make_network()
    decision = network(make_decision(network, *batch))
    assert decision["action"].shape == decision["action_log_prob"].shape == batch
    assert decision["state_value"].shape == (*batch, 1)
    assert decision["next", "recurrent_state", "hidden"].shape == (*batch, 32)
    assert all(key in decision.keys(True, True) for key in network.out_keys)
    slices = make_decision(network, *batch, 4)
    assert network.unroll(slices)["logits"].shape == (*batch, 4, 2)


def test_the_first_policy_is_nearly_uniform() -> None:
    network = ActorCritic(num_actions=6, input="embedding", embedding_dim=3)
    logits = network(make_decision(network, 100))["logits"]
    assert (logits.softmax(-1) - 1 / 6).abs().max() < 0.02


def test_pixels_are_collected_and_recomputed() -> None:
    network = ActorCritic(num_actions=6, code_dim=8, hidden_dim=8)
    slices = make_decision(network, 2, 3).exclude("embedding")
    slices["policy_pixels"] = torch.randint(256, (2, 3, 84, 84, 3), dtype=torch.uint8)
    with torch.no_grad():
        first = network(slices[:, 0].clone())
    unrolled = network.unroll(slices)
    torch.testing.assert_close(unrolled["logits"][:, 0], first["logits"])
    unrolled["state_value"].sum().backward()
    gradients = {name: p.grad for name, p in network.named_parameters()}
    assert gradients.pop("actor.weight") is None
    assert gradients.pop("actor.bias") is None
    assert all(g is not None and g.any() for g in gradients.values())


def test_the_view_may_lie_elsewhere() -> None:
    network = ActorCritic(
        num_actions=6,
        input="embedding",
        embedding_dim=3,
        view_key=("agent", "embedding"),
    )
    decision = make_decision(network, 2)
    decision["agent", "embedding"] = decision.pop("embedding")
    assert network.in_keys[0] == ("agent", "embedding")
    assert network(decision)["action"].shape == (2,)


class OneHotCorridor(CueCorridor):
    """The corridor with one-hot actions, and a count of them."""

    def __init__(self, num_envs: int) -> None:
        super().__init__(num_envs)
        self.action_spec = OneHot(2, shape=(num_envs, 2), dtype=torch.int64)
        self.taken = torch.zeros(2, dtype=torch.int64)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.taken += tensordict["action"].sum(0)
        numbers = tensordict["action"].argmax(-1)
        return super()._step(tensordict.copy().set("action", numbers))


def make_one_hot_env(network: ActorCritic) -> tuple[OneHotCorridor, EnvBase]:
    corridor = OneHotCorridor(8)
    transforms = Compose(InitTracker(), network.make_tensordict_primer())
    return corridor, TransformedEnv(corridor, transforms)


def test_an_env_with_one_hot_actions_gets_them() -> None:
    torch.manual_seed(0)
    network = ActorCritic(
        num_actions=2, input="embedding", embedding_dim=3, one_hot=True
    )
    corridor, env = make_one_hot_env(network)
    with torch.no_grad():
        rollout = env.rollout(40, network, break_when_any_done=False)
    assert rollout["action"].shape == (8, 40, 2)
    # 320 decisions of an even policy: four standard errors of 9 around 160.
    assert corridor.taken.sum() == 320
    assert abs(corridor.taken[0] - 160) < 36
    for loss in (A3CLoss(network), RecurrentPPOLoss(network)):
        assert loss(rollout)["loss_objective"].isfinite()


def test_an_env_with_other_actions_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"must be \(2, True\) .* OneHot \(or categ.* got \(2, False\)"
    ):
        make_one_hot_env(make_network())[1].reset()
    with pytest.raises(ValueError, match=r"must be \(2, True\) .* got \(3, False\)"):
        make_one_hot_env(make_network(num_actions=3))[1].reset()


@pytest.mark.parametrize("size", [(36, 52), (120, 160)])
def test_pixels_of_any_size_are_read(size: tuple[int, int]) -> None:
    network = ActorCritic(num_actions=3, image_size=size, code_dim=8, hidden_dim=8)
    decision = make_decision(network, 2).exclude("embedding")
    decision["policy_pixels"] = torch.zeros(2, *size, 3, dtype=torch.uint8)
    assert network(decision)["logits"].shape == (2, 3)


def test_weights_round_trip_and_copies_are_independent() -> None:
    network, other = make_network(0), make_network(1)
    decision = make_decision(network, 5)
    other.load_state_dict(network.state_dict())
    value = network(decision.clone())["state_value"]
    assert torch.equal(other(decision.clone())["state_value"], value)
    copied = copy.deepcopy(network)
    torch.nn.init.zeros_(copied.critic.weight)
    assert torch.equal(network(decision.clone())["state_value"], value)


def test_a_missing_state_says_what_to_add() -> None:
    network = make_network()
    with pytest.raises(KeyError, match=r"add the policy's make_tensordict_primer\(\)"):
        network(make_decision(network, 2).exclude("recurrent_state"))


@pytest.mark.parametrize(
    ("key", "writer"),
    [
        ("embedding", "WaypointMemory or EmbedViews"),
        ("previous_action", "PreviousAction"),
        ("previous_reward", "PreviousReward"),
        ("is_init", "TorchRL's InitTracker"),
    ],
)
def test_what_is_missing_is_named_with_what_writes_it(key: str, writer: str) -> None:
    network = make_network()
    with pytest.raises(KeyError, match=f"must have '{key}': add {writer}, got"):
        network(make_decision(network, 2).exclude(key))


def test_without_the_primer_an_env_is_refused_too() -> None:
    network = make_network()
    with pytest.raises(KeyError):
        TransformedEnv(CueCorridor(2)).rollout(2, network)


def test_it_reads_embeddings_if_their_length_is_given() -> None:
    assert ActorCritic(num_actions=2, embedding_dim=3).in_keys[0] == "embedding"
    assert ActorCritic(num_actions=2).in_keys[0] == "policy_pixels"
    both = ActorCritic(num_actions=2, input="pixels", embedding_dim=3)
    assert both.in_keys[0] == "policy_pixels"


def test_arguments_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match=r"one of \('pixels', 'embedding'\), got 'x'"):
        ActorCritic(num_actions=6, input="x")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="embedding_dim must be given"):
        ActorCritic(num_actions=6, input="embedding")
    with pytest.raises(ValueError, match="num_actions must be at least 2, got 1"):
        ActorCritic(num_actions=1)
