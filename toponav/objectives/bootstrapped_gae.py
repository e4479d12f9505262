"""`bootstrapped_gae`: advantages over slices in which episodes may end."""

from typing import Protocol

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.objectives.value.functional import generalized_advantage_estimate


class RecurrentActorCritic(Protocol):
    """What the losses of exploration ask of an actor-critic."""

    #: The view, the previous action and reward, ``is_init`` and the state.
    in_keys: list[NestedKey]
    #: From the LSTM's outputs to the logits of the actions and to the value.
    actor: torch.nn.Module
    critic: torch.nn.Module

    def unroll(self, tensordict: TensorDictBase) -> TensorDict:
        """Logits and values of a slice ``[*B, T]``, with gradients."""

    def unroll_lstm(self, tensordict: TensorDictBase) -> Tensor:
        """The LSTM's outputs over a slice, ``[*B, T, H]``, with gradients."""

    def next_values(self, tensordict: TensorDictBase) -> Tensor:
        """Values ``[*B, 1]`` of the states under ``"next"``, without gradients."""


def bootstrapped_gae(
    batch: TensorDictBase,
    state_value: Tensor,
    actor_critic: RecurrentActorCritic,
    *,
    gamma: float,
    lmbda: float,
    reward: NestedKey = "reward",
    done: NestedKey = "done",
    terminated: NestedKey = "terminated",
) -> tuple[Tensor, Tensor]:
    """Estimate advantages and value targets with the right value after every decision.

    Inside an episode the value of the next state is the next decision's. Where a slice
    ends, or an episode is cut off by its clock, the next decision belongs to something
    else: there the critic judges the state that the decision really led to, stored
    under ``"next"``. A terminated episode is followed by nothing, so by 0. With
    ``lmbda=1`` the value targets are the n-step returns of A3C.

    Reference:
        Schulman et al., "High-Dimensional Continuous Control Using Generalized
        Advantage Estimation" (2015); the paper, eq. of R_t in "Asynchronous advantage
        actor-critic algorithm".

    Args:
        batch: ``[*B, T]`` decisions with reward, done and terminated under ``"next"``,
            each ``[*B, T, 1]``, and what ``actor_critic.next_values`` reads.
        state_value: ``[*B, T, 1]``; no gradient goes back into it.
        actor_critic: judges the states where slices and episodes end.
        gamma: discount per decision, in [0, 1].
        lmbda: trade-off of bias and variance, in [0, 1].
        reward: key of the reward.
        done: key of the end of an episode.
        terminated: key of an end that nothing follows.

    Returns:
        Advantage and value target, each ``[*B, T, 1]`` without gradients.

    Raises:
        ValueError: if reward, done or terminated differ in shape from the values.

    Examples:
        >>> class Sure:  # of a value of 10 wherever a slice or an episode ends
        ...     def next_values(self, tensordict):
        ...         return torch.full((*tensordict.batch_size, 1), 10.0)
        >>> false = torch.zeros(1, 3, 1, dtype=torch.bool)
        >>> following = {"reward": torch.ones(1, 3, 1), "done": false}
        >>> batch = TensorDict({"next": {**following, "terminated": false}}, [1, 3])
        >>> values = torch.zeros(1, 3, 1)
        >>> bootstrapped_gae(batch, values, Sure(), gamma=0.5, lmbda=1.0)[1].flatten()
        tensor([3., 4., 6.])

    Shape notation:
        B: any batch dimensions.  T: decisions in the slice.
    """
    state_value = state_value.detach()
    following = batch.get("next")
    entries = [following.get(key) for key in (reward, done, terminated)]
    for key, entry in zip((reward, done, terminated), entries, strict=True):
        if entry.shape != state_value.shape:
            raise ValueError(
                f"('next', {key!r}) must have the shape {list(state_value.shape)} of "
                f"the values, got {list(entry.shape)}."
            )
    is_last = entries[1].clone()
    is_last[..., -1, :] = True
    next_value = torch.zeros_like(state_value)
    next_value[..., :-1, :] = state_value[..., 1:, :]
    next_value = next_value.masked_fill(is_last, 0)
    judged = (is_last & ~entries[2]).squeeze(-1)
    if judged.any():
        rows = batch.select("next")[judged]
        next_value[judged] = actor_critic.next_values(rows).to(next_value.dtype)
    advantage, target = generalized_advantage_estimate(
        gamma, lmbda, state_value, next_value, *entries
    )
    return advantage, target


def check_share(name: str, value: float) -> float:
    """Refuse a discount outside [0, 1]; return it otherwise."""
    if not 0 <= value <= 1:
        raise ValueError(f"{name} must be in [0, 1], got {value}.")
    return value
