"""From trajectories in a replay buffer to the pairs that train TC- and L-network."""

from toponav.data.compact_replay import CompactReplay as CompactReplay
from toponav.data.episodes import Episodes as Episodes, find_episodes as find_episodes
from toponav.data.held_out import HeldOut as HeldOut, PairSet as PairSet
from toponav.data.pair_rules import LPairs as LPairs, TCPairs as TCPairs
from toponav.data.pair_sources import (
    Chunks as Chunks,
    DrawnPairs as DrawnPairs,
    DrawRule as DrawRule,
    EpisodeSampler as EpisodeSampler,
    MinedPairs as MinedPairs,
    SplitPairs as SplitPairs,
)
from toponav.data.slice_replay import MASK as MASK, SliceReplay as SliceReplay
