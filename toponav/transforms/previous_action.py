"""`PreviousAction`: lets a policy see what it did before."""

import torch
from tensordict import TensorDictBase
from torchrl.data import Categorical, Composite

from toponav.keys import ACTION, PREVIOUS_ACTION
from toponav.transforms.specs import KeyedTransform, Keys, find_spec, get_entry


class PreviousAction(KeyedTransform):
    """Writes the action that led to an observation; ``num_actions`` if there is none.

    Reference:
        The paper, "Model implementation": the LSTM is fed the previous action.

    Args:
        num_actions: how many actions the env has, at least 2.
        in_keys: key of the action, int64 ``[*B]``, ``[*B, 1]`` or one-hot.
        out_keys: key of the action before, int64 ``[*B, 1]`` in ``[0, num_actions]``.

    Examples:
        >>> from tensordict import TensorDict
        >>> env = TensorDict(batch_size=[2])
        >>> previous = PreviousAction(num_actions=4)
        >>> previous._reset(env, env.clone())["previous_action"].squeeze(-1)
        tensor([4, 4])
    """

    def __init__(
        self, num_actions: int, *, in_keys: Keys = None, out_keys: Keys = None
    ) -> None:
        if num_actions < 2:
            raise ValueError(f"num_actions must be at least 2, got {num_actions}")
        defaults = [ACTION], [PREVIOUS_ACTION]
        super().__init__(in_keys, out_keys, defaults=defaults)
        self.num_actions = num_actions

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        action = get_entry(self, tensordict, self.in_keys[0])
        batch = tensordict.batch_size
        if action.shape == (*batch, self.num_actions):
            action = action.to(torch.uint8).argmax(-1)
        return next_tensordict.set(self.out_keys[0], action.reshape(*batch, 1).long())

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
        actions, key = self.parent.full_action_spec, self.in_keys[0]
        action = find_spec(actions, key, kind="an action")
        space = getattr(action.space, "n", None)
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
