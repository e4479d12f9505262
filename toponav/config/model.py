"""The schemas of the networks (``conf/model``) and of the pairs that train them."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import require, require_at_least, require_choice


@dataclass
class ModelConfig:
    """The TC-network and the L-network (``conf/model``)."""

    encoder: str = MISSING
    embedding_dim: int = MISSING
    batch_norm: bool = MISSING
    share_encoder: bool = MISSING
    comparator: str = MISSING
    projection_dim: int = MISSING
    comparator_hidden: list[int] = MISSING
    locomotion_hidden: list[int] = MISSING

    def __post_init__(self) -> None:
        require_choice("model.encoder", self.encoder, ("small", "resnet18"))
        require_choice("model.comparator", self.comparator, ("concat", "difference"))
        for name in ("embedding_dim", "projection_dim"):
            require_at_least(f"model.{name}", getattr(self, name), 1)
        require(
            min(self.comparator_hidden, default=0) >= 1,
            "model.comparator_hidden must be a list of widths of at least 1",
            self.comparator_hidden,
        )
        require(
            min(self.locomotion_hidden, default=1) >= 1,
            "model.locomotion_hidden must hold widths of at least 1",
            self.locomotion_hidden,
        )
        require(
            self.batch_norm or self.encoder == "small",
            "model.batch_norm must be true with the encoder resnet18",
            self.batch_norm,
        )

    @property
    def halve(self) -> bool:
        """Whether views are halved for the networks: all that `small` looks at."""
        return self.encoder == "small"


@dataclass
class PairsConfig:
    """Which pairs of views train the networks."""

    k: int = MISSING
    m: int = MISSING
    locomotion_k: int = MISSING
    other_episode_share: float = MISSING
    mined: bool = MISSING
    per_update: int = MISSING
    episodes: int = MISSING
    chunks: int = MISSING
    chunk_len: int = MISSING

    def __post_init__(self) -> None:
        names = ("k", "locomotion_k", "per_update", "episodes", "chunks", "chunk_len")
        for name in names:
            require_at_least(f"pairs.{name}", getattr(self, name), 1)
        require_at_least("pairs.m", self.m, 2)
        require(
            0 <= self.other_episode_share <= 1,
            "pairs.other_episode_share must lie in [0, 1]",
            self.other_episode_share,
        )
        longest = max(self.k, self.locomotion_k)
        require(
            not self.mined or self.chunk_len > longest,
            "pairs.chunk_len must be more than pairs.k and pairs.locomotion_k, "
            f"{longest}",
            self.chunk_len,
        )
