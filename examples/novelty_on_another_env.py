"""Novelty rewards on an env that is not ours: MountainCar, seen as pixels.

No network is trained: an embedding is the view shrunk to 10x15 grey pixels, and two are
alike if few of them differ. A car that swings sees more of the valley than one that
steers at random, and is paid more for it.

    pip install "gymnasium[classic-control]"
    python examples/novelty_on_another_env.py
"""

import torch
from tensordict.nn import TensorDictModule
from torch.nn.functional import adaptive_avg_pool2d
from torchrl.envs import Compose, GymEnv, TransformedEnv

from toponav.transforms import (
    CountReward,
    IntrinsicReward,
    TemporalDistanceReward,
    WaypointMemory,
)


def embed(views: torch.Tensor) -> torch.Tensor:
    """Views [N, H, W, 3] to embeddings [N, 150]."""
    grey = views.float().mean(-1).unsqueeze(1) / 255
    return adaptive_avg_pool2d(grey, (10, 15)).flatten(1)


def compare(embedding: torch.Tensor, memory: torch.Tensor) -> torch.Tensor:
    """Embeddings [N, D] and memory [N, M, D] to similarities in [0, 1], [N, M]."""
    return torch.exp(-2 * (embedding.unsqueeze(-2) - memory).norm(dim=-1))


valley = GymEnv(
    "MountainCar-v0",
    from_pixels=True,
    pixels_only=False,
    categorical_action_encoding=True,
)
memory = WaypointMemory(embed, compare, threshold=0.5)
rewards = [CountReward(0.2), TemporalDistanceReward(0.8), IntrinsicReward()]
env = TransformedEnv(valley, Compose(memory, *rewards))
env.set_seed(0)

swing = TensorDictModule(lambda state: 2 * (state[1] > 0), ["observation"], ["action"])
for name, policy in {"random": None, "swing": swing}.items():
    torch.manual_seed(0)
    walk = env.rollout(199, policy)["next"]
    places = ((walk["observation"][:, 0] + 1.2) / 0.1).long().unique()
    waypoints = walk["num_waypoints"][-1].item()
    reward, known = (
        walk[part].sum().item() for part in ("intrinsic_reward", "count_reward")
    )
    print(
        f"{name}: {len(places)} of 18 places, {waypoints} waypoints, "
        f"intrinsic return {reward:.1f} ({known:.1f} for known places), "
        f"task {walk['reward'].sum().item():.0f}"
    )
