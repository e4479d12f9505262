"""The schemas of the networks (``conf/model``) and of the pairs that train them."""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import Settings, at_least, between, one_of, require


@dataclass
class ModelConfig(Settings):
    """The TC-network and the L-network (``conf/model``)."""

    group = "model"
    encoder: str = one_of("small", "resnet18")
    embedding_dim: int = at_least(1)
    batch_norm: bool = MISSING
    share_encoder: bool = MISSING
    comparator: str = one_of("concat", "difference")
    projection_dim: int = at_least(1)
    comparator_hidden: list[int] = MISSING
    locomotion_hidden: list[int] = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
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
class PairsConfig(Settings):
    """Which pairs of views train the networks."""

    group = "pairs"
    k: int = at_least(1)
    m: int = at_least(2)
    locomotion_k: int = at_least(1)
    other_episode_share: float = between(0, 1)
    mined: bool = MISSING
    per_update: int = at_least(1)
    episodes: int = at_least(1)
    chunks: int = at_least(1)
    chunk_len: int = at_least(1)

    def __post_init__(self) -> None:
        super().__post_init__()
        longest = max(self.k, self.locomotion_k)
        require(
            not self.mined or self.chunk_len > longest,
            "pairs.chunk_len must be more than pairs.k and pairs.locomotion_k, "
            f"{longest}",
            self.chunk_len,
        )

    def longest(self, m: int) -> int:
        """Most decisions between the views of a pair, if M is ``m``."""
        return max(self.k * m, self.locomotion_k)
