"""Slices of experience made by hand, and a critic whose values are given."""

from typing import ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from tests.objectives.cue_corridor import make_network
from toponav.modules import ActorCritic


class GivenCritic(torch.nn.Module):
    """Values of the decisions, and after them those stored in ``next.given``."""

    in_keys: ClassVar[list[str]] = []

    def __init__(self, state_value: Tensor) -> None:
        super().__init__()
        self.state_value = state_value
        self.asked: list[TensorDictBase] = []

    def unroll(self, tensordict: TensorDictBase) -> TensorDict:
        logits = torch.zeros(*tensordict.shape, 2)
        return TensorDict({"logits": logits, "state_value": self.state_value})

    def next_values(self, tensordict: TensorDictBase) -> Tensor:
        self.asked.append(tensordict)
        values: Tensor = tensordict["next", "given"]
        return values


def random_ends(rows: int, steps: int, *, share: float = 0.3) -> tuple[Tensor, Tensor]:
    """Done and terminated: about half of the ends are cut off by the clock."""
    done = torch.rand(rows, steps, 1) < share
    return done, done & (torch.rand(rows, steps, 1) < 0.5)


def n_step_returns(
    reward: Tensor, values: Tensor, ends: tuple[Tensor, Tensor], gamma: float
) -> Tensor:
    """R_t by its definition: the discounted rewards up to an end or the slice's last.

    Then the value of what follows there, unless nothing does.
    """
    done, terminated = ends
    rows, steps, _ = reward.shape
    returns = torch.zeros_like(reward)
    for row in range(rows):
        for start in range(steps):
            total = 0.0
            for step in range(start, steps):
                total += gamma ** (step - start) * reward[row, step, 0].item()
                if done[row, step] or step == steps - 1:
                    if not terminated[row, step]:
                        after = gamma ** (step - start + 1)
                        total += after * values[row, step, 0].item()
                    break
            returns[row, start] = total
    return returns


def random_slice(
    network: ActorCritic, rows: int = 3, steps: int = 6, *, share: float = 0.3
) -> TensorDict:
    """Decisions of ``network`` on random views, with ends inside the slice."""
    done, terminated = random_ends(rows, steps, share=share)
    is_init = torch.zeros_like(done)
    is_init[:, 1:] = done[:, :-1]

    def views() -> dict[str, Tensor]:
        return {
            "embedding": torch.randn(rows, steps, 3),
            "previous_action": torch.randint(3, (rows, steps, 1)),
            "previous_reward": torch.randn(rows, steps, 1),
        }

    batch = TensorDict({**views(), "is_init": is_init}, [rows, steps])
    state = network.initial_state(rows)
    decisions = []
    with torch.no_grad():
        for decision in batch.unbind(-1):
            decision["recurrent_state"] = state
            decisions.append(network(decision))
            state = decision["next", "recurrent_state"].clone()
    batch = torch.stack(decisions, -1).contiguous()
    following = {**views(), "done": done, "terminated": terminated}
    batch["next"].update(following | {"reward": torch.randn(rows, steps, 1)})
    # Inside an episode the next view is the next decision's.
    inside = ~is_init[:, 1:].squeeze(-1)
    for key in views():
        batch["next", key][:, :-1][inside] = batch[key][:, 1:][inside]
    return batch


def collected_slice(seed: int = 0, **kwargs: float) -> tuple[ActorCritic, TensorDict]:
    network = make_network(seed)
    torch.nn.init.normal_(network.actor.weight)
    return network, random_slice(network, **kwargs)  # type: ignore[arg-type]
