"""`PreviousAction`: lets a policy see what it did before."""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, Composite
from torchrl.envs.transforms import Transform

from toponav.keys import ACTION, PREVIOUS_ACTION


class PreviousAction(Transform):
    """Writes the action that led to an observation.

    The first observation of an episode has none, which is a number of its own, the
    one after the last action: an embedding or one-hot code of it needs
    ``num_actions + 1`` entries. Stateless; for any TorchRL env with one discrete
    action, categorical or one-hot.

    Reference:
        The paper, "Model implementation": the LSTM is fed the previous action.

    Args:
        num_actions: how many actions the env has, at least 2.
        in_keys: key of the action, int64 ``[*B]`` or ``[*B, 1]``, or one-hot
            ``[*B, num_actions]``; ``action`` unless given.
        out_keys: key of the action before, int64 ``[*B, 1]`` in
            ``[0, num_actions]``; ``previous_action`` unless given.

    Raises:
        ValueError: if an argument is out of range, and when the env's specs are read,
            if it has no such action.

    Examples:
        >>> from tensordict import TensorDict
        >>> env = TensorDict(batch_size=[2])
        >>> previous = PreviousAction(num_actions=6)
        >>> previous._reset(env, env.clone())["previous_action"].squeeze(-1)
        tensor([6, 6])
        >>> env["action"] = torch.tensor([0, 5])
        >>> previous._step(env, env.empty())["previous_action"].squeeze(-1)
        tensor([0, 5])

    Shape notation:
        B: batch of environments.
    """

    def __init__(
        self,
        num_actions: int = 6,
        *,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        if num_actions < 2:
            raise ValueError(f"num_actions must be at least 2, got {num_actions}")
        super().__init__(
            in_keys=[ACTION] if in_keys is None else in_keys,
            out_keys=[PREVIOUS_ACTION] if out_keys is None else out_keys,
        )
        if len(self.in_keys) != 1 or len(self.out_keys) != 1:
            raise ValueError(
                f"in_keys and out_keys must be one key each, "
                f"got {self.in_keys} and {self.out_keys}"
            )
        self.num_actions = num_actions

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        action: Tensor = tensordict.get(self.in_keys[0])
        batch = tensordict.batch_size
        if action.shape == (*batch, self.num_actions):
            action = action.to(torch.uint8).argmax(-1)
        next_tensordict.set(self.out_keys[0], action.reshape(*batch, 1).long())
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # Rows that go on keep what they had: TorchRL merges this by the mask.
        shape = (*tensordict_reset.batch_size, 1)
        none = torch.full(
            shape, self.num_actions, dtype=torch.int64, device=tensordict_reset.device
        )
        return tensordict_reset.set(self.out_keys[0], none)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        actions = self.parent.full_action_spec
        key = self.in_keys[0]
        if key not in actions.keys(True, True):
            raise ValueError(
                f"in_keys must be an action of the env, got {key!r}; it has "
                f"{list(actions.keys(True, True))}"
            )
        space = getattr(actions[key].space, "n", None)
        if space != self.num_actions:
            raise ValueError(
                f"num_actions must be that of {key!r}, {space}, got {self.num_actions}"
            )
        observation_spec[self.out_keys[0]] = Categorical(
            self.num_actions + 1,
            shape=(*observation_spec.shape, 1),
            dtype=torch.int64,
            device=observation_spec.device,
        )
        return observation_spec
