"""A corridor that only a memory can walk: the sign at its start tells the way out."""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import Compose, EnvBase, InitTracker, TransformedEnv

from toponav import keys
from toponav.modules import ActorCritic


class CueCorridor(EnvBase):
    """Episodes of 3 to ``longest`` decisions; the last one earns 1 or -1.

    The first view shows one of two signs, the last one a junction, where the action of
    the sign's number is right. What lies between shows nothing, the previous action is
    always "none", so that no policy without a memory earns more than 0 in the mean.
    """

    def __init__(self, num_envs: int, *, seed: int = 0, longest: int = 4) -> None:
        super().__init__(batch_size=torch.Size([num_envs]))
        self.longest = longest
        shape = (num_envs,)
        self.observation_spec = Composite(
            {
                keys.EMBEDDING: Bounded(0.0, 1.0, shape=(*shape, 3)),
                keys.PREVIOUS_ACTION: Bounded(0, 2, (*shape, 1), dtype=torch.int64),
                keys.PREVIOUS_REWARD: Unbounded((*shape, 1)),
            },
            shape=shape,
        )
        self.action_spec = Categorical(2, shape=shape, dtype=torch.int64)
        self.reward_spec = Unbounded((*shape, 1))
        done = Binary(1, shape=(*shape, 1), dtype=torch.bool)
        self.full_done_spec = Composite(
            done=done, terminated=done.clone(), truncated=done.clone(), shape=shape
        )
        self.sign = torch.zeros(shape, dtype=torch.int64)
        self.left = torch.zeros(shape, dtype=torch.int64)
        self._set_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        self.generator = torch.Generator().manual_seed(seed or 0)

    def draw(self, low: int, high: int) -> Tensor:
        return torch.randint(low, high, self.batch_size, generator=self.generator)

    def _reset(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        rows = torch.ones(self.batch_size, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict:
            rows = tensordict["_reset"].reshape(self.batch_size)
        self.sign = torch.where(rows, self.draw(0, 2), self.sign)
        self.left = torch.where(rows, self.draw(3, self.longest + 1), self.left)
        signs = torch.nn.functional.one_hot(self.sign, 3).float()
        return self.observe(signs * rows.unsqueeze(-1))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        is_last = (self.left == 1).unsqueeze(-1)
        is_right = (tensordict["action"] == self.sign).unsqueeze(-1)
        self.left = self.left - 1
        out = self.observe(torch.zeros(*self.batch_size, 3))
        out["reward"] = (2.0 * is_right - 1) * is_last
        out["terminated"] = out["done"] = is_last
        return out

    def observe(self, view: Tensor) -> TensorDictBase:
        view = view.clone()
        view[:, 2] = (self.left == 1).float()
        zeros = torch.zeros(*self.batch_size, 1)
        false = zeros.bool()
        return TensorDict(
            {
                keys.EMBEDDING: view,
                keys.PREVIOUS_ACTION: torch.full_like(zeros, 2, dtype=torch.int64),
                keys.PREVIOUS_REWARD: zeros,
                "done": false,
                "terminated": false.clone(),
                "truncated": false.clone(),
            },
            batch_size=self.batch_size,
        )


def make_network(
    seed: int = 0, *, num_actions: int = 2, size: int = 32, layers: int = 1
) -> ActorCritic:
    """A small network for the corridor."""
    torch.manual_seed(seed)
    return ActorCritic(
        input="embedding",
        embedding_dim=3,
        num_actions=num_actions,
        code_dim=size,
        hidden_dim=size,
        layers=layers,
    )


def make_env(
    network: ActorCritic, num_envs: int, *, seed: int = 0, longest: int = 4
) -> EnvBase:
    """The corridor with what a recurrent policy needs."""
    transforms = Compose(InitTracker(), network.make_tensordict_primer())
    corridor = CueCorridor(num_envs, seed=seed, longest=longest)
    return TransformedEnv(corridor, transforms)
