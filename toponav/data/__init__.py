"""From trajectories in a replay buffer to the pairs that train TC- and L-network."""

from toponav.data.chunks import Chunks
from toponav.data.episode_sampler import DrawRule, EpisodeSampler
from toponav.data.episodes import Episodes, find_episodes
from toponav.data.held_out import HeldOut, PairSet
from toponav.data.l_pairs import LPairs
from toponav.data.pair_sources import DrawnPairs, Embed, MinedPairs
from toponav.data.split_pairs import SplitPairs
from toponav.data.tc_pairs import TCPairs

__all__ = [
    "Chunks",
    "DrawRule",
    "DrawnPairs",
    "Embed",
    "EpisodeSampler",
    "Episodes",
    "HeldOut",
    "LPairs",
    "MinedPairs",
    "PairSet",
    "SplitPairs",
    "TCPairs",
    "find_episodes",
]
