"""From trajectories in a replay buffer to the pairs that train TC- and L-network."""

from toponav.data.chunks import Chunks as Chunks
from toponav.data.episode_sampler import (
    DrawRule as DrawRule,
    EpisodeSampler as EpisodeSampler,
    SplitPairs as SplitPairs,
)
from toponav.data.episodes import Episodes as Episodes, find_episodes as find_episodes
from toponav.data.held_out import HeldOut as HeldOut, PairSet as PairSet
from toponav.data.pair_rules import LPairs as LPairs, TCPairs as TCPairs
from toponav.data.pair_sources import DrawnPairs as DrawnPairs, MinedPairs as MinedPairs
