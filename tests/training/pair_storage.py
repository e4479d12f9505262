"""Frames of made-up random walks, and a trainer of tiny networks on them."""

import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage

from tests.models import tiny_model
from toponav.builders import Networks, make_networks
from toponav.config import OnlineConfig, PairsConfig
from toponav.keys import ACTION, NETWORK_PIXELS, TRAJECTORY
from toponav.training import PairTrainer, make_pair_trainer
from toponav.worlds import WorldSpec

#: A world with small views, which are stored at half their size.
WORLD = WorldSpec(view_size=(16, 24), actions=("left", "right", "on"))


def make_walks(
    *,
    episodes: int = 3,
    length: int = 30,
    first: int = 0,
    size: tuple[int, int] = (8, 12),
) -> TensorDict:
    """Frames ``[E, T]``: views brighten with time, which decides the action."""
    shape = (episodes, length)
    step = torch.arange(length).expand(shape)
    episode = first + torch.arange(episodes).unsqueeze(1).expand(shape)
    brightness = (8 * step).to(torch.uint8)[..., None, None, None]
    return TensorDict(
        {
            NETWORK_PIXELS: brightness.repeat(1, 1, *size, 3),
            ACTION: step * 3 // length,
            TRAJECTORY: episode.clone(),
            "step_count": step.unsqueeze(-1).clone(),
        },
        shape,
    )


def pair_settings(**changes: object) -> PairsConfig:
    values = {
        "k": 2,
        "m": 5,
        "locomotion_k": 3,
        "locomotion_exact": False,
        "other_episode_share": 0.0,
        "mined": True,
        "per_update": 16,
        "episodes": 2,
        "chunks": 3,
        "chunk_len": 5,
    }
    return PairsConfig(**(values | changes))  # type: ignore[arg-type]


def make_trainer(
    *, mined: bool = True, seed: int = 0, **arguments: object
) -> tuple[Networks, PairTrainer]:
    torch.manual_seed(seed)
    shared = bool(arguments.pop("share_encoder", True))
    device = str(arguments.pop("device", "cpu"))
    encoder = str(arguments.pop("encoder", "small"))
    model = tiny_model(share_encoder=shared, encoder=encoder)
    # The small encoder sees half of a view's size.
    size = (8, 12) if model.halve else WORLD.view_size
    networks = make_networks(model, WORLD, device=device)
    storage = LazyTensorStorage(90)
    storage.set(slice(0, 90), make_walks(size=size).flatten())
    config = OnlineConfig(
        learn=True,
        lr=0.01,
        weight_decay=float(arguments.pop("weight_decay", 1e-4)),
        locomotion_coeff=float(arguments.pop("locomotion_coeff", 0.5)),
        every=1,
        publish_every=1,
        ahead=1,
        buffer_gb=1.0,
    )
    trainer = make_pair_trainer(
        networks,
        pair_settings(mined=mined),
        config,
        storage,
        seed=seed,
        **({"lr": config.lr} | arguments),
    )
    return networks, trainer
