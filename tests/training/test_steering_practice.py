"""Practice: how decisions are judged, and that it learns what leads on."""

import torch
from tensordict import TensorDict

from toponav import keys
from toponav.modules import SteeringNetwork
from toponav.training import PracticeRules, SteeringPractice

RULES = {"gamma": 0.5, "lmbda": 1.0, "lr": 1e-3, "epochs": 4, "minibatch": 64}
RULES |= {"clip_epsilon": 0.2, "entropy_coeff": 0.0}
SENSES = 2


def make(**rules: float) -> SteeringPractice:
    torch.manual_seed(0)
    network = SteeringNetwork(4, SENSES, 2)
    return SteeringPractice(
        network, temperature=1.0, rules=PracticeRules(**(RULES | rules))
    )


def batch_of(shape, **entries) -> TensorDict:
    """Decisions ``[E, T]`` in which nothing happens but for ``entries``."""
    flags = dict.fromkeys((keys.REACHED, keys.GAVE_UP, keys.IS_INIT))
    found = TensorDict(
        {
            keys.EMBEDDING: torch.zeros(*shape, 4),
            keys.ACTION: torch.zeros(shape, dtype=torch.int64),
        },
        shape,
    )
    found.set(keys.SENSES, torch.zeros(*shape, SENSES))
    found.set(keys.FREE_LOGITS, torch.zeros(*shape, 2))
    found.set(keys.PROGRESS, torch.zeros(*shape, 1))
    for key in flags:
        found.set(key, torch.zeros(*shape, 1, dtype=torch.bool))
    for key, value in entries.items():
        found.set(getattr(keys, key), torch.as_tensor(value).reshape(*shape, 1))
    return found


def targets(practice: SteeringPractice, batch: TensorDict) -> list[float]:
    """Value targets of a critic that says 0."""
    practice.critic.module.layers[-1].weight.data.zero_()
    practice.critic.module.layers[-1].bias.data.zero_()
    return practice._judge(batch)[keys.VALUE_TARGET].flatten().tolist()


def test_a_decision_is_judged_by_what_the_next_one_finds() -> None:
    batch = batch_of(
        (1, 4),
        PROGRESS=[9.0, 1.0, 0.5, 0.75],
        REACHED=[False, False, False, True],
    )
    # The first entry is about an earlier decision. Each costs 0.05, the target pays 1:
    # third 0.75 - 0.05 + 1 = 1.7; second 0.45 + 1.7 / 2 = 1.3; first 0.95 + 0.65.
    assert [round(one, 4) for one in targets(make(), batch)] == [1.6, 1.3, 1.7]


def test_what_follows_another_target_or_episode_does_not_count() -> None:
    for flag in ("GAVE_UP", "IS_INIT"):
        batch = batch_of(
            (1, 4),
            PROGRESS=[0.0, 1.0, 5.0, 1.0],
            **{flag: [False, False, True, False]},
        )
        # Third 0.95; the second ends with what the critic says, 0, and the jump of 5
        # is not its doing: -0.05; first 0.95 - 0.05 / 2.
        found = [round(one, 4) for one in targets(make(), batch)]
        assert found == [0.925, -0.05, 0.95], flag


def test_another_episode_that_begins_at_its_target_pays_nothing() -> None:
    flags = {"REACHED": [False, False, True], "IS_INIT": [False, False, True]}
    # Second -0.05 alone; first -0.05 - 0.05 / 2.
    found = targets(make(), batch_of((1, 3), **flags))
    assert [round(one, 4) for one in found] == [-0.075, -0.05]


def test_a_jump_of_the_belief_counts_for_three_decisions_at_most() -> None:
    batch = batch_of((1, 3), PROGRESS=[0.0, 50.0, -50.0])
    # Second -3.05; first 2.95 - 3.05 / 2.
    assert [round(one, 4) for one in targets(make(), batch)] == [1.425, -3.05]


def test_log_probabilities_are_those_at_the_temperature() -> None:
    practice = make()
    practice.temperature = 0.5
    batch = batch_of((1, 3))
    batch[keys.FREE_LOGITS][..., 0] = 1.0
    found = practice._judge(batch)[keys.ACTION_LOG_PROB]
    # Action 0, of logits 2 and 0: log(e^2 / (e^2 + 1)) = -0.1269.
    torch.testing.assert_close(found, torch.full((2,), -0.1269), atol=1e-4, rtol=0)


def test_it_learns_which_action_leads_on() -> None:
    """The sense that is 1 says which of two actions makes progress."""
    practice = make()
    generator = torch.Generator().manual_seed(1)
    for _ in range(12):
        batch = batch_of((16, 9))
        senses = torch.nn.functional.one_hot(
            torch.randint(2, (16, 9), generator=generator), SENSES
        ).float()
        batch.set(keys.SENSES, senses)
        logits = practice.network(
            batch[keys.EMBEDDING], senses, batch[keys.FREE_LOGITS]
        )
        action = torch.distributions.Categorical(logits=logits).sample()
        batch.set(keys.ACTION, action)
        right = (action == senses.argmax(-1)).float().unsqueeze(-1)
        progress = torch.zeros(16, 9, 1)
        progress[:, 1:] = right[:, :-1]
        batch.set(keys.PROGRESS, progress)
        measured = practice.extend(batch)
    # Half of them by chance.
    assert float(right.mean()) > 0.9
    assert measured["progress"] > 0.75
